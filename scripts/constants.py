#!/usr/bin/env python3
"""Checks two pages of notes against the sources: scripts/constants.py (Python's standard library only).

docs/notes/constants.md: each constant must be in its file, with the value of the table.
docs/notes/mistakes.md: each test must be in its file.
Prints a line for each difference and exits with 1 if there is one.
"""
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CONSTANTS = ROOT / "docs" / "notes" / "constants.md"
MISTAKES = ROOT / "docs" / "notes" / "mistakes.md"
FOLDER = re.compile(r"^Paths are below `([^`]+)`\.$")
CONSTANT = re.compile(r"^\| `(\w+)` in `([^`]+)` \| `([^`]+)` \|")
TEST = re.compile(r"\| `([^`]+)`: `(\w+)` \|$")


def is_row(line):
    """Returns true for the rows of a table, without its head."""
    return line.startswith("| ") and not line.startswith(("| constant |", "| what "))


def constant_errors():
    """Yields the differences between the table of constants and the sources."""
    folder = ROOT
    for number, line in enumerate(CONSTANTS.read_text(encoding="utf-8").splitlines(), 1):
        place = f"{CONSTANTS.relative_to(ROOT)}:{number}"
        if match := FOLDER.match(line):
            folder = ROOT / match[1]
        if not is_row(line):
            continue
        row = CONSTANT.match(line)
        if not row:
            yield f"{place}: is no row of a constant; write | `NAME` in `file` | `value` | meaning | source |"
            continue
        name, file, value = row.groups()
        path = folder / file
        if not path.exists():
            yield f"{place}: {name}: {path.relative_to(ROOT)} does not exist"
            continue
        definition = re.search(rf"\bconst {name}: [^=]+ = ([^;]+);", path.read_text(encoding="utf-8"))
        if not definition:
            yield f"{place}: {name}: is not in {path.relative_to(ROOT)}"
        elif (actual := " ".join(definition[1].split())) != value:
            yield f"{place}: {name}: is {value} here and {actual} in {path.relative_to(ROOT)}"


def test_errors():
    """Yields the tests of the page of mistakes that do not exist."""
    for number, line in enumerate(MISTAKES.read_text(encoding="utf-8").splitlines(), 1):
        place = f"{MISTAKES.relative_to(ROOT)}:{number}"
        if not is_row(line):
            continue
        row = TEST.search(line)
        if not row:
            yield f"{place}: names no test; end the row with | `file`: `test` |"
            continue
        file, test = row.groups()
        path = ROOT / file
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        if not re.search(rf"#\[test\]\s*(?:#\[[^\]]*\]\s*)*fn {test}\(", text):
            yield f"{place}: {file} has no test {test}"


def main():
    errors = [*constant_errors(), *test_errors()]
    for error in errors:
        print(error)
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
