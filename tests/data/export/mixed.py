"""Writes a box of 4 by 3 by 3 cubes with VTK: hexahedra (or polyhedra), then wedges, then pyramids, which on their far
side are tetrahedra, then tetrahedra; quadrilaterals between the first two, and arrays that say which cell is which."""

import sys

import vtk
from vtkmodules.util.numpy_support import numpy_to_vtk

path, how = sys.argv[1:3]
NX, NY, NZ = 4, 3, 3
number = lambda i, j, k: i + (NX + 1) * (j + (NY + 1) * k)
points = [(i, j, k) for k in range(NZ + 1) for j in range(NY + 1) for i in range(NX + 1)]
grid = vtk.vtkUnstructuredGrid()
kinds = []


def put(kind, corners):
    grid.InsertNextCell(kind, len(corners), corners)
    kinds.append(kind)


def put_polyhedron(faces):
    stream = vtk.vtkIdList()
    for n in [len(faces)] + [n for face in faces for n in [len(face), *face]]:
        stream.InsertNextId(n)
    grid.InsertNextCell(vtk.VTK_POLYHEDRON, stream)
    kinds.append(vtk.VTK_POLYHEDRON)


def sides(i, j, k):
    """Corners of a cube's sides, outwards: low x, high x, low y, high y, low z, high z."""
    a, b, c, d = (number(i + x, j + y, k) for x, y in [(0, 0), (1, 0), (1, 1), (0, 1)])
    e, f, g, h = (number(i + x, j + y, k + 1) for x, y in [(0, 0), (1, 0), (1, 1), (0, 1)])
    return [(a, e, h, d), (b, c, g, f), (a, b, f, e), (d, h, g, c), (a, d, c, b), (e, f, g, h)], (a, b, c, d, e, f, g, h)


def halves(side):
    at = side.index(min(side))
    a, b, c, d = side[at:] + side[:at]
    return [(a, b, c), (a, c, d)]


for i in range(NX):
    for j in range(NY):
        for k in range(NZ):
            own, (a, b, c, d, e, f, g, h) = sides(i, j, k)
            if i == 0:
                put_polyhedron(own) if how == "polyhedra" else put(vtk.VTK_HEXAHEDRON, (a, b, c, d, e, f, g, h))
                put(vtk.VTK_QUAD, own[1])
            elif i == 1:
                # One of the two the wrong way round, as many programs write them.
                put(vtk.VTK_WEDGE, (a, b, c, e, f, g))
                put(vtk.VTK_WEDGE, (a, d, c, e, h, g))
            else:
                points.append((i + 0.5, j + 0.5, k + 0.5))
                for at, side in enumerate(own):
                    if i == 2 and (at != 1 or how == "mismatch"):
                        put(vtk.VTK_PYRAMID, (*reversed(side), len(points) - 1))
                    else:
                        for half in halves(side):
                            put(vtk.VTK_TETRA, (*reversed(half), len(points) - 1))
own = vtk.vtkPoints()
own.SetDataTypeToDouble()
# A point that no cell has is no part of the mesh.
for point in [*points, (99.0, 99.0, 99.0)]:
    own.InsertNextPoint(*point)
grid.SetPoints(own)
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
