"""Labelled surfaces of a mesh: faults, horizons, the boundary of an object."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from . import _native

if TYPE_CHECKING:
    import numpy.typing as npt


class Surface:
    """One surface and its measures: triangles, or in the plane the segments of a curve."""

    def __init__(self, surfaces: Surfaces, number: int, measures: Mapping[str, Any]) -> None:
        self._all, self._number = surfaces, number
        #: Measures of the surface: `kind`, `area`, `dip`, `strike`, `meets` ...
        self.measures: dict[str, Any] = dict(measures)

    @property
    def name(self) -> str:
        """The kind and the number of the surface, such as fault1."""
        return self._all._native.names[self._number]

    @property
    def kind(self) -> str:
        """The kind of the surface: fault, horizon ..."""
        return str(self.measures.get("kind", self.name.rstrip("0123456789")))

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """The points of all surfaces, an array of shape (n, 3)."""
        return self._all.points

    @property
    def faces(self) -> npt.NDArray[np.uint32]:
        """The points of each face, an array of shape (m, 3), in the plane (m, 2)."""
        start = self._all._native.start
        return self._all._native.faces[start[self._number] : start[self._number + 1]]

    def to_pyvista(self) -> Any:
        """Returns a pyvista.PolyData of the surface."""
        return _polydata(self.points, self.faces).clean()

    def __repr__(self) -> str:
        return f"<atomesh.Surface {self.name}: {len(self.faces)} faces>"


class Surfaces(Sequence[Surface]):
    """Surfaces, the largest first. All share the array `points`."""

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
        """The points of all surfaces: a read-only array of shape (n, 3), without a copy."""
        return self._native.points

    @overload
    def __getitem__(self, index: int) -> Surface: ...
    @overload
    def __getitem__(self, index: slice) -> list[Surface]: ...
    def __getitem__(self, index: int | slice) -> Surface | list[Surface]:
        return self._selected[index]

    def __len__(self) -> int:
        return len(self._selected)

    def __iter__(self) -> Iterator[Surface]:
        return iter(self._selected)

    def to_pyvista(self) -> Any:
        """Returns a pyvista.PolyData with the cell arrays `surface`, `dip`, `strike`, `area` ..."""
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


def _polydata(points: npt.NDArray[np.float64], faces: npt.NDArray[np.uint32]) -> Any:
    import pyvista

    width = faces.shape[1]
    cells = np.hstack([np.full((len(faces), 1), width), faces.astype(np.int64)]).ravel()
    if width == 2:
        return pyvista.PolyData(np.array(points), lines=cells)
    return pyvista.PolyData(np.array(points), faces=cells)
