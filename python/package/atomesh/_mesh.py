"""Meshes, and what is done with them."""

from __future__ import annotations

import base64
import functools
import html
import json
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from . import _native
from ._call import Answer, call, error, options_of
from ._image import NAME, Image, read
from ._surfaces import Surfaces

if TYPE_CHECKING:
    import numpy.typing as npt
    from typing_extensions import Unpack

    from ._call import Progress
    from ._image import Volume
    from ._options import (
        ColumnsOptions,
        EditOptions,
        ExportOptions,
        FlowOptions,
        MeshOptions,
        PaintOptions,
        QualityOptions,
        ReportOptions,
        SegmentOptions,
        SurfaceOptions,
    )

    #: x, y, z; in the plane x, y.
    Point = Sequence[float]
    #: Points, or points with rates in m^3/s.
    Wells = Union[Point, Sequence[Point], Mapping[tuple[float, ...], float], Sequence[str], str]

#: The name under which verbs know the mesh of a call, and that of a mesh that they make.
MESH, MADE = "<mesh>", "<result>.vtu"
FACETS = "<surfaces>.vtp"


class Picture:
    """A picture as PNG; notebooks show it."""

    def __init__(self, png: bytes) -> None:
        self.png = png

    def _repr_png_(self) -> bytes:
        return self.png

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the PNG."""
        Path(path).write_bytes(self.png)


class Mesh:
    """A mesh in the image's physical coordinates, with all that is known of it.

    Arrays are NumPy's, read-only, without copies of what the mesh holds.
    """

    def __init__(
        self,
        native: _native.Mesh,
        answer: Answer | None = None,
        image: Image | Callable[[], Image] | None = None,
    ) -> None:
        self._native = native
        self._image = image
        self._text = answer.text if answer else ""
        self._said: dict[str, Any] = answer.report if answer else {}
        self._measured: dict[str, Any] | None = None
        #: Whether it was stopped before its end: then it is what there was by then.
        self.interrupted: bool = bool(answer and answer.interrupted)

    # What it holds

    @property
    def kind(self) -> str:
        """What its cells are: "tetra", "triangle", "polyhedron" or "polygon"."""
        return self._native.kind

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return self._native.n_cells

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """Positions in physical coordinates, shape (n, 3), in the plane (n, 2)."""
        return self._native.points

    @property
    def cells(self) -> npt.NDArray[np.uint32] | list[npt.NDArray[np.uint32]]:
        """The points of each cell: shape (m, 4) of tetrahedra, (m, 3) of triangles; of Voronoi cells a list
        of arrays, in the plane in order round the cell."""
        simplices = self._native.simplices
        if simplices is not None:
            return simplices
        corners, ends = self._corners()
        return np.split(corners, ends[:-1].astype(np.int64))

    def _corners(self) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint64]]:
        corners = self._native.corners
        assert corners is not None
        return corners[0], corners[1]

    @property
    def feature_faces(self) -> npt.NDArray[np.uint32]:
        """The faces that lie on features, each once: points of triangles, shape (k, 3); in the plane edges,
        shape (k, 2)."""
        return self._native.feature_faces

    @property
    def faces(self) -> list[npt.NDArray[np.uint32]]:
        """Of Voronoi cells the points of each face in order round it; faces between cells come first."""
        items, offsets, _, _ = self._voronoi()
        return np.split(items, offsets[1:-1].astype(np.int64))

    @property
    def face_cells(self) -> npt.NDArray[np.uint32]:
        """Of Voronoi cells the two cells of each face, shape (f, 2); from `2**32 - 7` on, the second is a
        side of the box: xmin, xmax, ymin ..."""
        return self._voronoi()[2]

    @property
    def sites(self) -> npt.NDArray[np.float64]:
        """Of Voronoi cells the point that each belongs to, shape (m, 3), in the plane (m, 2)."""
        return self._voronoi()[3]

    def _voronoi(self) -> list[npt.NDArray[Any]]:
        found = self._native.faces
        if found is None:
            raise error("the mesh", f"has no Voronoi cells but {self.kind} cells", "make it by atomesh.voronoi")
        return found

    @property
    def point_data(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays with a value, or a row, for each point."""
        return self._native.point_data

    @property
    def cell_data(self) -> dict[str, npt.NDArray[Any]]:
        """Arrays with a value, or a row, for each cell."""
        return self._native.cell_data

    @property
    def fields(self) -> dict[str, Any]:
        """What belongs to the whole mesh: units, version, parameters, where its lattice is ..."""
        return self._native.fields

    @property
    def image(self) -> Image | None:
        """The image that was meshed, if it is at hand; read anew if it was given as a file."""
        if callable(self._image):
            self._image = self._image()
        return self._image

    # How good it is

    @property
    def report(self) -> dict[str, Any]:
        """What the verb that made it reports: of `mesh` everything, of `flow` rates and balance ..."""
        return self._said

    @property
    def quality(self) -> dict[str, Any]:
        """Angles, sizes and shapes of the cells."""
        measured = self._said if self._said.get("quality") or self._said.get("voronoi") else self.measure()
        quality: dict[str, Any] = measured.get("quality") or measured["voronoi"]
        return quality

    @property
    def fidelity(self) -> dict[str, Any]:
        """How well faces lie on the image's features, and cover them; empty where that is not known."""
        return self._said.get("fidelity") or {}

    def measure(self, **options: Unpack[QualityOptions]) -> dict[str, Any]:
        """Quality, and with `truth` (as `synth` writes it) fidelity: `atomesh quality`."""
        if options or self._measured is None:
            answer = self._call("quality", [MESH], options)
            if options:
                return answer.report
            self._measured = answer.report
        return self._measured

    def validate(self) -> dict[str, Any]:
        """What our own checker, TetGen (or spade) and CGAL say: `atomesh validate`.

        Raises atomesh.Error if the mesh is not valid.
        """
        return self._call("validate", [MESH], {}).report

    # Out of it

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a .vtu file with all that is known of the mesh, for ParaView, `load` and the command line;
        for other programs see `export`."""
        if Path(path).suffix.lower() != ".vtu":
            raise error(os.fspath(path), "does not end in .vtu", "give such a name, or use export(format, path)")
        self._native.write(Path(path))

    def export(
        self, to: str, path: str | os.PathLike[str], *, threads: int | None = None, **options: Unpack[ExportOptions]
    ) -> dict[str, Any]:
        """The mesh for a simulator or another mesher: `atomesh export`. Gives the checks of the model.

        `to`: opm, grdecl, mrst, geos, openfoam, disv, msh ...; `atomesh.options("export")["to"]` lists them.
        """
        words = {"to": to, "output": os.fspath(path), **options}
        return self._call("export", [MESH], words, threads=threads).report

    def to_pyvista(self) -> Any:
        """A pyvista.UnstructuredGrid with all arrays; in the plane z = 0."""
        import pyvista

        if self.kind == "polyhedron":
            with tempfile.TemporaryDirectory(prefix="atomesh-") as folder:
                path = Path(folder) / "mesh.vtu"
                self.save(path)
                return pyvista.read(path)
        points = self._points_in_space()
        if self._native.simplices is not None:
            kind = pyvista.CellType.TETRA if self.kind == "tetra" else pyvista.CellType.TRIANGLE
            grid = pyvista.UnstructuredGrid({kind: self._native.simplices.astype(np.int64)}, points)
        else:
            corners, ends = self._corners()
            sizes = np.diff(ends.astype(np.int64), prepend=0)
            cells = np.insert(corners.astype(np.int64), np.concatenate([[0], ends[:-1]]).astype(np.int64), sizes)
            kinds = np.full(len(sizes), pyvista.CellType.POLYGON, dtype=np.uint8)
            grid = pyvista.UnstructuredGrid(cells, kinds, points)
        for name, values in self.point_data.items():
            grid.point_data[name] = np.array(values)
        for name, values in self.cell_data.items():
            grid.cell_data[name] = np.array(values)
        return grid

    def to_meshio(self) -> Any:
        """A meshio.Mesh with all arrays. meshio has polyhedra and polygons by their number of points: cells
        come in another order, which the cell array `cell` tells."""
        import meshio

        points = self._points_in_space()
        point_data = {name: np.array(values) for name, values in self.point_data.items()}
        if self._native.simplices is not None:
            cells: list[tuple[str, Any]] = [(self.kind, np.array(self._native.simplices))]
            data = {name: [np.array(values)] for name, values in self.cell_data.items()}
            return meshio.Mesh(points, cells, point_data, data)
        corners, ends = self._corners()
        sizes = np.diff(ends.astype(np.int64), prepend=0)
        polygons = self.kind == "polygon"
        of_cells = [] if polygons else self._faces_of_cells()
        cells, order = [], []
        every = self.cells
        for size in np.unique(sizes):
            numbers = np.flatnonzero(sizes == size)
            order.append(numbers)
            if polygons:
                cells.append(("polygon", np.array([every[i] for i in numbers])))
            else:
                cells.append((f"polyhedron{size}", [of_cells[i] for i in numbers]))
        data = {name: [values[numbers] for numbers in order] for name, values in self.cell_data.items()}
        data["cell"] = order
        return meshio.Mesh(points, cells, point_data, data)

    def _faces_of_cells(self) -> list[list[npt.NDArray[np.uint32]]]:
        """The faces of each polyhedron, outwards."""
        found: list[list[npt.NDArray[np.uint32]]] = [[] for _ in range(self.n_cells)]
        for ring, (owner, beyond) in zip(self.faces, self.face_cells.tolist()):
            found[owner].append(ring)
            if beyond < self.n_cells:
                found[beyond].append(ring[::-1])
        return found

    def _points_in_space(self) -> npt.NDArray[np.float64]:
        points = np.zeros((self.n_points, 3))
        points[:, : self.points.shape[1]] = self.points
        return points

    def plot(self, clip: bool = True, **options: Any) -> Any:
        """Draws it with PyVista: a corner cut away (`clip`), and the faces on features in it; `options` are
        those of pyvista.Plotter.show."""
        import pyvista

        grid = self.to_pyvista()
        plotter = pyvista.Plotter()
        flat = self.kind in ("triangle", "polygon")
        if clip and not flat:
            # The corner towards PyVista's camera.
            middle = 0.5 * (self.points.min(axis=0) + self.points.max(axis=0))
            in_corner = (grid.cell_centers().points > middle).all(axis=1)
            grid = grid.extract_cells(np.flatnonzero(~in_corner))
        plotter.add_mesh(grid, color="#dfe6ee", show_edges=True, edge_color="#8090a0", line_width=0.5)
        faces = self.feature_faces
        if len(faces):
            width = faces.shape[1]
            cells = np.hstack([np.full((len(faces), 1), width), faces.astype(np.int64)]).ravel()
            points = self._points_in_space()
            parts = {"lines": cells} if width == 2 else {"faces": cells}
            plotter.add_mesh(pyvista.PolyData(points, **parts), color="#d1495b", line_width=2)
        if flat:
            plotter.view_xy()
        return plotter.show(**options)

    def slice(
        self, image: Volume | None = None, at: Point | None = None, path: str | os.PathLike[str] | None = None
    ) -> Picture:
        """A picture of the mesh over its image: `atomesh slice`."""
        image = self._needs_image("slice", image)
        with tempfile.TemporaryDirectory(prefix="atomesh-") as folder:
            drawn = Path(folder) / "slice.png"
            held = {NAME: image._native, MESH: self._native}
            call("slice", [NAME, MESH], {"output": drawn, "at": at}, held)
            picture = Picture(drawn.read_bytes())
        if path is not None:
            picture.save(path)
        return picture

    def page(
        self, path: str | os.PathLike[str], image: Volume | None = None, **options: Unpack[ReportOptions]
    ) -> dict[str, Any]:
        """Writes a page to look at, one HTML file for any browser, and says how large it is: `atomesh report`.

        Its figures are those of `report` where the mesh was made here, else they are measured.
        """
        image = self._needs_image("page", image)
        with tempfile.TemporaryDirectory(prefix="atomesh-") as folder:
            words: dict[str, Any] = {"output": path, **options}
            if words.get("figures") is None and "verdict" in self._said:
                words["solver"] = Path(folder) / "report.json"
                words["solver"].write_text(json.dumps(self._said))
            return self._call("report", [NAME, MESH], words, {NAME: image._native}).report

    # What is made of it

    def surfaces(
        self, kind: str | Sequence[str] | None = None, image: Volume | None = None, **options: Unpack[SurfaceOptions]
    ) -> Surfaces:
        """Faces on features, grouped into labelled surfaces: `atomesh surface`.

        `kind`: only those of this kind, such as "fault" or "horizon". `image`: look for faces on the features
        of this image instead of those that the mesh declares.
        """
        held: dict[str, Any] = {}
        given = [MESH]
        if image is not None:
            given.append(NAME)
            held[NAME] = Image.of(image)._native
        answer = self._call("surface", given, {"output": FACETS, **options}, held, keep=[FACETS])
        kinds = [kind] if isinstance(kind, str) else kind
        return Surfaces(answer.kept[FACETS], answer.report, kinds)

    def flow(
        self,
        injectors: Wells | None = None,
        producers: Wells | None = None,
        *,
        progress: Progress = False,
        threads: int | None = None,
        **options: Unpack[FlowOptions],
    ) -> Mesh:
        """Steady flow from injectors to producers, or between sides with a `pressure`: `atomesh flow`.

        Gives the mesh, split along faults, with the cell arrays of pressure (Pa) and Darcy velocity (m/s), and
        a report. Wells are points, or a dict from points to rates in m^3/s.
        """
        words = {"source": injectors, "sink": producers, **options}
        return self._made("flow", [MESH], words, progress=progress, threads=threads)

    def paint(
        self, seed: Any = "auto", image: Volume | None = None, **options: Unpack[PaintOptions]
    ) -> Mesh:
        """Cells painted from seeds, within layers but not across surfaces, as the cell array `region`:
        `atomesh paint`. `seed`: points, a dict from points to regions, or "auto" for every block. Where `image`
        changes, paint flows less easily."""
        words: dict[str, Any] = {"seed": seed, **options}
        held = {}
        if image is not None:
            words["image"] = NAME
            held[NAME] = Image.of(image)._native
        return self._made("paint", [MESH], words, held)

    def segment(
        self, object: Any, background: Any, image: Volume | None = None, **options: Unpack[SegmentOptions]
    ) -> Mesh:
        """Object and background by a minimum cut on the cells, as the cell array `label`: `atomesh segment`.

        `object` and `background`: points, or boxes as pairs of points.
        """
        image = self._needs_image("segment", image)
        words = {"object": object, "background": background, **options}
        return self._made("segment", [NAME, MESH], words, {NAME: image._native}, image)

    def edit(
        self,
        add: Sequence[Point] | None = None,
        move: Mapping[int, Point] | None = None,
        remove: Sequence[int] | int | None = None,
        image: Volume | None = None,
        *,
        progress: Progress = False,
        **options: Unpack[EditOptions],
    ) -> Mesh:
        """Atoms added, moved and removed; only their neighbourhood changes: `atomesh edit`."""
        image = self._needs_image("edit", image)
        gone = [remove] if isinstance(remove, int) else remove
        words = {"add": add, "move": move, "remove": None if gone is None else [str(n) for n in gone], **options}
        return self._made("edit", [MESH, NAME], words, {NAME: image._native}, image, progress=progress)

    def columns(self, horizon: Sequence[Any], **options: Unpack[ColumnsOptions]) -> Mesh:
        """The Voronoi cells of a map, extended down through layers between horizons: `atomesh columns`.

        `horizon`: from the top down, each z as a number, a 2-D array of z, or a surface's file.
        """
        return self._made("columns", [MESH], {"horizon": list(horizon), **options})

    def _needs_image(self, verb: str, image: Volume | None) -> Image:
        if image is not None:
            return Image.of(image)
        if self.image is None:
            raise error(f"{verb}()", "needs the image that was meshed", "give image=")
        return self.image

    def _call(self, verb: str, given: Sequence[str], options: Mapping[str, Any], held: Any = None, **more: Any) -> Answer:
        return call(verb, given, options, {MESH: self._native, **(held or {})}, **more)

    def _made(
        self, verb: str, given: Sequence[str], options: Mapping[str, Any], held: Any = None,
        image: Image | None = None, **more: Any,
    ) -> Mesh:
        answer = self._call(verb, given, {"output": MADE, **options}, held, keep=[MADE], **more)
        return Mesh(answer.kept[MADE], answer, image or self._image)

    # How it shows

    def __repr__(self) -> str:
        head = f"<atomesh.Mesh: {self.n_points} points, {self.n_cells} {_PLURAL[self.kind]}>"
        table = self._text.split("\nwrote ")[0]
        return f"{head}\n{table}" if table else head

    def _repr_html_(self) -> str:
        picture = ""
        if self.image is not None:
            png = base64.b64encode(self.slice().png).decode()
            picture = f'<img src="data:image/png;base64,{png}" style="max-width:100%"/>'
        return f"{picture}<pre>{html.escape(repr(self))}</pre>"


_PLURAL = {"tetra": "tetrahedra", "triangle": "triangles", "polyhedron": "polyhedra", "polygon": "polygons"}


def load(path: str | os.PathLike[str], image: Volume | None = None) -> Mesh:
    """Reads a .vtu file that atomesh, meshio, VTK or ParaView wrote; `image` is the image that was meshed, for
    pictures and edits."""
    return Mesh(_native.Mesh.read(Path(path)), None, None if image is None else Image.of(image))


def mesh(
    volume: Volume,
    *,
    spacing: Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    units: str | Sequence[str] | None = None,
    progress: Progress = False,
    threads: int | None = None,
    **options: Unpack[MeshOptions],
) -> Mesh:
    """An image's mesh, aligned with its features: `atomesh mesh`.

    `volume`: a NumPy array of shape (nz, ny, nx), or (ny, nx); a file's path; an xarray.DataArray, a
    pyvista.ImageData, a SimpleITK or a nibabel image. `spacing`, `origin` (x, y, z) and `units` say where the
    samples of an array lie, or replace what the image says.

    `progress`: True, or a callable of the stage's name and the share of it that is done. Ctrl-C stops: what there
    is becomes the mesh (`interrupted` is True then), or KeyboardInterrupt is raised where there is none yet.

    Of the options the usual ones are `distance` (between atoms, in samples, "4:10" for a range), `feature`
    ("faults", "horizons", "edges", "labels" ...) and `beta`; `atomesh.options("mesh")` lists all.
    """
    held: dict[str, Any] = {}
    image: Image | Callable[[], Image] | None = None
    if isinstance(volume, (str, os.PathLike)) and spacing is None and origin is None and units is None:
        given = os.fspath(volume)
        # With a velocity the mesh lies in depth, the image in time.
        if options.get("velocity") is None:
            known = options_of("convert")
            image = functools.partial(read, given, **{k: v for k, v in options.items() if k in known})
    else:
        image = Image.of(volume, spacing, origin, units)
        given, held = NAME, {NAME: image._native}
    answer = call("mesh", [given], {"output": MADE, **options}, held, [MADE], progress, threads)
    return Mesh(answer.kept[MADE], answer, image)


def voronoi(volume: Volume, **options: Any) -> Mesh:
    """Voronoi cells (PEBI) alongside an image's features; arguments as those of `mesh`."""
    return mesh(volume, cells="voronoi", **options)
