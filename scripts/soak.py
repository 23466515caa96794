#!/usr/bin/env python3
"""Stops jobs of every verb at random moments by signals, full disks and memory limits, and checks the exit codes, the
one line of error, and that files are complete or absent, without temporary files.

    scripts/soak.py BINARY [--kills N] [--interrupts N] [--disks N] [--memory N] [--seed S]

Full disks need the right to mount a small tmpfs. Without it they are skipped, and a line says so.
"""

import argparse
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time

# Longest time in seconds that an interrupted process may continue, on a machine with other load.
MAX_DELAY = 4.0


def words(line):
    return line.split()


class Bench:
    """A folder of inputs, and jobs that read them."""

    def __init__(self, binary, folder):
        self.binary, self.inputs = binary, os.path.join(folder, "inputs")
        os.mkdir(self.inputs)
        self.run(words("synth faults -o faults.npy --dims 72,66,60"), self.inputs)
        self.run(words("synth amplitude -o layers.npy --dims 64,64,64"), self.inputs)
        self.run(words("synth planes -o plane.npy --dims 300,280"), self.inputs)
        self.run(words("mesh faults.npy -o tets.vtu --distance 5"), self.inputs)
        self.run(words("mesh faults.npy -o cells.vtu --distance 6 --cells voronoi"), self.inputs)
        self.run(words("mesh plane.npy -o flat.vtu --distance 6 --cells voronoi"), self.inputs)
        rock = "--porosity .2 --permeability 100 --permeability-unit mD --depth-at-top 1000"
        jobs = [
            "mesh IN/faults.npy -o m.vtu --distance 4 --trace t.pvd --lines l.vtp --report r.json",
            "mesh IN/faults.npy -o m.vtu --distance 6 --cells voronoi --potential-out p.vti",
            "mesh IN/layers.npy -o m.vtu --feature faults+horizons",
            "mesh IN/plane.npy -o m.vtu --distance 3",
            "mesh IN/plane.npy -o m.vtu --seeding canny",
            "feature IN/faults.npy -o f.vti --lines l.vtp",
            "synth network -o n.npy --truth t.npy --dims 96,96,96",
            "convert IN/layers.npy c.nrrd",
            "flow IN/tets.vtu -o f.vtu --source 10,10,10 --sink 60,55,50 --faults 0.1 --streamlines s.vtp",
            "flow IN/cells.vtu -o f.vtu --pressure xmin=1e6 --pressure xmax=0 --faults open",
            "surface IN/tets.vtu -o s.vtp",
            "paint IN/tets.vtu --seed auto -o p.vtu --surface-out s.vtp",
            "segment IN/faults.npy IN/tets.vtu --object 30,30,30 --background 5,5,5 -o s.vtu --labels-out l.npy",
            "slice IN/faults.npy IN/tets.vtu -o s.png",
            "edit IN/tets.vtu IN/faults.npy -o e.vtu --add 30,30,30",
            "columns IN/flat.vtu --horizon 10 --horizon 40 --layers 9 -o c.vtu",
            f"export IN/cells.vtu --to opm -o CASE.DATA {rock}",
            f"export IN/cells.vtu --to openfoam -o foam {rock}",
            f"export IN/cells.vtu --to grdecl -o g.GRDECL {rock}",
            f"export IN/cells.vtu --to resqml -o r.epc {rock}",
            "export IN/tets.vtu --to msh -o m.msh",
        ]
        # Each job has its arguments, the sizes of its files and its duration in seconds.
        self.jobs = [self.measure(line, folder) for line in jobs]

    def run(self, line, folder):
        result = subprocess.run([self.binary, *line, "--quiet"], cwd=folder, capture_output=True, text=True)
        if result.returncode:
            sys.exit(f"{' '.join(line)}: {result.stderr}")

    def measure(self, line, folder):
        line = [word.replace("IN/", self.inputs + "/") for word in words(line)]
        job_folder = tempfile.mkdtemp(dir=folder)
        start = time.time()
        self.run(line, job_folder)
        duration = time.time() - start
        outputs = {name: os.path.getsize(os.path.join(job_folder, name)) for name in tree(job_folder)}
        shutil.rmtree(job_folder)
        return line, outputs, duration

    def start(self, line, folder, **options):
        return subprocess.Popen(
            [self.binary, *line, "--quiet"], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, **options
        )


def tree(folder):
    return sorted(
        os.path.relpath(os.path.join(job_folder, name), folder)
        for job_folder, _, names in os.walk(folder)
        for name in names
    )


def folders(folder):
    return [job_folder for job_folder, _, _ in os.walk(folder) if job_folder != folder]


class Faults(list):
    """Failed checks, which are printed as they occur."""

    def report(self, *parts):
        print("FAULT", *parts, flush=True)
        self.append(parts)


def check_all_or_none(kind, line, outputs, job_folder, faults, code, hidden_allowed=False):
    """Checks that a job left all its files or none, and returns True if it left any."""
    files = tree(job_folder)
    hidden = [name for name in files if os.path.basename(name).startswith(".")]
    visible = [name for name in files if name not in hidden]
    # An interrupted job has fewer frames of its trace.
    is_frame = lambda name: name.startswith("t_")
    expected = sorted(name for name in outputs if not is_frame(name))
    actual = sorted(name for name in visible if not is_frame(name))
    if hidden and not hidden_allowed:
        faults.report(kind, code, "left", hidden, ":", *line)
    if actual and actual != expected:
        faults.report(kind, code, "left", actual, "of", expected, ":", *line)
    if not actual and code == 0:
        faults.report(kind, "wrote nothing and ended with 0:", *line)
    if not files and folders(job_folder) and not hidden_allowed:
        faults.report(kind, "left empty folders:", *line)
    return bool(actual)


def check_meshes(bench, job_folder, faults, kind, line):
    """Checks that every mesh in a folder can be read."""
    for name in tree(job_folder):
        if name.endswith(".vtu") and not name.startswith("."):
            result = subprocess.run([bench.binary, "quality", name, "--quiet"], cwd=job_folder, capture_output=True)
            if result.returncode:
                faults.report(kind, "left a damaged", name, result.stderr.decode(), ":", *line)


def wait_for_end(child, seconds):
    """Returns the exit code of a process, None if it hangs, and its standard error."""
    try:
        _, stderr = child.communicate(timeout=seconds)
        return child.returncode, stderr.decode(errors="replace")
    except subprocess.TimeoutExpired:
        stacks = backtraces(child.pid)
        child.kill()
        _, stderr = child.communicate()
        return None, stderr.decode(errors="replace") + stacks


def time_limit(duration):
    """Returns the seconds after which a job with a known duration counts as hanging, on a machine with other load."""
    return 120 + 60 * duration


def backtraces(pid):
    """Returns the backtraces of the threads of a process, if there is a debugger."""
    if not shutil.which("gdb"):
        return ""
    command = ["gdb", "-p", str(pid), "-batch", "-ex", "thread apply all backtrace 25"]
    text = subprocess.run(command, capture_output=True, text=True).stdout
    return "\n" + "\n".join(row for row in text.splitlines() if row.startswith(("Thread", "#")))


def kills(bench, folder, count, rng, faults):
    """Kills jobs by SIGKILL at any moment, and checks that the next job removes temporary files."""
    killed = removed = 0
    for _ in range(count):
        line, outputs, duration = rng.choice(bench.jobs)
        job_folder = tempfile.mkdtemp(dir=folder)
        child = bench.start(line, job_folder)
        time.sleep(rng.uniform(0, 1.1 * duration))
        child.kill()
        code, _ = wait_for_end(child, 10)
        killed += code == -signal.SIGKILL
        any_file = check_all_or_none("kill", line, outputs, job_folder, faults, code, hidden_allowed=True)
        if any_file:
            check_meshes(bench, job_folder, faults, "kill", line)
        temporary = [name for name in tree(job_folder) if os.path.basename(name).startswith(".")]
        if temporary:
            removed += 1
            again = bench.start(line, job_folder)
            code, stderr = wait_for_end(again, 120)
            if code:
                faults.report("after a kill", code, stderr, ":", *line)
            check_all_or_none("after a kill", line, outputs, job_folder, faults, code)
        shutil.rmtree(job_folder)
    return f"{killed} of {count} killed while running, {removed} had left temporary files"


def interrupts(bench, folder, count, rng, faults):
    """Interrupts jobs by SIGINT and SIGTERM at any moment."""
    interrupted, slowest = 0, 0.0
    for _ in range(count):
        line, outputs, duration = rng.choice(bench.jobs)
        job_folder = tempfile.mkdtemp(dir=folder)
        child = bench.start(line, job_folder)
        # The program needs some time before it handles signals.
        time.sleep(0.03 + rng.uniform(0, duration))
        number = rng.choice([signal.SIGINT, signal.SIGTERM])
        start = time.time()
        child.send_signal(number)
        code, stderr = wait_for_end(child, 20)
        slowest = max(slowest, time.time() - start)
        if time.time() - start > MAX_DELAY:
            faults.report("interrupt", number, "took", time.time() - start, ":", *line)
        interrupted += code == 130
        if code not in (0, 130):
            faults.report("interrupt", number, "ended with", code, stderr, ":", *line)
        if check_all_or_none("interrupt", line, outputs, job_folder, faults, code):
            check_meshes(bench, job_folder, faults, "interrupt", line)
        shutil.rmtree(job_folder)
    return f"{interrupted} of {count} ended with 130, the slowest after {slowest:.1f} s"


def check_error_line(kind, code, stderr, line, faults):
    """Checks that a job failed with exit code 1 and one line of error."""
    lines = [text for text in stderr.splitlines() if text.strip()]
    if code != 1 or len(lines) != 1 or not lines[0].startswith("error: "):
        faults.report(kind, "ended with", code, stderr[-600:], ":", *line)


def memory(bench, folder, count, rng, faults):
    """Runs jobs in an address space that is too small by any amount."""
    failed = 0
    for _ in range(count):
        line, outputs, duration = rng.choice(bench.jobs)
        job_folder = tempfile.mkdtemp(dir=folder)
        # Limits range from one that hardly suffices to load the program to one that suffices for the job.
        limit = int(30e6 * 7 ** rng.random())
        child = bench.start(
            line, job_folder, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        )
        code, stderr = wait_for_end(child, time_limit(duration))
        # The exit code is 127 if the loader has no memory.
        if code == 127 and ("error while loading shared libraries" in stderr or "for initial thread" in stderr):
            shutil.rmtree(job_folder)
            continue
        if code is None:
            faults.report("memory", limit, "hangs:", *line, stderr[-9000:])
        else:
            if code:
                failed += 1
                check_error_line(f"memory {limit}", code, stderr, line, faults)
            check_all_or_none("memory", line, outputs, job_folder, faults, code)
        shutil.rmtree(job_folder)
    return f"{failed} of {count} had too little memory"


def disks(bench, disk, count, rng, faults):
    """Runs jobs on a disk that is full after any number of bytes."""
    failed = 0
    for _ in range(count):
        line, outputs, duration = rng.choice(bench.jobs)
        size = max(int(sum(outputs.values()) * rng.uniform(0, 1.2)) >> 12, 1) << 12
        subprocess.run(["mount", "-o", f"remount,size={size}", disk], check=True)
        job_folder = tempfile.mkdtemp(dir=disk)
        code, stderr = wait_for_end(bench.start(line, job_folder), time_limit(duration))
        if code is None:
            faults.report("full disk hangs:", *line)
        elif code:
            failed += 1
            check_error_line("full disk", code, stderr, line, faults)
        if code is not None:
            check_all_or_none("full disk", line, outputs, job_folder, faults, code)
        shutil.rmtree(job_folder)
    return f"{failed} of {count} disks were full"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    for name in ("kills", "interrupts", "disks", "memory"):
        parser.add_argument(f"--{name}", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    faults, rng = Faults(), random.Random(args.seed)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(os.path.abspath(args.binary), folder)
        for name, run in (("kills", kills), ("interrupts", interrupts), ("memory", memory)):
            if count := getattr(args, name):
                print(f"{name}: {run(bench, folder, count, rng, faults)}", flush=True)
        if args.disks:
            disk = os.path.join(folder, "disk")
            os.mkdir(disk)
            mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk], capture_output=True)
            if mounted.returncode:
                print("disks: skipped, a small tmpfs cannot be mounted here")
            else:
                try:
                    print(f"disks: {disks(bench, disk, args.disks, rng, faults)}", flush=True)
                finally:
                    subprocess.run(["umount", disk], check=True)
    print(f"faults: {len(faults)}")
    sys.exit(bool(faults))


main()
