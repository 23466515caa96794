"""Prints the names and sizes of the sets of cells, faces and nodes that VTK reads of an Exodus, VTKHDF, XDMF or CGNS
file as JSON: sets.py FILE."""

import json
import sys

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkLogger
from vtkmodules.vtkCommonDataModel import vtkCompositeDataSet
from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter
from vtkmodules.vtkIOCGNSReader import vtkCGNSReader
from vtkmodules.vtkIOExodus import vtkExodusIIReader
from vtkmodules.vtkIOHDF import vtkHDFReader
from vtkmodules.vtkIOXdmf2 import vtkXdmfReader


def leaves(data, name=""):
    if data.IsA("vtkCompositeDataSet"):
        for i in range(data.GetNumberOfBlocks()):
            metadata = data.GetMetaData(i) if data.HasMetaData(i) else None
            block_name = metadata.Get(vtkCompositeDataSet.NAME()) if metadata else ""
            if data.GetBlock(i):
                yield from leaves(data.GetBlock(i), f"{name}/{block_name}")
    else:
        yield name, data


vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
path = sys.argv[1]
ending = path.rsplit(".", 1)[1]
reader = {"exo": vtkExodusIIReader, "vtkhdf": vtkHDFReader, "xdmf": vtkXdmfReader}.get(ending, vtkCGNSReader)()
reader.SetFileName(path)
reader.UpdateInformation()
if ending == "exo":
    kinds = [reader.ELEM_BLOCK, reader.NODE_SET]
    # VTK does not read side sets of polyhedra. Files of polyhedra have blocks of faces.
    if reader.GetNumberOfObjects(reader.FACE_BLOCK) == 0:
        kinds.append(reader.SIDE_SET)
    for kind in kinds:
        for i in range(reader.GetNumberOfObjects(kind)):
            reader.SetObjectStatus(kind, i, 1)
    reader.SetAllArrayStatus(reader.ELEM_BLOCK, 1)
elif ending == "cgns":
    reader.LoadBndPatchOn()
    reader.EnableAllCellArrays()
reader.Update()
parts = []
for name, grid in leaves(reader.GetOutputDataObject(0)):
    sizes = vtkCellSizeFilter()
    sizes.SetInputData(grid)
    sizes.Update()
    size_data = sizes.GetOutput().GetCellData()
    values, sets = grid.GetCellData(), grid.GetPointData()
    arrays = {values.GetArrayName(i): vtk_to_numpy(values.GetArray(i)) for i in range(values.GetNumberOfArrays())}
    nodes = {sets.GetArrayName(i): vtk_to_numpy(sets.GetArray(i)) for i in range(sets.GetNumberOfArrays())}
    parts.append({
        "name": name,
        "cells": grid.GetNumberOfCells(),
        "nodes": grid.GetNumberOfPoints(),
        "volume": float(np.abs(vtk_to_numpy(size_data.GetArray("Volume"))).sum()),
        "area": float(np.abs(vtk_to_numpy(size_data.GetArray("Area"))).sum()),
        "values": {name: float(np.sum(array)) for name, array in arrays.items()},
        "sets": {name: int(np.sum(array)) for name, array in nodes.items()},
    })
print(json.dumps(parts))
