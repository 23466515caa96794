#!/bin/sh
# Gmsh 4.15.2 writes the pairs of periodic nodes to MSH 2.2 ($Periodic) and ignores them when it reads the file: no
# surface has a master. The same mesh in MSH 4.1 keeps its pairs. No warning is given. The script fails if this changes.
# Needs Python 3 and PyPI.
set -eu
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv tools
tools/bin/pip install --quiet --disable-pip-version-check gmsh==4.15.2
cat >check.py <<'PYTHON'
import gmsh

gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
gmsh.model.occ.synchronize()


def side(index, value):
    """Returns the surface whose bounding box has this value at both ends of an axis."""
    for _, tag in gmsh.model.getEntities(2):
        box = gmsh.model.getBoundingBox(2, tag)
        if abs(box[index] - value) < 1e-3 and abs(box[index + 3] - value) < 1e-3:
            return tag
    raise ValueError(value)


near, far = side(0, 0.0), side(0, 1.0)
gmsh.model.mesh.setPeriodic(2, [far], [near], [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
gmsh.model.mesh.generate(3)
for version in (2.2, 4.1):
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.write(f"cube{version}.msh")
pairs = {}
for version in (2.2, 4.1):
    with open(f"cube{version}.msh") as file:
        assert "$Periodic" in file.read()
    gmsh.clear()
    gmsh.open(f"cube{version}.msh")
    found = [gmsh.model.mesh.getPeriodicNodes(2, tag) for _, tag in gmsh.model.getEntities(2)]
    pairs[version] = sum(len(nodes) for _, nodes, _, _ in found)
    print(f"version {version}: {pairs[version]} pairs of nodes on surfaces")
assert pairs[2.2] == 0
assert pairs[4.1] > 0
PYTHON
tools/bin/python check.py
