"""Solves two-point flow on a grid for MRST with SciPy, and prints totals as JSON.

mrst.py FILE SOURCE SINK has a rate of 1e-4 m3/s between two cells, whose numbers begin at 1. mrst.py FILE has the wells
of the file. The viscosity is 1e-3 Pa s."""

import json
import sys

import numpy as np
import scipy.io
import scipy.sparse as sparse
from scipy.sparse.linalg import spsolve

# All numbers are double, as in MATLAB.
data = scipy.io.loadmat(sys.argv[1], mat_dtype=True, squeeze_me=True, struct_as_record=False)
ends = [int(a) - 1 for a in sys.argv[2:4]]
wells = np.atleast_1d(data.get("W", []))
grid, rock, t = data["G"], data["rock"], data["T"]
cells, faces, nodes = grid.cells, grid.faces, grid.nodes
n, nf = int(cells.num), int(faces.num)
neighbors = faces.neighbors.astype(int)

# Compute areas and normals of faces from their nodes, and volumes of cells from their faces, as MRST's
# computeGeometry does.
pos, ring = faces.nodePos.astype(int) - 1, faces.nodes.astype(int) - 1
area_error, off_plane = 0.0, 0.0
for f in range(nf):
    p = nodes.coords[ring[pos[f] : pos[f + 1]]]
    q = p - p.mean(axis=0)
    normal = 0.5 * np.cross(q, np.roll(q, -1, axis=0)).sum(axis=0)
    area_error = max(area_error, np.abs(normal - faces.normals[f]).max())
    off_plane = max(off_plane, np.abs(q @ normal).max() / max(faces.areas[f], 1e-300))
flux = (faces.centroids * faces.normals).sum(axis=1) / 3
volume = np.zeros(n)
inside = neighbors > 0
for k, sign in ((0, 1), (1, -1)):
    has_cell = inside[:, k]
    np.add.at(volume, neighbors[has_cell, k] - 1, sign * flux[has_cell])
cell_faces = cells.faces.astype(int) - 1
first_face = cells.facePos.astype(int) - 1
listed = all(
    c + 1 in neighbors[f] for c in range(n) for f in cell_faces[first_face[c] : first_face[c + 1]]
)

inner = inside.all(axis=1)
a, b = (neighbors[inner] - 1).T
matrix = sparse.coo_matrix((t[inner], (a, b)), (n, n))
matrix = matrix + matrix.T
matrix = sparse.diags(np.asarray(matrix.sum(axis=1)).ravel()) - matrix
pressure = np.zeros(n)
if ends:
    rates = np.zeros(n)
    rates[ends] = 1e-4, -1e-4
    free = np.arange(1, n)
    pressure[free] = spsolve(matrix.tocsc()[free][:, free], 1e-3 * rates[free])
    pressure -= pressure.mean()
else:
    # The equations are those of incompTPFA without gravity: the pressure of each well is an additional unknown.
    matrix = sparse.block_diag([matrix, sparse.csr_matrix((len(wells), len(wells)))]).tolil()
    right = np.zeros(n + len(wells))
    for row, well in enumerate(wells, n):
        if well.type == "bhp":
            matrix[row, row], right[row] = 1.0, well.val
        else:
            right[row] = 1e-3 * well.val
        for cell, index in zip(np.atleast_1d(well.cells).astype(int) - 1, np.atleast_1d(well.WI)):
            matrix[cell, cell] += index
            matrix[cell, row] -= index
            if well.type != "bhp":
                matrix[row, row] += index
                matrix[row, cell] -= index
    pressure = spsolve(matrix.tocsc(), right)[:n]
print(
    json.dumps(
        {
            "cells": n,
            "faces": [nf, int(inner.sum())],
            "listed": bool(listed) and len(cell_faces) == int(inside.sum()),
            "volumes": cells.volumes.tolist(),
            "own_volumes": volume.tolist(),
            "normals_off": area_error,
            "pairs": (neighbors[inner] - 1).tolist(),
            "t": t.tolist(),
            "depth": cells.sites[:, 2].tolist(),
            "region": cells.region.tolist(),
            "perm": np.atleast_2d(rock.perm.T).T.tolist(),
            "poro": rock.poro.tolist(),
            "tags": sorted(set(faces.tag[~inner].astype(int).tolist())),
            "tagged": {
                str(name): int((faces.tag == n + 1).sum()) for n, name in enumerate(faces.tagNames)
            },
            "sets": {name: int(np.size(getattr(nodes.sets, name))) for name in nodes.sets._fieldnames},
            "pressure": pressure.tolist(),
        }
    )
)
