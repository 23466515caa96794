"""Prints the contents of a corner-point grid, as xtgeo reads them, as JSON: corners.py FILE REGIONS."""

import json
import sys

import numpy as np
import xtgeo

grid = xtgeo.grid_from_file(sys.argv[1], fformat="grdecl")
volume = grid.get_bulk_volume(asmasked=True, precision=4).values


def values(name, file):
    read = xtgeo.gridproperty_from_file(file, fformat="grdecl", name=name, grid=grid)
    return read.values


names = [line.strip() for line in open(sys.argv[1]) if line[:1].isalpha()]
properties = {}
for name in ("PORO", "PERMX", "PERMY", "PERMZ", "MULTX", "MULTY", "MULTZ"):
    if name in names:
        read = values(name, sys.argv[1])
        properties[name] = [float(read.min()), float((read * volume).sum()), float(read.max())]
fipnum = values("FIPNUM", sys.argv[2])
corners = grid._zcornsv
# Pillars are split if their corners have more than one depth.
split = (np.ptp(corners, axis=3) > 1e-3).any(axis=2)
coord = grid._coordsv
lean = np.hypot(coord[..., 3] - coord[..., 0], coord[..., 4] - coord[..., 1])
print(
    json.dumps(
        {
            "dims": list(grid.dimensions),
            "active": int(grid.nactive),
            "volume": float(volume.sum()),
            "least": float(volume.min()),
            "regions": {int(r): float(volume[fipnum == r].sum()) for r in np.unique(fipnum.compressed())},
            "split": int(split.sum()),
            "lean": lean[1:-1, 1:-1].ravel().tolist(),
            "properties": properties,
        }
    )
)
