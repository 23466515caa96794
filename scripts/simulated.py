#!/usr/bin/env python
"""Adds the last pressure (bar) and water saturation of OPM Flow to a mesh as cell arrays.

    scripts/simulated.py COMPANION.vtu FOLDER CASE OUT.vtu

Needs VTK and resfo, which are in .venv.
"""
import sys

import numpy as np
import resfo
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader, vtkXMLUnstructuredGridWriter


def cells(path):
    """Returns the mesh of a file."""
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def cell_array(path, name):
    """Returns a cell array of the mesh of a file."""
    return np.array(vtk_to_numpy(cells(path).GetCellData().GetArray(name)), dtype=float)


def write(mesh, path):
    """Writes a mesh."""
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(mesh)
    writer.Write()


def simulated(companion, folder, case):
    """Returns the companion mesh of a case with the last pressure and saturation."""
    mesh = cells(companion)
    # The last report overwrites those before it.
    results = {name.strip(): values for name, values in resfo.read(f"{folder}/{case}.UNRST")}
    for name in ("PRESSURE", "SWAT"):
        if name not in results:
            continue
        array = vtkDoubleArray()
        array.SetName(f"simulated_{name.lower()}")
        for value in results[name]:
            array.InsertNextValue(float(value))
        mesh.GetCellData().AddArray(array)
    return mesh


def main(companion, folder, case, out):
    write(simulated(companion, folder, case), out)


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
