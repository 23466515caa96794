"""Prints the numbers of points and tetrahedra that meshio reads from each file."""

import json
import sys

import meshio

counts = []
for path in sys.argv[1:]:
    mesh = meshio.read(path)
    cells = mesh.cells_dict
    counts.append({"points": len(mesh.points), "tetra": len(cells.get("tetra", []))})
print(json.dumps(counts))
