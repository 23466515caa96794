"""Prints figures of a mesh of quadratic tetrahedra, as Gmsh reads it, as JSON: quadratic.py FILE.

These are the volume from the Jacobians, their largest relative variation in an element, and the number of quadratic
triangles."""

import json
import sys

import gmsh
import numpy as np

gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
points, weights = gmsh.model.mesh.getIntegrationPoints(11, "Gauss4")
_, determinants, _ = gmsh.model.mesh.getJacobians(11, points)
by_element = np.reshape(determinants, (-1, len(weights)))
triangles, _ = gmsh.model.mesh.getElementsByType(9)
print(
    json.dumps(
        {
            "volume": float((by_element @ weights).sum()),
            "spread": float((np.ptp(by_element, axis=1) / by_element.mean(axis=1)).max()),
            "triangles": len(triangles),
        }
    )
)
