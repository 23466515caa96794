"""Prints the contents of a mesh, as meshio reads them, as JSON: simplices.py FILE [FORMAT].

These are points, tetrahedra, the numbers of triangles and of edges, and the area of the triangles."""

import json
import sys

import meshio
import numpy as np

mesh = meshio.read(sys.argv[1], *sys.argv[2:3])
corners = mesh.points[mesh.cells_dict.get("triangle", np.empty((0, 3), int))]
sides = np.diff(corners, axis=1)
if sides.shape[2] == 2:
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
else:
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
print(
    json.dumps(
        {
            "points": mesh.points.tolist(),
            "tets": mesh.cells_dict.get("tetra", np.empty((0, 4), int)).tolist(),
            "triangles": len(mesh.cells_dict.get("triangle", [])),
            "edges": len(mesh.cells_dict.get("line", [])),
            "area": 0.5 * float(area.sum()),
        }
    )
)
