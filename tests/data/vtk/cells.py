"""Prints the largest difference between the volumes of polyhedra as VTK reads them and those in the file, divided by
the mean volume: cells.py FILE.vtu. The volume of a cell is that of the pyramids from its first node to its faces.
(vtkMassProperties of VTK 9.7 is only exact to about 1e-6.)"""

import sys

import vtk

reader = vtk.vtkXMLUnstructuredGridReader()
reader.SetFileName(sys.argv[1])
reader.Update()
data = reader.GetOutput()
stored = data.GetCellData().GetArray("volume")
count = data.GetNumberOfCells()
mean = sum(stored.GetValue(i) for i in range(count)) / count
worst = 0.0
for i in range(count):
    cell = data.GetCell(i)
    apex = data.GetPoint(cell.GetPointId(0))
    volume = 0.0
    for k in range(cell.GetNumberOfFaces()):
        face = cell.GetFace(k)
        nodes = [data.GetPoint(face.GetPointId(j)) for j in range(face.GetNumberOfPoints())]
        first, *others = [[x - o for x, o in zip(node, apex)] for node in nodes]
        volume += sum(vtk.vtkMath.Determinant3x3(first, a, b) for a, b in zip(others, others[1:])) / 6
    worst = max(worst, abs(abs(volume) - stored.GetValue(i)) / mean)
print(f"{worst:.3e}")
