"""Prints the largest difference between the volumes of polyhedra that VTK computes and those in the file, divided by
the mean volume: cells.py FILE.vtu. VTK computes the volume that the faces of a cell enclose."""

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
    new_id = {}
    for k in range(cell.GetNumberOfFaces()):
        face = cell.GetFace(k)
        ids = [face.GetPointId(j) for j in range(face.GetNumberOfPoints())]
        for n in ids:
            if n not in new_id:
                new_id[n] = points.InsertNextPoint(data.GetPoint(n))
        polygons.InsertNextCell(len(ids))
        for n in ids:
            polygons.InsertCellPoint(new_id[n])
    surface = vtk.vtkPolyData()
    surface.SetPoints(points)
    surface.SetPolys(polygons)
    triangles = vtk.vtkTriangleFilter()
    triangles.SetInputData(surface)
    mass = vtk.vtkMassProperties()
    mass.SetInputConnection(triangles.GetOutputPort())
    worst = max(worst, abs(mass.GetVolume() - stored.GetValue(i)) / mean)
print(f"{worst:.3e}")
