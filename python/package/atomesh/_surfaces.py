"""Labelled surfaces of a mesh: faults, horizons, the boundary of an object."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from . import _native

if TYPE_CHECKING:
    import numpy.typing as npt


class Surface:
    """One surface: triangles, in the plane the segments of a curve, with what is known of it."""

    def __init__(self, all_of_them: Surfaces, number: int, measures: Mapping[str, Any]) -> None:
        self._all, self._number = all_of_them, number
        #: What is known of it: `kind`, `area`, `dip`, `strike`, `meets` ...
        self.measures: dict[str, Any] = dict(measures)

    @property
    def name(self) -> str:
        """Its kind and number, such as fault1."""
        return self._all._native.names[self._number]

    @property
    def kind(self) -> str:
        """fault, horizon, ..."""
        return str(self.measures.get("kind", self.name.rstrip("0123456789")))

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """The points of all surfaces, shape (n, 3)."""
        return self._all.points

    @property
    def faces(self) -> npt.NDArray[np.uint32]:
        """The points of each face, shape (m, 3), in the plane (m, 2)."""
        start = self._all._native.start
        return self._all._native.faces[start[self._number] : start[self._number + 1]]

    def to_pyvista(self) -> Any:
        """A pyvista.PolyData."""
        return _polydata(self.points, self.faces).clean()

    def __repr__(self) -> str:
        return f"<atomesh.Surface {self.name}: {len(self.faces)} faces>"


class Surfaces(Sequence[Surface]):
    """Surfaces, the largest first; `points` are shared by all."""

    def __init__(
        self, native: _native.Surfaces, report: Mapping[str, Any], kinds: Sequence[str] | None = None
    ) -> None:
        self._native = native
        self.report: dict[str, Any] = dict(report)
        measures = report.get("surfaces") or [{}] * len(native.names)
        everyone = [Surface(self, number, measures[number]) for number in range(len(native.names))]
        self._some = [one for one in everyone if kinds is None or one.kind in kinds]

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """The points of all surfaces, shape (n, 3); read-only, no copy."""
        return self._native.points

    @overload
    def __getitem__(self, index: int) -> Surface: ...
    @overload
    def __getitem__(self, index: slice) -> list[Surface]: ...
    def __getitem__(self, index: int | slice) -> Surface | list[Surface]:
        return self._some[index]

    def __len__(self) -> int:
        return len(self._some)

    def __iter__(self) -> Iterator[Surface]:
        return iter(self._some)

    def to_pyvista(self) -> Any:
        """A pyvista.PolyData with the cell arrays `surface`, `dip`, `strike`, `area` ..."""
        numbers = [one._number for one in self._some]
        start = self._native.start
        chosen = np.array([face for n in numbers for face in range(start[n], start[n + 1])], dtype=int)
        data = _polydata(self.points, self._native.faces[chosen])
        sizes = [start[n + 1] - start[n] for n in numbers]
        data.cell_data["surface"] = np.repeat(np.array(numbers, dtype=np.int32) + 1, sizes)
        for name, values in self._native.cell_data.items():
            data.cell_data[name] = np.array(values[chosen])
        return data.clean()

    def __repr__(self) -> str:
        return f"<atomesh.Surfaces: {', '.join(one.name for one in self._some) or 'none'}>"


def _polydata(points: npt.NDArray[np.float64], faces: npt.NDArray[np.uint32]) -> Any:
    import pyvista

    width = faces.shape[1]
    cells = np.hstack([np.full((len(faces), 1), width), faces.astype(np.int64)]).ravel()
    if width == 2:
        return pyvista.PolyData(np.array(points), lines=cells)
    return pyvista.PolyData(np.array(points), faces=cells)
