#!/bin/sh
# Installs the independent programs with which tests check the files of atomesh. From PyPI into .venv: VTK, Gmsh,
# toughio, xtgeo, resqpy, open-DARTS, SciPy, meshio, readers of images (segyio, nibabel, pynrrd, SimpleITK, tifffile,
# zarr, ome-zarr, ngff-zarr, pydicom), of logs (lasio), of models for FEBio (pyfebio) and a reader of simulation results
# (resfo). By apt: OPM Flow, OpenFOAM, CalculiX, Octave and Chromium. By npm: axe-core, which checks pages for accessibility.
set -eu

modules="vtkmodules.vtkIOXML resfo gmsh toughio scipy xtgeo resqpy darts flopy meshio netCDF4
segyio nibabel nrrd SimpleITK tifffile zarr ome_zarr ngff_zarr pydicom lasio pyfebio"
packages="libopm-simulators-bin openfoam calculix-ccx octave libglu1-mesa libxft2 libxcursor1 libxinerama1"
# Systems without a package of the headless shell (Ubuntu) have a package of the whole browser.
browser="chromium-headless-shell chromium"

absent() {
    echo "note: $1: tests that need it will fail" >&2
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
    # VTK is installed without its dependencies, which are for plots.
    { $pip --no-deps vtk && $pip resfo gmsh toughio h5py scipy xtgeo resqpy xarray flopy meshio netCDF4 &&
        $pip segyio nibabel pynrrd SimpleITK tifffile zarr ome-zarr ngff-zarr lasio pyfebio==0.3.0 &&
        $pip pydicom pylibjpeg pylibjpeg-libjpeg pylibjpeg-openjpeg; } ||
        absent "pip install fails"
    # Further readers of the test of one model in many programs, which runs without them, too.
    # pyNastran asks for an older NumPy than the others.
    { $pip trimesh scikit-fem meshioplusplus && $pip --no-deps pyNastran cpylog; } ||
        absent "pip install of further readers fails"
    # Most dependencies of open-DARTS are not needed to solve for pressures.
    $pip --no-deps open-darts || absent "pip install open-darts fails"
    python_modules || absent "some of the Python modules ($modules) do not load"
}

has_browser() {
    for name in $browser; do
        ! command -v "$name" >/dev/null 2>&1 || return 0
    done
    return 1
}

# Prints the first browser that has a package. The list of packages must be up to date.
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

install_axe() {
    command -v npm >/dev/null 2>&1 || { absent "no npm to download axe-core"; return; }
    folder="$(mktemp -d)"
    { (cd "$folder" && npm pack --silent axe-core@4 >/dev/null && tar xzf axe-core-*.tgz) &&
        mv "$folder/package/axe.min.js" .venv/axe.min.js; } || absent "npm pack axe-core fails"
    rm -rf "$folder"
}

if command -v dpkg >/dev/null 2>&1 && command -v apt-get >/dev/null 2>&1; then
    install_packages
else
    absent "no apt here; install OPM Flow, OpenFOAM, CalculiX, Octave and Chromium yourself"
fi
# A virtual environment of another machine does not work.
if ! { [ -x .venv/bin/python ] && python_modules; }; then
    install_modules
fi
[ -e .venv/axe.min.js ] || install_axe
