"""Values of arguments in the forms that Python users try first, and the exceptions for wrong ones."""

import pickle

import numpy as np
import pytest

import atomesh
from conftest import ball, disc


def parameters(mesh):
    return mesh.report["parameters"]


def labels():
    """Returns labels 0, 1 (a disc) and 5 (a strip)."""
    image = (disc() > 1).astype(np.uint8)
    image[:, 40:] = 5
    return image


@pytest.mark.parametrize("distance", [(4, 10), [4.0, 10.0], np.array([4, 10]), "4:10", (np.array(4), np.float32(10))])
def test_a_pair_is_a_range_of_distances(distance):
    mesh = atomesh.mesh(disc(), distance=distance, feature="edges")
    assert parameters(mesh)["distance"] == "4:10"


def test_labels_have_a_dict_each():
    given = {1: {"distance": 3, "name": "core"}, 5: {"into": 0}}
    mesh = atomesh.mesh(labels(), feature="labels", distance=6, label=given)
    assert [(region.label, region.name) for region in mesh.regions] == [(0, None), (1, "core")]
    typed = atomesh.mesh(labels(), feature="labels", distance=6, label=["1:distance=3,name=core", "5:into=0"])
    assert np.array_equal(typed.points, mesh.points)
    with pytest.raises(ValueError, match="label="):
        atomesh.mesh(labels(), feature="labels", label={1: {"distanse": 3}})


def test_one_spacing_is_that_of_all_axes():
    assert atomesh.Image.of(ball(), spacing=2.0).spacing.tolist() == [2, 2, 2]
    assert atomesh.Image.of(ball(), spacing=np.float32(2)).spacing.tolist() == [2, 2, 2]
    one, three = (atomesh.mesh(disc(), distance=6, spacing=s) for s in (2.0, (2, 2)))
    assert np.array_equal(one.points, three.points) and one.points.max() == 94


def test_scales_and_weights_are_tuples(faults):
    mesh = atomesh.mesh(ball(), distance=5, metric=(1, 1, 0.5), feature="edges")
    assert parameters(mesh)["metric"] == "1,1,0.5"
    mesh = atomesh.mesh(faults, distance=6, feature="faults+horizons", feature_weights=(1, 0.5))
    assert parameters(mesh)["feature-weights"] == "1,0.5"


def test_images_of_options_stay_in_memory(faults, monkeypatch):
    def refuse(*args, **keywords):
        raise AssertionError("an image needs no file")

    monkeypatch.setattr("tempfile.TemporaryDirectory", refuse)
    beta = np.full(faults.samples.shape, 0.3)
    distances = np.full(faults.samples.shape, 7.0)
    mesh = atomesh.mesh(faults, distance=(6, 8), feature="ridges", beta=beta, distance_from=atomesh.Image.of(distances))
    assert parameters(mesh)["beta"] == "<beta>" and parameters(mesh)["distance-from"] == "<distance_from>"
    # The verb reads them again.
    assert mesh.edit(add=[(20.5, 20.5, 20.5)]).report["edits"]
    timed = atomesh.Image.of(faults, units=("m", "m", "ms"), spacing=(25, 25, 4))
    deep = atomesh.mesh(timed, distance=6, feature="ridges", velocity=np.full(faults.samples.shape, 2000.0))
    assert deep.points[:, 2].max() == pytest.approx(4 * (faults.samples.shape[0] - 1))


def test_images_of_properties_stay_in_memory(mesh, faults, tmp_path):
    porosity = np.full(faults.samples.shape, 0.25)
    porosity[20:] = 0.1
    mesh.save(
        tmp_path / "a.vtkhdf", porosity=porosity, property={"amplitude": faults},
        permeability=(10 * porosity, 10 * porosity, porosity), permeability_unit="mD",
    )
    assert (tmp_path / "a.vtkhdf").stat().st_size > 1000


def test_a_table_is_a_list_of_rows(faults):
    wells = [(20, 20, 0, 1), (22, 21, 39, 1.0)]
    one = atomesh.mesh(faults, distance=6, feature="ridges", well=wells)
    two = atomesh.mesh(faults, distance=6, feature="ridges", well=[np.array(wells)])
    assert np.array_equal(one.points, two.points)
    pulled = atomesh.mesh(faults, distance=6, atoms_from=[(20.25, 20.25, 20.25)])
    assert np.isclose(pulled.points, 20.25).all(axis=1).any()


@pytest.mark.parametrize(
    "volume, options, kind, says",
    [
        (disc(), {"distanse": 5}, TypeError, r"mesh\(\): has no option distanse; did you mean distance=\?"),
        (disc(), {"distance": object()}, TypeError, "distance=: is of type object; atomesh.options"),
        (disc(), {"distance": {"min": 3}}, TypeError, "distance=: is of type dict"),
        (disc(), {"spacing": "wide"}, TypeError, "spacing='wide': is not numbers; give x, y"),
        (disc(), {"units": 5}, TypeError, "units=5: is not text; give one unit"),
        (object(), {}, TypeError, "is of type object; give an array of real numbers"),
        (None, {}, TypeError, "is of type NoneType"),
        (np.zeros((4, 4), complex), {}, TypeError, "holds complex128"),
        (np.zeros(5), {}, ValueError, "has shape 5; give an array"),
        (disc(), {"distance": -1}, ValueError, "distance=-1: is not positive; give"),
        (disc(), {"distance": (10, 4)}, ValueError, 'distance="10:4": has a minimum above its maximum'),
        (disc(), {"feature": "folds"}, ValueError, "feature="),
        (np.full((9, 9), np.nan), {}, ValueError, "NaN"),
        ("absent.vti", {}, FileNotFoundError, "absent.vti: cannot open"),
        (disc(), {"page": "absent/a.html"}, FileNotFoundError, "absent/a.html: the folder absent does not exist"),
        (disc(), {"atoms_from": "absent.csv"}, FileNotFoundError, "absent.csv"),
    ],
)
def test_an_error_is_also_the_standard_exception(volume, options, kind, says):
    with pytest.raises(kind, match=says) as caught:
        atomesh.mesh(volume, **options)
    problem = caught.value
    assert isinstance(problem, atomesh.Error) and "\n" not in str(problem)
    assert str(problem) == f"{problem.place}: {problem.problem}; {problem.remedy}"
    copy = pickle.loads(pickle.dumps(problem))
    assert type(copy) is type(problem) and str(copy) == str(problem) and copy.place == problem.place


def test_missing_meshes_are_files_not_found(tmp_path):
    with pytest.raises(FileNotFoundError) as caught:
        atomesh.load("absent.vtu")
    assert isinstance(caught.value, OSError) and caught.value.filename == "absent.vtu" and caught.value.errno == 2
    damaged = tmp_path / "a.vtu"
    damaged.write_text("<VTKFile")
    with pytest.raises(ValueError):
        atomesh.load(damaged)
    with pytest.raises(TypeError, match="give the path of a file"):
        atomesh.read(5)


def test_an_unknown_verb_has_no_options():
    with pytest.raises(KeyError, match="there is no such verb; give one of mesh, "):
        atomesh.options("meshes")


def test_two_or_three_flat_horizons_are_no_point():
    map_of_cells = atomesh.voronoi(np.eye(24, dtype=np.float32), distance=6, feature="none")
    for horizons in ([0, 10], [0, 10, 25], np.array([0.0, 10.0])):
        assert map_of_cells.columns(horizons).n_cells == (len(horizons) - 1) * map_of_cells.n_cells
