#!/usr/bin/env python3
"""Joins the parts of the page that runs atomesh in a browser: web.py PROGRAM.wasm PAGE.html"""
import base64
import gzip
import os
import sys

# The scripts of the page, in one module. Later ones use earlier ones.
SCRIPTS = ["session.js", "colors.js", "mesh_model.js", "sections.js", "body.js", "workbench.js", "paint.js", "edit.js", "picks.js", "flow.js",
           "project.js", "tour.js", "page.js"]
FOLDER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "web")


def part(name):
    with open(os.path.join(FOLDER, name), encoding="utf-8") as file:
        return file.read()


def main(program, page):
    with open(program, "rb") as file:
        packed = base64.b64encode(gzip.compress(file.read(), mtime=0)).decode()
    parts = {"style": part("style.css"), "script": "".join(map(part, SCRIPTS)), "worker": part("wasi.js") + part("worker.js"),
             "program": packed}
    text = part("index.html")
    for name, content in parts.items():
        if "</script" in content:
            sys.exit(f"error: {name}: contains the end of a script")
        text = text.replace("{{" + name + "}}", content)
    os.makedirs(os.path.dirname(page) or ".", exist_ok=True)
    with open(page, "w", encoding="utf-8") as file:
        file.write(text)
    print(f"wrote {page}, {os.path.getsize(page) / 1e6:.1f} MB")


if __name__ == "__main__":
    main(*sys.argv[1:])
