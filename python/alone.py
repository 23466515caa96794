"""Checks that meshes, pictures and exports need no package but NumPy."""

import tempfile
from pathlib import Path

import atomesh

image = atomesh.synth("faults", dims=(40, 36, 32))
mesh = atomesh.mesh(image, distance=6)
assert mesh.validate()["valid"], "the checkers agree"
cells = atomesh.voronoi(image, distance=9)
with tempfile.TemporaryDirectory() as folder:
    mesh.save(Path(folder) / "mesh.vtu")
    mesh.export("msh", Path(folder) / "mesh.msh")
    assert len(mesh.slice().png) > 1000
print(f"{mesh.n_cells} tetrahedra, {cells.n_cells} Voronoi cells")
