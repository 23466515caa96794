#!/usr/bin/env python3
"""Ends jobs of every verb at random moments, by signals, full disks and little memory, and looks at what
is left: exit codes, one line of reason, whole files or none, nothing under a temporary name.

    scripts/soak.py BINARY [--kills N] [--interrupts N] [--disks N] [--memory N] [--seed S]

Full disks need the right to mount a small tmpfs (or a folder on one, by --disk FOLDER); without it they
are left out, and the last line says so.
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

# Seconds within which an interrupted process has ended, on a machine that has other work too.
PROMPT = 4.0


def words(line):
    return line.split()


class Bench:
    """A folder of inputs, and jobs that read them."""

    def __init__(self, binary, folder):
        self.binary, self.inputs = binary, os.path.join(folder, "inputs")
        os.mkdir(self.inputs)
        here = self.inputs
        self.must(words("synth faults -o faults.npy --dims 72,66,60"), here)
        self.must(words("synth amplitude -o layers.npy --dims 64,64,64"), here)
        self.must(words("synth planes -o plane.npy --dims 300,280"), here)
        self.must(words("mesh faults.npy -o tets.vtu --distance 5"), here)
        self.must(words("mesh faults.npy -o cells.vtu --distance 6 --cells voronoi"), here)
        self.must(words("mesh plane.npy -o flat.vtu --distance 6 --cells voronoi"), here)
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
        # What each makes, and how long it takes.
        self.jobs = [self.measured(line, folder) for line in jobs]

    def must(self, line, folder):
        done = subprocess.run([self.binary, *line, "--quiet"], cwd=folder, capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{' '.join(line)}: {done.stderr}")

    def measured(self, line, folder):
        line = [word.replace("IN/", self.inputs + "/") for word in words(line)]
        place = tempfile.mkdtemp(dir=folder)
        start = time.time()
        self.must(line, place)
        took = time.time() - start
        made = {name: os.path.getsize(os.path.join(place, name)) for name in tree(place)}
        shutil.rmtree(place)
        return line, made, took

    def start(self, line, folder, **more):
        return subprocess.Popen(
            [self.binary, *line, "--quiet"], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, **more
        )


def tree(folder):
    return sorted(
        os.path.relpath(os.path.join(place, name), folder)
        for place, _, names in os.walk(folder)
        for name in names
    )


def folders(folder):
    return [place for place, _, _ in os.walk(folder) if place != folder]


class Faults(list):
    def say(self, *what):
        print("FAULT", *what, flush=True)
        self.append(what)


def all_or_none(kind, line, made, place, faults, code, hidden_allowed=False):
    """Whether a job left all its files, or none. Gives whether it left any."""
    left = tree(place)
    hidden = [name for name in left if os.path.basename(name).startswith(".")]
    seen = [name for name in left if name not in hidden]
    # An interrupted job has fewer frames of its trace.
    frames = lambda name: name.startswith("t_")
    wanted = sorted(name for name in made if not frames(name))
    got = sorted(name for name in seen if not frames(name))
    if hidden and not hidden_allowed:
        faults.say(kind, code, "left", hidden, ":", *line)
    if got and got != wanted:
        faults.say(kind, code, "left", got, "of", wanted, ":", *line)
    if not got and code == 0:
        faults.say(kind, "made nothing and said 0:", *line)
    if not left and folders(place) and not hidden_allowed:
        faults.say(kind, "left empty folders:", *line)
    return bool(got)


def whole(bench, place, faults, kind, line):
    """Every mesh that is there can be read."""
    for name in tree(place):
        if name.endswith(".vtu") and not name.startswith("."):
            done = subprocess.run([bench.binary, "quality", name, "--quiet"], cwd=place, capture_output=True)
            if done.returncode:
                faults.say(kind, "left a damaged", name, done.stderr.decode(), ":", *line)


def ended(child, seconds):
    try:
        _, said = child.communicate(timeout=seconds)
        return child.returncode, said.decode(errors="replace")
    except subprocess.TimeoutExpired:
        where = whereabouts(child.pid)
        child.kill()
        _, said = child.communicate()
        return None, said.decode(errors="replace") + where


def patience(took):
    """Seconds after which a job that took so long undisturbed hangs, on a machine that has other work too."""
    return 120 + 60 * took


def whereabouts(pid):
    """What the threads of a process that hangs are doing, where a debugger tells."""
    if not shutil.which("gdb"):
        return ""
    asked = ["gdb", "-p", str(pid), "-batch", "-ex", "thread apply all backtrace 25"]
    told = subprocess.run(asked, capture_output=True, text=True).stdout
    return "\n" + "\n".join(row for row in told.splitlines() if row.startswith(("Thread", "#")))


def kills(bench, folder, count, rng, faults):
    """SIGKILL at any moment; what is left under temporary names is removed by the next job."""
    hit = swept = 0
    for _ in range(count):
        line, made, took = rng.choice(bench.jobs)
        place = tempfile.mkdtemp(dir=folder)
        child = bench.start(line, place)
        time.sleep(rng.uniform(0, 1.1 * took))
        child.kill()
        code, _ = ended(child, 10)
        hit += code == -signal.SIGKILL
        any_file = all_or_none("kill", line, made, place, faults, code, hidden_allowed=True)
        if any_file:
            whole(bench, place, faults, "kill", line)
        left = [name for name in tree(place) if os.path.basename(name).startswith(".")]
        if left:
            swept += 1
            again = bench.start(line, place)
            code, said = ended(again, 120)
            if code:
                faults.say("after a kill", code, said, ":", *line)
            all_or_none("after a kill", line, made, place, faults, code)
        shutil.rmtree(place)
    return f"{hit} of {count} killed while running, {swept} had left temporary files"


def interrupts(bench, folder, count, rng, faults):
    """SIGINT and SIGTERM at any moment."""
    hit, slowest = 0, 0.0
    for _ in range(count):
        line, made, took = rng.choice(bench.jobs)
        place = tempfile.mkdtemp(dir=folder)
        child = bench.start(line, place)
        # Before it runs nobody handles signals.
        time.sleep(0.03 + rng.uniform(0, took))
        which = rng.choice([signal.SIGINT, signal.SIGTERM])
        start = time.time()
        child.send_signal(which)
        code, said = ended(child, 20)
        slowest = max(slowest, time.time() - start)
        if time.time() - start > PROMPT:
            faults.say("interrupt", which, "took", time.time() - start, ":", *line)
        hit += code == 130
        if code not in (0, 130):
            faults.say("interrupt", which, "ended with", code, said, ":", *line)
        if all_or_none("interrupt", line, made, place, faults, code):
            whole(bench, place, faults, "interrupt", line)
        shutil.rmtree(place)
    return f"{hit} of {count} ended with 130, the slowest after {slowest:.1f} s"


def one_line(kind, code, said, line, faults):
    lines = [text for text in said.splitlines() if text.strip()]
    if code != 1 or len(lines) != 1 or not lines[0].startswith("error: "):
        faults.say(kind, "ended with", code, said[-600:], ":", *line)


def memory(bench, folder, count, rng, faults):
    """An address space that is too small, by any amount."""
    failed = 0
    for _ in range(count):
        line, made, took = rng.choice(bench.jobs)
        place = tempfile.mkdtemp(dir=folder)
        # From what hardly loads the program to what suffices.
        limit = int(30e6 * 7 ** rng.random())
        child = bench.start(
            line, place, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        )
        code, said = ended(child, patience(took))
        # 127: the loader itself found no room.
        if code == 127 and ("error while loading shared libraries" in said or "for initial thread" in said):
            shutil.rmtree(place)
            continue
        if code is None:
            faults.say("memory", limit, "hangs:", *line, said[-9000:])
        else:
            if code:
                failed += 1
                one_line(f"memory {limit}", code, said, line, faults)
            all_or_none("memory", line, made, place, faults, code)
        shutil.rmtree(place)
    return f"{failed} of {count} had too little"


def disks(bench, disk, count, rng, faults):
    """A disk that is full after any number of bytes."""
    failed = 0
    for _ in range(count):
        line, made, took = rng.choice(bench.jobs)
        size = max(int(sum(made.values()) * rng.uniform(0, 1.2)) >> 12, 1) << 12
        subprocess.run(["mount", "-o", f"remount,size={size}", disk], check=True)
        place = tempfile.mkdtemp(dir=disk)
        code, said = ended(bench.start(line, place), patience(took))
        if code is None:
            faults.say("full disk hangs:", *line)
        elif code:
            failed += 1
            one_line("full disk", code, said, line, faults)
        if code is not None:
            all_or_none("full disk", line, made, place, faults, code)
        shutil.rmtree(place)
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
