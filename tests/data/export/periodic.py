"""Prints the periodic entities of a mesh, as Gmsh reads them, as JSON: periodic.py FILE.

For each side that is an image of another, these are the two names, the number of pairs of nodes, the number of nodes on the
side, and the largest deviation of a pair from the period that the file gives."""

import json
import sys

import gmsh
import numpy as np

gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
ids, coordinates, _ = gmsh.model.mesh.getNodes()
place = dict(zip(ids, np.reshape(coordinates, (-1, 3))))
dim = gmsh.model.getDimension() - 1


def name(tag):
    return gmsh.model.getPhysicalName(dim, gmsh.model.getPhysicalGroupsForEntity(dim, tag)[0])


sides = []
for _, tag in gmsh.model.getEntities(dim):
    master, nodes, masters, affine = gmsh.model.mesh.getPeriodicNodes(dim, tag, True)
    if master == tag:
        continue
    shift = np.reshape(affine, (4, 4))[:3, 3]
    gaps = [np.abs(place[n] - place[m] - shift).max() for n, m in zip(nodes, masters)]
    _, _, corners = gmsh.model.mesh.getElements(dim, tag)
    sides.append(
        {
            "side": name(tag),
            "master": name(master),
            "pairs": len(set(nodes)),
            "nodes": len(set(np.concatenate(corners))),
            "gap": float(max(gaps)),
            "shift": [float(x) for x in shift],
        }
    )
print(json.dumps(sides))
