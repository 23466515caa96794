"""The rate through a corner-point grid from its low to its high side along i, for a pressure of 1 and 0 there,
a permeability and a viscosity of 1: corner_rate.py FILE. Two-point fluxes as Eclipse has them (NEWTRAN), with
FAULTS and MULTFLT; pillars are not split."""

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
        found = []
        while "/" not in found:
            found += next(lines).split()
        words[keyword] = found[:-1]
n, m, layers = (int(word) for word in words["SPECGRID"][:3])
pillars = np.array(words["COORD"], float).reshape(m + 1, n + 1, 2, 3)
z = np.array(words["ZCORN"], float).reshape(layers, 2, m, 2, n, 2)
# Corners by k, its top and bottom, j, its two sides, i, its two sides.
corners = np.empty(z.shape + (3,))
for b in (0, 1):
    for a in (0, 1):
        top, bottom = np.moveaxis(pillars[b : m + b, a : n + a], 2, 0)
        depth = z[:, :, :, b, :, a]
        share = (depth - top[..., 2]) / (bottom[..., 2] - top[..., 2])
        corners[:, :, :, b, :, a, :2] = top[..., :2] + share[..., None] * (bottom - top)[..., :2]
        corners[:, :, :, b, :, a, 2] = depth
centre = corners.mean(axis=(1, 3, 5))
multiplier = np.ones((3, layers, m, n))
factor = {row[0]: float(row[1]) for row in records.get("MULTFLT", [])}
for name, *box, side, _ in records.get("FAULTS", []):
    i, _, j, _, k, last = (int(word) for word in box)
    multiplier["XYZ".index(side), k - 1 : last, j - 1, i - 1] *= factor.get(name, 1.0)


def half(axis, side):
    """Transmissibility from every cell's centre to one of its faces."""
    face = np.take(corners, side, axis=(5, 3, 1)[axis])
    # The two axes left of the three that have two sides each.
    pair = ((1, 3), (1, 4), (2, 4))[axis]
    at = lambda p, q: np.take(np.take(face, q, axis=pair[1]), p, axis=pair[0])
    ring = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)]
    area = 0.5 * np.cross(ring[2] - ring[0], ring[3] - ring[1])
    off = sum(ring) / 4 - centre
    return np.abs((area * off).sum(-1)) / (off * off).sum(-1)


number = np.arange(n * m * layers).reshape(layers, m, n)
ends, values = [], []
for axis in range(3):
    first = tuple(slice(0, -1) if k == 2 - axis else slice(None) for k in range(3))
    second = tuple(slice(1, None) if k == 2 - axis else slice(None) for k in range(3))
    t = multiplier[axis][first] / (1 / half(axis, 1)[first] + 1 / half(axis, 0)[second])
    ends.append(np.stack([number[first].ravel(), number[second].ravel()]))
    values.append(t.ravel())
ends, values = np.concatenate(ends, axis=1), np.concatenate(values)
count = number.size
joined = sparse.coo_matrix((values, ends), (count, count))
joined = joined + joined.T
diagonal = np.asarray(joined.sum(axis=1)).ravel()
right = np.zeros(count)
low, high = number[:, :, 0].ravel(), number[:, :, -1].ravel()
into, out = half(0, 0)[:, :, 0].ravel(), half(0, 1)[:, :, -1].ravel()
diagonal[low] += into
right[low] += into
diagonal[high] += out
pressure = spsolve((sparse.diags(diagonal) - joined).tocsc(), right)
print(json.dumps({"dims": [n, m, layers], "rate": float(out @ pressure[high])}))
