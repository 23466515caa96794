#!/usr/bin/env python3
"""Writes docs/reference/options.md from the help of the program, and python-api.md from the docstrings of the
Python package: scripts/reference.py BINARY [--check]

With `--check` it writes nothing, and fails if one of these pages is out of date, if a public function, class, method or
parameter of the Python package has no description, or if docs/reference/report.md or docs/reference/formats.md misses an
array, a key of the report or an extension that the program writes. It needs no Python package.
"""
import argparse
import json
import pathlib
import re
import subprocess
import sys
import tempfile

import reference_python

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAGES = ROOT / "docs" / "reference"
HEAD = """# Options

<!-- Written by scripts/reference.py from the help of the program: `make figures`. -->

`atomesh VERB --help` shows the options of a verb, and `atomesh VERB -h` shows them in short. A value in capitals stands for yours.
In a [TOML file](#options-of-mesh-in-a-file) and in [Python](python.md) options have the same names.

"""
FILE = """## Options of mesh in a file

`atomesh mesh --print-config` prints all options of `mesh` as TOML, with the values that the command line gives them.
`--config FILE.toml` reads such a file. Options on the command line take precedence.
"""
# A default at the end of a text or of a sentence.
DEFAULT = r"\[default:\s+([^\]]*)\](?=\.?\s|\.?$)"
# Arrays that every file of VTK has.
VTK = {"Points", "connectivity", "offsets", "types", "faces", "faceoffsets", "face_connectivity", "face_offsets"}
COMMON = {"--json", "--max-memory", "--quiet", "--threads"}
OMITTED = {"--help", "--version"}


def one_line(text):
    return " ".join(text.split())


class Entry:
    """An option or an argument: its name with its value, and the lines of its text."""

    def __init__(self, name):
        self.name, self.lines = name, []

    def long(self):
        """Returns the long name of an option."""
        return re.sub(r" .*", "", self.name.split(", ")[-1])

    def row(self):
        """Returns a row of a table: option, default, meaning."""
        text = "\n".join(self.lines).strip()
        text, _, values = text.partition("Possible values:\n")
        default = ""
        found = re.search(DEFAULT, text + values)
        if found:
            default = one_line(found[1])
        # A default in capitals or of one word is a value; any other is a sentence.
        default = f"`{default}`" if re.fullmatch(r"[\w.:,+-]+", default) else default
        clean = lambda part: one_line(re.sub(DEFAULT, "", part))
        text = re.sub(r" \.(?=\s|$)", ".", clean(text))
        short = re.search(r"\[possible values: ([^\]]*)\]", text)
        if short:
            choices = ", ".join(f"`{value}`" for value in short[1].split(", "))
            text = text.replace(short[0], "").strip() + f": {choices}"
        for value in re.split(r"\n\s*- (?=[\w+-]+:)", "\n" + values)[1:]:
            name, _, meaning = clean(value).partition(":")
            text += f"<br>`{name}`: {meaning.strip()}"
        text = text.replace("|", r"\|")
        return f"| `{self.name}` | {default} | {text} |"


def parse_help(text):
    """Returns the usage, the groups of entries by heading, and the example in the help of a verb."""
    usage, example, groups, entries, heading = "", [], {}, None, ""
    for line in text.splitlines():
        title = re.fullmatch(r"(\w[^:]*):", line)
        entry = re.match(r" {2,6}(-\w, --[\w-]+|--[\w-]+|[\[<][\w.]+[\]>])( [\[<].*?[\]>](?:\.\.\.)?|\.\.\.)?(?: {2,}(.*))?$", line)
        if line.startswith("Usage: "):
            usage = line.removeprefix("Usage: ")
        elif title:
            heading, entries = title[1], None
        elif heading == "Example" and line.strip():
            # The program wraps long commands.
            if example and not line.strip().startswith("atomesh "):
                line = f"{example.pop()} {line.strip()}"
            example.append(line.strip())
        elif entry:
            entries = Entry(entry[1] + (entry[2] or ""))
            entries.lines.append(entry[3] or "")
            groups.setdefault(heading, []).append(entries)
        elif entries:
            entries.lines.append(line.strip())
    return usage, groups, example


def table(entries, head="option"):
    return [f"| {head} | default | meaning |", "|---|---|---|", *(entry.row() for entry in entries), ""]


def options(program):
    """Returns the page of options."""
    help_of = lambda *verb: subprocess.run([program, *verb, "--help"], check=True, capture_output=True, text=True).stdout
    listed = help_of().partition("Commands:\n")[2].partition("\n\n")[0]
    verbs = dict(re.findall(r"^  (\w+) +(.*(?:\n {4,}.*)*)", listed, re.M))
    del verbs["help"]
    lines, shared = ["| verb | what it does |", "|---|---|"], {}
    lines += [f"| [`{verb}`](#{verb}) | {one_line(text)} |" for verb, text in verbs.items()] + [""]
    common = None
    for verb in verbs:
        usage, groups, example = parse_help(help_of(verb))
        lines += [f"## {verb}", "", "```sh", *example, "```", ""]
        if "Arguments" in groups:
            lines += table(groups.pop("Arguments"), "argument")
        for heading, entries in groups.items():
            kept = [entry for entry in entries if entry.long() not in COMMON | OMITTED]
            common = common or [entry for entry in entries if entry.long() in COMMON]
            if not kept:
                continue
            rows = table(kept)
            # Groups that several verbs have are printed once.
            same = next((first for first, known in shared.items() if known == rows), None)
            if heading != "Options":
                lines += [f"### {heading} ({verb})" if not same else f"{heading}: the options [of `{same[0]}`](#{same[1]}).", ""]
            if same:
                continue
            lines += rows
            anchor = re.sub(r"[^\w-]", "", f"{heading} ({verb})".lower().replace(" ", "-"))
            shared[verb, anchor] = rows
    return HEAD + "\n".join(lines) + "\n## Options of every verb\n\n" + "\n".join(table(common)) + "\n" + FILE


class Work:
    """A folder in which the program runs."""

    def __init__(self, program, folder):
        self.program, self.folder = program, pathlib.Path(folder)

    def run(self, line):
        """Runs the program and returns its output."""
        command = [self.program, *line.split(), "--quiet"]
        return subprocess.run(command, cwd=self.folder, check=True, stdout=subprocess.PIPE, text=True).stdout

    def rows(self, line):
        """Runs the program and returns the names of the rows of its report on the screen."""
        done = subprocess.run([self.program, *line.split()], cwd=self.folder, check=True, capture_output=True, text=True)
        return set(re.findall(r"^(\w+) {2,}", done.stdout, re.M))

    def error(self, line):
        """Runs the program, which must refuse, and returns its error."""
        done = subprocess.run([self.program, *line.split()], cwd=self.folder, capture_output=True, text=True)
        assert done.returncode == 1, line
        return done.stderr

    def arrays(self, file):
        """Returns the names of the arrays in a file of VTK, without those that every file of VTK has."""
        head = (self.folder / file).read_bytes().partition(b"<AppendedData")[0].decode("latin-1")
        return set(re.findall(r'<(?:DataArray|Array)[^>]*?Name="([^"]+)"', head)) - VTK


def keys(report, depth=2):
    """Yields the names of the report's groups and of the values in them."""
    for name, value in report.items():
        yield name
        if isinstance(value, list) and value:
            value = value[0]
        if depth > 1 and isinstance(value, dict) and name not in ("parameters", "fields"):
            yield from keys(value, depth - 1)


def missing(program):
    """Yields what the program writes and the pages do not name."""
    names = lambda page: set(re.findall(r"`([^`\n]+)`", (PAGES / page).read_text(encoding="utf-8")))
    described = names("report.md")
    sample = ROOT / "data" / "faults.vti"
    with tempfile.TemporaryDirectory() as folder:
        work = Work(program, folder)
        written = {}
        report = work.run(f"mesh {sample} -o mesh.vtu --lines lines.vtp --trace trace.pvd --json")
        written["the report of mesh"] = set(keys(json.loads(report)))
        work.run("synth amplitude --dims 64,56,48 --count 1 -o amplitude.vti")
        work.run("mesh amplitude.vti -o both.vtu --feature faults+horizons --distance 6")
        work.run("synth faults --dims 96,80 -o slice.vti --truth truth.npy")
        work.run("mesh slice.vti -o plane.vtu")
        written["the report of Voronoi cells"] = set(keys(json.loads(
            work.run(f"mesh slice.vti -o cells.vtu --cells voronoi --json"))))
        work.run("mesh amplitude.vti -o polyhedra.vtu --cells voronoi")
        written["the report of quality"] = set(keys(json.loads(work.run("quality plane.vtu --truth truth.npy --json"))))
        for line in (f"info {sample}", "info mesh.vtu", f"convert {sample} sample.npy", "synth faults --dims 32,32,32 -o small.npy",
                     f"feature {sample} -o b.vti --points points.vtp --lines rims.vtp", "surface both.vtu -o surfaces.vtp",
                     "flow mesh.vtu --source 15,60,20 --sink 60,12,20 --faults 0.01 -o flow.vtu --streamlines streamlines.vtp --lines 9",
                     "paint both.vtu --seed 30,20,20 -o painted.vtu --surface-out unit.vtp",
                     f"segment {sample} mesh.vtu --object 40,36,32 --background 2,2,2 -o segmented.vtu",
                     f"edit mesh.vtu {sample} -o edited.vtu --add 20.5,20,20",
                     "columns cells.vtu --horizon 0 --horizon 10 -o columns.vtu", "export mesh.vtu --to inp -o mesh.inp",
                     f"slice {sample} mesh.vtu -o sections.png", f"report {sample} mesh.vtu -o page.html", "validate mesh.vtu"):
            written[f"{line.split()[0]} --json"] = set(keys(json.loads(work.run(f"{line} --json"))))
        for file in ("mesh.vtu", "lines.vtp", "both.vtu", "plane.vtu", "cells.vtu", "polyhedra.vtu", "surfaces.vtp", "flow.vtu",
                     "streamlines.vtp", "painted.vtu", "unit.vtp", "segmented.vtu", "points.vtp", "rims.vtp"):
            written[file] = work.arrays(file)
        screen = (PAGES / "report.md").read_text(encoding="utf-8").partition("## On the screen")[2].partition("## ")[0]
        rows = {row for cell in re.findall(r"^\| ([\w, ]+) \|", screen, re.M) for row in cell.split(", ")}
        lines = [f"mesh {sample} -o mesh.vtu", "mesh slice.vti -o cells.vtu --cells voronoi", f"mesh {sample} -o mesh.vtu --pad above=80"]
        for line in lines + [f"{line} --details" for line in lines]:
            for row in sorted(work.rows(line) - rows):
                yield f"docs/reference/report.md does not describe the row {row} of the report"
        for place, found in written.items():
            for name in sorted(found - described):
                yield f"docs/reference/report.md does not name {name} of {place}"
        described = names("formats.md")
        for line in (f"convert {sample} x.none", "surface mesh.vtu -o x.none"):
            for extension in re.findall(r"\.\w+", work.error(line).partition("does not end in")[2].partition(",")[0]):
                if extension not in described:
                    yield f"docs/reference/formats.md does not name {extension}, which `{line.split()[0]}` writes"


def main():
    parser = argparse.ArgumentParser(description=" ".join(__doc__.split(":")[0].split()))
    parser.add_argument("binary")
    parser.add_argument("--check", action="store_true", help="write nothing, and fail where a page is out of date")
    arguments = parser.parse_args()
    program = pathlib.Path(arguments.binary).resolve()
    pages = {PAGES / "options.md": options(program), PAGES / reference_python.PAGE: reference_python.page()}
    errors = []
    for page, text in pages.items():
        if not arguments.check:
            page.write_text(text, encoding="utf-8")
        elif not page.exists() or page.read_text(encoding="utf-8") != text:
            errors.append(f"{page.relative_to(ROOT)} is out of date; run scripts/reference.py BINARY")
    errors += [*reference_python.missing(), *missing(program)]
    for error in errors:
        print(f"error: {error}", file=sys.stderr)
    sys.exit(bool(errors))


if __name__ == "__main__":
    main()
