"""Prints how many points and tetrahedra meshio reads from each file."""

import json
import sys

import meshio

found = []
for path in sys.argv[1:]:
    mesh = meshio.read(path)
    cells = mesh.cells_dict
    found.append({"points": len(mesh.points), "tetra": len(cells.get("tetra", []))})
print(json.dumps(found))
