"""Labelled surfaces of a mesh: faults, horizons, the boundary of an object."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from . import _native
from ._call import error
from ._errors import MissingItemError

if TYPE_CHECKING:
    import numpy.typing as npt
    from typing_extensions import Unpack

    from ._image import Volume
    from ._options import SurfaceOptions


class Surface:
    """One surface and its measures: triangles, or in the plane the segments of a curve.

    Attributes
    ----------
    measures : dict
        Measures of the surface: `kind`, `area`, `dip` and `strike` (degrees), `adjacent_surfaces` ... Lengths and areas
        have the units of the mesh.

    Examples
    --------
    >>> import atomesh, numpy as np
    >>> labels = np.ones((20, 20, 20), dtype=np.uint8)
    >>> labels[:, :, 10:] = 2
    >>> surface = atomesh.mesh(labels, feature="labels", distance=5).surfaces[0]
    >>> round(surface.measures["area"])
    361
    """

    def __init__(self, surfaces: Surfaces, number: int, measures: Mapping[str, Any]) -> None:
        self._all, self._number = surfaces, number
        #: Measures of the surface: `kind`, `area`, `dip`, `strike`, `adjacent_surfaces` ...
        self.measures: dict[str, Any] = dict(measures)

    @property
    def name(self) -> str:
        """The kind and the number of the surface, such as fault1."""
        return self._all._native.names[self._number]

    @property
    def kind(self) -> str:
        """The kind of the surface: fault, horizon, interface ..."""
        return str(self.measures.get("kind", self.name.rstrip("0123456789")))

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """The points of all surfaces of the mesh, float64 of shape (n, 3), in the plane (n, 2), in the units
        of the mesh.
        """
        return self._all.points

    @property
    def faces(self) -> npt.NDArray[np.uint32]:
        """The faces: indices of `points`, uint32 of shape (m, 3), in the plane (m, 2)."""
        start = self._all._native.start
        return self._all._native.faces[start[self._number] : start[self._number + 1]]

    def to_pyvista(self) -> Any:
        """Converts the surface to PyVista.

        Returns
        -------
        pyvista.PolyData
            The surface, with only the points that it uses.

        Raises
        ------
        ImportError
            If PyVista is not installed.
        """
        return _polydata(self.points, self.faces).clean()

    def __repr__(self) -> str:
        return f"<atomesh.Surface {self.name}: {len(self.faces)} faces>"


class Surfaces(Sequence[Surface]):
    """Surfaces, the largest first. All share the array `points`.

    Surfaces are a sequence: `len`, iteration, indices and slices work. A name is also an index: `surfaces["fault1"]`.
    The interface of two regions can be named without its kind: `surfaces["1_2"]` is `surfaces["interface_1_2"]`.

    Attributes
    ----------
    report : dict
        The report of the verb.

    Examples
    --------
    >>> import atomesh, numpy as np
    >>> labels = np.ones((20, 20, 20), dtype=np.uint8)
    >>> labels[:, :, 10:] = 2
    >>> surfaces = atomesh.mesh(labels, feature="labels", distance=5).surfaces()
    >>> surfaces
    <atomesh.Surfaces: interface_1_2>
    >>> "1_2" in surfaces
    True
    """

    def __init__(
        self, native: _native.Surfaces, report: Mapping[str, Any], kinds: Sequence[str] | None = None
    ) -> None:
        self._native = native
        self.report: dict[str, Any] = dict(report)
        measures = report.get("surfaces") or [{}] * len(native.names)
        all_surfaces = [Surface(self, number, measures[number]) for number in range(len(native.names))]
        self._selected = [surface for surface in all_surfaces if kinds is None or surface.kind in kinds]

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """The points of all surfaces: a read-only float64 array of shape (n, 3), in the plane (n, 2), without
        a copy.
        """
        return self._native.points

    @property
    def names(self) -> list[str]:
        """The names of the surfaces, in their order."""
        return [surface.name for surface in self._selected]

    @overload
    def __getitem__(self, index: int | str) -> Surface: ...
    @overload
    def __getitem__(self, index: slice) -> list[Surface]: ...
    def __getitem__(self, index: int | str | slice) -> Surface | list[Surface]:
        if isinstance(index, slice):
            return self._selected[index]
        count = len(self._selected)
        if isinstance(index, str):
            for surface in self._selected:
                if surface.name in (index, f"interface_{index}"):
                    return surface
        elif -count <= index < count:
            return self._selected[index]
        names = ", ".join(self.names)
        remedy = f"give one of {names}, or a number below {count}" if names else "this mesh has no such surfaces"
        raise error(f"surfaces[{index!r}]", "there is no such surface", remedy, MissingItemError)

    def __contains__(self, item: object) -> bool:
        if isinstance(item, str):
            return any(surface.name in (item, f"interface_{item}") for surface in self._selected)
        return item in self._selected

    def __len__(self) -> int:
        return len(self._selected)

    def __iter__(self) -> Iterator[Surface]:
        return iter(self._selected)

    def to_pyvista(self) -> Any:
        """Converts all surfaces to PyVista.

        Returns
        -------
        pyvista.PolyData
            The surfaces, with the cell arrays `surface` (from 1), `dip`, `strike` (degrees), `area` ...

        Raises
        ------
        ImportError
            If PyVista is not installed.
        """
        numbers = [surface._number for surface in self._selected]
        start = self._native.start
        faces = np.array([face for n in numbers for face in range(start[n], start[n + 1])], dtype=int)
        data = _polydata(self.points, self._native.faces[faces])
        sizes = [start[n + 1] - start[n] for n in numbers]
        data.cell_data["surface"] = np.repeat(np.array(numbers, dtype=np.int32) + 1, sizes)
        for name, values in self._native.cell_data.items():
            data.cell_data[name] = np.array(values[faces])
        return data.clean()

    def __repr__(self) -> str:
        return f"<atomesh.Surfaces: {', '.join(surface.name for surface in self._selected) or 'none'}>"


class SurfacesOfMesh(Sequence[Surface]):
    """The surfaces of a mesh: a sequence, and a function that takes options.

    `mesh.surfaces` is the sequence of all surfaces with default options, which are extracted at the first use.
    `mesh.surfaces(...)` extracts surfaces with options.
    """

    def __init__(self, extract: Callable[..., Surfaces], default: Callable[[], Surfaces]) -> None:
        self._extract = extract
        self._default = default

    def __call__(
        self, kind: str | Sequence[str] | None = None, image: Volume | None = None, **options: Unpack[SurfaceOptions]
    ) -> Surfaces:
        """Groups the faces on features into labelled surfaces: `atomesh surface`.

        Parameters
        ----------
        kind
            The kind of the surfaces that are returned, such as "fault" or "horizon"; by default all.
        image
            An image; faces on its features are used and not those that the mesh declares.
        **options
            Options of the verb; `atomesh.options("surface")` lists them.

        Returns
        -------
        Surfaces
            The surfaces.

        Examples
        --------
        >>> import atomesh
        >>> image = atomesh.synth("faults", dims=(48, 44, 40), count=1)
        >>> mesh = atomesh.mesh(image, distance=6, feature="ridges")
        >>> mesh.surfaces(kind="fault")[0].kind
        'fault'
        """
        return self._extract(kind, image, **options)

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """The points of all surfaces: a read-only float64 array of shape (n, 3), in the plane (n, 2), without
        a copy.
        """
        return self._default().points

    @property
    def names(self) -> list[str]:
        """The names of the surfaces, in their order."""
        return self._default().names

    @property
    def report(self) -> dict[str, Any]:
        """The report of the verb `surface`, a dict."""
        return self._default().report

    @overload
    def __getitem__(self, index: int | str) -> Surface: ...
    @overload
    def __getitem__(self, index: slice) -> list[Surface]: ...
    def __getitem__(self, index: int | str | slice) -> Surface | list[Surface]:
        return self._default()[index]

    def __len__(self) -> int:
        return len(self._default())

    def __iter__(self) -> Iterator[Surface]:
        return iter(self._default())

    def __contains__(self, item: object) -> bool:
        return item in self._default()

    def to_pyvista(self) -> Any:
        """Converts all surfaces to PyVista.

        Returns
        -------
        pyvista.PolyData
            The surfaces, with the cell arrays `surface` (from 1), `dip`, `strike` (degrees), `area` ...

        Raises
        ------
        ImportError
            If PyVista is not installed.
        """
        return self._default().to_pyvista()

    def __repr__(self) -> str:
        return repr(self._default())


def _polydata(points: npt.NDArray[np.float64], faces: npt.NDArray[np.uint32]) -> Any:
    import pyvista

    width = faces.shape[1]
    cells = np.hstack([np.full((len(faces), 1), width), faces.astype(np.int64)]).ravel()
    if width == 2:
        return pyvista.PolyData(np.array(points), lines=cells)
    return pyvista.PolyData(np.array(points), faces=cells)
