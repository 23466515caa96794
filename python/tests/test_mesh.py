"""Tests of meshes: their arrays, their files and the verbs that work on them."""

import json
import pickle
import subprocess
import sys
import warnings

import numpy as np
import pytest

import atomesh
from conftest import ball, disc


def volumes(mesh):
    corners = mesh.points[mesh.cells]
    return np.linalg.det(corners[:, 1:] - corners[:, :1]) / (6 if corners.shape[1] == 4 else 2)


def test_arrays_share_the_memory_of_the_mesh(mesh):
    assert mesh.kind == "tetra" and mesh.cells.shape == (mesh.n_cells, 4)
    assert mesh.points.shape == (mesh.n_points, 3) and mesh.points.dtype == np.float64
    for array in [mesh.points, mesh.cells, mesh.feature_faces, *mesh.point_data.values(), *mesh.cell_data.values()]:
        assert not array.flags.writeable and not array.flags.owndata
    assert np.shares_memory(mesh.points, mesh.points)
    assert np.shares_memory(mesh.cell_data["volume"], mesh.cell_data["volume"])
    assert {len(values) for values in mesh.point_data.values()} == {mesh.n_points}
    assert {len(values) for values in mesh.cell_data.values()} == {mesh.n_cells}


def test_arrays_outlive_their_mesh():
    points = atomesh.mesh(disc(), distance=6).points
    copy = points.copy()
    other_points = [atomesh.mesh(disc(), distance=7).points for _ in range(3)]
    assert np.array_equal(points, copy) and len(other_points) == 3


def test_cells_are_positive_and_fill_the_box(mesh, faults):
    assert (volumes(mesh) > 0).all()
    box = np.prod([n - 1 for n in faults.samples.shape])
    assert volumes(mesh).sum() == pytest.approx(box)
    assert np.allclose(mesh.cell_data["volume"], volumes(mesh), rtol=1e-5)


def test_feature_faces_are_faces_of_cells(mesh):
    faces = {tuple(sorted(face)) for face in mesh.feature_faces.tolist()}
    assert len(faces) == len(mesh.feature_faces) > 50
    all_faces = {
        tuple(sorted(face)) for k in range(4) for face in np.delete(mesh.cells, k, axis=1).tolist()
    }
    assert faces <= all_faces


def test_the_report_is_that_of_the_command_line(mesh):
    assert mesh.report["lattice"]["atoms"] == mesh.n_points
    assert mesh.quality["smallest_angle"]["worst"] > 1
    assert mesh.fidelity["feature_points"] > 100
    assert f"{mesh.n_cells} tetrahedra" in repr(mesh) and "angle" in repr(mesh)
    assert mesh.report["parameters"]["distance"] in (6, "6")
    json.dumps(mesh.report)


def test_a_notebook_shows_a_picture_and_the_table(mesh):
    shown = mesh._repr_html_()
    assert shown.startswith('<img src="data:image/png;base64,') and "tetrahedra" in shown


def test_a_saved_mesh_is_loaded_unchanged(mesh, tmp_path):
    mesh.save(tmp_path / "a.vtu")
    loaded = atomesh.load(tmp_path / "a.vtu")
    assert np.array_equal(loaded.points, mesh.points) and np.array_equal(loaded.cells, mesh.cells)
    assert np.array_equal(loaded.feature_faces, mesh.feature_faces)
    assert loaded.quality["cells"] == mesh.n_cells
    assert loaded.fidelity == {} and loaded.report == {}
    assert {"parameters", "units", "atomesh_version"} <= set(loaded.fields)
    assert atomesh.info(tmp_path / "a.vtu")["tetrahedra"] == mesh.n_cells


def test_triangles():
    plane = atomesh.mesh(disc(), distance=5, feature="edges", spacing=(2, 3))
    assert plane.kind == "triangle" and plane.points.shape[1] == 2 and plane.cells.shape[1] == 3
    assert volumes(plane).sum() == pytest.approx(47 * 2 * 47 * 3)
    assert plane.feature_faces.shape[1] == 2 and len(plane.feature_faces) > 10
    assert plane.to_pyvista().n_cells == plane.n_cells


def test_voronoi_cells(cells):
    assert cells.kind == "polyhedron" and len(cells.cells) == cells.n_cells == len(cells.sites)
    assert len(cells.faces) == len(cells.face_cells)
    assert cells.face_cells[:, 0].max() < cells.n_cells
    inner = cells.face_cells[:, 1] < cells.n_cells
    assert inner.any() and not inner.all()
    assert set(cells.face_cells[~inner, 1]) <= set(range(2**32 - 7, 2**32 - 1))
    assert len(cells.feature_faces) > 20 and len(cells.cell_data["region"]) == cells.n_cells
    with pytest.raises(atomesh.Error, match="make it by atomesh.voronoi"):
        atomesh.mesh(disc(), distance=8).faces


def test_pyvista_and_meshio_have_the_same_volume(mesh, cells):
    pytest.importorskip("meshio")
    pytest.importorskip("pyvista")
    for any_mesh in (mesh, cells, atomesh.voronoi(disc(), distance=6, feature="edges")):
        grid = any_mesh.to_pyvista()
        assert grid.n_cells == any_mesh.n_cells and grid.n_points == any_mesh.n_points
        low, high = any_mesh.points.min(axis=0), any_mesh.points.max(axis=0)
        sizes = grid.compute_cell_sizes()
        size = sizes["Area"] if any_mesh.points.shape[1] == 2 else sizes["Volume"]
        assert np.abs(size).sum() == pytest.approx(np.prod(high - low), rel=1e-3)
        meshio_mesh = any_mesh.to_meshio()
        assert sum(len(block.data) for block in meshio_mesh.cells) == any_mesh.n_cells
        for name in any_mesh.cell_data:
            assert sum(len(block) for block in meshio_mesh.cell_data[name]) == any_mesh.n_cells
    assert np.array_equal(mesh.to_meshio().cells_dict["tetra"], mesh.cells)
    assert "region" in cells.to_meshio().cell_data


def test_surfaces(mesh):
    surfaces = mesh.surfaces()
    assert len(surfaces) >= 1 and surfaces[0].kind == "fault"
    assert surfaces[0].faces.shape[1] == 3 and surfaces[0].faces.max() < len(surfaces.points)
    assert surfaces[0].measures["area"] > 0
    assert len(mesh.surfaces(kind="horizon")) == 0
    data = surfaces.to_pyvista()
    assert set(np.unique(data["surface"])) == set(range(1, len(surfaces) + 1))
    # Areas are measured without the bumps of single faces.
    assert 0.99 * data.area < sum(s.measures["area"] for s in surfaces) < data.area
    assert surfaces[0].to_pyvista().n_cells == len(surfaces[0].faces)
    assert len(mesh.surfaces(image=mesh.image, feature="ridges")) >= 1


def test_flow(mesh, cells):
    for any_mesh in (mesh, cells):
        result = any_mesh.flow(injectors=(6, 6, 6), producers=[(40, 36, 34)], faults="open", permeability=1e-12)
        pressure = result.cell_data.get("pressure", result.point_data.get("pressure"))
        assert np.ptp(pressure) > 0
    rates = mesh.flow({(6, 6, 6): 0.002}, {(40, 36, 34): 0.0015, (6, 36, 6): 0.0005}, faults="open")
    assert [well["rate"] for well in rates.report["exchange"]] == [0.002, -0.0015, -0.0005]
    sides = mesh.flow(pressure={"xmin": 1e6, "xmax": 0}, faults="open")
    assert sides.n_cells == mesh.n_cells
    with pytest.raises(atomesh.Error, match="nothing makes fluid flow"):
        mesh.flow()


def test_paint_segment_edit(mesh, faults):
    painted = mesh.paint()
    assert painted.cell_data["region"].min() >= 1
    painted = mesh.paint({(6, 6, 6): 3}, image=faults)
    assert set(np.unique(painted.cell_data["region"])) <= {0, 3}
    bright = atomesh.mesh(ball(), distance=5, feature="edges")
    cut = bright.segment(object=(17, 15, 13), background=[((0, 0, 0), (3, 3, 3)), (32, 28, 24)], lambda_=0.9)
    label = cut.cell_data["label"]
    assert 0 < label.mean() < 0.5 and cut.report["cells"]["object"] == label.sum()
    edited = mesh.edit(add=[(20.5, 20.5, 20.5)], remove=[_central_point(mesh)])
    assert np.isclose(edited.points, (20.5, 20.5, 20.5)).all(axis=1).any()
    assert edited.report["edits"]


def _central_point(mesh):
    offsets = mesh.points - mesh.points.mean(axis=0)
    return int(np.argmin((offsets**2).sum(axis=1)))


def test_columns():
    map_mesh = atomesh.voronoi(disc(), distance=8, feature="edges", spacing=(10, 10))
    y, _ = np.mgrid[:48, :48]
    model = map_mesh.columns([100.0, 120.0 + y, 180.0], layers="2,3")
    assert model.n_cells == 5 * map_mesh.n_cells and model.report["layers"] == [2, 3]


def test_export(mesh, cells, tmp_path):
    mesh.export("msh", tmp_path / "a.msh")
    assert (tmp_path / "a.msh").stat().st_size > 1000
    report = cells.export(
        "opm", tmp_path / "CASE.DATA", porosity=0.2, permeability=100, permeability_unit="mD", depth_at_top=2000,
        injector={(6, 6, 6): 3e7}, producer={(40, 36, 34): 1e7},
    )
    assert (tmp_path / "CASE.DATA").exists() and [well["name"] for well in report["wells"]]


def test_quality_and_validity(mesh, tmp_path):
    assert mesh.validate()["valid"] is True
    exact = tmp_path / "distance.npy"
    image = atomesh.synth("sphere", dims=(40, 40, 40), truth=exact)
    sphere = atomesh.mesh(image, distance=6)
    assert sphere.measure(truth=exact)["fidelity"]["feature_points"] > 0
    assert sphere.measure(truth=np.load(exact))["fidelity"] == sphere.measure(truth=exact)["fidelity"]


def test_a_picture(mesh, tmp_path):
    picture = mesh.slice(at=(20, 20, 20), path=tmp_path / "a.png")
    assert picture._repr_png_()[:4] == b"\x89PNG" == (tmp_path / "a.png").read_bytes()[:4]
    pytest.importorskip("pyvista")
    picture = tmp_path / "3d.png"
    try:
        mesh.plot(screenshot=picture, window_size=(300, 300), interactive=False)
    except Exception as problem:  # VTK without a display
        pytest.skip(f"no picture here: {problem}")
    assert picture.stat().st_size > 2000


def test_a_page(mesh, tmp_path):
    report = mesh.page(tmp_path / "a.html", title="Two faults")
    page = (tmp_path / "a.html").read_text()
    assert report["page"]["bytes"] == (tmp_path / "a.html").stat().st_size
    assert page.startswith("<!") and "Two faults" in page
    # A mesh from a file is measured, and needs its image.
    mesh.save(tmp_path / "a.vtu")
    loaded = atomesh.load(tmp_path / "a.vtu")
    with pytest.raises(atomesh.Error, match="needs the image"):
        loaded.page(tmp_path / "b.html")
    assert loaded.page(tmp_path / "b.html", image=mesh.image)["page"]["faces"] == report["page"]["faces"]


def test_the_verdict_is_in_the_report_and_in_the_table(mesh):
    assert mesh.report["verdict"]["grade"] in ("good", "fair")
    assert [line.split()[0] for line in repr(mesh).splitlines()[1:] if line[0] != " "][:3] == ["mesh", "features", "use"]


def test_an_image_in_a_file_is_drawn(faults, tmp_path):
    faults.save(tmp_path / "a.npy")
    from_file = atomesh.mesh(tmp_path / "a.npy", distance=8)
    assert "<img" in from_file._repr_html_() and np.array_equal(from_file.image.samples, faults.samples)


def test_other_verbs(faults, tmp_path):
    potential = atomesh.feature(faults, feature="ridges", lines=tmp_path / "lines.vtp")
    assert potential.samples.shape == faults.samples.shape and potential.report["points"] > 0
    assert potential.samples.min() == -1 and potential.samples.max() == 0
    atomesh.convert(faults, tmp_path / "a.nrrd")
    report = atomesh.info(tmp_path / "a.nrrd")
    assert report["image"]["numpy_shape"] == list(faults.samples.shape)
    assert "ridges" in atomesh.options("mesh")["feature"]


def test_arrays_in_place_of_files(faults):
    beta = np.full(faults.samples.shape, 0.3)
    wells = np.array([[20, 20, 0, 1], [22, 21, 39, 1.0]])
    with_wells = atomesh.mesh(faults, distance=6, feature="ridges", beta=beta, well=wells)
    assert with_wells.n_cells > 100
    with_atom = atomesh.mesh(faults, distance=6, atoms_from=np.array([[20.25, 20.25, 20.25]]))
    assert np.isclose(with_atom.points, 20.25).all(axis=1).any()


def test_errors_say_what_to_do(mesh):
    with pytest.raises(atomesh.Error, match="did you mean distance=") as caught:
        atomesh.mesh(disc(), distanse=5)
    assert caught.value.remedy.startswith("did you mean") and caught.value.kind == "Usage"
    with pytest.raises(atomesh.Error, match="distance= ?-1|distance") as caught:
        atomesh.mesh(disc(), distance=-1)
    assert caught.value.place and caught.value.problem and "--" not in str(caught.value)
    with pytest.raises(atomesh.Error, match="possible values") as caught:
        atomesh.mesh(disc(), feature="folds")
    assert "feature=" in str(caught.value) and "--" not in str(caught.value)
    with pytest.raises(atomesh.Error, match="give image="):
        atomesh.load.__globals__["Mesh"](mesh._native).edit(add=[(1, 2, 3)])
    assert isinstance(pickle.loads(pickle.dumps(RuntimeError("x"))), RuntimeError)


def test_progress(capsys, monkeypatch):
    events = []
    atomesh.mesh(disc(), distance=6, progress=lambda stage, fraction: events.append((stage, fraction)))
    stages = {stage for stage, _ in events}
    assert {"finding features", "moving atoms onto features"} <= stages
    assert all(0 <= fraction <= 1 for _, fraction in events)
    monkeypatch.setitem(sys.modules, "tqdm", None)
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    atomesh.mesh(disc(), distance=6, progress=True)
    assert "finding features ..." in capsys.readouterr().err


def test_exceptions_of_a_callback_are_raised():
    def refuse(stage, fraction):
        raise KeyError(stage)

    with pytest.raises(KeyError):
        atomesh.mesh(disc(), distance=6, progress=refuse)


def test_quality_names_its_space_and_has_both():
    flat = ball()
    with pytest.warns(atomesh.MeshWarning, match="metric='shape'") as caught:
        mesh = atomesh.mesh(flat, distance=6, feature="edges", spacing=(25, 25, 4), units="m", metric="samples")
    assert caught[0].filename == __file__
    quality = mesh.quality
    assert quality["space"] == quality["physical"]["space"] == "physical"
    assert quality["smallest_angle"] == quality["physical"]["smallest_angle"]
    assert quality["smallest_angle"]["worst"] < 15 < quality["lattice"]["smallest_angle"]["worst"]
    arrays = mesh.cell_data
    assert arrays["min_dihedral_physical"].min() == pytest.approx(quality["smallest_angle"]["worst"], abs=1e-3)
    assert arrays["min_dihedral"].min() == pytest.approx(quality["lattice"]["smallest_angle"]["worst"], abs=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        time = atomesh.mesh(flat, distance=6, feature="edges", spacing=(25, 25, 4), units=("m", "m", "ms"))
    assert time.quality["space"] == "lattice" and time.quality["physical"] is None
    assert "min_dihedral_physical" not in time.cell_data


def test_time_coordinates_cause_a_warning():
    with pytest.warns(UserWarning, match="is time") as caught:
        atomesh.mesh(ball(), distance=5, units=("m", "m", "ms"))
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        atomesh.mesh(ball(), distance=5, units="m")


def test_it_needs_nothing_but_numpy():
    code = "import sys, atomesh; print(sorted({'pyvista','vtk','meshio','xarray','tqdm'} & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"
