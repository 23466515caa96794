#!/usr/bin/env python3
"""Opens pages in headless Chromium and uses their controls: look.py OUT-FOLDER PAGE.html ...

Prints one line of JSON for each page. Prints an error and exits with 1 if a check fails.
"""
import json
import os
import sys

from browser import Browser, find_browser

# Returns the share of the scene's pixels that differ from the background, and a checksum of all pixels.
PIXELS = """(() => {
  const scene = document.getElementById('scene'), gl = scene.getContext('webgl2');
  const [w, h] = [scene.width, scene.height];
  const bytes = new Uint8Array(w * h * 4);
  gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  const ground = atomesh.look.ground;
  let drawn = 0, sum = 0;
  const colors = new Set();
  for (let i = 0; i < bytes.length; i += 4) {
    if ([0, 1, 2].some(k => Math.abs(bytes[i + k] - ground[k]) > 2)) drawn++;
    sum = (sum * 31 + bytes[i] * 7 + bytes[i + 1] * 3 + bytes[i + 2]) % 1000000007;
    if (i % 400 === 0) colors.add(bytes[i] << 16 | bytes[i + 1] << 8 | bytes[i + 2]);
  }
  return { share: drawn / (w * h), sum, colors: colors.size };
})()"""
# Returns the number of drawn pixels of the labels over the scene, and a checksum of them.
INK = """(() => {
  const labels = document.getElementById('labels');
  const bytes = labels.getContext('2d').getImageData(0, 0, labels.width, labels.height).data;
  let sum = 0, ink = 0;
  for (let i = 3; i < bytes.length; i += 4) { if (bytes[i]) ink++; sum = (sum * 31 + bytes[i] + bytes[i - 1] + bytes[i - 3]) % 1000000007; }
  return { ink, sum };
})()"""
# Is true if the page is wider than the window.
OVERFLOW = """document.documentElement.scrollWidth > innerWidth + 1"""


def slide(b, selector, value):
    """Moves a slider."""
    b.value(f"""(() => {{ const s = document.querySelector({json.dumps(selector)}); s.value = {value};
        s.dispatchEvent(new Event('input', {{ bubbles: true }})); }})()""")
    b.settle()


def check(condition, message):
    if not condition:
        raise AssertionError(message)


def drawing(b):
    """Checks that the scene is drawn, and returns the checksum of its pixels."""
    pixels = b.value(PIXELS)
    check(pixels["share"] > 0.05, f"little is drawn: {pixels}")
    check(pixels["colors"] > 4, f"few colours: {pixels}")
    return pixels["sum"]


def middle(b):
    """Returns the position of the middle of the mesh in the window."""
    return b.value("""(() => { const s = document.getElementById('stage').getBoundingClientRect();
        return [s.left + s.width / 2 + atomesh.aside[0] / atomesh.ratio, s.top + s.height / 2 - atomesh.aside[1] / atomesh.ratio]; })()""")


def controls(b, flat):
    """Checks that every control changes the drawing, and that the reset restores it."""
    first = drawing(b)
    triangle_count = b.value("atomesh.triangles")
    slide(b, "#cuts input", b.value("atomesh.facts.steps") * 0.25)
    cut = drawing(b)
    check(cut != first, "the cut does not move")
    check(b.value("atomesh.triangles") != triangle_count, "the cut hides no cell")
    b.value("document.querySelector('#cuts button').click()")
    b.settle()
    check(drawing(b) != cut, "the cut does not turn")
    b.value("document.getElementById('reset').click()")
    b.settle()
    check(drawing(b) == first, "reset does not bring back the first view")

    check(b.value("atomesh.facts.image !== null"), "no image")
    if not flat:
        b.value("document.getElementById('cells').click()")
        b.settle()
        slide(b, "#sections label:nth-child(2) input[type=range]", 3)
        section = drawing(b)
        slide(b, "#sections label:nth-child(2) input[type=range]", 9)
        check(drawing(b) != section, "the section does not move")
        b.key("i")
        b.key("m")
        check(drawing(b) == first, "sections and cells do not come back")


def colors(b):
    """Checks that every colouring has a legend, and that legends differ."""
    legends = {}
    for option in b.value("[...document.getElementById('color').options].map(o => o.value)"):
        b.value(f"""(() => {{ const c = document.getElementById('color'); c.value = {json.dumps(option)};
            c.dispatchEvent(new Event('change')); }})()""")
        b.settle()
        b.value(PIXELS)
        legends[option] = b.value(INK)["sum"]
    check(len(legends) >= 4, f"few colourings: {list(legends)}")
    check(len(set(legends.values())) == len(legends), f"some legends are equal: {legends}")
    units = b.value("atomesh.facts.arrays.filter(a => /angle|dihedral/.test(a.name) && a.name !== 'angles').map(a => a.unit)")
    check(all(unit == "degrees" for unit in units), f"units: {units}")
    b.value("document.getElementById('color').selectedIndex = 0; document.getElementById('color').dispatchEvent(new Event('change'))")
    b.settle()


def click(b):
    """Checks that a click shows the numbers of the cell."""
    b.click(*middle(b))
    text = b.value("document.getElementById('picked').innerText")
    for word in ("number", "Sample", "Image here"):
        check(word in text, f"a click does not show {word!r}: {text}")
    cell = b.value("atomesh.picked.cell")
    check(b.value(f"atomesh.mesh.numbers[{cell}] < atomesh.facts.counts.cells"), "no such cell")
    b.click(6, middle(b)[1])
    check(b.value("document.getElementById('picked').hidden"), "a click next to the mesh shows something")


def keys(b, flat):
    """Checks that keys have the effects of the table of keys."""
    first = drawing(b)
    for key in ("ArrowLeft", "ArrowUp", "+", "-", "e", "c") + (() if flat else ("1", "5", "x")):
        before = b.value(PIXELS)["sum"]
        b.key(key)
        check(b.value(PIXELS)["sum"] != before, f"key {key} does nothing")
    b.key("r")
    for _ in range(b.value("document.getElementById('color').options.length") - 1):
        b.key("c")
    b.key("e")
    check(drawing(b) == first, "keys do not bring back the first view")
    dark = b.value("document.documentElement.dataset.theme")
    b.key("d")
    check(b.value("document.documentElement.dataset.theme") != dark, "key d does not change the theme")
    b.key("d")
    b.key("p")
    check(b.value("!!atomesh.lastPicture && atomesh.lastPicture.width > 100"), "no picture")


def pointers(b, flat, phone):
    """Checks that mouse and fingers rotate and zoom."""
    first = b.value(PIXELS)["sum"]
    x, y = middle(b)
    if phone:
        b.touch([(x, y)], [(x + 30, y + 10)], [(x + 60, y + 20)])
        rotated = b.value(PIXELS)["sum"]
        check(rotated != first, "a finger does not rotate")
        zoom = b.value("atomesh.view.zoom")
        b.touch([(x - 20, y), (x + 20, y)], [(x - 40, y), (x + 20, y)], [(x - 60, y), (x + 60, y)])
        check(b.value("atomesh.view.zoom") > 1.5 * zoom, "two fingers do not zoom")
    else:
        b.drag((x, y), (x + 80, y + 30))
        check(b.value(PIXELS)["sum"] != first, "the mouse does not rotate")
        check(b.value("document.getElementById('picked').hidden"), "a rotation counts as a click")
        zoom = b.value("atomesh.view.zoom")
        b.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-300)
        b.settle()
        check(b.value("atomesh.view.zoom") > zoom, "the wheel does not zoom")
    b.value("document.getElementById('reset').click()")
    b.settle()
    check(b.value(PIXELS)["sum"] == first, "reset does not bring back the first view")


def tables(b):
    """Checks that the page has figures, a histogram and the provenance."""
    figures = b.value("document.getElementById('figures').innerText")
    check("Nodes" in figures and "Valid, fills its box" in figures, f"figures: {figures}")
    check(b.value("!document.getElementById('histogram-section').hidden"), "no histogram")
    provenance = b.value("document.getElementById('provenance').innerText")
    check("atomesh" in provenance and "sha256" in provenance, f"provenance: {provenance}")
    check("distance" in b.value("document.getElementById('parameters').textContent"), "no parameters")
    json.loads(b.value("document.getElementById('report').textContent"))


def look(program, page, folder):
    """Checks a page at two sizes in light and dark mode, and returns figures of the page."""
    name = os.path.splitext(os.path.basename(page))[0]
    result = {"page": name, "bytes": os.path.getsize(page)}
    for size, dark, phone in (((1920, 1080), False, False), ((1920, 1080), True, False),
                              ((360, 640), False, True), ((360, 640), True, True)):
        with Browser(program) as b:
            b.window(*size, dark=dark, phone=phone)
            b.open(page)
            flat = b.value("atomesh.flat")
            theme = b.value("document.documentElement.dataset.theme")
            check(theme == ("dark" if dark else "light"), f"theme {theme}")
            check(not b.value(OVERFLOW), "wider than the window")
            check(b.value(INK)["ink"] > 500, "no labels")
            drawing(b)
            kind = f"{size[0]}x{size[1]}-{'dark' if dark else 'light'}"
            b.shot(os.path.join(folder, f"{name}-{kind}.png"))
            result[f"first_frame_ms {kind}"] = round(b.value("atomesh.firstFrame"))
            pointers(b, flat, phone)
            if not dark and not phone:
                controls(b, flat)
                colors(b)
                tables(b)
                keys(b, flat)
            if not phone:
                click(b)
            check(b.value("document.getElementById('message').textContent") == "", "a message stays")
            external = [url for url in b.requests if not url.startswith(("file://", "blob:", "data:"))]
            check(not external, f"requests from the network: {external}")
            files = [url for url in b.requests if url.startswith("file://")]
            check(len(files) == 1, f"requests other files: {files}")
            check(not b.errors, f"errors of the browser: {b.errors}")
    return result


if __name__ == "__main__":
    program = find_browser()
    if program is None:
        sys.exit("no Chromium")
    for page in sys.argv[2:]:
        try:
            print(json.dumps(look(program, page, sys.argv[1])), flush=True)
        except (AssertionError, RuntimeError, TimeoutError, EOFError) as error:
            sys.exit(f"{page}: {error}")
