"""Prints the contents of a mesh, as Gmsh reads them, as JSON: physical.py FILE.

These are the volume and the number of tetrahedra, and for each physical group its dimension, name and number of
elements."""

import json
import sys

import gmsh

gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
tags, _ = gmsh.model.mesh.getElementsByType(4)
volumes = gmsh.model.mesh.getElementQualities(tags, "volume")
groups = []
for dim, tag in gmsh.model.getPhysicalGroups():
    count = 0
    for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
        _, elements, _ = gmsh.model.mesh.getElements(dim, entity)
        count += sum(len(e) for e in elements)
    groups.append([dim, gmsh.model.getPhysicalName(dim, tag), count])
print(json.dumps({"tets": len(tags), "volume": float(sum(volumes)), "groups": groups}))
