#!/usr/bin/env python3
"""Checks the links of the documentation: scripts/links.py (Python's standard library only).

Every relative link and image of README.md, ARCHITECTURE.md, CHANGELOG.md, CONTRIBUTING.md, data/README.md and docs/*.md
must lead to a file, and every #anchor to a heading of its page. Pages of docs/ also make the book: they
must all be in docs/SUMMARY.md, and may not link to files outside docs/, which the book does not hold.
Addresses on the web are not looked up. Exits with 1, and a line per fault, if any link is broken.
"""
import re
import sys
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
FENCE = re.compile(r"^ *(```|~~~)")
HEADING = re.compile(r"^#{1,6} +(.*?)(?: +#+)? *$")
LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
WEB = re.compile(r"^[a-z][a-z0-9+.-]*:", re.IGNORECASE)


def prose(page):
    """The lines of a page with their numbers, without blocks of code."""
    inside = False
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if FENCE.match(line):
            inside = not inside
        elif not inside:
            yield number, line


def anchors(page):
    """What links may name on a page: its headings as GitHub and mdBook spell them."""
    found = {}
    for _, line in prose(page):
        heading = HEADING.match(line)
        if not heading:
            continue
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading[1]).lower()
        name = re.sub(r"[^\w\- ]", "", text).replace(" ", "-")
        repeated = found.get(name, 0)
        found[name] = repeated + 1
        yield f"{name}-{repeated}" if repeated else name


def faults(page):
    """What is wrong with the links of a page."""
    for number, line in prose(page):
        for target in LINK.findall(re.sub(r"`[^`]*`", "", line)):
            if WEB.match(target):
                continue
            path, _, anchor = target.partition("#")
            file = (page.parent / unquote(path)).resolve() if path else page
            where = f"{page.relative_to(ROOT)}:{number}: {target}"
            if not file.exists():
                yield f"{where}: no such file"
            elif page.parent == DOCS and not file.is_relative_to(DOCS):
                yield f"{where}: outside docs/, so the book lacks it"
            elif anchor and anchor not in set(anchors(file)):
                yield f"{where}: no such heading"


def main():
    pages = sorted(DOCS.glob("*.md"))
    summary = (DOCS / "SUMMARY.md").read_text(encoding="utf-8")
    found = [
        f"docs/SUMMARY.md: {page.name} is missing"
        for page in pages
        if page.name != "SUMMARY.md" and f"({page.name})" not in summary
    ]
    others = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "data/README.md")]
    for page in others + pages:
        found += faults(page)
    for fault in found:
        print(f"error: {fault}", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
