"""Prints what meshio reads of a mesh as JSON: simplices.py FILE [FORMAT]. Points, tetrahedra, triangles."""

import json
import sys

import meshio

mesh = meshio.read(sys.argv[1], *sys.argv[2:3])
print(
    json.dumps(
        {
            "points": mesh.points.tolist(),
            "tets": mesh.cells_dict.get("tetra", []).tolist(),
            "triangles": len(mesh.cells_dict.get("triangle", [])),
        }
    )
)
