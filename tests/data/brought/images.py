"""Brings images of other programs into atomesh, in every way in which they are written.

A box has two labelled bodies and one marked voxel. Each program that writes images writes it in the sample types, units,
orders of axes, orientations and compressions that it has. An independent reader reads each file, and finds the voxel and
the labels where they were meant to be; then `atomesh info` and `atomesh convert` must find them there.

    images.py ATOMESH FOLDER [--only FORMAT,...] [--list]
    images.py ATOMESH FOLDER --keep FILES     also copies the first files of each format that are right to FILES,
                                              with `cases.json`, for `cargo test --test main brought::`

The combinations are generated: each pair of values of two dimensions occurs at least once among those that a format can
hold. A combination is right, wrong (another place, size, unit or label, without a word), or refused (exit code 1). The
program prints a table and fails if any is wrong, or more than one in ten is refused.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys

import h5py
import nibabel
import nrrd
import numpy as np
import segyio
import SimpleITK as sitk
import tifffile
import zarr
from matrix import pairwise, print_table

# Voxels along x, y and z, and the place of the marked one.
DIMS = (12, 10, 8)
MARKED = (9, 2, 5)
# Bodies: ranges of voxels along x, y and z.
BODIES = [((1, 5), (1, 8), (1, 4)), ((5, 10), (4, 9), (2, 7))]
# Steps and origin, in the unit of the file.
STEP = np.array([0.5, 0.25, 2.0])
ORIGIN = np.array([30.0, -20.0, 10.0])

# Labels of the two bodies and of the marked voxel.
LABELS = {
    "small": (1, 2, 7),
    "byte": (3, 200, 255),
    "signed": (-5, 100, 7),
    "wide": (1000, 40000, 65535),
    "atlas": (312782546, 614454277, 312782550),
    "negative": (-(2**31), 2**31 - 1, -1),
    "huge": (2**40 + 1, 2**40 + 2, 2**40 + 3),
}
METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": 0.0254, "cm": 1e-2, "angstrom": 1e-10, "ft": 0.3048, "": 1.0}

# Directions of the columns i, j and k of an image, in the coordinates of the file.
c, s = np.cos(np.radians(25)), np.sin(np.radians(25))
DIRECTIONS = {
    "plain": np.eye(3),
    "flipped": np.diag([1.0, 1.0, -1.0]),
    "turned": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    "tilted": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.diag([-1.0, -1.0, 1.0]),
    "sagittal": np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]]),
}


def volume(case):
    """The samples, by (z, y, x)."""
    a, b, mark = LABELS[case["labels"]]
    dtype = np.dtype(case["type"])
    out = np.zeros(DIMS[::-1], dtype)
    for label, ranges in zip((a, b), BODIES):
        (x0, x1), (y0, y1), (z0, z1) = ranges
        out[z0:z1, y0:y1, x0:x1] = label
    i, j, k = MARKED
    out[k, j, i] = mark
    return out


def matrix_of(case):
    """Columns: the step along i, j and k; and the place of the first sample."""
    return DIRECTIONS[case["direction"]] @ np.diag(STEP), ORIGIN


def place(case, index=MARKED):
    steps, origin = matrix_of(case)
    return origin + steps @ np.array(index, float)


class Expected:
    """What a reader must find: the marked voxel, the labels, and metres for a unit of each coordinate."""

    def __init__(self, case, point, units, options=(), path=None, labels=None):
        self.point, self.units, self.options = np.asarray(point, float), units, list(options)
        self.path = path
        self.labels = sorted({0, *LABELS[case["labels"]]}) if labels is None else labels


# ------------------------------------------------------------------ writers

def npy(case, path):
    data = volume(case)
    axes = case["order"]
    # Order: the axes of the array, the slowest first.
    array = np.transpose(data, ["zyx".index(a) for a in axes])
    np.save(path, np.asfortranarray(array) if case["packing"] == "other" else np.ascontiguousarray(array))
    back = np.load(path)
    assert back[tuple(MARKED["xyz".index(a)] for a in axes)] == data[MARKED[::-1]]
    fastest_first = axes[::-1]
    options = ["--axes", ",".join(fastest_first), "--spacing", ",".join(str(STEP["xyz".index(a)]) for a in fastest_first),
               "--origin", ",".join(map(str, ORIGIN)), "--unit", case["unit"]]
    return Expected(case, ORIGIN + STEP * MARKED, [case["unit"]] * 3, options)


def itk_image(case):
    image = sitk.GetImageFromArray(volume(case))
    image.SetSpacing(STEP.tolist())
    image.SetOrigin(ORIGIN.tolist())
    image.SetDirection(DIRECTIONS[case["direction"]].ravel().tolist())
    return image


def itk(case, path):
    sitk.WriteImage(itk_image(case), path, case["packing"] == "packed")
    back = sitk.ReadImage(path)
    point = back.TransformIndexToPhysicalPoint(MARKED)
    assert np.allclose(point, place(case), atol=1e-4), (point, place(case))
    assert sitk.GetArrayFromImage(back)[MARKED[::-1]] == LABELS[case["labels"]][2]
    return Expected(case, place(case), [case["unit"]] * 3)


def pynrrd(case, path):
    steps, origin = matrix_of(case)
    header = {"space directions": steps.T, "space origin": origin, "encoding": "raw" if case["packing"] == "plain" else "gzip"}
    if case["packing"] == "other":
        header["encoding"] = "ascii"
    if case["packing"] == "big":
        header["endian"] = "big"
    sign = np.ones(3)
    if case["order"] == "zyx":
        header["space"] = "left-posterior-superior"
    else:
        header["space"] = "right-anterior-superior"
        sign = np.array([-1.0, -1.0, 1.0])
    if case["unit"]:
        header["space units"] = [case["unit"]] * 3
    nrrd.write(path, volume(case).transpose(2, 1, 0), header)
    data, head = nrrd.read(path)
    assert data[MARKED] == LABELS[case["labels"]][2]
    point = head["space origin"] + head["space directions"].T @ MARKED
    return Expected(case, sign * point, [case["unit"]] * 3)


def nifti(case, path):
    steps, origin = matrix_of(case)
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = steps, origin
    kind = nibabel.Nifti2Image if case["packing"] == "other" else nibabel.Nifti1Image
    data = volume(case).transpose(2, 1, 0)
    image = kind(data, affine, dtype=data.dtype)
    image.header.set_xyzt_units({"mm": "mm", "um": "micron", "m": "meter"}[case["unit"]])
    image.set_sform(affine, code=int(case["code"]))
    image.set_qform(affine if case["code"] != "3" else None, code=1 if case["code"] != "3" else 0)
    if case["order"] == "big":
        image = kind(data, affine, image.header.as_byteswapped(">"))
    nibabel.save(image, path)
    back = nibabel.load(path)
    assert np.asanyarray(back.dataobj)[MARKED] == LABELS[case["labels"]][2]
    point = (back.affine @ [*MARKED, 1])[:3]
    return Expected(case, point * [-1, -1, 1], [case["unit"]] * 3)


def scaled_nifti(case, path):
    """Labels that nibabel stores as bytes, with the slope that it chooses."""
    data = volume({**case, "type": "f8"}).transpose(2, 1, 0)
    image = nibabel.Nifti1Image(data, np.diag([*STEP, 1]))
    image.set_data_dtype(np.dtype(case["type"]))
    image.header.set_xyzt_units("mm")
    nibabel.save(image, path)
    back = nibabel.load(path)
    assert abs(back.get_fdata()[MARKED] - LABELS[case["labels"]][2]) < 0.5
    return Expected(case, (STEP * MARKED) * [-1, -1, 1], ["mm"] * 3)


def vtk_image(case):
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData

    image = vtkImageData()
    image.SetDimensions(DIMS)
    image.SetSpacing(STEP)
    image.SetOrigin(ORIGIN)
    image.SetDirectionMatrix(DIRECTIONS[case["direction"]].ravel().tolist())
    array = numpy_to_vtk(volume(case).ravel(), deep=True)
    array.SetName("labels")
    image.GetPointData().SetScalars(array)
    return image


def vtk_xml(case, path):
    from vtkmodules.vtkIOXML import vtkXMLImageDataReader, vtkXMLImageDataWriter

    writer = vtkXMLImageDataWriter()
    writer.SetFileName(path)
    writer.SetInputData(vtk_image(case))
    {"plain": writer.SetDataModeToBinary, "packed": writer.SetDataModeToAppended, "other": writer.SetDataModeToAscii,
     "big": writer.SetByteOrderToBigEndian}[case["packing"]]()
    if case["order"] == "lz4":
        writer.SetCompressorTypeToLZ4()
    if case["order"] == "none":
        writer.SetCompressorTypeToNone()
    writer.Write()
    reader = vtkXMLImageDataReader()
    reader.SetFileName(path)
    reader.Update()
    return Expected(case, marked_by_vtk(case, reader.GetOutput()), [""] * 3)


def vtk_legacy(case, path):
    from vtkmodules.vtkIOLegacy import vtkStructuredPointsReader, vtkStructuredPointsWriter

    writer = vtkStructuredPointsWriter()
    writer.SetFileName(path)
    writer.SetInputData(vtk_image(case))
    if case["packing"] == "packed":
        writer.SetFileTypeToBinary()
    else:
        writer.SetFileTypeToASCII()
    if case["order"] == "old":
        writer.SetFileVersion(42)
    writer.Write()
    reader = vtkStructuredPointsReader()
    reader.SetFileName(path)
    reader.Update()
    return Expected(case, marked_by_vtk(case, reader.GetOutput()), [""] * 3)


def marked_by_vtk(case, image):
    index = np.ravel_multi_index(MARKED[::-1], DIMS[::-1])
    scalars = image.GetPointData().GetScalars()
    value = scalars.GetTuple1(int(index))
    assert value == float(LABELS[case["labels"]][2]), (value, case, scalars.GetClassName())
    return np.array(image.GetPoint(int(index)))


def imagej(case, path):
    unit = {"um": "um", "nm": "nm", "mm": "mm", "cm": "cm", "in": "inch", "angstrom": "\\u00C5"}[case["unit"]]
    step = np.array([1.0, 1.0, 1.0]) if case["order"] == "one" else STEP
    metadata = {"spacing": step[2], "unit": unit, "axes": "ZYX"}
    if case["order"] == "micro":
        # As ImageJ writes letters that are not ASCII.
        metadata["unit"] = "\\u00B5m" if case["unit"] == "um" else unit
    data = volume(case)
    tifffile.imwrite(path, data, imagej=True, resolution=(1 / step[0], 1 / step[1]), metadata=metadata)
    with tifffile.TiffFile(path) as file:
        assert file.is_imagej and file.asarray()[MARKED[::-1]] == data[MARKED[::-1]]
    return Expected(case, step * MARKED, [case["unit"]] * 3)


def ome_tiff(case, path):
    unit = {"um": "\u00b5m", "nm": "nm", "mm": "mm", "cm": "cm", "in": "in", "angstrom": "\u00c5"}[case["unit"]]
    metadata = {"axes": "ZYX", "PhysicalSizeX": STEP[0], "PhysicalSizeY": STEP[1], "PhysicalSizeZ": STEP[2],
                "PhysicalSizeXUnit": unit, "PhysicalSizeYUnit": unit, "PhysicalSizeZUnit": unit}
    data = volume(case)
    step = STEP.copy()
    if case["order"] == "micro" and case["unit"] in ("um", "nm"):
        # The step along z in another unit of length.
        metadata["PhysicalSizeZUnit"] = "mm"
        metadata["PhysicalSizeZ"] = STEP[2] * METRES[case["unit"]] / 1e-3
    if case["order"] == "one":
        data = data[None, :, None]
        metadata["axes"] = "TZCYX"
    options = {"compression": "zlib"} if case["packing"] == "packed" else {}
    if case["packing"] == "big":
        options["byteorder"] = ">"
    if case["packing"] == "other":
        options["bigtiff"] = True
    tifffile.imwrite(path, data, ome=True, metadata=metadata, **options)
    assert np.squeeze(tifffile.imread(path))[MARKED[::-1]] == volume(case)[MARKED[::-1]]
    return Expected(case, step * MARKED, [case["unit"]] * 3)


OME_UNITS = {"um": "micrometer", "nm": "nanometer", "mm": "millimeter", "cm": "centimeter", "m": "meter", "angstrom": "angstrom",
             "ft": "foot", "in": "inch", "": None}


def ome_metadata(case, names, path, version):
    unit = OME_UNITS[case["unit"]]
    kinds = {"c": "channel", "t": "time"}
    axes = [{"name": n, "type": kinds.get(n, "space"), **({"unit": unit} if unit and n in "xyz" else {})} for n in names]
    scale = [float(STEP["xyz".index(n)]) if n in "xyz" else 1.0 for n in names]
    shift = [float(ORIGIN["xyz".index(n)]) if n in "xyz" else 0.0 for n in names]
    levels = [{"path": path, "coordinateTransformations": [
        {"type": "scale", "scale": scale}, {"type": "translation", "translation": shift}]}]
    if case["layout"] == "levels":
        levels.append({"path": path + "half", "coordinateTransformations": [
            {"type": "scale", "scale": [v * 2 if n in "xyz" else v for v, n in zip(scale, names)]},
            {"type": "translation", "translation": shift}]})
    return {"version": version, "axes": axes, "datasets": levels, "name": "image"}


def ome_zarr(version, zarr_format):
    def write(case, path):
        names = case["order"]
        data = volume(case)
        array = np.transpose(data, ["zyx".index(n) for n in names if n in "xyz"])
        for position, n in enumerate(names):
            if n in "ct":
                array = np.expand_dims(array, position)
        inner = "scale0/image" if case["layout"] == "deep" else "0"
        root = zarr.open_group(path, mode="w", zarr_format=zarr_format)
        levels = [(inner, array)]
        if case["layout"] == "levels":
            levels.append((inner + "half", array[tuple(slice(None, None, 2 if n in "xyz" else 1) for n in names)]))
        for name, values in levels:
            options = {"compressors": None} if case["packing"] == "plain" else {}
            if case["packing"] == "other" and zarr_format == 3:
                options["shards"] = tuple(8 if n in "xyz" else 1 for n in names)
            if case["packing"] == "other" and zarr_format == 2:
                options["order"] = "F"
            chunks = tuple(4 if n in "xyz" else 1 for n in names)
            if zarr_format == 2:
                options["chunk_key_encoding"] = {"name": "v2", "separator": "/" if case["layout"] != "plain" else "."}
            target = root.create_array(name, shape=values.shape, chunks=chunks, dtype=values.dtype, **options)
            target[...] = values
        metadata = ome_metadata(case, names, inner, version)
        root.attrs.update({"ome": {"version": version, "multiscales": [metadata]}} if zarr_format == 3
                          else {"multiscales": [metadata]})
        back = zarr.open_group(path, mode="r")[inner]
        index = tuple(MARKED["xyz".index(n)] if n in "xyz" else 0 for n in names)
        assert back[index] == data[MARKED[::-1]]
        given = os.path.join(path, inner) if case["layout"] == "array" else path
        return Expected(case, ORIGIN + STEP * MARKED, [case["unit"]] * 3, path=given)
    return write


def zarr_array(case, path):
    """A bare array, or one whose dimensions have names; the place is given by options."""
    names = case["order"]
    data = volume(case)
    array = np.transpose(data, ["zyx".index(n) for n in names])
    options = {"zarr_format": 2 if case["packing"] == "other" else 3}
    zarr.create_array(path, shape=array.shape, chunks=(4, 4, 4), dtype=array.dtype, **options)[...] = array
    fastest_first = names[::-1]
    given = ["--axes", ",".join(fastest_first), "--spacing", ",".join(str(STEP["xyz".index(a)]) for a in fastest_first),
             "--origin", ",".join(map(str, ORIGIN)), "--unit", case["unit"]]
    return Expected(case, ORIGIN + STEP * MARKED, [case["unit"]] * 3, given)


def with_ome_zarr(case, path):
    from ome_zarr.format import FormatV04, FormatV05
    from ome_zarr.writer import write_image

    names = case["order"]
    data = volume(case)
    array = np.transpose(data, ["zyx".index(n) for n in names if n in "xyz"])
    for position, n in enumerate(names):
        if n in "ct":
            array = np.expand_dims(array, position)
    units = {n: OME_UNITS[case["unit"]] for n in names if n in "xyz"}
    version = FormatV04() if case["packing"] == "other" else FormatV05()
    root = zarr.open_group(path, mode="w", zarr_format=version.zarr_format)
    scale = {n: float(STEP["xyz".index(n)]) if n in "xyz" else 1.0 for n in names}
    write_image(array, root, axes=names, axes_units=units, fmt=version, scale=scale, scale_factors=[2], method="nearest")
    back = zarr.open_group(path, mode="r")
    first = (back.attrs.get("ome") or back.attrs)["multiscales"][0]["datasets"][0]
    index = tuple(MARKED["xyz".index(n)] if n in "xyz" else 0 for n in names)
    assert back[first["path"]][index] == data[MARKED[::-1]]
    written = first["coordinateTransformations"][0]["scale"]
    point = [MARKED[k] * written[names.index("xyz"[k])] for k in range(3)]
    return Expected(case, point, [case["unit"]] * 3)


def with_ngff_zarr(case, path):
    import ngff_zarr

    names = [n for n in case["order"] if n in "xyz"]
    array = np.transpose(volume(case), ["zyx".index(n) for n in names])
    unit = OME_UNITS[case["unit"]]
    image = ngff_zarr.to_ngff_image(
        array, dims=names, scale={n: float(STEP["xyz".index(n)]) for n in names},
        translation={n: float(ORIGIN["xyz".index(n)]) for n in names}, axes_units={n: unit for n in names} if unit else None)
    scales = ngff_zarr.to_multiscales(image, scale_factors=[2] if case["layout"] == "levels" else [])
    ngff_zarr.to_ngff_zarr(path, scales, version="0.4" if case["packing"] == "other" else "0.5")
    back = ngff_zarr.from_ngff_zarr(path).images[0]
    index = tuple(MARKED["xyz".index(n)] for n in back.dims)
    assert np.asarray(back.data)[index] == LABELS[case["labels"]][2]
    point = [back.translation[n] + back.scale[n] * MARKED["xyz".index(n)] for n in "xyz"]
    return Expected(case, point, [case["unit"]] * 3)


def segy(case, path):
    """A survey: inlines along y, crosslines along x, samples downwards."""
    spec = segyio.spec()
    spec.format = {"f4": 5, "i4": 2, "i2": 3, "i1": 8}[case["type"]]
    spec.sorting = 2 if case["order"] == "zyx" else 1
    step_line = 3 if case["direction"] == "flipped" else 1
    spec.ilines = 100 + step_line * np.arange(DIMS[1])
    spec.xlines = 200 + np.arange(DIMS[0])
    spec.samples = ORIGIN[2] + STEP[2] * np.arange(DIMS[2])
    spec.endian = "little" if case["packing"] == "other" else "big"
    directions = DIRECTIONS["turned" if case["direction"] in ("turned", "tilted") else "plain"]
    data = volume(case)
    scalar = -100 if case["labels"] == "small" else -10
    with segyio.create(path, spec) as out:
        out.bin[segyio.BinField.MeasurementSystem] = 2 if case["unit"] == "ft" else 1
        out.bin[segyio.BinField.Interval] = int(STEP[2] * 1000)
        lines = [(j, i) for j in range(DIMS[1]) for i in range(DIMS[0])]
        if spec.sorting == 1:
            lines = [(j, i) for i in range(DIMS[0]) for j in range(DIMS[1])]
        for trace, (j, i) in enumerate(lines):
            x, y, _ = [600000.0, 6000000.0, 0] + directions @ [25.0 * i, 50.0 * j, 0]
            out.header[trace] = {
                segyio.TraceField.INLINE_3D: int(spec.ilines[j]), segyio.TraceField.CROSSLINE_3D: int(spec.xlines[i]),
                segyio.TraceField.CDP_X: round(x * -scalar), segyio.TraceField.CDP_Y: round(y * -scalar),
                segyio.TraceField.SourceGroupScalar: scalar, segyio.TraceField.TRACE_SAMPLE_COUNT: DIMS[2],
                segyio.TraceField.TRACE_SAMPLE_INTERVAL: int(STEP[2] * 1000),
                segyio.TraceField.DelayRecordingTime: int(ORIGIN[2]), segyio.TraceField.TraceIdentificationCode: 1,
            }
            out.trace[trace] = np.ascontiguousarray(data[:, j, i])
    with segyio.open(path, endian=spec.endian) as back:
        assert back.iline[spec.ilines[MARKED[1]]][MARKED[0], MARKED[2]] == data[MARKED[::-1]]
    i, j, k = MARKED
    point = [600000.0, 6000000.0, 0] + directions @ [25.0 * i, 50.0 * j, 0]
    point[2] = -(ORIGIN[2] + STEP[2] * k)
    unit = case["unit"]
    # A survey holds amplitudes.
    return Expected(case, point, [unit, unit, "ms"], labels=[])


def hdf5(case, path):
    """A data set of h5py, or of MATLAB 7.3, whose first index is x; ilastik names its axes."""
    names = case["order"]
    data = volume(case)
    if case["packing"] == "big":
        data = data.astype(data.dtype.newbyteorder(">"))
    array = np.transpose(data, ["zyx".index(n) for n in names if n in "xyz"])
    for position, n in enumerate(names):
        if n in "ct":
            array = np.expand_dims(array, position)
    inner = "study/volume" if case["layout"] == "deep" else "volume"
    options = {"compression": "gzip", "shuffle": True, "chunks": True} if case["packing"] == "packed" else {}
    is_matlab = case["layout"] == "matlab"
    with h5py.File(path, "w", userblock_size=512 if is_matlab else 0) as file:
        file.create_dataset(inner, data=array, **options)
        if case["layout"] == "deep":
            # Another data set of three axes, so that the path is needed.
            file["study/other"] = np.zeros((3, 3, 3))
        attributes = file[inner].attrs
        if is_matlab:
            attributes["MATLAB_class"] = np.bytes_("double")
        elif names == "zyx":
            attributes["element_size_um"] = STEP[::-1]
        else:
            axes = [{"key": n, "typeFlags": 2, "resolution": float(STEP["xyz".index(n)]) if n in "xyz" else 0,
                     "description": ""} for n in names]
            attributes["axistags"] = json.dumps({"axes": axes})
    if is_matlab:
        with open(path, "r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    with h5py.File(path, "r") as back:
        index = tuple(MARKED["xyz".index(n)] if n in "xyz" else 0 for n in names)
        assert back[inner][index] == LABELS[case["labels"]][2]
    step, unit = (np.ones(3), "") if is_matlab else (STEP, "um" if names == "zyx" else "")
    given = f"{path}:/{inner}" if case["layout"] == "deep" else path
    return Expected(case, step * MARKED, [unit] * 3, path=given)


def vtkhdf(case, path):
    from vtkmodules.vtkIOHDF import vtkHDFReader, vtkHDFWriter

    writer = vtkHDFWriter()
    writer.SetFileName(path)
    writer.SetInputData(vtk_image(case))
    writer.Write()
    reader = vtkHDFReader()
    reader.SetFileName(path)
    reader.Update()
    return Expected(case, marked_by_vtk(case, reader.GetOutputDataObject(0)), [""] * 3)


INTEGERS = ["u1", "i1", "u2", "i2", "i4", "u4", "i8", "u8"]
TYPES = INTEGERS + ["f4", "f8"]
ORDERS = ["zyx", "xyz", "yxz", "zxy", "yzx", "xzy"]
PACKINGS = ["plain", "packed", "other", "big"]
LENGTHS = ["mm", "um", "nm", "cm", "in", "angstrom"]


def writer(write, ending, **dimensions):
    standard = {"type": TYPES, "labels": list(LABELS), "unit": ["mm"], "order": ["zyx"], "direction": ["plain"],
                "packing": ["plain"], "layout": ["plain"], "code": ["1"]}
    return {"write": write, "ending": ending, "dimensions": {**standard, **dimensions}}


AXES = ["zyx", "xyz", "yxz", "czyx", "tczyx", "cxyz", "zcyx", "xyzc"]
WRITERS = {
    "npy": writer(npy, ".npy", unit=LENGTHS + ["m", "ft"], order=ORDERS, packing=["plain", "other"]),
    "itk-nrrd": writer(itk, ".nrrd", unit=[""], direction=list(DIRECTIONS), packing=["plain", "packed"]),
    "itk-mha": writer(itk, ".mha", unit=[""], direction=list(DIRECTIONS), packing=["plain", "packed"]),
    "itk-nifti": writer(itk, ".nii.gz", type=["u1", "i2", "u2", "i4", "f4", "f8"], direction=list(DIRECTIONS)),
    "pynrrd": writer(pynrrd, ".nrrd", unit=["mm", "um", "nm", "m", ""], order=["zyx", "ras"], direction=list(DIRECTIONS),
                     packing=PACKINGS),
    "nibabel": writer(nifti, ".nii.gz", unit=["mm", "um", "m"], order=["little", "big"], direction=list(DIRECTIONS),
                      packing=["plain", "other"], code=["1", "2", "3", "4"]),
    "nibabel-scaled": writer(scaled_nifti, ".nii", type=["u1", "i2"], labels=["small", "byte", "signed", "wide"]),
    "vtk-xml": writer(vtk_xml, ".vti", unit=[""], order=["zlib", "lz4", "none"], direction=list(DIRECTIONS),
                      packing=["plain", "packed", "other"]),
    "vtk-legacy": writer(vtk_legacy, ".vtk", unit=[""], order=["new", "old"], packing=["plain", "packed"]),
    "imagej": writer(imagej, ".tif", type=["u1", "u2", "f4"], unit=LENGTHS, order=["stated", "one", "micro"]),
    "ome-tiff": writer(ome_tiff, ".ome.tif", type=["u1", "i1", "u2", "i2", "i4", "u4", "f4", "f8"], unit=LENGTHS, order=["stated", "one", "micro"], packing=PACKINGS),
    "ome-zarr-5": writer(ome_zarr("0.5", 3), ".zarr", unit=LENGTHS + [""], order=AXES, packing=["plain", "packed", "other"],
                         layout=["plain", "levels", "deep", "array"]),
    "ome-zarr-4": writer(ome_zarr("0.4", 2), ".zarr", unit=LENGTHS + [""], order=AXES, packing=["plain", "packed", "other"],
                         layout=["plain", "levels", "deep", "array"]),
    "zarr": writer(zarr_array, ".zarr", unit=LENGTHS, order=ORDERS, packing=["plain", "other"]),
    "ome-zarr": writer(with_ome_zarr, ".zarr", unit=["um", "nm", "mm"], order=["zyx", "czyx", "tczyx"],
                       packing=["packed", "other"]),
    "ngff-zarr": writer(with_ngff_zarr, ".zarr", unit=["um", "nm", "mm"], order=["zyx", "xyz"], packing=["packed", "other"],
                        layout=["plain", "levels"]),
    "h5py": writer(hdf5, ".h5", unit=[""], order=["zyx", "xyz", "yxz", "czyx", "xyzc", "tzyx"], packing=["plain", "packed", "big"],
                   layout=["plain", "deep"]),
    "matlab-7.3": writer(hdf5, ".mat", unit=[""], packing=["plain", "packed"], layout=["matlab"]),
    "itk-hdf5": writer(itk, ".h5", unit=[""], direction=list(DIRECTIONS), packing=["plain", "packed"]),
    "vtkhdf": writer(vtkhdf, ".vtkhdf", unit=[""], direction=list(DIRECTIONS)),
    "segyio": writer(segy, ".sgy", type=["f4", "i4", "i2", "i1"], unit=["m", "ft"], order=["zyx", "xyz"],
                     direction=["plain", "flipped", "turned"], packing=["plain", "other"]),
}


def fits(case):
    """True if the sample type holds the labels."""
    dtype = np.dtype(case["type"])
    labels = LABELS[case["labels"]]
    if (case["format"], case["type"], case["labels"]) == ("vtk-legacy", "f8", "huge"):
        # VTK writes eleven digits.
        return case["packing"] == "packed"
    if case["format"] == "nibabel-scaled":
        # With larger steps the type itself loses the labels.
        return (max(labels) - min(0, *labels)) / np.ptp([np.iinfo(dtype).min, np.iinfo(dtype).max]) < 0.5
    if case["format"] == "segyio" and case["labels"] in ("atlas", "negative", "huge") and case["type"] != "i4":
        return False
    if dtype.kind == "f":
        return all(float(np.array(label, dtype)) == label for label in labels)
    return np.iinfo(dtype).min <= min(labels) and max(labels) <= np.iinfo(dtype).max


def cases():
    for name, entry in WRITERS.items():
        dimensions = {"format": [name], **entry["dimensions"]}
        yield from pairwise(dimensions, fits)


# ------------------------------------------------------------------ judgement

def run(args, folder):
    return subprocess.run(args, cwd=folder, capture_output=True, text=True)


def judge(atomesh, case, folder, name):
    """Returns right, wrong or refused, the reason, and what was expected."""
    entry = WRITERS[case["format"]]
    path = name + entry["ending"]
    os.chdir(folder)
    expected = entry["write"](case, path)
    given = expected.path or path
    result = run([atomesh, "info", given, *expected.options, "--json", "--quiet"], folder)
    if result.returncode:
        return "refused", (result.stderr.strip().splitlines() or ["?"])[0], expected, path
    image = json.loads(result.stdout)["image"]
    result = run([atomesh, "convert", given, *expected.options, "out.npy", "--quiet"], folder)
    if result.returncode:
        return "refused", (result.stderr.strip().splitlines() or ["?"])[0], expected, path
    samples = np.load("out.npy")
    mark = np.float32(LABELS[case["labels"]][2])
    reason = check_labels(case, image, expected) or check_place(samples, mark, image, expected, case)
    return ("wrong", reason, expected, path) if reason else ("right", "", expected, path)


def check_labels(case, image, expected):
    if image["labels"] is None and expected.labels:
        return "no labels"
    if sorted(image["labels"] or []) != expected.labels:
        return f"labels {image['labels']}, right {expected.labels}"
    return None


def check_place(samples, mark, image, expected, case):
    places = np.argwhere(samples == mark)
    # Labels beyond 24 bits may be equal as 32-bit floats; then any of them may be the marked voxel.
    points = [np.array(image["origin"]) + sum(n * np.array(axis["step"]) for n, axis in zip(index[::-1], image["axes"]))
              for index in places]
    if not points:
        return "the marked voxel is not there"
    factors = []
    for ours, right in zip(image["units"], expected.units):
        if ours == right:
            factors.append(1.0)
        elif ours in METRES and right in METRES and ours and right:
            factors.append(METRES[ours] / METRES[right])
        else:
            return f"unit '{ours}', right '{right}'"
    away = [np.abs(np.array(factors) * point - expected.point).max() for point in points]
    if min(away) > 1e-4 * max(1.0, np.abs(expected.point).max() * 1e-3):
        nearest = points[int(np.argmin(away))]
        return f"the marked voxel is at {nearest}, right {expected.point}"
    return None


# The files of each writer that are kept.
KEPT = 4


def kept_case(case, expected, path):
    return {"file": path, "given": expected.path or path, "options": expected.options, "units": expected.units,
            "labels": expected.labels, "mark": LABELS[case["labels"]][2], "point": expected.point.tolist()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("atomesh")
    parser.add_argument("folder")
    parser.add_argument("--only", help="writers, separated by commas")
    parser.add_argument("--list", action="store_true", help="print the combinations only")
    parser.add_argument("--keep", metavar="FILES", help="copy some files of each writer to this folder")
    args = parser.parse_args()
    os.makedirs(args.folder, exist_ok=True)
    atomesh, folder = os.path.abspath(args.atomesh), os.path.abspath(args.folder)
    keep = args.keep and os.path.abspath(args.keep)
    only = args.only.split(",") if args.only else None
    table, kept = {}, []
    for n, case in enumerate(cases()):
        if only and case["format"] not in only:
            continue
        words = " ".join(f"{k}={case[k]}" for k in case if k != "format")
        if args.list:
            print(case["format"], words)
            continue
        verdict, why, expected, path = judge(atomesh, case, folder, f"{case['format']}{n}")
        counts = table.setdefault(case["format"], {"right": 0, "wrong": 0, "refused": 0})
        counts[verdict] += 1
        if verdict == "right" and keep and counts[verdict] <= KEPT:
            copy = shutil.copytree if os.path.isdir(path) else shutil.copy
            copy(path, os.path.join(keep, path))
            kept.append(kept_case(case, expected, path))
        if verdict != "right":
            print(f"{verdict}: {case['format']}{n}: {words} | {why}", file=sys.stderr)
    if keep:
        with open(os.path.join(keep, "cases.json"), "w") as out:
            out.write("[\n" + ",\n".join(json.dumps(entry) for entry in kept) + "\n]\n")
    return print_table(table)


if __name__ == "__main__":
    sys.exit(main())
