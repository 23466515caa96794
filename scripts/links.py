#!/usr/bin/env python3
"""Checks the links of the documentation: scripts/links.py (Python's standard library only).

Every relative link and image of README.md, the other pages in `OTHERS`, and the pages of docs/ must lead to a file, and every #anchor to a heading of its page. The pages of docs/ are also the book: they must
all be in docs/SUMMARY.md, and must not link to files outside docs/, which the book does not contain.
Links to the web are not checked. Prints a line for each broken link and exits with 1 if there is one.
"""
import re
import sys
from pathlib import Path
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
OTHERS = (
    "README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CODE_OF_CONDUCT.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "data/README.md",
)
FENCE = re.compile(r"^ *(```|~~~)")
HEADING = re.compile(r"^#{1,6} +(.*?)(?: +#+)? *$")
LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
WEB = re.compile(r"^[a-z][a-z0-9+.-]*:", re.IGNORECASE)


def prose(page):
    """Yields the lines of a page with their numbers, without blocks of code."""
    in_code = False
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if FENCE.match(line):
            in_code = not in_code
        elif not in_code:
            yield number, line


def anchors(page):
    """Yields the anchors of the headings of a page, as GitHub and mdBook derive them."""
    counts = {}
    for _, line in prose(page):
        heading = HEADING.match(line)
        if not heading:
            continue
        text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading[1]).lower()
        name = re.sub(r"[^\w\- ]", "", text).replace(" ", "-")
        repeated = counts.get(name, 0)
        counts[name] = repeated + 1
        yield f"{name}-{repeated}" if repeated else name


def faults(page):
    """Yields the errors of the links of a page."""
    for number, line in prose(page):
        for target in LINK.findall(re.sub(r"`[^`]*`", "", line)):
            if WEB.match(target):
                continue
            path, _, anchor = target.partition("#")
            file = (page.parent / unquote(path)).resolve() if path else page
            place = f"{page.relative_to(ROOT)}:{number}: {target}"
            if not file.exists():
                yield f"{place}: no such file"
            elif page.is_relative_to(DOCS) and not file.is_relative_to(DOCS):
                yield f"{place}: outside docs/, so it is missing in the book"
            elif anchor and anchor not in set(anchors(file)):
                yield f"{place}: no such heading"


def main():
    pages = sorted(DOCS.rglob("*.md"))
    summary = (DOCS / "SUMMARY.md").read_text(encoding="utf-8")
    errors = [
        f"docs/SUMMARY.md: {page.relative_to(DOCS)} is missing"
        for page in pages
        if page.name != "SUMMARY.md" and f"({page.relative_to(DOCS)})" not in summary
    ]
    for page in [ROOT / name for name in OTHERS] + pages:
        errors += faults(page)
    for error in errors:
        print(f"error: {error}", file=sys.stderr)
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
