"""Compares images of segyio, nibabel, pynrrd, SimpleITK and tifffile, and the test data of nibabel: `atomesh convert`
must read the same values, and `atomesh info` the same geometry, as these libraries.

    others.py ATOMESH FOLDER

Prints one line for each library and one for each difference. The exit code is 1 if there is a difference."""

import glob
import itertools
import json
import os
import subprocess
import sys

import nibabel
import nrrd
import numpy as np
import segyio
import SimpleITK as sitk
import tifffile

atomesh, folder = sys.argv[1:]
os.chdir(folder)
rng = np.random.default_rng(7)
faults, read = [], 0
# NumPy's order: x varies fastest.
SHAPE = (4, 5, 6)
# Tolerance of the geometry relative to its largest coordinate, since NIfTI has single precision.
GEOMETRY_TOLERANCE = 1e-5


def values(dtype):
    dtype = np.dtype(dtype)
    if dtype.kind in "iu":
        limit = min(np.iinfo(dtype).max, 1 << 23)
        return rng.integers(max(np.iinfo(dtype).min, -limit), limit, SHAPE).astype(dtype)
    return (100 * rng.standard_normal(SHAPE)).astype(dtype)


def run(*words):
    return subprocess.run([atomesh, *words], capture_output=True, text=True)


def compare(path, array, origin=None, axes=None, refused=()):
    """Compares an image with values in the order (z, y, x), and with an origin and axes in ITK's coordinates."""
    global read
    if os.path.exists("out.npy"):
        os.remove("out.npy")
    result = run("convert", path, "out.npy", "--quiet")
    if result.returncode:
        if not any(reason in result.stderr for reason in refused):
            faults.append(f"{path}: refused: {result.stderr.strip()}")
        return
    read += 1
    ours = np.load("out.npy")
    theirs = np.squeeze(np.asarray(array)).astype(np.float32)
    theirs = np.where(np.isfinite(theirs), theirs, 0)
    ours = np.where(np.isfinite(ours), ours, 0)
    if np.squeeze(ours).shape != theirs.shape:
        faults.append(f"{path}: shape {ours.shape}, theirs {theirs.shape}")
    elif not np.allclose(np.squeeze(ours), theirs, rtol=2e-6, atol=1e-6 * (np.abs(theirs).max() + 1e-30)):
        difference = np.abs(np.squeeze(ours) - theirs).max()
        faults.append(f"{path}: values differ by {difference}")
    if origin is None:
        return
    image = json.loads(run("info", path, "--json", "--quiet").stdout)["image"]
    actual = [np.array(image["origin"])] + [np.array(axis["step"]) for axis in image["axes"]]
    if len(actual[0]) != len(origin):
        return
    expected = [np.array(origin)] + [np.array(axis) for axis in axes]
    size = max(np.abs(w).max() for w in expected) + 1e-30
    for a, b in zip(actual, expected):
        if not np.allclose(a, b, atol=GEOMETRY_TOLERANCE * size):
            faults.append(f"{path}: lies at {actual}, theirs {expected}")
            break


def by_segyio():
    for fmt, sorting, step in itertools.product((1, 2, 3, 5, 8), (1, 2), (1, 3)):
        spec = segyio.spec()
        spec.ilines, spec.xlines = range(10, 10 + 4 * step, step), range(20, 20 + 5 * step, step)
        spec.samples, spec.sorting, spec.format = np.arange(6) * 4.0, sorting, fmt
        path = f"segyio-{fmt}-{sorting}-{step}.sgy"
        cube = np.round(values("f4")).clip(-120, 120).astype(np.float32)
        with segyio.create(path, spec) as file:
            positions = itertools.product(range(4), range(5))
            positions = sorted(positions, key=lambda p: p if sorting == 2 else p[::-1])
            for n, (i, j) in enumerate(positions):
                file.header[n] = {
                    segyio.TraceField.INLINE_3D: spec.ilines[i],
                    segyio.TraceField.CROSSLINE_3D: spec.xlines[j],
                    segyio.TraceField.CDP_X: 1000 + 25 * j,
                    segyio.TraceField.CDP_Y: 2000 + 12 * i,
                    segyio.TraceField.SourceGroupScalar: 1,
                    segyio.TraceField.TRACE_SAMPLE_INTERVAL: 4000,
                }
                file.trace[n] = cube[i, j].astype(file.dtype)
            file.bin.update(hdt=4000, hns=6)
        with segyio.open(path) as file:
            # The slowest axis comes first, which depends on the sorting.
            theirs = segyio.tools.cube(file)
            compare(path, theirs if file.sorting == 2 else theirs.transpose(1, 0, 2))


def itk_geometry(affine):
    """Converts the geometry of nibabel (right-anterior-superior) to that of ITK (left-posterior-superior)."""
    flip = np.diag([-1.0, -1.0, 1.0])
    return flip @ affine[:3, 3], list((flip @ affine[:3, :3]).T)


def by_nibabel():
    rotation = np.array([[1.9, 0.3, -0.1, -30.5], [-0.2, 2.5, 0.4, 12.0], [0.3, -0.5, 3.1, 7.25], [0, 0, 0, 1]])
    for dtype, end, scaled in itertools.product(("u1", "i2", "i4", "u2", "i1", "f4", "f8"), (".nii", ".nii.gz"), (0, 1)):
        path = f"nibabel-{dtype}-{scaled}{end}"
        image = nibabel.Nifti1Image(values(dtype).T.copy(), rotation)
        image.header.set_data_dtype(dtype)
        if scaled:
            image.header.set_slope_inter(0.25, -3)
        image.to_filename(path)
        theirs = nibabel.load(path)
        compare(path, theirs.get_fdata().T, *itk_geometry(theirs.affine))
    for order in "<>":
        path = f"nibabel-order-{'little' if order == '<' else 'big'}.nii"
        header = nibabel.Nifti1Header(endianness=order)
        image = nibabel.Nifti1Image(values("i2").T.copy(), rotation, header)
        image.to_filename(path)
        compare(path, nibabel.load(path).get_fdata().T, *itk_geometry(nibabel.load(path).affine))
    # Test data of nibabel. Files with more than one volume or without samples are refused.
    test_data = os.path.join(os.path.dirname(nibabel.__file__), "tests", "data")
    for path in sorted(glob.glob(test_data + "/*.nii") + glob.glob(test_data + "/*.nii.gz")):
        theirs = nibabel.load(path)
        is_volume = theirs.ndim <= 3 and hasattr(theirs, "affine")
        compare(
            path,
            np.asarray(theirs.dataobj).T,
            *(itk_geometry(theirs.affine) if is_volume else (None, None)),
            refused=() if is_volume else ("volume", "axes"),
        )


def by_nrrd():
    kinds = ("u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8", "i8")
    for dtype, encoding, end, detached in itertools.product(kinds, ("raw", "gzip", "ascii"), ("little", "big"), (0, 1)):
        if detached and encoding == "ascii":
            continue
        path = f"nrrd-{dtype}-{encoding}-{end}.{'nhdr' if detached else 'nrrd'}"
        header = {
            "encoding": encoding,
            "endian": end,
            "space": "left-posterior-superior",
            "space directions": np.array([[1.5, 0, 0.2], [0, 2, 0], [-0.3, 0, 2.5]]),
            "space origin": np.array([3.0, -4.0, 5.0]),
        }
        nrrd.write(path, values(dtype).T.copy(), header, detached_header=bool(detached))
        array, header = nrrd.read(path)
        compare(path, array.T, header["space origin"], list(header["space directions"]))


def by_itk():
    kinds = ("u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8")
    direction = (0.8, -0.6, 0, 0.6, 0.8, 0, 0, 0, 1)
    for dtype, end, packed in itertools.product(kinds, ("mha", "mhd", "nrrd", "nii", "nii.gz"), (False, True)):
        # Names differ, since ITK would read x.nii in place of x.nii.gz.
        path = f"itk-{dtype}-{packed}-{end[-2:]}.{end}"
        image = sitk.GetImageFromArray(values(dtype))
        image.SetSpacing((0.5, 1.25, 3))
        image.SetOrigin((-10, 20, 5.5))
        image.SetDirection(direction)
        sitk.WriteImage(image, path, packed)
        image = sitk.ReadImage(path)
        axes = np.array(image.GetDirection()).reshape(3, 3) * np.array(image.GetSpacing())
        compare(path, sitk.GetArrayFromImage(image), image.GetOrigin(), list(axes.T))


def by_atomesh():
    """Compares files that atomesh writes, as other libraries read them, also of a survey in time."""
    global read
    image = sitk.GetImageFromArray(values("f4"))
    image.SetSpacing((25, 12.5, 4))
    image.SetOrigin((1000, 2000, -300))
    image.SetDirection((0.8, -0.6, 0, 0.6, 0.8, 0, 0, 0, 1))
    sitk.WriteImage(image, "original.nrrd")
    survey = sitk.ReadImage("original.nrrd")
    for source, expected in (("original.nrrd", survey), ("segyio-5-2-3.sgy", None)):
        first = None
        for end in ("mha", "nrrd", "nii", "nii.gz", "vti"):
            path = f"ours-{source[:4]}.{end}"
            result = run("convert", source, path, "--quiet")
            if result.returncode:
                faults.append(f"{path}: {result.stderr}")
                continue
            read += 1
            if end == "vti":
                actual = vtk_read(path)
            else:
                actual = sitk.ReadImage(path)
                axes = np.array(actual.GetDirection()).reshape(3, 3) * np.array(actual.GetSpacing())
                actual = sitk.GetArrayFromImage(actual), np.array(actual.GetOrigin()), axes
            if first is None:
                if expected is None:
                    first = actual
                else:
                    axes = np.array(expected.GetDirection()).reshape(3, 3) * np.array(expected.GetSpacing())
                    first = sitk.GetArrayFromImage(expected), np.array(expected.GetOrigin()), axes
            for what, a, b in zip(("values", "origin", "axes"), actual, first):
                if a.shape != b.shape or not np.allclose(a, b, rtol=1e-5, atol=1e-5 * np.abs(b).max()):
                    faults.append(f"{path}: others read other {what}: {a.ravel()[:9]}, not {b.ravel()[:9]}")


def vtk_read(path):
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXML import vtkXMLImageDataReader

    reader = vtkXMLImageDataReader()
    reader.SetFileName(path)
    reader.Update()
    image = reader.GetOutput()
    rotation = image.GetDirectionMatrix()
    rotation = np.array([[rotation.GetElement(i, j) for j in range(3)] for i in range(3)])
    array = vtk_to_numpy(image.GetPointData().GetArray(0)).reshape(image.GetDimensions()[::-1])
    return array, np.array(image.GetOrigin()), rotation * np.array(image.GetSpacing())


def by_tifffile():
    kinds = ("u1", "u2", "u4", "i2", "f4", "f8")
    for dtype, order, packing, big in itertools.product(kinds, "<>", (None, "zlib", "lzw"), (False, True)):
        for predictor in (False, True) if packing else (False,):
            path = f"tifffile-{dtype}-{'le' if order == '<' else 'be'}-{packing}-{big}-{predictor}.tif"
            try:
                tifffile.imwrite(
                    path, values(dtype), byteorder=order, compression=packing, bigtiff=big, predictor=predictor,
                    photometric="minisblack", metadata=None,
                )
            except (ImportError, KeyError, ValueError, NotImplementedError):
                # Writing some compressions needs another package.
                continue
            compare(path, tifffile.imread(path))
    # Samples of one bit are stored in rows of whole bytes. Separate planes of colours are no volume.
    tifffile.imwrite("tifffile-bits.tif", values("i2") > 0, photometric="minisblack")
    compare("tifffile-bits.tif", tifffile.imread("tifffile-bits.tif"))
    tifffile.imwrite("tifffile-planes.tif", values("u1")[:3], photometric="rgb", planarconfig="separate")
    compare("tifffile-planes.tif", values("u1"), refused=("in a separate plane",))
    for name, options in (("imagej", {"imagej": True, "metadata": {"axes": "ZYX"}}), ("ome", {"ome": True, "metadata": {"axes": "ZYX"}}), ("tiled", {"tile": (16, 16)})):
        path = f"tifffile-{name}.tif"
        tifffile.imwrite(path, values("u2"), photometric="minisblack", **options)
        compare(path, tifffile.imread(path), refused=("only the first is a page",))


for name, compare_library in (
    ("segyio", by_segyio), ("nibabel", by_nibabel), ("pynrrd", by_nrrd), ("SimpleITK", by_itk), ("tifffile", by_tifffile),
    ("written by atomesh", by_atomesh),
):
    before, read = len(faults), 0
    compare_library()
    print(f"{name}: {read} files read, {len(faults) - before} differ")
for fault in faults:
    print(fault)
sys.exit(bool(faults))
