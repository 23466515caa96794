#!/usr/bin/env python3
"""Looks for words of `words.txt` in the repository, and fails where it finds one.

    scripts/words.py            # the whole repository
    scripts/words.py FILE ...   # these files

`words.txt` lists names and phrases that this project does not use, each with what to write instead:

    name WORD -> BETTER      an identifier (exactly, upper or lower case) that a Rust or Python file defines
    prose REGEX -> BETTER    text in comments, messages, help texts and documentation

A line with the comment `words: allow` may define any name.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# What introduces a name: a definition, a field, a parameter, a pattern.
DEFINED = re.compile(
    r"\b(?:fn|struct|enum|trait|type|mod|const|static|union|let|let mut|ref|ref mut|mut|def|class|for)\s+(\w+)"
    r"|[({|,]\s*(?:mut\s+|ref\s+|&\s*)?(\w+)\s*:(?!:)"
    r"|^\s*(?:pub(?:\([^)]*\))?\s+)?(\w+)\s*:(?!:)"
    r"|\|\s*&?(\w+)\s*\|"
)
RUST_TEXT = re.compile(r'//[^\n]*|/\*.*?\*/|r#*"(?:.*?)"#*|"(?:\\.|[^"\\])*"|\'(?:\\.[^\']*|[^\\\'])\'', re.S)
PYTHON_TEXT = re.compile(r'#[^\n]*|""".*?"""|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'', re.S)


def listed() -> tuple[dict[str, str], list[tuple[re.Pattern[str], str]]]:
    names: dict[str, str] = {}
    prose: list[tuple[re.Pattern[str], str]] = []
    for line in (ROOT / "scripts" / "words.txt").read_text().splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        rule, _, better = line.partition(" -> ")
        kind, _, word = rule.partition(" ")
        if kind == "name":
            names[word.lower()] = better
        elif kind == "prose":
            prose.append((re.compile(word, re.I), better))
        else:
            sys.exit(f"scripts/words.txt: {line!r}; begin with `name` or `prose`")
    return names, prose


def blank(text: str) -> str:
    return re.sub(r"[^\n]", " ", text)


def split(path: Path, text: str) -> tuple[str, str]:
    """The code and the texts of a file, each on its own lines."""
    pattern = {".rs": RUST_TEXT, ".py": PYTHON_TEXT, ".pyi": PYTHON_TEXT}.get(path.suffix)
    if pattern is None:
        return "", text
    code = pattern.sub(lambda m: blank(m[0]), text)
    kept, last = [], 0
    for m in pattern.finditer(text):
        kept += [blank(text[last : m.start()]), m[0]]
        last = m.end()
    return code, "".join(kept) + blank(text[last:])


def main() -> None:
    names, prose = listed()
    files = sys.argv[1:] or subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    found = 0
    for name in files:
        path = ROOT / name
        if path.suffix not in {".rs", ".py", ".pyi", ".md", ".toml", ".sh"} or name.endswith("words.txt"):
            continue
        if name in {"CHANGELOG.md"} or not path.exists():
            continue
        code, texts = split(path, path.read_text(errors="replace"))
        whole_lines = path.read_text(errors="replace").splitlines()
        for number, line in enumerate(code.splitlines(), 1):
            if "words: allow" in whole_lines[number - 1]:
                continue
            for m in DEFINED.finditer(line):
                word = next(group for group in m.groups() if group)
                if word.lower() in names:
                    found += 1
                    print(f"{name}:{number}: name `{word}`; write {names[word.lower()]}")
        for number, line in enumerate(texts.splitlines(), 1):
            for pattern, better in prose:
                if m := pattern.search(line):
                    found += 1
                    print(f"{name}:{number}: `{m[0]}`; write {better}")
    if found:
        sys.exit(f"{found} words of scripts/words.txt")


if __name__ == "__main__":
    main()
