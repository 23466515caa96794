#!/bin/sh
# VTK 9.6.2 reads the coordinates of an Exodus file, which are 64-bit floats, as 32-bit floats: in map coordinates, such as a
# northing of 6,000,000 m, nodes are up to .25 m away from where they were written, and nodes .2 m apart may be at one place. The
# netCDF library reads the numbers exactly. No warning is given. The script fails if this changes.
set -eu
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv tools
tools/bin/pip install --quiet --disable-pip-version-check vtk==9.6.2 meshio==5.3.5 netCDF4==1.7.2 numpy
cat >check.py <<'PYTHON'
import meshio
import netCDF4
import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkCompositeDataSet
from vtkmodules.vtkIOExodus import vtkExodusIIReader

NORTHING = 6_000_000.0


def read_by_vtk(path):
    """Returns the points of the only block."""
    reader = vtkExodusIIReader()
    reader.SetFileName(path)
    reader.Update()
    grids = reader.GetOutput().NewIterator()
    grids.InitTraversal()
    return vtk_to_numpy(grids.GetCurrentDataObject().GetPoints().GetData())


if __name__ == "__main__":
    nodes = np.array([[0, NORTHING + 0.2, 0], [1, NORTHING, 0], [0, NORTHING + 1.1, 0], [0, NORTHING, 1]])
    meshio.Mesh(nodes, [("tetra", np.array([[0, 1, 2, 3]]))]).write("map.e")
    with netCDF4.Dataset("map.e") as data:
        names = [name for name in data.variables if name.startswith("coord")]
        exact = np.asarray(data["coord"][:]).T if "coord" in names else np.array([data[f"coord{a}"][:] for a in "xyz"]).T
    by_vtk = read_by_vtk("map.e")
    error = np.abs(np.sort(by_vtk[:, 1]) - np.sort(nodes[:, 1])).max()
    print("VTK's number type:", by_vtk.dtype, "largest difference in northing:", error, "m")
    assert np.array_equal(np.sort(exact[:, 1]), np.sort(nodes[:, 1])), "the file does not hold the coordinates exactly"
    assert by_vtk.dtype == np.float32 and error > 0.1, "the coordinates are exact"
PYTHON
tools/bin/python check.py
