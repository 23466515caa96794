#!/bin/sh
# Puts VTK, the library under ParaView, into .venv: tests then read atomesh's files with it.
# Without it those tests say so and check less.
set -eu

if [ -x .venv/bin/python ] && .venv/bin/python -c 'import vtkmodules.vtkIOXML' 2>/dev/null; then
    exit 0
fi
absent() {
    echo "note: VTK is absent ($1): the tests will not open meshes with it" >&2
    exit 0
}
command -v python3 >/dev/null 2>&1 || absent "no python3"
rm -rf .venv
python3 -m venv .venv >/dev/null 2>&1 || absent "python3 -m venv fails; apt install python3-venv"
.venv/bin/pip install --quiet --disable-pip-version-check --no-deps vtk || absent "pip install vtk fails"
.venv/bin/python -c 'import vtkmodules.vtkIOXML' || absent "vtk does not load"
