"""Reads a MODFLOW 6 simulation of columns with flopy, and solves it as MODFLOW does: disv.py FOLDER.
Prints counts, volume, and the head of each active cell as JSON.

The rules are those of MODFLOW. The width of a connection is the length of the shared edge, and its lengths are
the distances of the centres in CELL2D from this edge. Between layers the lengths are half the thicknesses. Cells
with IDOMAIN -1 connect the cells above and below them. A negative HYDCHR multiplies the conductance."""

import json
import sys

import flopy
import numpy as np

sim = flopy.mf6.MFSimulation.load(sim_ws=sys.argv[1], verbosity_level=0)
gwf = sim.get_model("model")
disv, npf = gwf.disv, gwf.npf
layers, columns = disv.nlay.get_data(), disv.ncpl.get_data()
top, bottom = disv.top.get_data(), disv.botm.get_data().reshape(layers, columns)
domain = disv.idomain.get_data().reshape(layers, columns)
vertices = {v[0]: np.array([v[1], v[2]]) for v in disv.vertices.get_data()}
rings, centres, areas, clockwise = [], [], [], True
for record in disv.cell2d.get_data():
    record = list(record)
    ring = [int(v) for v in record[4 : 4 + record[3]]]
    points = np.array([vertices[v] for v in ring])
    x, y = points[:, 0], points[:, 1]
    area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    clockwise = clockwise and area < 0
    rings.append(ring)
    centres.append(np.array([record[1], record[2]]))
    areas.append(abs(area))
upper = np.vstack([top, bottom[:-1]])
thickness = upper - bottom
active = [(l, c) for l in range(layers) for c in range(columns) if domain[l, c] == 1]
number = {cell: i for i, cell in enumerate(active)}
shape = (layers, columns)
k = npf.k.get_data().reshape(shape)
k22 = npf.k22.get_data().reshape(shape)
k33 = npf.k33.get_data().reshape(shape)
volume = sum(areas[c] * thickness[l, c] for l, c in active)
assert all(thickness[cell] > 0 for cell in active)

edges = {}
for column, ring in enumerate(rings):
    for a, b in zip(ring, ring[1:] + ring[:1]):
        edges.setdefault(frozenset((a, b)), []).append((column, a, b))
pairs = []
for owners in edges.values():
    if len(owners) == 2:
        (m, a, b), (n, c, d) = owners
        # Neighbours have their common edge in opposite directions.
        assert (a, b) == (d, c)
        edge = vertices[b] - vertices[a]
        width = np.hypot(*edge)
        normal = np.array([-edge[1], edge[0]]) / width
        distances = [abs((centres[i] - vertices[a]) @ normal) for i in (m, n)]
        pairs.append((m, n, width, distances, normal))

barriers = {}
if gwf.get_package("hfb") is not None:
    for record in gwf.hfb.stress_period_data.get_data(0):
        assert record[2] < 0
        barriers[frozenset((tuple(record[0]), tuple(record[1])))] = -record[2]

matrix = np.zeros((len(active), len(active)))
right = np.zeros(len(active))
connections = passed = 0


def connect(a, b, conductance):
    global connections
    connections += 1
    i, j = number[a], number[b]
    matrix[i, i] += conductance
    matrix[j, j] += conductance
    matrix[i, j] -= conductance
    matrix[j, i] -= conductance


for m, n, width, distances, normal in pairs:
    for l in range(layers):
        a, b = (l, m), (l, n)
        if a in number and b in number:
            # Conductivities along the normal come from their ellipse.
            conductivity = [k[c] * k22[c] / (k22[c] * normal[0] ** 2 + k[c] * normal[1] ** 2) for c in (a, b)]
            t = [conductivity[0] * thickness[a], conductivity[1] * thickness[b]]
            conductance = width * t[0] * t[1] / (t[0] * distances[1] + t[1] * distances[0])
            connect(a, b, conductance * barriers.get(frozenset((a, b)), 1.0))
for c in range(columns):
    above = None
    for l in range(layers):
        if domain[l, c] == -1:
            passed += 1
        if domain[l, c] == 1:
            if above is not None:
                half = [0.5 * thickness[cell] / k33[cell] for cell in ((above, c), (l, c))]
                connect((above, c), (l, c), areas[c] / sum(half))
            above = l
        elif domain[l, c] == 0:
            above = None
for record in gwf.wel.stress_period_data.get_data(0) if gwf.get_package("wel") else ():
    right[number[tuple(record[0])]] += record[1]
for record in gwf.ghb.stress_period_data.get_data(0) if gwf.get_package("ghb") else ():
    i = number[tuple(record[0])]
    matrix[i, i] += record[2]
    right[i] += record[2] * record[1]
for record in gwf.chd.stress_period_data.get_data(0) if gwf.get_package("chd") else ():
    i = number[tuple(record[0])]
    matrix[i, i] += 1e12
    right[i] += 1e12 * record[1]
head = np.linalg.solve(matrix, right)
print(
    json.dumps(
        {
            "clockwise": bool(clockwise),
            "active": len(active),
            "passed": passed,
            "connections": connections,
            "volume": float(volume),
            "head": head.tolist(),
        }
    )
)
