"""Prints the contents of NASTRAN bulk data, as meshio reads them, as JSON: nastran.py FILE.

For each property, by the name that its comment gives: the kind and the number of its elements, their
total volume or area, and the sum of the area vectors of its triangles. Also the largest distance of a
node in the middle of an edge from that middle."""

import json
import re
import sys

import meshio
import numpy as np

MIDDLES = {"tetra10": [[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]], "triangle6": [[0, 1], [1, 2], [2, 0]]}

mesh = meshio.read(sys.argv[1], "nastran")
with open(sys.argv[1]) as file:
    names = dict(re.findall(r"^\$ Femap Property (\d+) : (\w+)$", file.read(), re.MULTILINE))
properties, distance = {}, 0.0
for block, numbers in zip(mesh.cells, mesh.cell_data["nastran:ref"]):
    for number in np.unique(numbers):
        cells = mesh.points[block.data[numbers == number]]
        edges = cells[:, 1:] - cells[:, :1]
        found = {"kind": block.type, "cells": len(cells)}
        if block.type.startswith("tetra"):
            volumes = np.linalg.det(edges[:, :3]) / 6
            found |= {"size": float(volumes.sum()), "min": float(volumes.min())}
        else:
            areas = np.cross(edges[:, 0], edges[:, 1]) / 2
            found |= {"size": float(np.linalg.norm(areas, axis=1).sum()), "vector": areas.sum(axis=0).tolist()}
        properties[names[str(number)]] = found
    for k, (a, b) in enumerate(MIDDLES.get(block.type, [])):
        corners = block.data.shape[1] - len(MIDDLES[block.type])
        ends, middle = mesh.points[block.data[:, [a, b]]], mesh.points[block.data[:, corners + k]]
        distance = max(distance, float(np.abs(ends.mean(axis=1) - middle).max()))
print(json.dumps({"nodes": len(mesh.points), "properties": properties, "distance": distance}))
