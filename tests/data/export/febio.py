"""Prints figures of a model for FEBio, as pyfebio reads it, as JSON: febio.py FILE.

These are the volume of each part, the area of each surface, its signed area along each axis, the sizes of the sets of nodes, and
the types of the elements."""

import json
import sys

import numpy as np
from pyfebio.model import Model

with open(sys.argv[1], "rb") as file:
    model = Model.from_xml(file.read())
mesh = model.mesh_
nodes = np.array([[float(c) for c in node.text.split(",")] for node in mesh.nodes[0].all_nodes])
ids = [node.id for node in mesh.nodes[0].all_nodes]
assert ids == list(range(1, len(ids) + 1))


def numbers(element):
    return [int(n) - 1 for n in element.text.split(",")]


parts = {}
for part in mesh.elements:
    cells = np.array([numbers(element) for element in part.all_elements])
    corners = nodes[cells[:, :4]]
    edges = corners[:, 1:] - corners[:, :1]
    volumes = np.linalg.det(edges) / 6.0
    middle = 0.0
    if cells.shape[1] == 10:
        # Nodes 5 to 10 lie on the edges 12, 23, 31, 14, 24, 34.
        pairs = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
        ends = np.stack([nodes[cells[:, pair]].mean(axis=1) for pair in pairs], axis=1)
        middle = float(np.abs(ends - nodes[cells[:, 4:]]).max())
    parts[part.name] = {
        "type": part.type,
        "volume": float(volumes.sum()),
        "least": float(volumes.min()),
        "middle": middle,
    }
surfaces = {}
for surface in mesh.surfaces:
    faces = np.array([numbers(face)[:3] for face in surface.all_tri3 + surface.all_tri6])
    a, b, c = (nodes[faces[:, k]] for k in range(3))
    vectors = 0.5 * np.cross(b - a, c - a)
    surfaces[surface.name] = {
        "area": float(np.linalg.norm(vectors, axis=1).sum()),
        "vector": [float(x) for x in vectors.sum(axis=0)],
    }
print(
    json.dumps(
        {
            "nodes": len(nodes),
            "parts": parts,
            "surfaces": surfaces,
            "node_sets": {s.name: len(s.text.replace("\n", "").split(",")) for s in mesh.node_sets},
            "domains": [domain.name for domain in model.meshdomains_.solid_domains],
            "materials": [material.name for material in model.material_.all_materials],
        }
    )
)
