"""Regions, surfaces, subsets, copies, pickles and files of meshes."""

import copy
import doctest
import importlib
import pickle

import numpy as np
import pytest

import atomesh
from conftest import disc


@pytest.fixture(scope="module")
def labelled():
    """Returns a mesh of labels 0, 1 (a ball) and 5 (a slab)."""
    z, y, x = np.mgrid[:30, :32, :34]
    labels = ((x - 15) ** 2 + (y - 16) ** 2 + (z - 15) ** 2 < 90).astype(np.uint8)
    labels[:, :, 28:] = 5
    return atomesh.mesh(labels, feature="labels", distance=5, label={1: {"name": "core"}})


@pytest.fixture(scope="module")
def meshes(labelled, cells):
    plane = (disc() > 1).astype(np.uint8)
    options = {"feature": "labels", "distance": 6}
    return [labelled, cells, atomesh.mesh(plane, **options), atomesh.voronoi(plane, **options)]


def assert_equal(one, other):
    kind, points, cells, *data = one._native.parts()
    other_kind, other_points, other_cells, *other_data = other._native.parts()
    assert kind == other_kind and np.array_equal(points, other_points) and len(cells) == len(other_cells)
    assert all(a.dtype == b.dtype and np.array_equal(a, b) for a, b in zip(cells, other_cells))
    for named, other_named in zip(data, other_data):
        assert [name for name, _ in named] == [name for name, _ in other_named]
        for (_, a), (_, b) in zip(named, other_named):
            assert type(a) is type(b)
            if isinstance(a, str):
                assert a == b
            else:
                assert a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    assert np.array_equal(one.feature_faces, other.feature_faces)


def test_regions_are_a_table(labelled):
    table = labelled.regions
    assert [(row.region, row.label, row.name) for row in table] == [(0, 0, None), (1, 1, "core"), (5, 5, None)]
    reported = labelled.report["regions"]["regions"]
    assert [row.cells for row in table] == [row["cells"] for row in reported]
    assert np.allclose([row.volume for row in table], [row["volume"] for row in reported])
    pandas = pytest.importorskip("pandas")
    assert list(pandas.DataFrame(table).columns) == ["region", "label", "name", "volume", "cells"]


def test_regions_of_all_kinds_fill_the_box(meshes, tmp_path):
    for number, mesh in enumerate(meshes):
        box = np.prod(mesh.points.max(axis=0) - mesh.points.min(axis=0))
        assert sum(row.volume for row in mesh.regions) == pytest.approx(box)
        assert sum(row.cells for row in mesh.regions) == mesh.n_cells
        mesh.save(tmp_path / f"{number}.vtu")
        assert atomesh.load(tmp_path / f"{number}.vtu").regions == mesh.regions
    assert all(row.label is None for row in meshes[1].regions)


def test_surfaces_are_a_sequence_and_a_function(labelled):
    surfaces = labelled.surfaces
    assert surfaces.names == labelled.surfaces().names == [surface.name for surface in surfaces]
    assert len(surfaces) == len(list(surfaces)) == 2
    assert surfaces["interface_0_5"] is surfaces["0_5"] is labelled.surfaces["0_5"]
    assert surfaces[-1] is surfaces[len(surfaces) - 1] and len(surfaces[:1]) == 1
    assert "0_5" in surfaces and "fault1" not in surfaces and surfaces[0] in surfaces
    assert labelled.surfaces(kind="fault").names == [] and "interface_0_5" in repr(surfaces)
    with pytest.raises(KeyError, match=r"surfaces\['9_9'\]: there is no such surface; give one of interface") as caught:
        surfaces["9_9"]
    assert isinstance(caught.value, atomesh.Error)
    with pytest.raises(IndexError):
        surfaces[2]


def test_surfaces_are_extracted_once_and_when_needed(labelled, monkeypatch):
    mesh = labelled[:]
    calls = []
    extract = atomesh.Mesh._extract_surfaces
    monkeypatch.setattr(atomesh.Mesh, "_extract_surfaces", lambda *args, **more: calls.append(1) or extract(*args, **more))
    surfaces = mesh.surfaces
    assert not calls
    assert len(surfaces) == len(mesh.surfaces) == 2 and len(calls) == 1


def test_a_subset_has_the_cells_and_their_data(meshes):
    for mesh in meshes:
        chosen = np.flatnonzero(mesh.points[[cell[0] for cell in mesh.cells]][:, 0] > 15)[::-1]
        mask = np.zeros(mesh.n_cells, dtype=bool)
        mask[chosen] = True
        part = mesh[chosen]
        assert part.n_cells == len(chosen) < mesh.n_cells and part.n_points < mesh.n_points
        assert set(np.concatenate([np.ravel(cell) for cell in part.cells])) == set(range(part.n_points))
        for new, old in zip(part.cells, chosen):
            ours, theirs = part.points[new], mesh.points[mesh.cells[old]]
            assert np.array_equal(np.sort(ours, axis=0), np.sort(theirs, axis=0))
        assert set(part.cell_data) == set(mesh.cell_data) and set(part.point_data) == set(mesh.point_data)
        for name, values in mesh.cell_data.items():
            assert np.array_equal(part.cell_data[name], values[chosen], equal_nan=values.dtype.kind == "f")
        assert part.fields["units"] == mesh.fields["units"] and part.report == {}
        assert [row.region for row in part.regions] == [row.region for row in mesh[mask].regions]
        volumes = [[row.volume for row in some.regions] for some in (part, mesh[mask])]
        assert np.allclose(*volumes)
        assert_equal(mesh[:], mesh)
        assert mesh[-1].n_cells == 1


def test_a_subset_goes_everywhere(meshes, tmp_path):
    pytest.importorskip("pyvista")
    for mesh in meshes:
        part = mesh[mesh.cell_data["region"] == mesh.cell_data["region"].max()]
        assert part.to_pyvista().n_cells == part.n_cells
        part.save(tmp_path / "part.vtu")
        back = atomesh.load(tmp_path / "part.vtu")
        assert np.array_equal(back.points, part.points) and back.n_cells == part.n_cells
        assert back.regions == part.regions
        assert part.quality


def test_numbers_of_cells_in_fields_follow(cells):
    kind, points, arrays, point_data, cell_data, fields = cells._native.parts()
    pairs = arrays[2][arrays[2][:, 1] < cells.n_cells].astype(np.int64)
    fields = [*fields, ("horizon_faces", pairs.ravel())]
    native = type(cells._native)(kind, points, arrays, point_data, cell_data, fields)
    mesh = atomesh.Mesh(native)
    part = mesh[::-2]
    kept = np.array(part.fields["horizon_faces"]).reshape(-1, 2)
    new_pairs = part.face_cells[part.face_cells[:, 1] < part.n_cells]
    assert {tuple(pair) for pair in kept.tolist()} == {tuple(pair) for pair in new_pairs.tolist()}


@pytest.mark.parametrize(
    "cells, kind, says",
    [
        (lambda n: np.zeros(n + 1, dtype=bool), IndexError, "the mask has .* give one value per cell"),
        (lambda n: [n], IndexError, "there is no cell .* give numbers below"),
        (lambda n: [0.5], TypeError, "give a mask of cells, or their numbers"),
        (lambda n: "mantle", IndexError, "there is no region and no set of cells .* give one of .*core"),
        (lambda n: [], ValueError, "no cell is selected"),
        (lambda n: [3, 3], ValueError, "a cell is selected twice"),
    ],
)
def test_impossible_subsets_are_errors(labelled, cells, kind, says):
    with pytest.raises(kind, match=says) as caught:
        labelled[cells(labelled.n_cells)]
    assert isinstance(caught.value, atomesh.Error)
    with pytest.raises(TypeError):
        iter(labelled)


@pytest.mark.parametrize("through", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_copies_and_pickles_are_equal(meshes, through):
    for mesh in meshes:
        again = through(mesh)
        assert again is not mesh
        assert_equal(again, mesh)
        assert again.report == mesh.report and repr(again) == repr(mesh)
        assert again.quality == mesh.quality and again.interrupted == mesh.interrupted
        assert np.array_equal(again.image.samples, mesh.image.samples)
    surfaces = meshes[0].surfaces()
    again = through(surfaces)
    assert again.names == surfaces.names and again.report == surfaces.report
    assert np.array_equal(again.points, surfaces.points)
    for one, other in zip(again, surfaces):
        assert np.array_equal(one.faces, other.faces) and one.measures == other.measures
    assert set(again._native.cell_data) == set(surfaces._native.cell_data)
    assert through(meshes[0].surfaces).names == surfaces.names


@pytest.mark.parametrize("through", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_images_are_copied_and_pickled(through):
    values = np.full((6, 7, 8), 2**60, dtype=np.int64)
    values[3:] += 1
    image = atomesh.Image.of(values, (2, 3, 4), (10, 20, 30), ("m", "m", "ft"))
    image.report = {"points": 3}
    again = through(image)
    assert np.array_equal(again.samples, image.samples) and np.array_equal(again.axes, image.axes)
    assert np.array_equal(again.origin, image.origin) and again.units == image.units and again.report == image.report
    # Exact labels come along.
    assert atomesh.mesh(again, distance=1, feature="labels").regions[1].label == 2**60 + 1


@pytest.mark.parametrize(
    "ending, begins",
    [
        ("msh", b"$MeshFormat"), ("inp", b"*"), ("stl", b""), ("mesh", b"MeshVersion"), ("xdmf", b"<?xml"),
        ("exo", b"CDF"), ("vtkhdf", b"\x89HDF"), ("obj", b""), ("bdf", b"$"), ("vtu", b"<?xml"),
    ],
)
def test_the_ending_chooses_the_format(labelled, tmp_path, ending, begins):
    path = tmp_path / f"a.{ending}"
    assert labelled.save(path) is None
    assert path.stat().st_size > 500 and path.read_bytes().startswith(begins)


def test_unknown_endings_are_errors(labelled, tmp_path):
    with pytest.raises(ValueError, match=r"a\.doc: has an unknown ending; give one of \.vtu, .*\.msh, .*\.stl"):
        labelled.save(tmp_path / "a.doc")
    with pytest.raises(TypeError, match="takes no quadratic="):
        labelled.save(tmp_path / "a.vtu", quadratic=True)
    labelled.save(tmp_path / "a.msh")
    linear = (tmp_path / "a.msh").stat().st_size
    labelled.save(tmp_path / "a.msh", quadratic=True)
    assert (tmp_path / "a.msh").stat().st_size > 1.5 * linear


@pytest.mark.parametrize("name", ["atomesh", "atomesh._image", "atomesh._mesh", "atomesh._surfaces"])
def test_the_examples_of_docstrings_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(name)
    result = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert result.failed == 0 and result.attempted > 3
