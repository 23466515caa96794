"""Prints the contents of a RESQML model, as resqpy reads them, as JSON: resqml.py FILE.epc."""

import json
import logging
import sys

logging.disable(logging.CRITICAL)

import numpy as np
import resqpy.crs
import resqpy.model
import resqpy.property
import resqpy.unstructured

model = resqpy.model.Model(sys.argv[1])
grid = resqpy.unstructured.UnstructuredGrid(
    model, uuid=model.uuid(obj_type="UnstructuredGridRepresentation")
)
grid.cache_all_geometry_arrays()
grid.check_indices()
crs = resqpy.crs.Crs(model, uuid=grid.crs_uuid)

# Volumes of cells as sums of pyramids on their faces, with the signs that the file stores for the faces.
points = grid.points_ref()
node_ends = grid.nodes_per_face_cl.astype(int)
nodes = grid.nodes_per_face.astype(int)
cells = np.repeat(np.arange(grid.cell_count), np.diff(grid.faces_per_cell_cl, prepend=0))
flux = np.empty(grid.face_count)
for face, end in enumerate(node_ends):
    ring = points[nodes[node_ends[face - 1] if face else 0 : end]]
    middle = ring.mean(axis=0)
    areas = 0.5 * np.cross(ring - middle, np.roll(ring, -1, axis=0) - middle)
    flux[face] = (areas * (ring + np.roll(ring, -1, axis=0) + middle) / 9).sum()
sign = np.where(np.asarray(grid.cell_face_is_right_handed, dtype=bool), 1, -1)
signed_volumes = np.zeros(grid.cell_count)
np.add.at(signed_volumes, cells, sign * flux[grid.faces_per_cell.astype(int)])

properties = {}
for uuid in (
    model.uuids(obj_type="ContinuousProperty")
    + model.uuids(obj_type="DiscreteProperty")
    + model.uuids(obj_type="CategoricalProperty")
):
    prop = resqpy.property.Property(model, uuid=uuid)
    names = prop.string_lookup()
    properties[prop.title] = [
        prop.property_kind(),
        prop.uom() if prop.is_continuous() else None,
        prop.facet(),
        np.asarray(prop.array_ref(), dtype=float).tolist(),
        prop.indexable_element(),
        [names.get_string(int(n)) for n in prop.array_ref()] if names is not None else None,
    ]
# resqpy computes volumes slowly, so that there are only a few hundred. It cannot triangulate faces with a node in
# the middle of a straight edge.
volumes = {}
for c in range(0, grid.cell_count, 1 + grid.cell_count // 600):
    try:
        volumes[c] = float(grid.volume(c))
    except AssertionError:
        pass
print(
    json.dumps(
        {
            "shape": grid.cell_shape,
            "up": not crs.z_inc_down,
            "units": [crs.xy_units, crs.z_units],
            "cells": grid.cell_count,
            "volume": volumes,
            "handed": signed_volumes.tolist(),
            "properties": properties,
        }
    )
)
