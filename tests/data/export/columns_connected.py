"""Prints in how many columns of a simulator's model all active cells are connected vertically.

columns_connected.py FOLDER CASE reads the files INIT and EGRID of a case in an output folder."""
import json
import sys

import numpy as np
import resfo

folder, case = sys.argv[1:]
read = lambda ending: {k.strip(): v for k, v in resfo.read(f"{folder}/{case}.{ending}")}
init, egrid = read("INIT"), read("EGRID")
nx, ny, nz = (int(n) for n in egrid["GRIDHEAD"][1:4])
active = np.asarray(egrid.get("ACTNUM", np.ones(nx * ny * nz, int))).reshape(nz, ny * nx) > 0
tranz = np.zeros(active.size)
tranz[active.ravel()] = init["TRANZ"]
tranz = tranz.reshape(active.shape)
joined = set()
if "NNC1" in egrid:
    for a, b, t in zip(egrid["NNC1"], egrid["NNC2"], init["TRANNNC"]):
        if t > 0:
            joined.add((min(a, b) - 1, max(a, b) - 1))
columns = connected = pinched = 0
for column in range(nx * ny):
    layers = np.nonzero(active[:, column])[0]
    pairs = list(zip(layers[:-1], layers[1:]))
    holds = [tranz[a, column] > 0 or (a * nx * ny + column, b * nx * ny + column) in joined for a, b in pairs]
    columns += 1
    connected += all(holds)
    pinched += len(layers) < nz
print(json.dumps({"columns": [columns], "connected": [connected], "pinched": [int(pinched)]}))
