"""Prints the contents of an Exodus file of polyhedra, as SciPy reads them, as JSON: exodus.py FILE.

VTK does not read side sets of polyhedra. For each side set the output has the area, the number of faces, and whether
the nodes of the faces are those of the node set."""

import json
import sys

import numpy as np
from scipy.io import netcdf_file

file = netcdf_file(sys.argv[1], mmap=False)
read = lambda name: np.array(file.variables[name].data, dtype=np.int64)
texts = lambda name: [bytes(row).split(b"\0")[0].decode() for row in file.variables[name].data]
points = np.stack([np.array(file.variables["coord" + axis].data, dtype=float) for axis in "xyz"], axis=1)
split = lambda items, counts: np.split(items - 1, np.cumsum(counts)[:-1])
faces = split(read("fbconn1"), read("fbepecnt1"))
cells = []
for k in range(1, len(texts("eb_names")) + 1):
    assert file.variables[f"facconn{k}"].elem_type == b"NFACED"
    cells += split(read(f"facconn{k}"), read(f"ebepecnt{k}"))


def area(face):
    x = points[faces[face]]
    return np.linalg.norm(sum(np.cross(x[i] - x[0], x[i + 1] - x[0]) for i in range(1, len(x) - 1))) / 2


sets = {}
for k, name in enumerate(texts("ss_names"), 1):
    set_faces = [cells[c - 1][side - 1] for c, side in zip(read(f"elem_ss{k}"), read(f"side_ss{k}"))]
    nodes = sorted({int(n) + 1 for face in set_faces for n in faces[face]})
    sets[name] = {"area": sum(map(area, set_faces)), "faces": len(set_faces), "same": nodes == read(f"node_ns{k}").tolist()}
owners = np.bincount(np.concatenate(cells), minlength=len(faces))
print(json.dumps({
    "blocks": texts("eb_names"), "numbers": read("eb_prop1").tolist(), "cells": len(cells), "faces": len(faces),
    "owners": sorted(set(owners.tolist())), "map": sorted(read("elem_num_map").tolist()) == list(range(1, len(cells) + 1)),
    "sets": sets,
}))
