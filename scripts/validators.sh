#!/bin/sh
# Installs the programs that judge atomesh's files, each independent of it: VTK, Gmsh, toughio, xtgeo,
# resqpy, open-DARTS, SciPy, meshio, the readers of images of the field (segyio, nibabel, pynrrd, SimpleITK,
# tifffile, zarr) and a reader of simulators' output from PyPI into .venv; OPM Flow, OpenFOAM, CalculiX, Octave and
# Chromium, which opens pages, by apt. Tests then use them; without one they name it and check less.
set -eu

modules="vtkmodules.vtkIOXML resfo gmsh toughio scipy xtgeo resqpy darts flopy meshio
segyio nibabel nrrd SimpleITK tifffile zarr"
packages="libopm-simulators-bin openfoam calculix-ccx octave libglu1-mesa libxft2 libxcursor1 libxinerama1"
# Where there is no shell of its own (Ubuntu), the whole browser.
browser="chromium-headless-shell chromium"

absent() {
    echo "note: $1: tests that need them check less" >&2
}

python_modules() {
    for module in $modules; do
        .venv/bin/python -c "import $module" 2>/dev/null || return 1
    done
}

install_modules() {
    command -v python3 >/dev/null 2>&1 || { absent "no python3"; return; }
    rm -rf .venv
    python3 -m venv .venv >/dev/null 2>&1 ||
        { absent "python3 -m venv fails (apt install python3-venv)"; return; }
    pip=".venv/bin/pip install --quiet --disable-pip-version-check"
    # VTK without what it draws plots with.
    { $pip --no-deps vtk && $pip resfo gmsh toughio h5py scipy xtgeo resqpy xarray flopy meshio &&
        $pip segyio nibabel pynrrd SimpleITK tifffile zarr; } ||
        absent "pip install fails"
    # DARTS asks for much that it does not need to solve for pressures.
    $pip --no-deps open-darts || absent "pip install open-darts fails"
    python_modules || absent "some of the Python modules ($modules) do not load"
}

has_browser() {
    for name in $browser; do
        ! command -v "$name" >/dev/null 2>&1 || return 0
    done
    return 1
}

# The first that there is a package of; known only after an update.
packaged_browser() {
    for name in $browser; do
        ! apt-cache show "$name" >/dev/null 2>&1 || { echo "$name"; return; }
    done
}

install_packages() {
    missing=""
    for package in $packages; do
        dpkg -s "$package" 2>/dev/null | grep -q '^Status: install ok installed' ||
            missing="$missing $package"
    done
    if [ -z "$missing" ] && has_browser; then
        return 0
    fi
    as_root=""
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null 2>&1 ||
            { absent "not root and no sudo to install$missing"; return; }
        as_root="sudo"
    fi
    $as_root apt-get update -qq || { absent "apt-get update fails"; return; }
    has_browser || missing="$missing $(packaged_browser)"
    echo "Installing validators:$missing"
    { $as_root env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -qq --no-install-recommends $missing >/dev/null; } ||
        absent "apt-get install fails"
}

if command -v dpkg >/dev/null 2>&1 && command -v apt-get >/dev/null 2>&1; then
    install_packages
else
    absent "no apt here; install OPM Flow, OpenFOAM, CalculiX, Octave and Chromium yourself"
fi
# A folder made elsewhere is of no use.
if ! { [ -x .venv/bin/python ] && python_modules; }; then
    install_modules
fi
