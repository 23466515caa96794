#!/bin/sh
# VTK 9.7.2 takes the least dihedral angle of a tetrahedron (vtkMeshQuality, measure MinAngle) over four of its six edges: those
# from corner 0 to 2 and from corner 1 to 3 are left out. A tetrahedron whose least angle lies there gets a larger value (19.47
# degrees in place of 17.75 below), and the value changes when the same tetrahedron is stored with its corners in another order.
# VTK 9.3.1 to 9.7.1 do the same. No warning is given. The script fails if this changes.
set -eu
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv tools
tools/bin/pip install --quiet --disable-pip-version-check vtk==9.7.2
cat >check.py <<'PYTHON'
import itertools
import math

import vtk

NODES = [(0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (5.0, 4.0, 0.0), (5.0, 0.0, 1.0)]


def dihedral_angles(nodes):
    """Returns the angle at each of the six edges, in degrees."""
    angles = {}
    for a, b in itertools.combinations(range(4), 2):
        along = [q - p for p, q in zip(nodes[a], nodes[b])]
        normals = []
        for c in set(range(4)) - {a, b}:
            to = [q - p for p, q in zip(nodes[a], nodes[c])]
            normals.append([along[k - 2] * to[k - 1] - along[k - 1] * to[k - 2] for k in range(3)])
        dot, m, n = (sum(p * q for p, q in zip(u, v)) for u, v in (normals, normals[:1] * 2, normals[1:] * 2))
        angles[a, b] = math.degrees(math.acos(dot / math.sqrt(m * n)))
    return angles


def angle_by_vtk(nodes):
    points = vtk.vtkPoints()
    points.SetDataTypeToDouble()
    for node in nodes:
        points.InsertNextPoint(node)
    grid = vtk.vtkUnstructuredGrid()
    grid.SetPoints(points)
    grid.InsertNextCell(vtk.VTK_TETRA, 4, range(4))
    quality = vtk.vtkMeshQuality()
    quality.SetInputData(grid)
    quality.SetTetQualityMeasureToMinAngle()
    quality.Update()
    return quality.GetOutput().GetCellData().GetArray("Quality").GetValue(0)


if __name__ == "__main__":
    # The orders that keep the orientation: even permutations.
    is_even = lambda order: sum(a > b for a, b in itertools.combinations(order, 2)) % 2 == 0
    values = set()
    for order in filter(is_even, itertools.permutations(range(4))):
        nodes = [NODES[n] for n in order]
        angles = dihedral_angles(nodes)
        of_four = min(angle for edge, angle in angles.items() if edge not in ((0, 2), (1, 3)))
        value, exact = angle_by_vtk(nodes), min(angles.values())
        assert abs(value - of_four) < 1e-9, f"{order}: {value}, of four edges {of_four}"
        values.add(round(value, 3))
    print("VTK", vtk.vtkVersion.GetVTKVersion(), "least angle by order of corners:", sorted(values), "exact:", round(exact, 3))
    assert len(values) == 2, "the value does not depend on the order of the corners"
PYTHON
tools/bin/python check.py
