#!/bin/sh
# Netgen 6.2.2506 reads the names of physical groups in a mesh of Gmsh, version 2.2, up to the first blank only, and without
# their last letter: "Host rock" becomes "Hos", and two groups whose names begin alike get one name, so that a material or a
# boundary condition applies to both. meshio reads the names in full. The script fails if this changes.
set -eu
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv tools
tools/bin/pip install --quiet --disable-pip-version-check netgen-mesher==6.2.2506 meshio==5.3.5 numpy
cat >mesh.msh <<'MESH'
$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
3 1 "Host rock"
3 2 "Host sand"
$EndPhysicalNames
$Nodes
5
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1
5 0 0 -1
$EndNodes
$Elements
2
1 4 2 1 1 1 2 3 4
2 4 2 2 2 1 3 2 5
$EndElements
MESH
cat >check.py <<'PYTHON'
import meshio
from netgen.read_gmsh import ReadGmsh

if __name__ == "__main__":
    mesh = ReadGmsh("mesh.msh")
    by_netgen = [mesh.GetMaterial(number) for number in (1, 2)]
    by_meshio = list(meshio.read("mesh.msh").field_data)
    print("Netgen:", by_netgen, "meshio:", by_meshio)
    assert by_meshio == ["Host rock", "Host sand"]
    assert by_netgen[0] == by_netgen[1] and by_netgen[0] not in by_meshio, "the names are whole"
PYTHON
tools/bin/python check.py
