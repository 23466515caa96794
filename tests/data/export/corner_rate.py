"""Prints the rate through a corner-point grid from its low to its high side along i as JSON: corner_rate.py FILE.

The pressures there are 1 and 0, and permeability and viscosity are 1. Fluxes are two-point fluxes as in Eclipse
(NEWTRAN), with FAULTS and MULTFLT. Pillars must not be split."""

import json
import sys

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import spsolve

words, records = {}, {}
lines = iter(open(sys.argv[1]))
for line in lines:
    keyword = line.strip()
    if keyword in ("FAULTS", "MULTFLT"):
        rows = iter(lambda: next(lines).replace("'", " ").split(), ["/"])
        records[keyword] = [row for row in rows]
    elif keyword in ("SPECGRID", "COORD", "ZCORN"):
        tokens = []
        while "/" not in tokens:
            tokens += next(lines).split()
        words[keyword] = tokens[:-1]
n, m, layers = (int(word) for word in words["SPECGRID"][:3])
pillars = np.array(words["COORD"], float).reshape(m + 1, n + 1, 2, 3)
z = np.array(words["ZCORN"], float).reshape(layers, 2, m, 2, n, 2)
# The axes are k, top and bottom, j, the two sides along j, i, the two sides along i, coordinates.
corners = np.empty(z.shape + (3,))
for b in (0, 1):
    for a in (0, 1):
        top, bottom = np.moveaxis(pillars[b : m + b, a : n + a], 2, 0)
        depth = z[:, :, :, b, :, a]
        fraction = (depth - top[..., 2]) / (bottom[..., 2] - top[..., 2])
        corners[:, :, :, b, :, a, :2] = top[..., :2] + fraction[..., None] * (bottom - top)[..., :2]
        corners[:, :, :, b, :, a, 2] = depth
centre = corners.mean(axis=(1, 3, 5))
multiplier = np.ones((3, layers, m, n))
factor = {row[0]: float(row[1]) for row in records.get("MULTFLT", [])}
for name, *box, side, _ in records.get("FAULTS", []):
    i, _, j, _, k, last = (int(word) for word in box)
    multiplier["XYZ".index(side), k - 1 : last, j - 1, i - 1] *= factor.get(name, 1.0)


def half_transmissibility(axis, side):
    """Returns the transmissibilities from the centres of all cells to their faces on one side of an axis."""
    face = np.take(corners, side, axis=(5, 3, 1)[axis])
    # These axes of the face have its two corners each.
    pair = ((1, 3), (1, 4), (2, 4))[axis]
    corner = lambda p, q: np.take(np.take(face, q, axis=pair[1]), p, axis=pair[0])
    ring = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)]
    area = 0.5 * np.cross(ring[2] - ring[0], ring[3] - ring[1])
    offset = sum(ring) / 4 - centre
    return np.abs((area * offset).sum(-1)) / (offset * offset).sum(-1)


number = np.arange(n * m * layers).reshape(layers, m, n)
pairs, values = [], []
for axis in range(3):
    first = tuple(slice(0, -1) if k == 2 - axis else slice(None) for k in range(3))
    second = tuple(slice(1, None) if k == 2 - axis else slice(None) for k in range(3))
    t = multiplier[axis][first] / (1 / half_transmissibility(axis, 1)[first] + 1 / half_transmissibility(axis, 0)[second])
    pairs.append(np.stack([number[first].ravel(), number[second].ravel()]))
    values.append(t.ravel())
pairs, values = np.concatenate(pairs, axis=1), np.concatenate(values)
count = number.size
matrix = sparse.coo_matrix((values, pairs), (count, count))
matrix = matrix + matrix.T
diagonal = np.asarray(matrix.sum(axis=1)).ravel()
right = np.zeros(count)
low, high = number[:, :, 0].ravel(), number[:, :, -1].ravel()
into, out = half_transmissibility(0, 0)[:, :, 0].ravel(), half_transmissibility(0, 1)[:, :, -1].ravel()
diagonal[low] += into
right[low] += into
diagonal[high] += out
pressure = spsolve((sparse.diags(diagonal) - matrix).tocsc(), right)
print(json.dumps({"dims": [n, m, layers], "rate": float(out @ pressure[high])}))
