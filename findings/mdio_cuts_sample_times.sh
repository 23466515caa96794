#!/bin/sh
# multidimio 1.1.3 imports a SEG-Y file sampled every 2.5 ms, and stores whole milliseconds as its axis `time`: 0, 2, 5,
# 7, 10, 12. segyio reads 0, 2.5, 5, 7.5, 10, 12.5 from the same file. No warning is given, and the steps differ, so that a
# reader of the store finds no even sampling. The script fails if this changes. Needs Python 3.10 or 3.11 and PyPI.
set -eu
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv tools
tools/bin/pip install --quiet --disable-pip-version-check multidimio==1.1.3 segyio==1.9.14
cat >check.py <<'PYTHON'
import mdio
import numpy as np
import segyio
from mdio.builder.template_registry import get_template
from segy.schema import HeaderField
from segy.standards import get_segy_standard


def write_survey(path):
    """Writes eight inlines and crosslines with 16 samples every 2,500 microseconds."""
    spec = segyio.spec()
    spec.sorting, spec.format = 2, 5
    spec.samples = np.arange(16) * 2.5
    spec.ilines = spec.xlines = np.arange(1, 9)
    with segyio.create(path, spec) as survey:
        survey.bin[segyio.BinField.Interval] = 2500
        for trace in range(64):
            inline, crossline = 1 + trace // 8, 1 + trace % 8
            survey.header[trace] = {
                71: 1, 115: 16, 117: 2500, 181: 1000 + 10 * crossline, 185: 2000 + 10 * inline, 189: inline, 193: crossline,
            }
            survey.trace[trace] = np.full(16, trace, "f4")


if __name__ == "__main__":
    write_survey("survey.sgy")
    with segyio.open("survey.sgy") as survey:
        by_segyio = survey.samples[:6].tolist()
    bytes_of = {"inline": 189, "crossline": 193, "cdp_x": 181, "cdp_y": 185}
    fields = [HeaderField(name=name, byte=byte, format="int32") for name, byte in bytes_of.items()]
    standard = get_segy_standard(1.0).customize(trace_header_fields=fields)
    mdio.segy_to_mdio(standard, get_template("PostStack3DTime"), "survey.sgy", "survey.mdio")
    by_mdio = mdio.open_mdio("survey.mdio")["time"].values[:6].tolist()
    print("segyio:", by_segyio)
    print("multidimio:", by_mdio)
    assert by_segyio == [0, 2.5, 5, 7.5, 10, 12.5]
    assert by_mdio == [0, 2, 5, 7, 10, 12]
PYTHON
tools/bin/python check.py
