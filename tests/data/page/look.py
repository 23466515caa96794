#!/usr/bin/env python3
"""Opens pages in headless Chromium and uses them as people do: look.py OUT-FOLDER PAGE.html ...

Prints one line of JSON a page; says what is wrong and exits with 1 if anything is.
"""
import json
import os
import sys

from browser import Browser, found

# The pixels of the scene that are not ground, as a share, and a number that changes with them.
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
# The same of what is written over it.
INK = """(() => {
  const labels = document.getElementById('labels');
  const bytes = labels.getContext('2d').getImageData(0, 0, labels.width, labels.height).data;
  let sum = 0, ink = 0;
  for (let i = 3; i < bytes.length; i += 4) { if (bytes[i]) ink++; sum = (sum * 31 + bytes[i] + bytes[i - 1] + bytes[i - 3]) % 1000000007; }
  return { ink, sum };
})()"""
# Text that is cut off or lies outside of its element's window.
OVERFLOW = """document.documentElement.scrollWidth > innerWidth + 1"""


def slide(b, selector, value):
    """Moves a slider, as a finger does."""
    b.value(f"""(() => {{ const s = document.querySelector({json.dumps(selector)}); s.value = {value};
        s.dispatchEvent(new Event('input', {{ bubbles: true }})); }})()""")
    b.settle()


def check(truth, what):
    if not truth:
        raise AssertionError(what)


def drawn(b):
    found = b.value(PIXELS)
    check(found["share"] > 0.05, f"little is drawn: {found}")
    check(found["colors"] > 4, f"few colours: {found}")
    return found["sum"]


def middle(b):
    """Somewhere on the mesh."""
    return b.value("""(() => { const s = document.getElementById('stage').getBoundingClientRect();
        return [s.left + s.width / 2 + atomesh.aside[0] / atomesh.ratio, s.top + s.height / 2 - atomesh.aside[1] / atomesh.ratio]; })()""")


def controls(b, flat):
    """All that can be moved changes what is drawn, and comes back."""
    first = drawn(b)
    triangles = b.value("atomesh.triangles")
    slide(b, "#cuts input", b.value("atomesh.facts.steps") * 0.25)
    cut = drawn(b)
    check(cut != first, "the cut does not move")
    check(b.value("atomesh.triangles") != triangles, "the cut hides no cell")
    b.value("document.querySelector('#cuts button').click()")
    b.settle()
    check(drawn(b) != cut, "the cut does not turn")
    b.value("document.getElementById('reset').click()")
    b.settle()
    check(drawn(b) == first, "reset does not bring back the first view")

    check(b.value("atomesh.facts.image !== null"), "no image")
    if not flat:
        b.value("document.getElementById('cells').click()")
        b.settle()
        slide(b, "#sections label:nth-child(2) input[type=range]", 3)
        near = drawn(b)
        slide(b, "#sections label:nth-child(2) input[type=range]", 9)
        check(drawn(b) != near, "the section does not move")
        b.key("i")
        b.key("m")
        check(drawn(b) == first, "sections and cells do not come back")


def colors(b):
    """Every colouring has a legend, and they differ."""
    seen = {}
    for option in b.value("[...document.getElementById('color').options].map(o => o.value)"):
        b.value(f"""(() => {{ const c = document.getElementById('color'); c.value = {json.dumps(option)};
            c.dispatchEvent(new Event('change')); }})()""")
        b.settle()
        b.value(PIXELS)
        seen[option] = b.value(INK)["sum"]
    check(len(seen) >= 4, f"few colourings: {list(seen)}")
    check(len(set(seen.values())) == len(seen), f"legends do not tell colourings apart: {seen}")
    units = b.value("atomesh.facts.arrays.filter(a => /angle|dihedral/.test(a.name) && a.name !== 'angles').map(a => a.unit)")
    check(all(unit == "degrees" for unit in units), f"units: {units}")
    b.value("document.getElementById('color').selectedIndex = 0; document.getElementById('color').dispatchEvent(new Event('change'))")
    b.settle()


def click(b):
    """A click tells the numbers of what is there."""
    b.click(*middle(b))
    said = b.value("document.getElementById('picked').innerText")
    for word in ("number", "Sample", "Image here"):
        check(word in said, f"a click does not say {word!r}: {said}")
    cell = b.value("atomesh.picked.cell")
    check(b.value(f"atomesh.mesh.numbers[{cell}] < atomesh.facts.counts.cells"), "no such cell")
    b.click(6, middle(b)[1])
    check(b.value("document.getElementById('picked').hidden"), "a click beside the mesh says something")


def keys(b, flat):
    """Keys do what the table of keys says."""
    first = drawn(b)
    for key in ("ArrowLeft", "ArrowUp", "+", "-", "e", "c") + (() if flat else ("1", "5", "x")):
        before = b.value(PIXELS)["sum"]
        b.key(key)
        check(b.value(PIXELS)["sum"] != before, f"key {key} does nothing")
    b.key("r")
    for _ in range(b.value("document.getElementById('color').options.length") - 1):
        b.key("c")
    b.key("e")
    check(drawn(b) == first, "keys do not bring back the first view")
    dark = b.value("document.documentElement.dataset.theme")
    b.key("d")
    check(b.value("document.documentElement.dataset.theme") != dark, "key d does not change the theme")
    b.key("d")
    b.key("p")
    check(b.value("!!atomesh.lastPicture && atomesh.lastPicture.width > 100"), "no picture")


def pointers(b, flat, phone):
    """Mouse and fingers turn and zoom."""
    first = b.value(PIXELS)["sum"]
    x, y = middle(b)
    if phone:
        b.touch([(x, y)], [(x + 30, y + 10)], [(x + 60, y + 20)])
        turned = b.value(PIXELS)["sum"]
        check(turned != first, "a finger does not turn")
        zoom = b.value("atomesh.view.zoom")
        b.touch([(x - 20, y), (x + 20, y)], [(x - 40, y), (x + 20, y)], [(x - 60, y), (x + 60, y)])
        check(b.value("atomesh.view.zoom") > 1.5 * zoom, "two fingers do not zoom")
    else:
        b.drag((x, y), (x + 80, y + 30))
        check(b.value(PIXELS)["sum"] != first, "the mouse does not turn")
        check(b.value("document.getElementById('picked').hidden"), "turning is taken for a click")
        zoom = b.value("atomesh.view.zoom")
        b.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-300)
        b.settle()
        check(b.value("atomesh.view.zoom") > zoom, "the wheel does not zoom")
    b.value("document.getElementById('reset').click()")
    b.settle()
    check(b.value(PIXELS)["sum"] == first, "reset does not bring back the first view")


def tables(b):
    """Figures, histogram and provenance are there."""
    figures = b.value("document.getElementById('figures').innerText")
    check("Nodes" in figures and "Valid, fills its box" in figures, f"figures: {figures}")
    check(b.value("!document.getElementById('histogram-section').hidden"), "no histogram")
    made = b.value("document.getElementById('provenance').innerText")
    check("atomesh" in made and "sha256" in made, f"provenance: {made}")
    check("distance" in b.value("document.getElementById('parameters').textContent"), "no parameters")
    json.loads(b.value("document.getElementById('report').textContent"))


def look(program, page, folder):
    name = os.path.splitext(os.path.basename(page))[0]
    said = {"page": name, "bytes": os.path.getsize(page)}
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
            drawn(b)
            kind = f"{size[0]}x{size[1]}-{'dark' if dark else 'light'}"
            b.shot(os.path.join(folder, f"{name}-{kind}.png"))
            said[f"first_frame_ms {kind}"] = round(b.value("atomesh.firstFrame"))
            pointers(b, flat, phone)
            if not dark and not phone:
                controls(b, flat)
                colors(b)
                tables(b)
                keys(b, flat)
            if not phone:
                click(b)
            check(b.value("document.getElementById('message').textContent") == "", "a message stays")
            outside = [url for url in b.requests if not url.startswith(("file://", "blob:", "data:"))]
            check(not outside, f"asks the network for {outside}")
            files = [url for url in b.requests if url.startswith("file://")]
            check(len(files) == 1, f"asks for other files: {files}")
            check(not b.complaints, f"the browser complains: {b.complaints}")
    return said


if __name__ == "__main__":
    program = found()
    if program is None:
        sys.exit("no Chromium")
    for page in sys.argv[2:]:
        try:
            print(json.dumps(look(program, page, sys.argv[1])), flush=True)
        except (AssertionError, RuntimeError, TimeoutError, EOFError) as error:
            sys.exit(f"{page}: {error}")
