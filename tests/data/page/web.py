#!/usr/bin/env python3
"""Uses the page that runs atomesh in a browser: web.py PAGE.html ATOMESH [FOLDER-FOR-PICTURES]

Drops files on the page, makes meshes, cancels one, saves files, and compares them with those of the program ATOMESH.
Prints times. Prints an error and exits with 1 if a check fails.
"""
import base64
import json
import os
import subprocess
import sys
import tempfile
import time

from browser import Browser, find_browser

# Each case: the arguments that make the image, the options of the mesh by the ids of their controls, and exports.
CASES = {
    "picture.png": ("faults --dims 200,200", {"distance": "6"}, ["msh"]),
    "cells.nii": ("faults --dims 32,32,32", {"distance": "6", "cells": "voronoi"}, []),
    "amplitude.npy": ("amplitude --dims 128,128,128 --count 3", {"feature": "faults+horizons", "distance": "6"}, []),
    "faults.nii": ("faults --dims 64,64,64", {"feature": "ridges", "distance": "5"}, ["msh", "inp"]),
}
OVERFLOW = "document.documentElement.scrollWidth > innerWidth + 1"
STATUS = "document.getElementById('status').textContent"


class WebPage(Browser):
    """A browser with the page, which also records the requests of workers and frames."""

    def __init__(self, program, page):
        super().__init__(program)
        self.call("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=False, flatten=True)
        self.call("Page.navigate", url="file://" + os.path.abspath(page))
        self.wait("!!(window.atomesh && atomesh.ready)")

    def record(self, message):
        super().record(message)
        if message.get("method") == "Target.attachedToTarget":
            # No call waits for the answer, which has a number of its own.
            request = {"id": 0, "method": "Network.enable", "sessionId": message["params"]["sessionId"]}
            os.write(self.output, json.dumps(request).encode() + b"\0")

    def wait(self, condition, seconds=600):
        end = time.monotonic() + seconds
        while not self.value(condition):
            if time.monotonic() > end or self.errors:
                raise TimeoutError(f"never {condition}: {self.value(STATUS)} {self.errors}")
            time.sleep(0.02)

    def click_button(self, selector):
        self.value(f"document.querySelector({selector!r}).click()")

    def choose(self, control, value):
        self.value(f"(() => {{ const c = document.getElementById({control!r}); c.value = {value!r};"
                   "c.dispatchEvent(new Event('input', { bubbles: true })); })()")

    def drop_files(self, paths):
        """Drops files on the page, as from a file manager."""
        data = {"items": [], "files": [os.path.abspath(path) for path in paths], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            self.call("Input.dispatchDragEvent", type=kind, x=200, y=200, data=data)

    def drop(self, path):
        """Drops an image on the page, and waits until it is shown."""
        self.value("scrollTo(0, 0)")
        self.drop_files([path])
        name = os.path.basename(path)
        self.wait(f"atomesh.info && atomesh.image === {name!r} && {STATUS} === ''")

    def output_file(self, file):
        """Returns the bytes of a file: an expression of JavaScript that returns it, or a promise of it."""
        text = self.value(f"""Promise.resolve({file}).then(file => file.arrayBuffer()).then(buffer => {{
            const bytes = new Uint8Array(buffer), parts = [];
            for (let i = 0; i < bytes.length; i += 32768) parts.push(String.fromCharCode(...bytes.subarray(i, i + 32768)));
            return btoa(parts.join('')); }})""")
        return base64.b64decode(text)


def check(condition, message):
    if not condition:
        raise AssertionError(message)


def native(program, folder, *args):
    done = subprocess.run([program, *args, "--quiet", "--threads", "1"], cwd=folder, capture_output=True, text=True)
    check(done.returncode == 0, f"{args}: {done.stderr}")


def read(path):
    with open(path, "rb") as file:
        return file.read()


def use(browser, page, program, folder, name, pictures):
    """Makes the mesh of a case on the page, and compares its files with those of the program."""
    how, options, exports = CASES[name]
    native(program, folder, "synth", *how.split(), "-o", name)
    with WebPage(browser, page) as b:
        b.window(1280, 900)
        start = time.monotonic()
        b.drop(os.path.join(folder, name))
        read_seconds = time.monotonic() - start
        sections = b.value("document.querySelectorAll('#views .section').length")
        check(sections == (1 if name.endswith(".png") else 3), f"{sections} sections")
        args = []
        for control, value in options.items():
            b.choose(control, value)
            args += ["--" + control, value]
        b.shot(os.path.join(pictures, name + "-image.png"))

        b.click_button("#mesh")
        b.wait("document.getElementById('progress').value > 0")
        b.click_button("#cancel")
        b.wait(f"{STATUS} === 'cancelled'")
        check(b.value("document.getElementById('results').hidden"), "a cancelled job has results")

        start = time.monotonic()
        b.click_button("#mesh")
        b.wait(f"{STATUS}.startsWith('Done') || document.querySelector('#status.error')")
        seconds = time.monotonic() - start
        status = b.value(STATUS)
        check(status.startswith("Done"), status)
        native(program, folder, "mesh", name, "-o", "mesh.vtu", *args)
        check(b.output_file("atomesh.session.meshFile('mesh.vtu')") == read(os.path.join(folder, "mesh.vtu")),
              f"{name}: mesh.vtu differs from the program's")
        exports = [("surfaces.vtp", ["surface", "mesh.vtu", "-o", "surfaces.vtp"])] + [
            (f"mesh.{kind}", ["export", "mesh.vtu", "--to", kind, "-o", f"mesh.{kind}"]) for kind in exports]
        saved = os.path.join(folder, "saved")
        b.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=saved)
        for file, command in exports:
            native(program, folder, *command)
            b.value(f"[...document.querySelectorAll('#download-list button')].find(b => b.textContent === {file!r}).click()")
            end = time.monotonic() + 60
            while not os.path.exists(os.path.join(saved, file)) and time.monotonic() < end:
                b.settle()
            check(read(os.path.join(saved, file)) == read(os.path.join(folder, file)), f"{file} differs from the program's")
            os.remove(os.path.join(saved, file))
        b.value("document.getElementById('bench').scrollIntoView()")
        time.sleep(2)
        b.shot(os.path.join(pictures, name + "-result.png"))
        for dark in (False, True):
            b.window(360, 740, dark=dark, phone=True)
            check(not b.value(OVERFLOW), "wider than a phone")
            b.value("scrollTo(0, 0)")
            b.shot(os.path.join(pictures, f"{name}-phone-{'dark' if dark else 'light'}.png"))
        external = [url for url in b.requests if not url.startswith(("blob:", "data:", "file://"))]
        check(not external, f"requests from the network: {external}")
        check(len([url for url in b.requests if url.startswith("file://")]) <= 1, f"requests files: {b.requests}")
        check(not b.errors, f"errors of the browser: {b.errors}")
    print(f"{name}: shown after {read_seconds:.1f} s, meshed after {seconds:.1f} s; {status}", flush=True)


if __name__ == "__main__":
    browser = find_browser()
    if browser is None:
        sys.exit("no Chromium")
    with tempfile.TemporaryDirectory() as folder:
        pictures = sys.argv[3] if len(sys.argv) > 3 else folder
        names = sys.argv[4:] or CASES
        try:
            for name in names:
                use(browser, sys.argv[1], os.path.abspath(sys.argv[2]), folder, name, pictures)
        except (AssertionError, RuntimeError, TimeoutError, EOFError) as error:
            sys.exit(f"error: {error}")
    print(f"{len(names)} passed, 0 failed")
