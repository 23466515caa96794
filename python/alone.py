"""Checks that meshes, the worker process, pictures and exports need no package but NumPy.

With the argument `hidden`, it also checks that the system's TetGen, GMP and MPFR cannot be loaded.
"""

import ctypes
import subprocess
import sys
import tempfile
from pathlib import Path

import atomesh

if "hidden" in sys.argv:
    for library in ("libtet.so.1.5", "libgmp.so.10", "libmpfr.so.6"):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        sys.exit(f"{library} is not hidden")

package = Path(atomesh.__file__).parent
for binary in [*package.glob("_native*.so"), package / "atomesh-tetgen"]:
    print(f"{binary.name} needs")
    for line in subprocess.run(["ldd", binary], capture_output=True, text=True).stdout.splitlines():
        print("   ", line.strip().split(" (0x")[0])

image = atomesh.synth("faults", dims=(40, 36, 32))
mesh = atomesh.mesh(image, distance=6)
assert mesh.validate()["valid"], "TetGen and CGAL agree"
cells = atomesh.voronoi(image, distance=9)
with tempfile.TemporaryDirectory() as folder:
    mesh.save(Path(folder) / "mesh.vtu")
    mesh.export("msh", Path(folder) / "mesh.msh")
    assert len(mesh.slice().png) > 1000
print(f"{mesh.n_cells} tetrahedra, {cells.n_cells} Voronoi cells, by TetGen of the wheel")
