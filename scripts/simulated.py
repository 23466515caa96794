#!/usr/bin/env python
"""Puts what OPM Flow found onto the cells: scripts/simulated.py TWIN.vtu FOLDER CASE OUT.vtu
(with .venv's VTK and resfo). The last pressure (bar) and saturation of water."""
import sys

import numpy as np
import resfo
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader, vtkXMLUnstructuredGridWriter


def cells(path):
    """The mesh in a file."""
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def cell_array(path, name):
    """A value of each cell of the mesh in a file."""
    return np.array(vtk_to_numpy(cells(path).GetCellData().GetArray(name)), dtype=float)


def write(mesh, path):
    """Writes the mesh."""
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(mesh)
    writer.Write()


def simulated(twin, folder, case):
    """The cells with the last pressure and saturation."""
    mesh = cells(twin)
    # Of several reports the last.
    found = {name.strip(): values for name, values in resfo.read(f"{folder}/{case}.UNRST")}
    for name in ("PRESSURE", "SWAT"):
        if name not in found:
            continue
        array = vtkDoubleArray()
        array.SetName(f"simulated_{name.lower()}")
        for value in found[name]:
            array.InsertNextValue(float(value))
        mesh.GetCellData().AddArray(array)
    return mesh


def main(twin, folder, case, out):
    write(simulated(twin, folder, case), out)


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
