"""Prints the contents of TOUGH2's file MESH, as toughio reads them, as JSON: tough.py FILE."""

import json
import sys

import toughio

parameters = toughio.read_input(sys.argv[1], file_format="tough")
elements = list(parameters["elements"].items())
index = {name: i for i, (name, _) in enumerate(elements)}
connections = []
for name, c in parameters["connections"].items():
    pair = [index[name[:5]], index[name[5:]]]
    distances = [float(d) for d in c["nodal_distances"]]
    beta = float(c["gravity_cosine_angle"] or 0.0)
    connections.append(
        [pair, int(c["permeability_direction"]), distances, float(c["interface_area"]), beta]
    )
print(
    json.dumps(
        {
            "volume": [float(e["volume"]) for _, e in elements],
            "modifier": [float(e.get("permeability_modifier") or 0.0) for _, e in elements],
            "rock": [str(e["material"]) for _, e in elements],
            "center": [[float(x) for x in e["center"]] for _, e in elements],
            "connections": connections,
        }
    )
)
