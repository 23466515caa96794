"""Makes, compares and sums a corner-point grid with xtgeo, OPM Flow and resfo: corner_points.py TASK FOLDER.

make: writes XTGEO.EGRID, XTGEO.GRDECL and the decks XTGEO.DATA and COPY.DATA, which differ in the grid they include.
compare: prints the largest relative differences between the grids, and between the results of both decks.
pores: prints the sum of the pore volumes of OPM Flow."""

import json
import os
import sys

import numpy as np
import resfo
import xtgeo

DIMS = (12, 9, 6)
DECK = """RUNSPEC
TITLE
 A grid of xtgeo
DIMENS
 {nx} {ny} {nz} /
OIL
WATER
METRIC
TABDIMS
/
START
 1 'JAN' 2020 /
UNIFOUT
NOSIM
GRID
INIT
GRIDFILE
 0 1 /
INCLUDE
 '{grid}' /
PORO
 {cells}*0.2 /
PERMX
 {cells}*100 /
PERMY
 {cells}*100 /
PERMZ
 {cells}*10 /
PROPS
SWOF
 0.2 0 1 0
 1 1 0 0 /
PVTW
 200 1 1e-5 1 0 /
PVDO
 1 1.1 1
 400 1 1 /
ROCK
 200 1e-5 /
DENSITY
 800 1000 1 /
SOLUTION
EQUIL
 1500 200 2000 0 0 0 /
SCHEDULE
TSTEP
 1 /
END
"""

task, folder = sys.argv[1:]
os.chdir(folder)


def read(name):
    kind = "egrid" if name.endswith("EGRID") else "grdecl"
    return xtgeo.grid_from_file(name, fformat=kind)


def volumes(grid):
    return grid.get_bulk_volume(asmasked=False, precision=4).values


def arrays(name):
    return {keyword.strip(): np.array(values) for keyword, values in resfo.read(name)}


def difference(a, b):
    a, b = np.asarray(a, float), np.asarray(b, float)
    assert a.shape == b.shape and a.size
    return float(np.abs(a - b).max() / np.abs(a).max())


if task == "make":
    grid = xtgeo.create_box_grid(DIMS, origin=(450000.0, 6500000.0, 1500.0), increment=(80, 60, 5), rotation=25)
    corners = grid._zcornsv
    # Dips, layers of uneven thickness, and a fault of 12 m behind the fifth column.
    corners += 4.0 * np.arange(DIMS[0] + 1)[:, None, None, None] + 2.0 * np.arange(DIMS[1] + 1)[None, :, None, None]
    corners += 0.1 * np.arange(DIMS[0] + 1)[:, None, None, None] * np.arange(DIMS[2] + 1)[None, None, :, None]
    corners[6:] += 12
    # Corners 1 and 3 of a pillar belong to the column with the larger index along i.
    corners[5, :, :, (1, 3)] += 12
    # Pillars lean.
    grid._coordsv[..., 3] += 30
    active = grid.get_actnum()
    active.values[:2, :3, :] = 0
    active.values[7, 7, 2] = 0
    grid.set_actnum(active)
    grid.to_file("XTGEO.EGRID", fformat="egrid")
    # Both files hold the numbers of single precision.
    read("XTGEO.EGRID").to_file("XTGEO.GRDECL", fformat="grdecl")
    for case in ("XTGEO", "COPY"):
        with open(f"{case}.DATA", "w") as deck:
            nx, ny, nz = DIMS
            deck.write(DECK.format(nx=nx, ny=ny, nz=nz, cells=nx * ny * nz, grid=f"{case}.GRDECL"))
    grid = read("XTGEO.EGRID")
    volume = np.where(grid.get_actnum().values == 1, volumes(grid), 0).sum()
    print(json.dumps({"dims": list(DIMS), "active": int(grid.nactive), "volume": float(volume)}))
elif task == "compare":
    first = read("XTGEO.EGRID")
    result = {}
    for name in ("COPY.GRDECL", "COPY.EGRID"):
        copy = read(name)
        result[f"volumes of {name}"] = difference(volumes(first), volumes(copy))
        result[f"active cells of {name}"] = int((first.get_actnum().values != copy.get_actnum().values).sum())
    init, copied = arrays("XTGEO/XTGEO.INIT"), arrays("COPY/COPY.INIT")
    for name in ("PORV", "TRANX", "TRANY", "TRANZ", "TRANNNC", "DEPTH"):
        result[name] = difference(init[name], copied[name])
    grids = arrays("XTGEO/XTGEO.EGRID"), arrays("COPY/COPY.EGRID")
    for name in ("NNC1", "NNC2"):
        result[name] = difference(grids[0][name], grids[1][name])
    print(json.dumps(result))
else:
    print(json.dumps({"porv": float(arrays("XTGEO/XTGEO.INIT")["PORV"].astype(float).sum())}))
