"""Tests of threads, interruption and memory, and of bytes that equal those of the command line."""

import hashlib
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import atomesh
from conftest import ball


def hash_of(mesh):
    digest = hashlib.sha256()
    for array in (mesh.points, mesh.cells, *mesh.point_data.values(), *mesh.cell_data.values()):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def test_ten_threads_make_the_mesh_of_one():
    expected = hash_of(atomesh.mesh(ball(), distance=5, feature="edges"))
    with ThreadPoolExecutor(10) as pool:
        hashes = list(pool.map(lambda _: hash_of(atomesh.mesh(ball(), distance=5, feature="edges")), range(10)))
    assert set(hashes) == {expected}
    assert hash_of(atomesh.mesh(ball(), distance=5, feature="edges", threads=1)) == expected


def assert_the_command_line_writes_the_same_bytes(folder, image, **options):
    """Makes a mesh with the package and with the program, and returns that of the package."""
    words = ["mesh", image, "-o", folder / "a.vtu", "--quiet"]
    words += [word for name, value in options.items() for word in (f"--{name}", str(value))]
    subprocess.run([os.environ["ATOMESH_BINARY"], *words], check=True)
    mesh = atomesh.mesh(image, **options)
    mesh.save(folder / "b.vtu")
    assert (folder / "a.vtu").read_bytes() == (folder / "b.vtu").read_bytes()
    return mesh


with_program = pytest.mark.skipif(
    "ATOMESH_BINARY" not in os.environ, reason="ATOMESH_BINARY does not name the program"
)


@with_program
@pytest.mark.parametrize("cells", ["tets", "voronoi"])
def test_the_command_line_writes_the_same_bytes(tmp_path, cells):
    image = tmp_path / "ball.vti"
    atomesh.Image.of(ball(), (2, 3, 4)).save(image)
    assert_the_command_line_writes_the_same_bytes(tmp_path, image, distance=6, cells=cells)


@with_program
@pytest.mark.parametrize("distance, is_large", [(6, False), (3.5, True)])
def test_the_command_line_writes_the_same_bytes_for_any_kernel(tmp_path, distance, is_large):
    # By default, the program joins fewer than 40,000 atoms by TetGen, and the package by atomesh's kernel.
    image = tmp_path / "faults.npy"
    atomesh.synth("faults", dims=(112, 104, 104)).save(image)
    options = {"feature": "edges", "slivers": "none"}
    mesh = assert_the_command_line_writes_the_same_bytes(tmp_path, image, distance=distance, **options)
    assert (mesh.n_points > 40_000) == is_large


def test_other_threads_run_meanwhile():
    counted = 0
    stop = threading.Event()

    def count():
        nonlocal counted
        while not stop.is_set():
            counted += 1
            time.sleep(0.001)

    counter = threading.Thread(target=count)
    counter.start()
    start = time.monotonic()
    atomesh.mesh(ball((50, 52, 54)), distance=4, feature="edges")
    seconds = time.monotonic() - start
    stop.set()
    counter.join()
    assert counted > 100 * seconds


INTERRUPTED = """
    import os, signal, sys, threading, time
    import atomesh
    # Background jobs ignore Ctrl-C by default.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    image = atomesh.synth("faults", dims=(90, 90, 90))
    stopped = []
    def watch(stage, fraction):
        if stage.startswith(sys.argv[1]) and not stopped:
            stopped.append(stage)
            os.kill(os.getpid(), signal.SIGINT)
    try:
        mesh = atomesh.mesh(image, distance=4, progress=watch)
    except KeyboardInterrupt:
        print("KeyboardInterrupt")
    else:
        mesh.validate()
        print(mesh.interrupted, mesh.n_cells > 1000)
"""


@pytest.mark.parametrize(
    "stage, expected", [("finding features", "KeyboardInterrupt"), ("moving atoms", "True True")]
)
def test_ctrl_c_stops_as_on_the_command_line(stage, expected):
    process = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(INTERRUPTED), stage], capture_output=True, text=True, timeout=120
    )
    assert process.stdout.strip() == expected, process.stderr


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_200_meshes_leave_no_memory_behind():
    image = atomesh.Image.of(ball((22, 24, 26)))

    def make(count):
        for _ in range(count):
            mesh = atomesh.mesh(image, distance=5, feature="edges")
            assert len(mesh.points) and len(mesh.cells) and len(mesh.feature_faces) and mesh.cell_data
        return resident_bytes()

    before = make(60)
    after = make(200)
    # Each of these meshes takes about 100 kB, and its features more.
    assert after - before < 8e6, f"{(after - before) / 1e6:.1f} MB"
