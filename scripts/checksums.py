#!/usr/bin/env python3
"""Prints checksums of the outputs of an atomesh binary, to check that a change alters no result.

    scripts/checksums.py OLD-BINARY > before.txt
    scripts/checksums.py NEW-BINARY --compare before.txt

Runs the binary on small images and prints a line for each output: name, tab, SHA-256 (or the code, for the exit code
of a run). VTK files have a line for each array, JSON reports a line for each member, folders a line for each file.
Provenance, paths and costs are omitted: see `PROVENANCE`, `UNHASHED` and `VERSION`.

Each run has a folder of its name in a temporary folder or in OUTDIR (which is kept). `--only 'mesh2|export'` selects
runs by a regular expression, and adds the runs that they need. `--data DIR` adds runs on real images, and `--list`
shows the runs. A refused run has a line with its exit code; `--verbose` prints the reason. Messages are not compared,
except the notes in reports (`--ignore ':notes$'` leaves them out, `--ignore 'FieldData/features'` the record of feature
detection in files).
"""

import argparse
import concurrent.futures
import gzip
import hashlib
import json
import os
import re
import resource
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
import zipfile
import zlib
from pathlib import Path

sys.dont_write_bytecode = True  # leaves no folder among the scripts

from checksums_runs import RUNS, add_all, needs_of, selected, write_inputs  # noqa: E402

# Field data of VTK files with the provenance. `features` (the scales and thresholds that feature detection
# selected) and `flow` (a report) are results, and are not among them.
PROVENANCE = {"atomesh_version", "version", "parameters", "input_sha256", "edits", "record", "job"}
# Members of JSON reports that are not hashed at any depth: provenance and costs.
UNHASHED = PROVENANCE | {"schema", "hash", "stages", "seconds", "cpu_seconds", "means_seconds", "cut_seconds",
                         "peak_mb"}
# Members of JSON reports that are not hashed if they are names of files.
FILES = {"file", "files", "twin", "labels", "surface", "lines", "streamlines", "potential", "output",
         "confidence", "picture", "truth"}
# The version in the comments of text formats, in EPC's citations and in the head of a MAT-file.
VERSION = re.compile(rb"atomesh[ :]\d+\.\d+\.\d+[-+.\w]*")
UUID = re.compile(rb"[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}")

# Present and former names of options.
FORMER_NAMES = {"--evaluator": "--potential"}

MAX_SECONDS = 300
MAX_MEMORY = 8 << 30


# --- what is hashed ---


def sha(data):
    return hashlib.sha256(data).hexdigest()


def hashes_of_file(path, name):
    """Returns the lines (name, hash) of a file."""
    data = path.read_bytes()
    if path.suffix in (".vtu", ".vtp", ".vti"):
        return hashes_of_vtk(data, name)
    if path.suffix == ".json":
        return hashes_of_json(data, name)
    if path.suffix == ".png":
        return hashes_of_png(data, name)
    if path.suffix in (".mha", ".nrrd"):
        return hashes_of_headed(data, name)
    if path.suffix == ".gz":
        return [(name, sha(gzip.decompress(data)))]
    if path.suffix == ".epc" or path.suffix == ".h5" and path.with_suffix(".epc").exists():
        return hashes_of_resqml(path, name)
    if path.suffix == ".mat":
        # The first 116 bytes are a text with the program that wrote the file.
        return [(name, sha(data[116:]))]
    return [(name, sha(VERSION.sub(b"atomesh VERSION", data)))]


def hashes_of_vtk(data, name):
    """Returns a line for each array with its type, shape and uncompressed bytes, and one for the attributes of the
    elements, which hold the geometry of an image."""
    mark = b'<AppendedData encoding="raw">'
    end = data.find(mark)
    appended = data.find(b"_", end) + 1 if end >= 0 else len(data)
    root = ElementTree.fromstring(data[:end] + b"</VTKFile>" if end >= 0 else data)
    structure, lines = [], []

    def visit(element, section):
        if element.tag not in ("DataArray", "Array"):
            structure.append((element.tag, sorted(element.attrib.items())))
            for child in element:
                visit(child, element.tag)
            return
        array_name = element.get("Name")
        if section == "FieldData" and array_name in PROVENANCE:
            return
        if element.get("format") == "appended":
            at = appended + int(element.get("offset"))
            values = unpack(data, at, root.get("compressor") is not None)
        else:
            values = (element.text or "").encode()
        line = f"{name}:{section}/{array_name}"
        # Text stored as VTK strings or as bytes has the same hash.
        if section == "FieldData" and element.get("type") in ("String", "UInt8"):
            values = values.rstrip(b"\0")
            if values[:1] in (b"{", b"["):
                lines.extend(hashes_of_json(values, line))
            else:
                lines.append((line, sha(repr(["String", "1", "1"]).encode() + values + b"\0")))
            return
        shape = [element.get("type"), element.get("NumberOfComponents", "1"), element.get("NumberOfTuples")]
        lines.append((line, sha(repr(shape).encode() + values)))

    visit(root, None)
    return [(f"{name}:structure", sha(repr(structure).encode())), *lines]


def unpack(data, at, compressed):
    if not compressed:
        (length,) = struct.unpack_from("<Q", data, at)
        return data[at + 8 : at + 8 + length]
    count, _, _ = struct.unpack_from("<3Q", data, at)
    sizes = struct.unpack_from(f"<{count}Q", data, at + 24)
    at += 24 + 8 * count
    blocks = []
    for size in sizes:
        blocks.append(zlib.decompress(data[at : at + size]))
        at += size
    return b"".join(blocks)


def hashes_of_json(data, name):
    """Returns a line for each member of the outermost object, without provenance and costs."""
    value = without_provenance(json.loads(data))
    parts = value.items() if isinstance(value, dict) else [("", value)]
    return [(f"{name}:{key}".rstrip(":"), sha(json.dumps(part, sort_keys=True).encode())) for key, part in parts]


def without_provenance(value):
    if isinstance(value, list):
        return [without_provenance(item) for item in value]
    if not isinstance(value, dict):
        return value

    def names_files(key, item):
        texts = item if isinstance(item, list) else [item]
        return key in FILES and all(text is None or isinstance(text, str) for text in texts)

    return {key: without_provenance(item) for key, item in value.items()
            if key not in UNHASHED and not names_files(key, item)}


def hashes_of_png(data, name):
    """Returns lines for the uncompressed pixels and for the other chunks."""
    at, pixels, rest = 8, b"", []
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind, chunk = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if kind == b"IDAT":
            pixels += chunk
        else:
            rest.append((kind, chunk))
        at += 12 + length
    return [(f"{name}:head", sha(repr(rest).encode())), (f"{name}:pixels", sha(zlib.decompress(pixels)))]


def hashes_of_headed(data, name):
    """Returns lines for the header of a MetaImage or NRRD file, without the size of the data, and for the uncompressed
    samples."""
    end = re.search(rb"ElementDataFile.*\n|\n\n", data).end()
    head, body = data[:end], data[end:]
    if head.startswith(b"NRRD"):
        body = gzip.decompress(body) if b"encoding: gz" in head else body
    elif b"CompressedData = True" in head:
        body = zlib.decompress(body)
    head = re.sub(rb"CompressedDataSize.*\n", b"", head)
    return [(f"{name}:head", sha(head)), (f"{name}:samples", sha(body))]


def hashes_of_resqml(path, name):
    """Returns lines for a RESQML package or its HDF5 file. UUIDs, which are digests of the model and of the version, are
    replaced by numbers in the order of the package, also in HDF5, where they are names of groups."""
    with zipfile.ZipFile(path.with_suffix(".epc")) as package:
        members = [(member.filename.encode(), package.read(member)) for member in package.infolist()]
    numbers = {}
    for _, text in members:
        for uuid in UUID.findall(text):
            numbers.setdefault(uuid, b"%036d" % len(numbers))

    def anonymous(text):
        return VERSION.sub(b"atomesh VERSION", UUID.sub(lambda match: numbers.get(match[0], match[0]), text))

    if path.suffix == ".h5":
        return [(name, sha(anonymous(path.read_bytes())))]
    named = ((anonymous(member).decode(), sha(anonymous(text))) for member, text in members)
    return [(f"{name}:{member}", digest) for member, digest in named]


# --- running ---


def execute(binary, folder, name, renamed, threads):
    """Executes a run in its folder and returns the lines of its outputs, and the standard error."""
    run_folder = folder / name
    run_folder.mkdir()
    command = re.sub(r"@([^/\s]+)/", r"../\1/", RUNS[name])
    words = [renamed.get(word, word) for word in shlex.split(command)]
    words += ["--json", "--quiet", *(["--threads", str(threads)] if threads else [])]

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    try:
        result = subprocess.run([binary, *words], cwd=run_folder, capture_output=True, timeout=MAX_SECONDS,
                              stdin=subprocess.DEVNULL, preexec_fn=limit, env={**os.environ, "RUST_BACKTRACE": "0"})
    except subprocess.TimeoutExpired:
        return [(f"{name}/exit", "timeout")], b""
    lines = [(f"{name}/exit", str(result.returncode))]
    output = result.stdout.strip()
    if output:
        try:
            lines += hashes_of_json(output, f"{name}/printed")
        except ValueError:
            lines.append((f"{name}/printed", sha(output)))
    for path in sorted(path for path in run_folder.rglob("*") if path.is_file()):
        file = str(path.relative_to(folder))
        try:
            lines += hashes_of_file(path, file)
        except Exception as fault:
            # The file violates its format. Its bytes are hashed, and the error is printed.
            lines.append((f"{file}:unreadable", sha(path.read_bytes())))
            print(f"{file}: {type(fault).__name__}: {fault}", file=sys.stderr)
    return lines, result.stderr


def former_names(binary):
    """Returns the options that this binary has under a former name."""
    text = subprocess.run([binary, "mesh", "--help"], capture_output=True, check=True, text=True).stdout
    return {new: old for new, old in FORMER_NAMES.items() if f"{new} " not in text}


def all_lines(binary, folder, arguments):
    """Executes the runs, several at a time, and yields the lines of those that match, always in the same order."""
    chosen, ordered = selected(re.compile(arguments.only))
    for name in ("inputs", *ordered):
        shutil.rmtree(folder / name, ignore_errors=True)
    write_inputs(folder / "inputs")
    (folder / "data").unlink(missing_ok=True)
    if arguments.data:
        (folder / "data").symlink_to(arguments.data.resolve())
    renamed = former_names(binary)
    waiting = {}

    def work(name):
        # Workers take runs in order, so that the runs that a run needs have started before it.
        for need in needs_of(RUNS[name]):
            waiting[need].result()
        return execute(binary, folder, name, renamed, arguments.threads)

    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        for name in ordered:
            waiting[name] = pool.submit(work, name)
        for name in ordered:
            lines, stderr = waiting[name].result()
            if arguments.verbose and lines[0][1] != "0":
                first = stderr.decode(errors="replace").strip().partition("\n")[0]
                print(f"{name}: {lines[0][1]}: {first}", file=sys.stderr)
            if name in chosen:
                yield from lines


def compare(lines, file, counts):
    """Prints the lines that differ from those in `file`, as far as their names count, and returns True if there are any."""
    text = file.read_text(encoding="utf-8")
    before = dict(line.split("\t") for line in text.splitlines() if counts(line.split("\t")[0]))
    same = different = 0
    for name, value in lines:
        old = before.pop(name, "nothing")
        if old == value:
            same += 1
        else:
            different += 1
            print(f"{name}\t{old}\t{value}", flush=True)
    for name, old in before.items():
        print(f"{name}\t{old}\tnothing")
    different += len(before)
    print(f"{same} lines are the same, {different} are not", file=sys.stderr)
    return different > 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", type=Path, help="the atomesh binary")
    parser.add_argument("outdir", type=Path, nargs="?", help="folder that keeps the outputs")
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of real images for additional runs")
    parser.add_argument("--only", default="", metavar="PATTERN", help="runs whose names match this regular expression")
    parser.add_argument("--ignore", metavar="PATTERN", help="leave out lines whose names match this expression")
    parser.add_argument("--compare", type=Path, metavar="FILE",
                        help="print only lines that differ from FILE (name, there, here); exit with 1 if there are any")
    parser.add_argument("-j", dest="jobs", type=int, default=1, metavar="N", help="number of runs at the same time")
    parser.add_argument("--threads", type=int, metavar="N", help="number of threads of each run")
    parser.add_argument("--list", action="store_true", help="print the runs and exit")
    parser.add_argument("--verbose", action="store_true", help="print on standard error why runs fail")
    arguments = parser.parse_args()

    add_all(arguments.data and arguments.data.resolve())
    if arguments.list:
        for name in selected(re.compile(arguments.only))[1]:
            print(f"{name}\t{RUNS[name]}")
        return 0

    only = re.compile(arguments.only)
    ignored = re.compile(arguments.ignore) if arguments.ignore else None

    def counts(name):
        return only.search(name.split("/")[0]) and not (ignored and ignored.search(name))

    binary = arguments.binary.resolve()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (arguments.outdir or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        lines = all_lines(binary, folder, arguments)
        lines = ((name, value) for name, value in lines if counts(name))
        if arguments.compare:
            return int(compare(lines, arguments.compare, counts))
        for name, value in lines:
            print(f"{name}\t{value}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
