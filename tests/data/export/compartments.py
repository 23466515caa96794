"""Prints the sizes of the compartments of a simulator's model, by number of active cells and by pore volume.

compartments.py FOLDER CASE reads the files INIT and EGRID of a case in an output folder."""
import json
import sys

import numpy as np
import resfo
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

folder, case = sys.argv[1:]
read = lambda ending: {k.strip(): v for k, v in resfo.read(f"{folder}/{case}.{ending}")}
init, egrid = read("INIT"), read("EGRID")
nx, ny, nz = (int(n) for n in egrid["GRIDHEAD"][1:4])
active = np.asarray(egrid.get("ACTNUM", np.ones(nx * ny * nz, int)))
cells = np.nonzero(active)[0]
active_index = -np.ones(nx * ny * nz, int)
active_index[cells] = np.arange(len(cells))
pairs = []
for step, name in ((1, "TRANX"), (nx, "TRANY"), (nx * ny, "TRANZ")):
    for cell in np.nonzero(init[name] > 0)[0]:
        pairs.append((cell, active_index[cells[cell] + step]))
nnc_count = 0
if "NNC1" in egrid:
    for a, b, t in zip(egrid["NNC1"], egrid["NNC2"], init["TRANNNC"]):
        if t > 0:
            pairs.append((active_index[a - 1], active_index[b - 1]))
            nnc_count += 1
pairs = np.array(pairs)
graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells),) * 2)
count, compartment = connected_components(graph, directed=False)
porv = init["PORV"][cells] if len(init["PORV"]) == nx * ny * nz else init["PORV"]
print(json.dumps({
    "cells": np.bincount(compartment).tolist(),
    "porv": np.bincount(compartment, weights=porv).tolist(),
    "joined": nnc_count,
}))
