"""Meshes, and the verbs that work on them."""

from __future__ import annotations

import base64
import functools
import html
import json
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Union

import numpy as np

from . import _native
from ._call import Answer, call, error, options_of, warn_of_issue
from ._errors import ArgumentError
from ._image import NAME, Image, read
from ._subset import cell_numbers, cell_volumes, named_cells, select_cells
from ._surfaces import Surfaces, SurfacesOfMesh

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

    #: A point x, y, z; in the plane x, y.
    Point = Sequence[float]
    #: Points, or points with rates in m^3/s.
    Wells = Union[Point, Sequence[Point], Mapping[tuple[float, ...], float], Sequence[str], str]

#: The names by which verbs refer to the mesh of a call, and to the mesh that they make.
MESH, RESULT = "<mesh>", "<result>.vtu"
FACETS = "<surfaces>.vtp"


class Picture:
    """A picture as PNG, which notebooks display.

    Attributes
    ----------
    png : bytes
        The content of the PNG file.
    """

    def __init__(self, png: bytes) -> None:
        self.png = png

    def _repr_png_(self) -> bytes:
        return self.png

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the picture to a PNG file.

        Parameters
        ----------
        path
            The file to write.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        Path(path).write_bytes(self.png)


class Region(NamedTuple):
    """A region of a mesh: the cells of one label of the image, or of one painted block.

    Attributes
    ----------
    region : int
        The number of the region, as in the cell array `region`.
    label : float, int or None
        The label of the image's samples; None if the region is no label.
    name : str or None
        The name of the label.
    volume : float
        The volume of its cells, in the plane their area, in physical coordinates.
    cells : int
        The number of its cells.
    """

    #: The number of the region, as in the cell array `region`.
    region: int
    #: The label of the image's samples; None if the region is no label.
    label: float | int | None
    #: The name of the label, or None.
    name: str | None
    #: The volume of its cells, in the plane their area, in physical coordinates.
    volume: float
    #: The number of its cells.
    cells: int


class Mesh:
    """A mesh in the image's physical coordinates, with its arrays and its report.

    Arrays are read-only NumPy arrays that share the memory of the mesh. A mesh can be copied (`copy.copy`,
    `copy.deepcopy`) and pickled. `mesh[cells]` is the mesh of some cells. Meshes are made by `mesh`, `voronoi`
    and `load`, and by methods such as `flow` and `paint`, which return a new mesh.

    Attributes
    ----------
    interrupted : bool
        True if the job was stopped; the mesh is then the one so far.

    Examples
    --------
    >>> import atomesh
    >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
    >>> mesh.points.shape[1], mesh.cells.shape[1], mesh.feature_faces.shape[1]
    (3, 4, 3)
    """

    # A mesh is no sequence of its cells.
    __iter__ = None

    def __init__(
        self,
        native: _native.Mesh,
        answer: Answer | None = None,
        image: Image | Callable[[], Image] | None = None,
    ) -> None:
        self._native = native
        self._image = image
        self._text = answer.text if answer else ""
        self._report: dict[str, Any] = answer.report if answer else {}
        self._measured: dict[str, Any] | None = None
        self._default_surfaces: Surfaces | None = None
        # Images in memory that options named; later verbs may read them again.
        self._option_images: dict[str, _native.Image] = dict(answer.images) if answer else {}
        #: True if the job was stopped; the mesh is then the one so far.
        self.interrupted: bool = bool(answer and answer.interrupted)

    # Content

    @property
    def kind(self) -> str:
        """The kind of the cells: "tetra", "triangle", "polyhedron" or "polygon"."""
        return self._native.kind

    @property
    def n_points(self) -> int:
        """The number of points."""
        return len(self.points)

    @property
    def n_cells(self) -> int:
        """The number of cells."""
        return self._native.n_cells

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """The points in physical coordinates, float64 of shape (n, 3), in the plane (n, 2), in the units of
        the image.
        """
        return self._native.points

    @property
    def cells(self) -> npt.NDArray[np.uint32] | list[npt.NDArray[np.uint32]]:
        """The points of each cell.

        An array of indices, uint32 of shape (m, 4) for tetrahedra and (m, 3) for triangles. For Voronoi cells a list of
        arrays; in the plane, the points are in order around the cell.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> mesh.cells.shape == (mesh.n_cells, 4)
        True
        """
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
        """The faces that lie on features, each once.

        The points of triangles, uint32 of shape (k, 3); in the plane those of edges, of shape (k, 2).
        """
        return self._native.feature_faces

    @property
    def faces(self) -> list[npt.NDArray[np.uint32]]:
        """The points of each face of Voronoi cells, in order around the face. Faces between two cells come first.

        Raises
        ------
        InvalidValueError
            If the mesh has no Voronoi cells. This is also a ValueError.
        """
        items, offsets, _, _ = self._voronoi()
        return np.split(items, offsets[1:-1].astype(np.int64))

    @property
    def face_cells(self) -> npt.NDArray[np.uint32]:
        """The two cells of each face of Voronoi cells, uint32 of shape (f, 2).

        If the second is `2**32 - 7` or more, it is a side of the box: xmin, xmax, ymin ...

        Raises
        ------
        InvalidValueError
            If the mesh has no Voronoi cells. This is also a ValueError.
        """
        return self._voronoi()[2]

    @property
    def sites(self) -> npt.NDArray[np.float64]:
        """The site (atom) of each Voronoi cell, float64 of shape (m, 3), in the plane (m, 2), in the units of
        the image.

        Raises
        ------
        InvalidValueError
            If the mesh has no Voronoi cells. This is also a ValueError.
        """
        return self._voronoi()[3]

    def _voronoi(self) -> list[npt.NDArray[Any]]:
        arrays = self._native.faces
        if arrays is None:
            raise error("the mesh", f"has no Voronoi cells but {self.kind} cells", "make it by atomesh.voronoi")
        return arrays

    @property
    def point_data(self) -> dict[str, npt.NDArray[Any]]:
        """The arrays with a value, or a row, for each point, by name."""
        return self._native.point_data

    @property
    def cell_data(self) -> dict[str, npt.NDArray[Any]]:
        """The arrays with a value, or a row, for each cell, by name: `min_dihedral` (degrees), `volume`, `region` ...

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> len(mesh.cell_data["min_dihedral"]) == mesh.n_cells
        True
        """
        return self._native.cell_data

    @property
    def fields(self) -> dict[str, Any]:
        """The field data of the whole mesh, a dict: units, version, parameters, position of its lattice ..."""
        return self._native.fields

    @property
    def regions(self) -> list[Region]:
        """The regions of the mesh, ascending by their numbers; empty if it has none.

        A mesh of an image of labels has a region for each label. The rows are named tuples: `pandas.DataFrame`
        makes a table of them.

        Examples
        --------
        >>> import atomesh, numpy as np
        >>> labels = np.ones((40, 40), dtype=np.uint8)
        >>> labels[:, 20:] = 5
        >>> mesh = atomesh.mesh(labels, feature="labels", distance=5, label={5: {"name": "core"}})
        >>> [(region.label, region.name) for region in mesh.regions]
        [(1, None), (5, 'core')]
        """
        numbers = self.cell_data.get("region")
        if numbers is None:
            return []
        labels = {row["region"]: row for row in json.loads(self.fields.get("labels", "[]"))}
        found, inverse, counts = np.unique(numbers, return_inverse=True, return_counts=True)
        volumes = np.bincount(inverse.ravel(), cell_volumes(self._native), len(found))
        rows = zip(found.tolist(), volumes.tolist(), counts.tolist())
        return [
            Region(number, labels.get(number, {}).get("label"), labels.get(number, {}).get("name"), volume, count)
            for number, volume, count in rows
        ]

    def __getitem__(self, cells: Any) -> Mesh:
        """Returns the mesh of some cells, with their data and only the points that they use.

        Parameters
        ----------
        cells
            A mask with one value per cell, numbers of cells, or a slice; or the name of a region or of a set of
            cells, or a list of such names.

        Returns
        -------
        Mesh
            The mesh, with its names and sets. Its cells have the order of `cells`, and its points the order that they
            have here. Faces whose other cell is omitted become boundary faces: those between regions are a set of
            faces such as `interface_0_3`, and those within a region the set `cut`. It has no report.

        Raises
        ------
        MissingItemError
            If there is no such cell, region or set, or if the mask has a wrong length. This is also an IndexError.
        InvalidValueError
            If no cell is selected, or one cell twice. This is also a ValueError.

        Examples
        --------
        >>> import atomesh, numpy as np
        >>> labels = np.zeros((40, 40), dtype=np.uint8)
        >>> labels[:, 20:] = 1
        >>> mesh = atomesh.mesh(labels, feature="labels", distance=5)
        >>> part = mesh[mesh.cell_data["region"] == 1]
        >>> bool(part.points[:, 0].min() > 15)
        True
        """
        is_name = isinstance(cells, str) or (
            isinstance(cells, (list, tuple)) and len(cells) > 0 and all(isinstance(name, str) for name in cells)
        )
        selection = named_cells(cells, self) if is_name else cells
        native = select_cells(self._native, cell_numbers(selection, self.n_cells))
        part = Mesh(native, None, self._image)
        part._option_images = dict(self._option_images)
        return part

    @property
    def image(self) -> Image | None:
        """The image that was meshed, or None. If it was given as a file, it is read again at the first use."""
        if callable(self._image):
            self._image = self._image()
        return self._image

    # Quality

    @property
    def report(self) -> dict[str, Any]:
        """The report of the verb that made the mesh, a dict: everything for `mesh`, rates and balance for `flow` ...

        The keys are those of the command line's JSON.
        """
        return self._report

    @property
    def quality(self) -> dict[str, Any]:
        """Angles (degrees), sizes and shapes of the cells, a dict. It is measured at the first use if the
        report lacks it.

        `space` names the space in which they are measured: "physical", in which simulators compute, or "lattice"
        if angles have no meaning there, as where z is time. The keys `physical` and `lattice` have the figures in
        each space. Without a meaning in physical space, `physical` is None; if all angles are the same in both spaces,
        both have the figures of lattice space. Voronoi cells have the figures of the report's `voronoi`.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> mesh.quality["space"], mesh.quality["cells"] == mesh.quality["lattice"]["cells"]
        ('physical', True)
        """
        has_quality = self._report.get("quality") or self._report.get("voronoi")
        measured = self._report if has_quality else self.measure()
        lattice: dict[str, Any] | None = measured.get("quality")
        if lattice is None:
            voronoi: dict[str, Any] = measured["voronoi"]
            return voronoi
        space: str = (measured.get("angle_space") or {}).get("space", "lattice")
        physical = measured.get("quality_physical") or (lattice if space == "physical" else None)
        return {**(physical or lattice), "space": space, "lattice": lattice, "physical": physical}

    @property
    def fidelity(self) -> dict[str, Any]:
        """The precision with which faces lie on the image's features, and their coverage, a dict; empty if unknown."""
        return self._report.get("fidelity") or {}

    def measure(self, **options: Unpack[QualityOptions]) -> dict[str, Any]:
        """Measures the quality of the mesh, and with `truth` its fidelity: `atomesh quality`.

        Parameters
        ----------
        **options
            Options of the verb; `atomesh.options("quality")` lists them. `truth` is the file or array of
            exact distances
            that `synth` writes.

        Returns
        -------
        dict
            The report of the verb.

        Raises
        ------
        ArgumentError
            If there is no such option, or if an option has a wrong type. This is also a TypeError.
        InvalidValueError
            If an option does not fit the mesh. This is also a ValueError.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> mesh.measure()["quality"]["cells"] == mesh.n_cells
        True
        """
        if options or self._measured is None:
            answer = self._call("quality", [MESH], options)
            if options:
                return answer.report
            self._measured = answer.report
        return self._measured

    def check(self, labels: Any) -> dict[str, Any]:
        """Compares the mesh with the image of labels that was meshed, sample by sample.

        Parameters
        ----------
        labels
            The image: an array, an `Image`, or the path of a file.

        Returns
        -------
        dict
            The certificate: for each connected part of each label its volume and that of its samples, the Dice
            coefficient, the distances between the boundaries, the thickness and the Euler number in the image and in
            the mesh; the nodes at which parts touch that are apart in the image; and the samples that changed sides.
            It is the part `certificate` of the report of `atomesh quality --labels`.

        Raises
        ------
        InvalidValueError
            If the image does not fit the mesh, or holds no labels. This is also a ValueError.

        Examples
        --------
        >>> import numpy as np, atomesh
        >>> labels = np.zeros((20, 20, 20), dtype=np.uint8)
        >>> labels[5:15, 5:15, 5:15] = 1
        >>> check = atomesh.mesh(labels, distance=4).check(labels)
        >>> check["parts"], check["lost_parts"], check["pinch_count"]
        (2, 0, 0)
        """
        certificate: dict[str, Any] = self.measure(labels=labels)["certificate"]
        return certificate

    def validate(self) -> dict[str, Any]:
        """Checks the mesh with atomesh's own checker and its Delaunay kernels (spade in 2-D): `atomesh validate`.

        Returns
        -------
        dict
            The verdicts of the checkers.

        Raises
        ------
        Error
            If the mesh is not valid.

        Examples
        --------
        >>> import atomesh
        >>> verdicts = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5).validate()
        """
        return self._call("validate", [MESH], {}).report

    # Output

    def save(self, path: str | os.PathLike[str], **options: Unpack[ExportOptions]) -> None:
        """Writes the mesh in the format of the file's ending.

        A .vtu file holds the whole mesh with all its data, for `load`, the command line and ParaView. Other endings
        choose a format of `export`: .msh (Gmsh), .inp (Abaqus), .bdf (Nastran), .exo (Exodus), .stl and so on.

        Parameters
        ----------
        path
            The file.
        **options
            Options of `export`, for other formats than .vtu.

        Raises
        ------
        InvalidValueError
            If no format has this ending; the message lists the endings. This is also a ValueError.
        ArgumentError
            If options are given for a .vtu file. This is also a TypeError.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> mesh.save("sphere.vtu")
        >>> mesh.save("sphere.msh")
        """
        path = Path(path)
        if path.suffix.lower() == ".vtu":
            if options:
                problem = f"takes no {next(iter(options))}="
                remedy = "omit it, or use export(format, path), which takes options"
                raise error(os.fspath(path), problem, remedy, ArgumentError)
            self._native.write(path)
            return
        formats = _formats_by_ending()
        name = formats.get(path.suffix[1:]) or formats.get(path.name)
        if name is None:
            endings = ", ".join(f".{ending}" for ending in ["vtu", *formats])
            remedy = f"give one of {endings}; formats that are folders need export(format, path)"
            raise error(os.fspath(path), "has an unknown ending", remedy)
        self.export(name, path, **options)

    def export(
        self, to: str, path: str | os.PathLike[str], *, threads: int | None = None, **options: Unpack[ExportOptions]
    ) -> dict[str, Any]:
        """Writes the mesh for a simulator or another mesher: `atomesh export`.

        Parameters
        ----------
        to
            The format: opm, grdecl, mrst, geos, openfoam, disv, msh ...; `atomesh.options("export")["to"]` lists
            all formats.
        path
            The file to write, or the folder for formats with several files.
        threads
            Number of threads; by default all processors.
        **options
            Options of the verb; `atomesh.options("export")` lists them.

        Returns
        -------
        dict
            The report of the verb, with the checks of the model.

        Raises
        ------
        ArgumentError
            If there is no such option, or if an option has a wrong type. This is also a TypeError.
        InvalidValueError
            If there is no such format, or if the format cannot hold the mesh or an option. This is also a ValueError.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> report = mesh.export("inp", "sphere.inp", quadratic=True)
        """
        words = {"to": to, "output": os.fspath(path), **options}
        return self._call("export", [MESH], words, threads=threads).report

    def to_pyvista(self) -> Any:
        """Converts the mesh to PyVista. A mesh of the plane lies at z = 0.

        Returns
        -------
        pyvista.UnstructuredGrid
            The mesh with all its point and cell arrays.

        Raises
        ------
        ImportError
            If PyVista is not installed.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> mesh.to_pyvista().n_cells == mesh.n_cells
        True
        """
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
        """Converts the mesh to meshio.

        Returns
        -------
        meshio.Mesh
            The mesh with all its arrays. meshio groups polyhedra and polygons by their number of points; the cell array
            `cell` then holds the index of each cell in this mesh.

        Raises
        ------
        ImportError
            If meshio is not installed.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> mesh.to_meshio().cells[0].type
        'tetra'
        """
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
        cell_faces = [] if polygons else self._faces_of_cells()
        cells, order = [], []
        all_cells = self.cells
        for size in np.unique(sizes):
            numbers = np.flatnonzero(sizes == size)
            order.append(numbers)
            if polygons:
                cells.append(("polygon", np.array([all_cells[i] for i in numbers])))
            else:
                cells.append((f"polyhedron{size}", [cell_faces[i] for i in numbers]))
        data = {name: [values[numbers] for numbers in order] for name, values in self.cell_data.items()}
        data["cell"] = order
        return meshio.Mesh(points, cells, point_data, data)

    def _faces_of_cells(self) -> list[list[npt.NDArray[np.uint32]]]:
        """Returns the faces of each polyhedron, oriented outwards."""
        faces: list[list[npt.NDArray[np.uint32]]] = [[] for _ in range(self.n_cells)]
        for ring, (owner, neighbour) in zip(self.faces, self.face_cells.tolist()):
            faces[owner].append(ring)
            if neighbour < self.n_cells:
                faces[neighbour].append(ring[::-1])
        return faces

    def _points_in_space(self) -> npt.NDArray[np.float64]:
        points = np.zeros((self.n_points, 3))
        points[:, : self.points.shape[1]] = self.points
        return points

    def plot(self, clip: bool = True, **options: Any) -> Any:
        """Draws the mesh and its faces on features with PyVista.

        Parameters
        ----------
        clip
            True to cut a corner away, so that the faces on features are visible.
        **options
            Options of pyvista.Plotter.show.

        Returns
        -------
        object
            What pyvista.Plotter.show returns: in a notebook its view, otherwise usually None.

        Raises
        ------
        ImportError
            If PyVista is not installed.
        """
        import pyvista

        grid = self.to_pyvista()
        plotter = pyvista.Plotter()
        flat = self.kind in ("triangle", "polygon")
        if clip and not flat:
            # The corner that faces PyVista's camera.
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
        """Draws the mesh over its image: `atomesh slice`.

        Parameters
        ----------
        image
            The image that was meshed; by default the one that the mesh holds.
        at
            The point where the planes meet, in physical coordinates; by default the middle.
        path
            A file to which the picture is also written.

        Returns
        -------
        Picture
            The picture.

        Raises
        ------
        InvalidValueError
            If there is no image, or if `at` lies outside it. This is also a ValueError.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> mesh.slice(path="sphere.png").png[1:4]
        b'PNG'
        """
        image = self._needs_image("slice", image)
        with tempfile.TemporaryDirectory(prefix="atomesh-") as folder:
            output = Path(folder) / "slice.png"
            objects = {NAME: image._native, MESH: self._native}
            call("slice", [NAME, MESH], {"output": output, "at": at}, objects)
            picture = Picture(output.read_bytes())
        if path is not None:
            picture.save(path)
        return picture

    def page(
        self, path: str | os.PathLike[str], image: Volume | None = None, **options: Unpack[ReportOptions]
    ) -> dict[str, Any]:
        """Writes a page with mesh, image and figures, one HTML file for any browser: `atomesh report`.

        The figures are those of `report` if the mesh was made in this session, otherwise they are measured.

        Parameters
        ----------
        path
            The file to write.
        image
            The image that was meshed; by default the one that the mesh holds.
        **options
            Options of the verb; `atomesh.options("report")` lists them.

        Returns
        -------
        dict
            The size of the page.

        Raises
        ------
        InvalidValueError
            If there is no image, or if it is not that of the mesh. This is also a ValueError.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
        >>> size = mesh.page("sphere.html")
        """
        image = self._needs_image("page", image)
        with tempfile.TemporaryDirectory(prefix="atomesh-") as folder:
            words: dict[str, Any] = {"output": path, **options}
            if words.get("figures") is None and "verdict" in self._report:
                words["figures"] = Path(folder) / "report.json"
                words["figures"].write_text(json.dumps(self._report))
            return self._call("report", [NAME, MESH], words, {NAME: image._native}).report

    # Verbs

    @property
    def surfaces(self) -> SurfacesOfMesh:
        """The labelled surfaces of the faces on features: faults, horizons, interfaces of regions.

        It is a sequence of all surfaces, which are extracted at the first use; a name is also an index. Called as a
        function, it extracts surfaces with options: `mesh.surfaces(kind="fault", image=None, **options)`, as
        `atomesh surface` does.

        Examples
        --------
        >>> import atomesh, numpy as np
        >>> labels = np.ones((20, 20, 20), dtype=np.uint8)
        >>> labels[:, :, 10:] = 2
        >>> mesh = atomesh.mesh(labels, feature="labels", distance=5)
        >>> mesh.surfaces.names
        ['interface_1_2']
        >>> mesh.surfaces["1_2"].kind
        'interface'
        >>> len(mesh.surfaces(kind="fault"))
        0
        """
        return SurfacesOfMesh(self._extract_surfaces, self._surfaces)

    def _surfaces(self) -> Surfaces:
        """Returns the surfaces with default options."""
        if self._default_surfaces is None:
            self._default_surfaces = self._extract_surfaces()
        return self._default_surfaces

    def _extract_surfaces(
        self, kind: str | Sequence[str] | None = None, image: Volume | None = None, **options: Any
    ) -> Surfaces:
        objects: dict[str, Any] = {}
        arguments = [MESH]
        if image is not None:
            arguments.append(NAME)
            objects[NAME] = Image.of(image)._native
        answer = self._call("surface", arguments, {"output": FACETS, **options}, objects)
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
        """Computes steady flow from injectors to producers, or between sides with a `pressure`: `atomesh flow`.

        Parameters
        ----------
        injectors
            Points where fluid enters, or a dict from points to rates in m^3/s.
        producers
            Points where fluid leaves, or a dict from points to rates in m^3/s.
        progress
            True to show the progress, or a callable that receives the name of the stage and the fraction of it that
            is done.
        threads
            Number of threads; by default all processors.
        **options
            Options of the verb; `atomesh.options("flow")` lists them.

        Returns
        -------
        Mesh
            The mesh, split along faults, with the cell arrays of pressure (Pa) and Darcy velocity (m/s), and a report.

        Raises
        ------
        ArgumentError
            If there is no such option, or if an option has a wrong type. This is also a TypeError.
        InvalidValueError
            If nothing makes fluid flow, if rates do not balance, or if a point lies outside. This is also a ValueError.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5, feature="none")
        >>> flow = mesh.flow(pressure={"xmin": 2e7, "xmax": 1e7}, permeability=1e-13)
        >>> bool(abs(flow.point_data["pressure"].max() - 2e7) < 1)
        True
        """
        words = {"source": injectors, "sink": producers, **options}
        return self._run("flow", [MESH], words, progress=progress, threads=threads)

    def paint(
        self, seed: Any = "auto", image: Volume | None = None, **options: Unpack[PaintOptions]
    ) -> Mesh:
        """Paints cells from seeds, within layers but not across surfaces: `atomesh paint`.

        Parameters
        ----------
        seed
            Points, a dict from points to regions, or "auto" for every block.
        image
            An image; paint flows less easily where its values change.
        **options
            Options of the verb; `atomesh.options("paint")` lists them.

        Returns
        -------
        Mesh
            The mesh with the painted regions as the cell array `region`.

        Raises
        ------
        ArgumentError
            If there is no such option, or if an option has a wrong type. This is also a TypeError.
        InvalidValueError
            If a seed lies outside the mesh. This is also a ValueError.

        Examples
        --------
        >>> import atomesh, numpy as np
        >>> labels = np.ones((20, 20, 20), dtype=np.uint8)
        >>> labels[:, :, 10:] = 2
        >>> mesh = atomesh.mesh(labels, feature="labels", distance=5)
        >>> len(mesh.paint().regions)
        2
        """
        words: dict[str, Any] = {"seed": seed, **options}
        objects = {}
        if image is not None:
            words["image"] = NAME
            objects[NAME] = Image.of(image)._native
        return self._run("paint", [MESH], words, objects)

    def segment(
        self, object: Any, background: Any, image: Volume | None = None, **options: Unpack[SegmentOptions]
    ) -> Mesh:
        """Separates an object from the background by a minimum cut on the cells: `atomesh segment`.

        Parameters
        ----------
        object
            Places in the object: points, or boxes as pairs of points.
        background
            Places in the background, in the same form.
        image
            The image that was meshed; by default the one that the mesh holds.
        **options
            Options of the verb; `atomesh.options("segment")` lists them.

        Returns
        -------
        Mesh
            The mesh with the cell array `label`: 1 object, 0 background.

        Raises
        ------
        ArgumentError
            If there is no such option, or if an option has a wrong type. This is also a TypeError.
        InvalidValueError
            If there is no image, or if a place lies outside it. This is also a ValueError.

        Examples
        --------
        >>> import atomesh, numpy as np
        >>> y, x = np.mgrid[:48, :48]
        >>> disc = (np.hypot(x - 24, y - 22) < 14).astype(np.float32)
        >>> mesh = atomesh.mesh(disc, distance=4, feature="edges")
        >>> labels = mesh.segment(object=[(24, 22)], background=[(2, 2)]).cell_data["label"]
        >>> sorted(set(labels.tolist()))
        [0, 1]
        """
        image = self._needs_image("segment", image)
        words = {"object": object, "background": background, **options}
        return self._run("segment", [NAME, MESH], words, {NAME: image._native}, image)

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
        """Adds, moves and removes atoms; only their neighbourhood changes: `atomesh edit`.

        Parameters
        ----------
        add
            Positions of new atoms, in physical coordinates.
        move
            A dict from the numbers of atoms to their new positions.
        remove
            Numbers of atoms to remove.
        image
            The image that was meshed; by default the one that the mesh holds.
        progress
            True to show the progress, or a callable that receives the name of the stage and the fraction of it that
            is done.
        **options
            Options of the verb; `atomesh.options("edit")` lists them.

        Returns
        -------
        Mesh
            The edited mesh.

        Raises
        ------
        ArgumentError
            If there is no such option, or if an option has a wrong type. This is also a TypeError.
        InvalidValueError
            If there is no image, nothing to do, no such atom, or if a place is impossible. This is also a ValueError.

        Examples
        --------
        >>> import atomesh
        >>> mesh = atomesh.mesh(atomesh.synth("sphere", dims=(32, 32, 32)), distance=5)
        >>> edited = mesh.edit(add=[(16.2, 15.7, 16.4)])
        >>> edited.kind
        'tetra'
        """
        image = self._needs_image("edit", image)
        removed = [remove] if isinstance(remove, int) else remove
        words = {"add": add, "move": move, "remove": None if removed is None else [str(n) for n in removed], **options}
        return self._run("edit", [MESH, NAME], words, {NAME: image._native}, image, progress=progress)

    def columns(self, horizon: Sequence[Any], **options: Unpack[ColumnsOptions]) -> Mesh:
        """Extends the Voronoi cells of a map down through layers between horizons: `atomesh columns`.

        Parameters
        ----------
        horizon
            Horizons from the top down, each a number z, a 2-D array of z, or the file of a surface.
        **options
            Options of the verb; `atomesh.options("columns")` lists them.

        Returns
        -------
        Mesh
            The mesh of columns.

        Raises
        ------
        ArgumentError
            If there is no such option, or if an option has a wrong type. This is also a TypeError.
        InvalidValueError
            If the mesh is not a map of Voronoi cells, or if the horizons do not fit it. This is also a ValueError.

        Examples
        --------
        >>> import atomesh, numpy as np
        >>> y, x = np.mgrid[:48, :48]
        >>> disc = (np.hypot(x - 24, y - 22) < 14).astype(np.float32)
        >>> map = atomesh.voronoi(disc, distance=6, feature="edges")
        >>> columns = map.columns([0, 10, 25], layers=2)
        >>> columns.n_cells == 4 * map.n_cells
        True
        """
        # As texts, so that two or three numbers are not taken for the coordinates of a point.
        horizons = [str(z) if isinstance(z, (int, float, np.number)) else z for z in horizon]
        return self._run("columns", [MESH], {"horizon": horizons, **options})

    def _needs_image(self, verb: str, image: Volume | None) -> Image:
        if image is not None:
            return Image.of(image)
        if self.image is None:
            raise error(f"{verb}()", "needs the image that was meshed", "give image=")
        return self.image

    def _call(
        self, verb: str, arguments: Sequence[str], options: Mapping[str, Any], objects: Any = None, **call_options: Any
    ) -> Answer:
        objects = {**self._option_images, MESH: self._native, **(objects or {})}
        return call(verb, arguments, options, objects, **call_options)

    def _run(
        self, verb: str, arguments: Sequence[str], options: Mapping[str, Any], objects: Any = None,
        image: Image | None = None, **call_options: Any,
    ) -> Mesh:
        """Runs a verb that makes a mesh of this one."""
        answer = self._call(verb, arguments, {"output": RESULT, **options}, objects, **call_options)
        made = Mesh(answer.kept[RESULT], answer, image or self._image)
        made._option_images = {**self._option_images, **made._option_images}
        return made

    # Display

    def __repr__(self) -> str:
        head = f"<atomesh.Mesh: {self.n_points} points, {self.n_cells} {_PLURAL[self.kind]}>"
        return f"{head}\n{self._text}" if self._text else head

    def _repr_html_(self) -> str:
        picture = ""
        if self.image is not None:
            png = base64.b64encode(self.slice().png).decode()
            picture = f'<img src="data:image/png;base64,{png}" style="max-width:100%"/>'
        return f"{picture}<pre>{html.escape(repr(self))}</pre>"


_PLURAL = {"tetra": "tetrahedra", "triangle": "triangles", "polyhedron": "polyhedra", "polygon": "polygons"}


@functools.lru_cache(maxsize=1)
def _formats_by_ending() -> dict[str, str]:
    """Returns the first export format of each ending, or whole file name. The ending .vtu belongs to `save`."""
    formats: dict[str, str] = {}
    for name, _, endings in _native.export_formats():
        for ending in endings:
            formats.setdefault(ending, name)
    formats.pop("vtu", None)
    return formats


def load(path: str | os.PathLike[str], image: Volume | None = None) -> Mesh:
    """Reads a .vtu file of a mesh that atomesh, meshio, VTK or ParaView wrote. `read` reads the file of an image.

    Parameters
    ----------
    path
        The file.
    image
        The image that was meshed, for pictures and edits.

    Returns
    -------
    Mesh
        The mesh.

    Raises
    ------
    MissingFileError
        If there is no such file. This is also a FileNotFoundError.

    See Also
    --------
    read : Reads the file of an image.

    Examples
    --------
    >>> import atomesh
    >>> atomesh.mesh(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5).save("sphere.vtu")
    >>> atomesh.load("sphere.vtu").kind
    'tetra'
    """
    return Mesh(_native.Mesh.read(Path(path)), None, None if image is None else Image.of(image))


def mesh(
    volume: Volume,
    *,
    spacing: float | Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    units: str | Sequence[str] | None = None,
    progress: Progress = False,
    threads: int | None = None,
    **options: Unpack[MeshOptions],
) -> Mesh:
    """Makes a mesh of an image that is aligned with the image's features: `atomesh mesh`.

    Ctrl-C stops the job. If there is a lattice already, it becomes the mesh, whose `interrupted` is then True;
    otherwise KeyboardInterrupt is raised.

    Parameters
    ----------
    volume
        A NumPy array of shape (nz, ny, nx) or (ny, nx), the path of a file, an xarray.DataArray, a
        pyvista.ImageData, a SimpleITK image or a nibabel image.
    spacing
        The distances between samples along x, y, z, or one distance for all axes. They replace those of the volume.
    origin
        The position of the first sample: x, y, z. It replaces that of the volume.
    units
        The units of the axes, or one unit for all. They replace those of the volume.
    progress
        True to show the progress, or a callable that receives the name of the stage and the fraction of it that is
        done.
    threads
        Number of threads; by default all processors.
    **options
        Options of the verb. The most usual ones are `distance` (between atoms, in samples; a pair such as (4, 10)
        for a range), `feature` ("faults", "horizons", "edges", "labels" ...), `beta` (a number or an array) and
        `label` (a dict from labels to what is requested of them, such as
        `{1: {"distance": 3, "name": "core"}, 5: {"into": 1}}`); `atomesh.options("mesh")` lists all.

    Returns
    -------
    Mesh
        The mesh, with its report.

    Warns
    -----
    MeshWarning
        If the verdict on the mesh is not good: what is wrong, and what helps. This is also a UserWarning.

    Raises
    ------
    ArgumentError
        If there is no such option, or if an argument has a wrong type. This is also a TypeError.
    InvalidValueError
        If an option or the image has impossible values. This is also a ValueError.
    MissingFileError
        If a file does not exist. This is also a FileNotFoundError.

    Examples
    --------
    >>> import atomesh, numpy as np
    >>> y, x = np.mgrid[:48, :48]
    >>> disc = (np.hypot(x - 24, y - 22) < 14).astype(np.float32)
    >>> mesh = atomesh.mesh(disc, distance=(4, 10), feature="edges", spacing=2.0)
    >>> mesh.kind
    'triangle'
    """
    objects: dict[str, Any] = {}
    image: Image | Callable[[], Image] | None = None
    if isinstance(volume, (str, os.PathLike)) and spacing is None and origin is None and units is None:
        name = os.fspath(volume)
        # With a velocity, the mesh is in depth, while the image is in time.
        if options.get("velocity") is None:
            known = options_of("convert")
            image = functools.partial(read, name, **{k: v for k, v in options.items() if k in known})
    else:
        image = Image.of(volume, spacing, origin, units)
        name, objects = NAME, {NAME: image._native}
    answer = call("mesh", [name], {"output": RESULT, **options}, objects, progress, threads)
    warn_of_issue(answer.report.get("verdict"))
    return Mesh(answer.kept[RESULT], answer, image)


def voronoi(volume: Volume, **options: Any) -> Mesh:
    """Makes Voronoi cells (PEBI) that conform to an image's features: `atomesh mesh --cells voronoi`.

    Parameters
    ----------
    volume
        The image, as for `mesh`.
    **options
        The other arguments of `mesh`.

    Returns
    -------
    Mesh
        The mesh of Voronoi cells, with its report.

    Raises
    ------
    ArgumentError
        If there is no such option, or if an argument has a wrong type. This is also a TypeError.
    InvalidValueError
        If an option or the image has impossible values. This is also a ValueError.
    MissingFileError
        If a file does not exist. This is also a FileNotFoundError.

    Examples
    --------
    >>> import atomesh
    >>> cells = atomesh.voronoi(atomesh.synth("sphere", dims=(20, 20, 20)), distance=5)
    >>> cells.kind, len(cells.sites) == cells.n_cells
    ('polyhedron', True)
    """
    return mesh(volume, cells="voronoi", **options)
