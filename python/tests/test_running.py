"""Tests of threads, interruption, memory, and TetGen's own process."""

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


@pytest.mark.skipif("ATOMESH_BINARY" not in os.environ, reason="ATOMESH_BINARY does not name the program")
@pytest.mark.parametrize("cells", ["tets", "voronoi"])
def test_the_command_line_writes_the_same_bytes(tmp_path, cells):
    image = tmp_path / "ball.vti"
    atomesh.Image.of(ball(), (2, 3, 4)).save(image)
    words = ["mesh", image, "-o", tmp_path / "a.vtu", "--distance", "6", "--cells", cells, "--quiet"]
    subprocess.run([os.environ["ATOMESH_BINARY"], *words], check=True)
    atomesh.mesh(image, distance=6, cells=cells).save(tmp_path / "b.vtu")
    assert (tmp_path / "a.vtu").read_bytes() == (tmp_path / "b.vtu").read_bytes()


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


def workers():
    tasks = Path("/proc/self/task")
    children = [(task / "children").read_text().split() for task in tasks.iterdir()]
    return [pid for pids in children for pid in pids if _is_worker(pid)]


def _is_worker(pid):
    try:
        return "atomesh-tetgen" in Path(f"/proc/{pid}/comm").read_text()
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="processes are read from /proc")
def test_a_killed_worker_causes_one_error_and_leaves_no_process():
    killed = []
    done = threading.Event()

    def kill():
        while not done.is_set() and not killed:
            for pid in workers():
                os.kill(int(pid), signal.SIGKILL)
                killed.append(pid)
            time.sleep(0.0005)

    image = atomesh.synth("faults", dims=(100, 96, 90))
    killer = threading.Thread(target=kill)
    killer.start()
    try:
        with pytest.raises(atomesh.Error, match="ended without an answer") as caught:
            atomesh.mesh(image, distance=3)
    finally:
        done.set()
        killer.join()
    assert caught.value.kind == "Delaunay" and "signal: 9" in str(caught.value)
    assert killed and not workers()
    # The next job succeeds.
    assert atomesh.mesh(ball(), distance=6).n_cells > 50
