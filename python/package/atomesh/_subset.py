"""Meshes of some cells of a mesh, and volumes of cells, from their arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import _native
from ._call import error
from ._errors import ArgumentError, MissingItemError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from ._mesh import Mesh


def cell_numbers(selection: Any, count: int) -> npt.NDArray[np.int64]:
    """Returns the numbers of the selected cells.

    Parameters
    ----------
    selection
        A mask, numbers of cells (negative ones count from the end), or a slice.
    count
        The number of cells.
    """
    if isinstance(selection, slice):
        numbers = np.arange(count)[selection]
    else:
        array = np.atleast_1d(np.asarray(selection))
        if array.size == 0:
            numbers = np.zeros(0, dtype=np.int64)
        elif array.ndim != 1 or not (array.dtype == bool or np.issubdtype(array.dtype, np.integer)):
            problem = f"an array of {array.dtype} of shape {array.shape} does not select cells"
            raise error("mesh[cells]", problem, "give a mask of cells, or their numbers", ArgumentError)
        elif array.dtype == bool:
            if len(array) != count:
                problem = f"the mask has {len(array)} values, but the mesh has {count} cells"
                raise error("mesh[cells]", problem, "give one value per cell", MissingItemError)
            numbers = np.flatnonzero(array)
        else:
            numbers = array.astype(np.int64)
            outside = (numbers < -count) | (numbers >= count)
            if outside.any():
                problem = f"there is no cell {numbers[outside][0]}"
                raise error("mesh[cells]", problem, f"give numbers below {count}", MissingItemError)
            numbers = np.where(numbers < 0, numbers + count, numbers)
    if len(numbers) == 0:
        raise error("mesh[cells]", "no cell is selected", "select at least one cell")
    if len(np.unique(numbers)) < len(numbers):
        raise error("mesh[cells]", "a cell is selected twice", "give each number once")
    return numbers


def select_cells(mesh: _native.Mesh, numbers: npt.NDArray[np.int64]) -> _native.Mesh:
    """Returns the mesh of the cells with these numbers, with their data, names and sets, and only the points that
    they use.
    """
    return mesh.take_cells(numbers.astype(np.uint32))


def named_cells(names: str | Sequence[str], mesh: Mesh) -> npt.NDArray[np.bool_]:
    """Returns a mask of the cells of some regions, by name, or of sets of cells."""
    mask = np.zeros(mesh.n_cells, dtype=bool)
    numbers = mesh.cell_data.get("region")
    for name in [names] if isinstance(names, str) else names:
        found = [region for region in mesh.regions if name in (region.name, str(region.label))]
        members = mesh.cell_data.get(f"cell_set:{name}")
        if members is not None:
            mask |= members.astype(bool)
        elif found and numbers is not None:
            mask |= np.isin(numbers, [region.region for region in found])
        else:
            known = [region.name or str(region.region) for region in mesh.regions]
            known += [key.removeprefix("cell_set:") for key in mesh.cell_data if key.startswith("cell_set:")]
            problem = f"there is no region and no set of cells {name!r}"
            raise error("mesh[cells]", problem, f"give one of {', '.join(known)}", MissingItemError)
    return mask


def _sizes(offsets: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Returns the lengths of lists from their offsets."""
    ends = offsets.astype(np.int64)
    return np.asarray(ends[1:] - ends[:-1], dtype=np.int64)


def cell_volumes(mesh: _native.Mesh) -> npt.NDArray[np.float64]:
    """Returns the volume of each cell, in the plane its area."""
    points, simplices = mesh.points, mesh.simplices
    if simplices is not None:
        corners = points[simplices]
        volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / (6 if corners.shape[1] == 4 else 2)
        return np.asarray(np.abs(volumes), dtype=np.float64)
    faces = mesh.faces
    assert faces is not None
    items, offsets, face_cells, sites = faces
    sizes = _sizes(offsets)
    starts = offsets[:-1].astype(np.int64)
    # Positions relative to a point of the mesh, so that large coordinates cost no digits.
    points = points - sites[0]
    if points.shape[1] == 2:
        p, q = points[items[starts]], points[items[starts + 1]]
        sums = 0.5 * (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    else:
        p = points[items]
        following = np.arange(len(items)) + 1
        following[starts + sizes - 1] = starts
        q = p[following]
        centres = np.add.reduceat(p, starts) / sizes[:, None]
        faces_of_items = np.repeat(np.arange(len(sizes)), sizes)
        fan = np.einsum("ij,ij->i", centres[faces_of_items], np.cross(p, q)) / 6
        sums = np.add.reduceat(fan, starts)
    count = len(sites)
    volumes = np.bincount(face_cells[:, 0], sums, count)
    inner = face_cells[:, 1] < count
    return np.asarray(volumes - np.bincount(face_cells[inner, 1], sums[inner], count), dtype=np.float64)
