"""Writes a box of 4 by 3 by 3 cubes with VTK: mixed.py FILE KIND.

Along x the cells are hexahedra (or polyhedra, with KIND polyhedra), wedges, pyramids with tetrahedra on their last side,
and tetrahedra. Between the first two layers there are quadrilaterals. Arrays hold the kind and the region of each cell.
With KIND mismatch the pyramids meet tetrahedra with quadrilaterals."""

import sys

import vtk
from vtkmodules.util.numpy_support import numpy_to_vtk

path, kind_of_box = sys.argv[1:3]
NX, NY, NZ = 4, 3, 3
number = lambda i, j, k: i + (NX + 1) * (j + (NY + 1) * k)
points = [(i, j, k) for k in range(NZ + 1) for j in range(NY + 1) for i in range(NX + 1)]
grid = vtk.vtkUnstructuredGrid()
kinds = []


def insert(kind, corners):
    grid.InsertNextCell(kind, len(corners), corners)
    kinds.append(kind)


def insert_polyhedron(faces):
    stream = vtk.vtkIdList()
    for n in [len(faces)] + [n for face in faces for n in [len(face), *face]]:
        stream.InsertNextId(n)
    grid.InsertNextCell(vtk.VTK_POLYHEDRON, stream)
    kinds.append(vtk.VTK_POLYHEDRON)


def sides(i, j, k):
    """Returns the corners of a cube's sides, oriented outwards (low x, high x, low y, high y, low z, high z), and of the cube."""
    a, b, c, d = (number(i + x, j + y, k) for x, y in [(0, 0), (1, 0), (1, 1), (0, 1)])
    e, f, g, h = (number(i + x, j + y, k + 1) for x, y in [(0, 0), (1, 0), (1, 1), (0, 1)])
    return [(a, e, h, d), (b, c, g, f), (a, b, f, e), (d, h, g, c), (a, d, c, b), (e, f, g, h)], (a, b, c, d, e, f, g, h)


def halves(side):
    """Divides a side into two triangles by the diagonal from its lowest corner."""
    first = side.index(min(side))
    a, b, c, d = side[first:] + side[:first]
    return [(a, b, c), (a, c, d)]


for i in range(NX):
    for j in range(NY):
        for k in range(NZ):
            cube_sides, (a, b, c, d, e, f, g, h) = sides(i, j, k)
            if i == 0:
                insert_polyhedron(cube_sides) if kind_of_box == "polyhedra" else insert(vtk.VTK_HEXAHEDRON, (a, b, c, d, e, f, g, h))
                insert(vtk.VTK_QUAD, cube_sides[1])
            elif i == 1:
                # One of the two wedges has the wrong orientation, as in files of many programs.
                insert(vtk.VTK_WEDGE, (a, b, c, e, f, g))
                insert(vtk.VTK_WEDGE, (a, d, c, e, h, g))
            else:
                points.append((i + 0.5, j + 0.5, k + 0.5))
                for side_index, side in enumerate(cube_sides):
                    if i == 2 and (side_index != 1 or kind_of_box == "mismatch"):
                        insert(vtk.VTK_PYRAMID, (*reversed(side), len(points) - 1))
                    else:
                        for half in halves(side):
                            insert(vtk.VTK_TETRA, (*reversed(half), len(points) - 1))
vtk_points = vtk.vtkPoints()
vtk_points.SetDataTypeToDouble()
# A point without a cell does not belong to the mesh.
for point in [*points, (99.0, 99.0, 99.0)]:
    vtk_points.InsertNextPoint(*point)
grid.SetPoints(vtk_points)
region = numpy_to_vtk([int(kind in (vtk.VTK_TETRA, vtk.VTK_PYRAMID)) + 4 for kind in kinds], deep=True)
region.SetName("attribute")
grid.GetCellData().AddArray(region)
array = numpy_to_vtk([float(kind) for kind in kinds], deep=True)
array.SetName("kind")
grid.GetCellData().AddArray(array)
writer = vtk.vtkXMLUnstructuredGridWriter()
writer.SetFileName(path)
writer.SetInputData(grid)
writer.Write()
print("true")
