"""Prints the largest difference between the volumes of polyhedra as VTK finds them and as the file
has them, over their mean: cells.py FILE.vtu. Each cell's faces are taken as a closed surface."""

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
    points = vtk.vtkPoints()
    points.SetDataTypeToDouble()
    polygons = vtk.vtkCellArray()
    number = {}
    for k in range(cell.GetNumberOfFaces()):
        face = cell.GetFace(k)
        ids = [face.GetPointId(j) for j in range(face.GetNumberOfPoints())]
        for n in ids:
            if n not in number:
                number[n] = points.InsertNextPoint(data.GetPoint(n))
        polygons.InsertNextCell(len(ids))
        for n in ids:
            polygons.InsertCellPoint(number[n])
    surface = vtk.vtkPolyData()
    surface.SetPoints(points)
    surface.SetPolys(polygons)
    triangles = vtk.vtkTriangleFilter()
    triangles.SetInputData(surface)
    mass = vtk.vtkMassProperties()
    mass.SetInputConnection(triangles.GetOutputPort())
    worst = max(worst, abs(mass.GetVolume() - stored.GetValue(i)) / mean)
print(f"{worst:.3e}")
