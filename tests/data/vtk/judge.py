"""Prints a description of the files that VTK reads, for tests/vtk.rs: judge.py FILE..."""

import sys

import vtk

vtk.vtkObject.GlobalWarningDisplayOff()
READERS = {
    "vtu": vtk.vtkXMLUnstructuredGridReader,
    "vti": vtk.vtkXMLImageDataReader,
    "vtp": vtk.vtkXMLPolyDataReader,
}


def show(name, data):
    for i in range(data.GetNumberOfArrays()):
        array = data.GetAbstractArray(i)
        values = array.GetNumberOfValues()
        if isinstance(array, vtk.vtkStringArray):
            print(name, array.GetName(), repr(array.GetValue(0)))
        elif name == "field" and array.GetDataTypeAsString() == "unsigned char":
            print(name, array.GetName(), repr(bytes(array.GetValue(j) for j in range(values)).decode()))
        else:
            total = sum(array.GetVariantValue(j).ToDouble() for j in range(values))
            print(name, array.GetName(), array.GetDataTypeAsString(), values, f"{total:.9g}")


for path in sys.argv[1:]:
    reader = READERS[path.rsplit(".", 1)[1]]()
    reader.SetFileName(path)
    reader.Update()
    data = reader.GetOutput()
    print("points", data.GetNumberOfPoints(), "cells", data.GetNumberOfCells())
    show("field", data.GetFieldData())
    show("point", data.GetPointData())
    show("cell", data.GetCellData())
    if path.endswith("vti"):
        matrix = data.GetDirectionMatrix()
        print("direction", *[f"{matrix.GetElement(i, j):g}" for i in range(3) for j in range(3)])
        position = [0.0] * 3
        data.TransformIndexToPhysicalPoint([2, 1, 1], position)
        print("at 2 1 1", *[f"{x:.12g}" for x in position])
    if path.endswith("vtu"):
        volumes = []
        for i in range(data.GetNumberOfCells()):
            p = [data.GetPoint(data.GetCell(i).GetPointId(k)) for k in range(4)]
            volumes.append(vtk.vtkTetra.ComputeVolume(*p))
        print("volume", f"{sum(volumes):.12g}", "positive", all(v > 0 for v in volumes))
        validator = vtk.vtkCellValidator()
        validator.SetInputData(data)
        validator.Update()
        states = validator.GetOutput().GetCellData().GetArray("ValidityState")
        wrong = sum(states.GetTuple1(i) != 0 for i in range(states.GetNumberOfTuples()))
        print("invalid cells", wrong)
