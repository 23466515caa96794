"""Writes a mesh of two regions in HDF5 with meshio (Exodus in NetCDF-4) and VTK (VTKHDF), and prints what is in each
file as JSON: hdf5_meshes.py FOLDER meshes."""

import json
import sys

import meshio
import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import VTK_TETRA, vtkUnstructuredGrid
from vtkmodules.vtkIOHDF import vtkHDFWriter

folder = sys.argv[1]
# The six tetrahedra of a cube.
points = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
tets = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
region = np.array([4, 4, 4, 4, 9, 9])

blocks = [("tetra", tets[region == value]) for value in (4, 9)]
meshio.Mesh(points, blocks).write(f"{folder}/blocks.e")

grid = vtkUnstructuredGrid()
vtk_points = vtkPoints()
vtk_points.SetDataTypeToDouble()
for point in points:
    vtk_points.InsertNextPoint(point)
grid.SetPoints(vtk_points)
for tet in tets:
    grid.InsertNextCell(VTK_TETRA, 4, tet.tolist())
array = numpy_to_vtk(region.astype(np.uint16), deep=True)
array.SetName("material")
grid.GetCellData().AddArray(array)
writer = vtkHDFWriter()
writer.SetInputData(grid)
writer.SetFileName(f"{folder}/grid.vtkhdf")
writer.Write()

expected = {"nodes": 8, "tetrahedra": 6, "regions": [4, 2]}
print(json.dumps({"blocks.e": expected, "grid.vtkhdf": expected}))
