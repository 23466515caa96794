#!/usr/bin/env python
"""Puts what OPM Flow found onto the cells: scripts/simulated.py TWIN.vtu FOLDER CASE OUT.vtu (with
.venv's VTK and resfo). The last pressure (bar) and saturation of water."""
import sys

import resfo
from vtkmodules.vtkCommonCore import vtkDoubleArray
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader, vtkXMLUnstructuredGridWriter


def main(twin, folder, case, out):
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(twin)
    reader.Update()
    mesh = reader.GetOutput()
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
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(out)
    writer.SetInputData(mesh)
    writer.Write()


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
