"""Writes images in HDF5 as h5py, MATLAB, ilastik, ITK and VTK do, and prints what is in each as JSON: hdf5.py FOLDER.

For each name of an image: its dims (x first), the sum of samples weighted by their index, and origin and spacing if the
file has them."""

import json
import sys

import h5py
import numpy as np
import SimpleITK
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkIOHDF import vtkHDFWriter

folder = sys.argv[1]
rng = np.random.default_rng(1)
shape = (4, 5, 6)
expected = {}


def add(name, zyx, origin=(0, 0, 0), spacing=(1, 1, 1)):
    flat = zyx.astype(np.float64).ravel()
    expected[name] = {
        "dims": list(zyx.shape[::-1]),
        "sum": float((flat * np.arange(1, flat.size + 1)).sum()),
        "origin": list(origin),
        "spacing": list(spacing),
    }


for kind in "i1 u1 <i2 >i2 <u2 <i4 >i4 <u4 <i8 <u8 <f2 <f4 >f4 <f8 >f8 ?".split():
    array = rng.integers(0, 2 if kind == "?" else 100, shape).astype(kind)
    name = f"plain_{kind.strip('<>?')}_{len(expected)}.h5"
    with h5py.File(f"{folder}/{name}", "w", libver="latest" if len(expected) % 2 else None) as file:
        file.create_dataset("data", data=array)
    add(name, array)

array = rng.integers(0, 100, shape).astype("u2")
for name, options in {
    "gzip.h5": {"compression": "gzip", "shuffle": True, "chunks": (2, 3, 4)},
    "fletcher.h5": {"fletcher32": True, "chunks": (2, 3, 4)},
    "scaled.h5": {"scaleoffset": 0, "chunks": (2, 3, 4)},
}.items():
    with h5py.File(f"{folder}/{name}", "w") as file:
        file.create_dataset("volumes/raw", data=array, **options)
    add(name, array)

with h5py.File(f"{folder}/two.h5", "w") as file:
    file["raw"] = array
    file["labels"] = array + 1
    file["table"] = np.zeros(7)
    file["raw"].attrs["element_size_um"] = [4.0, 0.5, 0.25]
add("two.h5:/labels", array + 1)
add("two.h5:/raw", array, spacing=(0.25, 0.5, 4.0))

with h5py.File(f"{folder}/ilastik.h5", "w") as file:
    # Axes x, y, z and one channel.
    file["exported_data"] = array.transpose(2, 1, 0)[..., None]
    tags = {"axes": [{"key": key, "typeFlags": 2, "resolution": 0, "description": ""} for key in "xyzc"]}
    file["exported_data"].attrs["axistags"] = json.dumps(tags)
add("ilastik.h5", array)

with h5py.File(f"{folder}/matlab.mat", "w", userblock_size=512) as file:
    file["V"] = array
    file["V"].attrs["MATLAB_class"] = np.bytes_("uint16")
with open(f"{folder}/matlab.mat", "r+b") as file:
    file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
add("matlab.mat", array)

image = SimpleITK.GetImageFromArray(array)
image.SetSpacing((0.25, 0.5, 4.0))
image.SetOrigin((10.0, 20.0, -30.0))
SimpleITK.WriteImage(image, f"{folder}/itk.h5")
add("itk.h5", array, (10, 20, -30), (0.25, 0.5, 4.0))

grid = vtkImageData()
grid.SetDimensions(6, 5, 4)
grid.SetOrigin(10, 20, -30)
grid.SetSpacing(0.25, 0.5, 4.0)
values = numpy_to_vtk(array.ravel(), deep=True)
values.SetName("raw")
grid.GetPointData().SetScalars(values)
writer = vtkHDFWriter()
writer.SetInputData(grid)
writer.SetFileName(f"{folder}/image.vtkhdf")
if writer.Write():
    add("image.vtkhdf", array, (10, 20, -30), (0.25, 0.5, 4.0))
print(json.dumps(expected))
