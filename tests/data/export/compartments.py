"""What a simulator has read, from its INIT and EGRID: the sizes of the parts that nothing connects, by number
of active cells and by pore volume. Arguments: output folder, case."""
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
place = -np.ones(nx * ny * nz, int)
place[cells] = np.arange(len(cells))
pairs = []
for step, name in ((1, "TRANX"), (nx, "TRANY"), (nx * ny, "TRANZ")):
    for at in np.nonzero(init[name] > 0)[0]:
        pairs.append((at, place[cells[at] + step]))
joined = 0
if "NNC1" in egrid:
    for a, b, t in zip(egrid["NNC1"], egrid["NNC2"], init["TRANNNC"]):
        if t > 0:
            pairs.append((place[a - 1], place[b - 1]))
            joined += 1
pairs = np.array(pairs)
graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells),) * 2)
count, part = connected_components(graph, directed=False)
porv = init["PORV"][cells] if len(init["PORV"]) == nx * ny * nz else init["PORV"]
print(json.dumps({
    "cells": np.bincount(part).tolist(),
    "porv": np.bincount(part, weights=porv).tolist(),
    "joined": joined,
}))
