"""Meshes of some cells of a mesh, and volumes of cells, from their arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import _native
from ._call import error
from ._errors import ArgumentError, MissingItemError

if TYPE_CHECKING:
    import numpy.typing as npt

#: First number of a side of the box in `face_cells`, and the number of an unknown side.
FIRST_SIDE, UNKNOWN_SIDE = 2**32 - 7, 2**32 - 1

#: Fields that hold numbers of cells: the length of their rows, and the columns that are cells.
CELL_FIELDS = {"horizon_faces": (2, [0, 1]), "surface_faces": (3, [1, 2])}
#: Fields of sets of faces, which are lists of nodes; meshes of some cells have none.
FACE_SET_FIELDS = ("face_set_names", "face_sets")


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
    """Returns the mesh of the cells with these numbers, with their data and only the points that they use."""
    kind, points, cells, point_data, cell_data, fields = mesh.parts()
    new_numbers = np.full(mesh.n_cells, -1, dtype=np.int64)
    new_numbers[numbers] = np.arange(len(numbers))
    if len(cells) == 1:
        used, corners = _renumbered(cells[0][numbers])
        selected = [corners]
    else:
        used, selected = _select_faces(cells, numbers, new_numbers)
    return _native.Mesh(
        kind,
        points[used],
        selected,
        [(name, values[used]) for name, values in point_data],
        [(name, values[numbers]) for name, values in cell_data],
        [
            (name, _renumbered_field(name, value, new_numbers))
            for name, value in fields
            if name not in FACE_SET_FIELDS
        ],
    )


def _renumbered(points: npt.NDArray[np.uint32]) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint32]]:
    """Returns the points that are used, and the array with their new numbers."""
    used, inverse = np.unique(points, return_inverse=True)
    return used, inverse.reshape(points.shape).astype(np.uint32)


def _select_faces(
    cells: list[npt.NDArray[Any]], numbers: npt.NDArray[np.int64], new_numbers: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.uint32], list[npt.NDArray[Any]]]:
    """Returns the points that Voronoi cells use, and the arrays of these cells."""
    items, offsets, face_cells, sites, region, on_feature = cells
    first = new_numbers[face_cells[:, 0]]
    is_inner = face_cells[:, 1] < FIRST_SIDE
    second = face_cells[:, 1].astype(np.int64)
    # A face whose other cell is not selected becomes a face on an unknown side.
    beyond = new_numbers[face_cells[is_inner, 1]]
    second[is_inner] = np.where(beyond < 0, UNKNOWN_SIDE, beyond)
    # The owner of a face has the lower number.
    flipped = (first < 0) & (second < FIRST_SIDE) | (first > second) & (second < FIRST_SIDE)
    first, second = np.where(flipped, second, first), np.where(flipped, first, second)
    second[second < 0] = UNKNOWN_SIDE
    kept = np.flatnonzero(first >= 0)
    # Faces between cells come first; both kinds are sorted by their cells.
    order = kept[np.lexsort((second[kept], first[kept], second[kept] >= FIRST_SIDE))]
    starts, sizes = offsets[:-1].astype(np.int64)[order], _sizes(offsets)[order]
    ends = np.cumsum(sizes)
    within = np.arange(ends[-1]) - np.repeat(ends - sizes, sizes)
    # A face with another owner is seen from the other side.
    within = np.where(np.repeat(flipped[order], sizes), np.repeat(sizes, sizes) - 1 - within, within)
    used, rings = _renumbered(items[np.repeat(starts, sizes) + within])
    pairs = np.stack([first[order], second[order]], axis=1).astype(np.uint32)
    new_offsets = np.concatenate([[0], ends]).astype(np.uint32)
    return used, [rings, new_offsets, pairs, sites[numbers], region[numbers], on_feature[order]]


def _sizes(offsets: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Returns the lengths of lists from their offsets."""
    ends = offsets.astype(np.int64)
    return np.asarray(ends[1:] - ends[:-1], dtype=np.int64)


def _renumbered_field(
    name: str, value: str | npt.NDArray[Any], new_numbers: npt.NDArray[np.int64]
) -> str | npt.NDArray[Any]:
    """Returns the field with new numbers of cells, without the rows of cells that are not selected."""
    if name not in CELL_FIELDS or isinstance(value, str):
        return value
    width, columns = CELL_FIELDS[name]
    rows: npt.NDArray[np.int64] = value.reshape(-1, width).astype(np.int64)
    rows[:, columns] = np.sort(new_numbers[rows[:, columns]], axis=1)
    return rows[rows[:, columns[0]] >= 0].ravel()


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
