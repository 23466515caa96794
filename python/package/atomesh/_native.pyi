"""The extension module: runs verbs on meshes and images in memory."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

__version__: str

class Error(Exception):
    """An error: the place, the problem and the remedy."""

    #: The file, argument or item that is at fault.
    place: str
    #: What is wrong.
    problem: str
    #: What to do.
    remedy: str
    #: The kind of the error: "Io", "Image", "Mesh", "Usage" ...
    kind: str

#: Arrays, or field values, by name.
_Named = Sequence[tuple[str, Any]]

class Mesh:
    def __init__(
        self,
        kind: str,
        nodes: npt.NDArray[np.float64],
        cells: Sequence[npt.NDArray[Any]],
        point_data: _Named,
        cell_data: _Named,
        fields: _Named,
    ) -> None: ...
    def parts(
        self,
    ) -> tuple[
        str,
        npt.NDArray[np.float64],
        list[npt.NDArray[Any]],
        list[tuple[str, npt.NDArray[Any]]],
        list[tuple[str, npt.NDArray[Any]]],
        list[tuple[str, str | npt.NDArray[Any]]],
    ]: ...
    @staticmethod
    def read(path: Path) -> Mesh: ...
    def write(self, path: Path) -> None: ...
    @property
    def kind(self) -> str: ...
    @property
    def n_cells(self) -> int: ...
    def take_cells(self, cells: npt.NDArray[np.uint32]) -> Mesh: ...
    @property
    def points(self) -> npt.NDArray[np.float64]: ...
    @property
    def simplices(self) -> npt.NDArray[np.uint32] | None: ...
    @property
    def corners(self) -> list[npt.NDArray[Any]] | None: ...
    @property
    def faces(self) -> list[npt.NDArray[Any]] | None: ...
    @property
    def feature_faces(self) -> npt.NDArray[np.uint32]: ...
    @property
    def point_data(self) -> dict[str, npt.NDArray[Any]]: ...
    @property
    def cell_data(self) -> dict[str, npt.NDArray[Any]]: ...
    @property
    def fields(self) -> dict[str, Any]: ...

class Image:
    def __init__(
        self,
        samples: npt.NDArray[np.float32],
        place: tuple[Sequence[float], Sequence[Sequence[float]], Sequence[str]],
        names: Sequence[str],
        encoding: str,
        labels: tuple[list[int], npt.NDArray[np.uint32]] | None,
        missing: npt.NDArray[np.bool_] | None = None,
        dead: npt.NDArray[np.bool_] | None = None,
    ) -> None: ...
    def parts(self) -> tuple[Any, ...]: ...
    @property
    def samples(self) -> npt.NDArray[np.float32]: ...
    @property
    def place(self) -> tuple[list[float], list[list[float]], list[str]]: ...

class Surfaces:
    def __init__(
        self,
        points: npt.NDArray[np.float64],
        faces: npt.NDArray[np.uint32],
        start: Sequence[int],
        names: Sequence[str],
        cell_data: _Named,
    ) -> None: ...
    @property
    def points(self) -> npt.NDArray[np.float64]: ...
    @property
    def faces(self) -> npt.NDArray[np.uint32]: ...
    @property
    def start(self) -> list[int]: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def cell_data(self) -> dict[str, npt.NDArray[Any]]: ...

def run(
    verb: str,
    arguments: Sequence[str],
    options: Mapping[str, Any],
    objects: Mapping[str, Mesh | Image],
    on_event: Callable[[str, float, str], object] | None,
    threads: int | None,
) -> dict[str, Any]: ...
def describe() -> str: ...
def export_formats() -> list[tuple[str, str, list[str]]]: ...
