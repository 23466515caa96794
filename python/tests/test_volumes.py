"""Tests of volumes: arrays, paths, and images of other packages, with their positions."""

import numpy as np
import pytest

import atomesh
from conftest import ball

SPACING, ORIGIN = (2.0, 3.0, 4.0), (10.0, 20.0, 30.0)


def nodes(volume, **options):
    # Otherwise cells of scans, which some of these images are, would have another shape.
    return atomesh.mesh(volume, distance=7, feature="edges", metric="samples", **options).points


@pytest.fixture(scope="module")
def expected():
    return nodes(ball(), spacing=SPACING, origin=ORIGIN)


def test_an_array_has_the_given_position(expected):
    far_corner = [o + s * (n - 1) for o, s, n in zip(ORIGIN, SPACING, ball().shape[::-1])]
    assert np.allclose(expected.min(axis=0), ORIGIN)
    assert np.allclose(expected.max(axis=0), far_corner)


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int16, np.uint8, bool])
def test_arrays_of_every_type(kind):
    array = ball() > 50 if kind is bool else np.round(ball()).astype(kind)
    assert np.array_equal(atomesh.Image.of(array).samples, array.astype(np.float32))
    assert np.array_equal(atomesh.Image.of(array[:, ::-1, ::2]).samples, array[:, ::-1, ::2].astype(np.float32))


def test_a_file(tmp_path, expected):
    image = atomesh.Image.of(ball(), SPACING, ORIGIN)
    image.save(tmp_path / "ball.vti")
    assert np.array_equal(nodes(tmp_path / "ball.vti"), expected)
    read = atomesh.read(str(tmp_path / "ball.vti"))
    assert np.array_equal(read.samples, image.samples)
    assert np.allclose(read.spacing, SPACING) and np.allclose(read.origin, ORIGIN)
    # An origin replaces that of the file.
    moved = nodes(tmp_path / "ball.vti", origin=(0, 0, 0))
    assert np.allclose(moved, expected - ORIGIN)


def test_xarray(expected):
    xarray = pytest.importorskip("xarray")
    coords = {
        name: (name, ORIGIN[k] + SPACING[k] * np.arange(ball().shape[2 - k]), {"units": "m"})
        for k, name in enumerate("xyz")
    }
    array = xarray.DataArray(ball(), dims=("z", "y", "x"), coords=coords)
    assert np.array_equal(nodes(array), expected)
    # Named axes are sorted.
    assert np.array_equal(nodes(array.transpose("x", "z", "y")), expected)
    assert atomesh.Image.of(array).units == ["m"] * 3
    uneven = array.assign_coords(x=np.arange(array.sizes["x"]) ** 2)
    with pytest.raises(atomesh.Error, match="x: is not evenly spaced"):
        atomesh.mesh(uneven)


def test_pyvista(expected):
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.ImageData(dimensions=ball().shape[::-1], spacing=SPACING, origin=ORIGIN)
    grid["values"] = ball().ravel()
    assert np.array_equal(nodes(grid), expected)
    corner = np.array(ORIGIN) - 0.5 * np.array(SPACING)
    grid = pyvista.ImageData(dimensions=np.array(ball().shape[::-1]) + 1, spacing=SPACING, origin=corner)
    grid.cell_data["values"] = ball().ravel()
    assert np.allclose(nodes(grid), expected)
    converted = atomesh.Image.of(ball(), SPACING, ORIGIN).to_pyvista()
    assert np.array_equal(nodes(converted), expected)


def test_the_accessor_of_pyvista(expected):
    pyvista = pytest.importorskip("pyvista", minversion="0.48")
    grid = atomesh.Image.of(ball(), SPACING, ORIGIN).to_pyvista()
    assert np.array_equal(grid.atomesh.mesh(distance=7, feature="edges").points, expected)
    potential = grid.atomesh.feature(feature="edges")
    assert isinstance(potential, pyvista.ImageData) and potential.dimensions == grid.dimensions


@pytest.mark.parametrize("on_cells", [False, True])
def test_vtk(on_cells, expected):
    vtk = pytest.importorskip("vtkmodules.vtkCommonDataModel")
    from vtkmodules.util.numpy_support import numpy_to_vtk

    values = numpy_to_vtk(ball().ravel(), deep=True)
    values.SetName("values")
    grid, shape = vtk.vtkImageData(), np.array(ball().shape[::-1])
    grid.SetDimensions(*(int(n) for n in shape + on_cells))
    grid.SetSpacing(SPACING)
    grid.SetOrigin(np.array(ORIGIN) - 0.5 * on_cells * np.array(SPACING))
    (grid.GetCellData() if on_cells else grid.GetPointData()).AddArray(values)
    assert np.array_equal(nodes(grid), expected)
    with pytest.raises(atomesh.Error, match="without an array"):
        nodes(vtk.vtkImageData())


def test_masked_samples_are_missing():
    array = ball()
    marked = array.copy()
    marked[:, :4, :4] = -999
    image = atomesh.Image.of(np.ma.masked_equal(marked, -999))
    assert np.array_equal(np.isnan(image.samples), marked == -999)
    # Without masked samples, the array is used as it is, even if it holds integers.
    unmasked = np.ma.array(array.astype(np.int16))
    assert np.array_equal(atomesh.Image.of(unmasked).samples, array.astype(np.int16))


def test_labels_that_floats_cannot_represent_remain_distinct(tmp_path):
    labels = np.full((16, 17, 18), 2**60, dtype=np.int64)
    labels[8:] += 1
    mesh = atomesh.mesh(labels, distance=4)
    region_labels = [region["label"] for region in mesh.report["regions"]["regions"]]
    assert region_labels == [2**60, 2**60 + 1]


def test_simpleitk(expected):
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(ball())
    image.SetSpacing(SPACING)
    image.SetOrigin(ORIGIN)
    assert np.array_equal(nodes(image), expected)
    rotation = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    image.SetDirection(rotation)
    rotated = atomesh.Image.of(image)
    assert np.allclose(rotated.origin + rotated.axes[0], image.TransformIndexToPhysicalPoint((1, 0, 0)))
    assert np.allclose(rotated.origin + rotated.axes[1], image.TransformIndexToPhysicalPoint((0, 1, 0)))


def test_nibabel(tmp_path, expected):
    nibabel = pytest.importorskip("nibabel")
    affine = np.diag([*SPACING, 1.0])
    affine[:3, 3] = ORIGIN
    image = nibabel.Nifti1Image(ball().T, affine)
    # In ITK, x points to the left and y to the back.
    assert np.allclose(nodes(image), expected * [-1, -1, 1])
    # The file of the image has the same position.
    nibabel.save(image, tmp_path / "ball.nii.gz")
    assert np.allclose(nodes(tmp_path / "ball.nii.gz"), nodes(image), atol=1e-4)


@pytest.mark.parametrize(
    "volume, options, message",
    [
        (np.zeros(5), {}, "shape 5; give an array of two axes or three"),
        (np.zeros((4, 4, 4), complex), {}, "holds complex128; give real numbers"),
        (np.array([["a"]]), {}, "give real numbers"),
        (ball(), {"spacing": (1, 2)}, "is not 3 positive numbers; give x, y, z"),
        (ball(), {"spacing": (1, 2, 0)}, "spacing=.* give x, y, z"),
        (ball(), {"units": ["m"]}, "as many"),
        (np.full((9, 9, 9), np.nan), {}, "NaN"),
        ("absent.npy", {}, "absent.npy: cannot open"),
    ],
)
def test_invalid_volumes_are_refused(volume, options, message):
    with pytest.raises(atomesh.Error, match=message):
        atomesh.mesh(volume, **options)
