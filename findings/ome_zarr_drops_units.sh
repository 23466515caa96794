#!/bin/sh
# ome-zarr 0.18.0 takes the axes of an image as dictionaries with name, type and unit, as the metadata of OME-Zarr have them,
# and writes them without the unit: the distances between samples have none in the file. No warning is given. Units that
# are given in the separate argument `axes_units` are written. The script fails if this changes. Needs Python 3.11 or later.
set -eu
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv tools
tools/bin/pip install --quiet --disable-pip-version-check ome-zarr==0.18.0 zarr==3.1.6
cat >check.py <<'PYTHON'
import warnings

import numpy as np
import zarr
from ome_zarr.format import FormatV05
from ome_zarr.writer import write_image

AXES = [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]
SCALE = {"z": 2.0, "y": 0.25, "x": 0.5}


def units(path, **options):
    """Writes an image, and returns the units of its axes in the file and the texts of warnings on units."""
    root = zarr.open_group(path, mode="w", zarr_format=3)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write_image(np.zeros((8, 8, 8), "u1"), root, fmt=FormatV05(), scale=SCALE, scale_factors=[2], **options)
    written = zarr.open_group(path, mode="r").attrs["ome"]["multiscales"][0]["axes"]
    texts = [str(warning.message) for warning in caught if "unit" in str(warning.message).lower()]
    return [axis.get("unit") for axis in written], texts


if __name__ == "__main__":
    in_axes, warned = units("axes.zarr", axes=AXES)
    separate, _ = units("separate.zarr", axes="zyx", axes_units={name: "micrometer" for name in "zyx"})
    print("units in the dictionaries of axes:", in_axes, "warnings:", warned)
    print("units in axes_units:", separate)
    assert in_axes == [None] * 3 and not warned, "the units are written, or their loss is warned of"
    assert separate == ["micrometer"] * 3
PYTHON
tools/bin/python check.py
