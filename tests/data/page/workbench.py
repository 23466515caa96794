#!/usr/bin/env python3
"""Uses the workbench of the page that runs atomesh in a browser: workbench.py PAGE.html ATOMESH [FOLDER-FOR-PICTURES]
[--dims 64] [--actions 40] [--axe axe.min.js]

Paints, drags atoms, undoes, picks and computes flow with the mouse and the keyboard, and compares the meshes with those that the
program ATOMESH makes by the same script. With --axe it runs this accessibility checker, axe-core of npm. Prints times. Prints an
error and exits with 1 if a check fails.
"""
import argparse
import os
import random
import subprocess
import sys
import tempfile
import time

from browser import find_browser
from web import STATUS, WebPage, check, native, read

DISTANCE = "5"
IDLE = f"!atomesh.session.isBusy && ({STATUS} === '' || {STATUS}.startsWith('Done'))"
MESH_FILE = "atomesh.session.meshFile('mesh.vtu')"


class Workbench(WebPage):
    """The page with functions for the parts of its workbench."""

    def wait_idle(self):
        """Waits until an action is complete, and checks that it did not fail."""
        self.wait(f"!atomesh.session.isBusy && ({IDLE} || document.querySelector('#status.error'))")
        self.settle()
        failed = self.value("document.querySelector('#status.error')?.textContent")
        check(not failed, f"refused: {failed}")

    def tool(self, name):
        self.click_element(f"[data-tool={name}]")

    def click_element(self, selector):
        """Clicks the middle of an element with the mouse."""
        x, y = self.value(f"""(() => {{ const e = document.querySelector({selector!r}); e.scrollIntoView({{ block: 'nearest' }});
            const r = e.getBoundingClientRect(); return [r.left + r.width / 2, r.top + r.height / 2]; }})()""")
        self.click(x, y)

    def pixel(self, section, point):
        """Returns the place on the screen of a point (indices of samples) in a section."""
        return self.value(f"""(() => {{ const s = atomesh.bench.sections[{section}], p = {list(point)!r};
            s.element.scrollIntoView({{ block: 'nearest' }});
            const r = s.top.getBoundingClientRect(), [x, y] = s.toPixel(p[s.u], p[s.v]);
            return [r.left + x / s.ratio, r.top + y / s.ratio]; }})()""")

    def atom_near(self, section, point):
        """Returns the number and the place on the screen of the inner atom of a section that is nearest to a point."""
        return self.value(f"""(() => {{ const b = atomesh.bench, s = b.sections[{section}], p = {list(point)!r}, m = b.mesh;
            s.element.scrollIntoView({{ block: 'nearest' }});
            let best = [Infinity];
            for (const n of s.nodesNear(b.tools.edit.reach())) {{
              const at = b.tools.edit.placeOf(n);
              if (at.some((c, k) => c < 3 || c > b.frame.dims[k] - 4)) continue;
              const d = Math.hypot(...at.map((c, k) => c - p[k]));
              if (d < best[0]) best = [d, n];
            }}
            const r = s.top.getBoundingClientRect(), [x, y] = s.pixelOfNode(best[1]);
            return [best[1], r.left + x / s.ratio, r.top + y / s.ratio]; }})()""")

    def mesh_bytes(self):
        return self.output_file(MESH_FILE)

    def script(self):
        return self.value("atomesh.session.script()")


def check_against_program(b, program, folder, what):
    """Compares the mesh of the session with that which the program makes by the script of the session."""
    lines = [line for line in b.script().splitlines() if not line.startswith("flow ")]
    with open(os.path.join(folder, "script.txt"), "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
    native(program, folder, "script", "script.txt")
    check(b.mesh_bytes() == read(os.path.join(folder, "mesh.vtu")), f"{what}: the script makes another mesh on the command line")


def measured(b, work):
    """Runs `work` and returns the milliseconds of the program, and those until the new picture was drawn."""
    work()
    b.wait_idle()
    return b.value("[atomesh.bench.measures.program, atomesh.bench.measures.total]")


def drag_atom(b, section, point, by):
    node, x, y = b.atom_near(section, point)
    before = b.value("atomesh.session.done.length")
    b.drag((x, y), (x + by[0], y + by[1]))
    b.wait(f"atomesh.session.done.length === {before + 1} || document.querySelector('#status.error')")
    return node


def use(browser, page, program, folder, options):
    name, n = "faults.nii", options.dims
    native(program, folder, "synth", "faults", "--dims", f"{n},{n},{n}", "-o", name)
    middle = [n / 2 - 0.5] * 3
    pictures = options.pictures
    with Workbench(browser, page) as b:
        b.window(1400, 1000)
        b.drop(os.path.join(folder, name))
        b.choose("distance", DISTANCE)
        b.choose("feature", "ridges")
        b.click_element("#mesh")
        b.wait(f"{STATUS}.startsWith('Done') || document.querySelector('#status.error')")
        status = b.value(STATUS)
        check(status.startswith("Done"), status)
        job_memory = b.value("atomesh.session.memoryBytes")
        first = b.mesh_bytes()
        cells = b.value("atomesh.bench.mesh.cellCount")
        print(f"{status} {cells} cells", flush=True)
        b.shot(os.path.join(pictures, "workbench-mesh.png"))

        # Paint.
        b.tool("paint")
        times = []
        for section, share in ((0, (0.5, 0.5, 0.5)), (1, (0.2, 0.5, 0.3)), (2, (0.5, 0.8, 0.8))):
            x, y = b.pixel(section, [s * n for s in share])
            times.append(measured(b, lambda: b.click(x, y)))
        units = b.value("document.querySelectorAll('#unit-rows tr').length")
        check(units >= 1, "no unit in the table")
        volume = b.value("atomesh.bench.units.totals().reduce((sum, unit) => sum + unit[1][1], 0)")
        check(0 < volume <= (n - 1) ** 3 * (1 + 1e-5), f"units of {volume}")
        print("paint: program and picture after", ", ".join(f"{a:.0f} and {c:.0f} ms" for a, c in times), flush=True)
        b.shot(os.path.join(pictures, "workbench-paint.png"))
        check_against_program(b, program, folder, "paint")

        # Drag atoms; the first edit finds the features of the whole image.
        b.tool("edit")
        b.wait_idle()
        times = []
        for share in ((0.5, 0.5, 0.5), (0.3, 0.6, 0.5), (0.7, 0.3, 0.5), (0.6, 0.6, 0.5)):
            times.append(measured(b, lambda: drag_atom(b, 0, [s * n for s in share], (7, 5))))
        print("drag: program and picture after", ", ".join(f"{a:.0f} and {c:.0f} ms" for a, c in times), flush=True)
        b.shot(os.path.join(pictures, "workbench-edit.png"))
        check_against_program(b, program, folder, "edits")
        memory = b.value("atomesh.session.memoryBytes")
        print(f"memory: {memory / 1e6:.0f} MB, {memory / job_memory:.2f} times that of the mesh job", flush=True)

        # The keyboard alone: choose an atom, move the cursor, move the atom; undo and redo.
        before = b.mesh_bytes()
        b.value("atomesh.bench.sections[0].top.focus()")
        for key in ("n", "ArrowRight", "ArrowDown", "Enter"):
            b.key(key)
        b.wait_idle()
        check(b.script().splitlines()[-1].startswith("edit "), "Enter does not move the atom")
        after = b.mesh_bytes()
        check(after != before, "the keyboard moves no atom")
        b.control("z")
        b.wait_idle()
        check(b.mesh_bytes() == before, "undo leaves another mesh")
        b.control("y")
        b.wait_idle()
        check(b.mesh_bytes() == after, "redo makes another mesh")

        random_actions(b, n, options.actions)
        check_against_program(b, program, folder, "random actions")
        last = b.mesh_bytes()
        script = b.script()

        # A crash of the tab: another page has the last state.
        b.value("atomesh.project.saving")
        b.call("Page.reload")
        b.wait("!!(window.atomesh && atomesh.ready)")
        check(not b.value("document.getElementById('last').hidden"), "no offer to restore the session")
        b.click_element("#restore")
        b.wait(f"atomesh.session.done.length === {len(script.splitlines())} && {IDLE}")
        b.wait_idle()
        check(b.script() == script and b.mesh_bytes() == last, "the restored session differs")

        # A project file in a page that has kept nothing.
        project = os.path.join(folder, "faults.atomesh")
        with open(project, "wb") as file:
            file.write(b.output_file("atomesh.project.content().then(content => new Blob([JSON.stringify(content)]))"))
        b.click_element("#forget")
        b.wait(f"{STATUS}.startsWith('The browser keeps nothing')")
        b.call("Page.reload")
        b.wait("!!(window.atomesh && atomesh.ready)")
        check(b.value("document.getElementById('last').hidden"), "what was forgotten is offered")
        b.drop_files([project, os.path.join(folder, name)])
        b.wait(f"atomesh.session.done.length === {len(script.splitlines())} && {IDLE}")
        check(b.mesh_bytes() == last, "the project makes another mesh")

        # Undoing everything but the mesh.
        while b.value("atomesh.session.done.length") > 1:
            b.value("atomesh.bench.undo()")
        check(b.mesh_bytes() == first, "undoing everything leaves another mesh")

        flow(b, n, pictures)
        draw_fault(b, n, pictures)
        frames(b)
        if options.axe:
            accessibility(b, options.axe)
        external = [url for url in b.requests if not url.startswith(("blob:", "data:", "file://"))]
        check(not external, f"requests from the network: {external}")
        check(not b.errors, f"errors of the browser: {b.errors}")
        print(f"requests that leave the page: {len(external)}", flush=True)


def random_actions(b, n, count):
    """Runs random actions, with undo and redo between them, and checks that each state has the bytes that it had before."""
    numbers = random.Random(5)
    states, position, refused = [hash(b.mesh_bytes())], 0, 0
    for _ in range(count):
        kind = numbers.random()
        if kind < 0.2 and position > 0:
            position -= 1
            b.value("atomesh.bench.undo()")
        elif kind < 0.35 and position + 1 < len(states):
            position += 1
            b.value("atomesh.bench.redo()")
        else:
            point = [numbers.uniform(2, n - 3) for _ in range(3)]
            before = b.value("atomesh.session.done.length")
            action = numbers.choice(["add", "free", "move", "remove", "paint"])
            b.value(f"document.getElementById('free').checked = {'true' if action == 'free' else 'false'}")
            atom = numbers.randrange(b.value("atomesh.bench.mesh.nodeCount"))
            work = {"add": f"edit.add({point})", "free": f"edit.add({point})", "move": f"edit.moveTo({atom}, {point})",
                    "remove": f"(tools => {{ tools.edit.selected = {atom}; return tools.edit.remove(); }})(atomesh.bench.tools)",
                    "paint": f"paint.paint({point})"}[action]
            if action != "remove":
                work = "atomesh.bench.tools." + work
            b.value(work + ".then(() => null)")
            if b.value("atomesh.session.done.length") == before:
                refused += 1
                continue
            position += 1
            del states[position:]
            states.append(None)
        state = hash(b.mesh_bytes())
        check(states[position] in (None, state), "undo or redo makes another mesh")
        states[position] = state
        check(b.value(NEIGHBOURS), "the mesh of the page has cells whose neighbours do not match")
    check(refused < count / 3, f"{refused} of {count} actions were refused")
    print(f"{count} random actions, {refused} refused", flush=True)


# Is true if the neighbours that the page keeps up to date are those of a mesh that is linked as a whole.
NEIGHBOURS = """(() => { const m = atomesh.bench.mesh, whole = new m.constructor(m.frame);
    Object.assign(whole, { nodes: m.nodes, corners: m.corners, nodeCount: m.nodeCount, cellCount: m.cellCount, neighbours: new Int32Array(4 * m.cellCount) });
    whole.link(Uint32Array.from({ length: m.cellCount }, (_, i) => i));
    return whole.neighbours.every((c, i) => c === m.neighbours[i]); })()"""


def flow(b, n, pictures):
    """Computes a flow from side to side, with open and with closed faults."""
    b.tool("flow")
    for side, value in (("xmin", "2e5"), ("xmax", "100000,5")):
        b.value(f"document.querySelector('[data-side={side}]').value = {value!r}")
    rates = []
    for how in ("open", "factor"):
        b.choose("faults", how)
        b.click_element("#run-flow")
        b.wait_idle()
        low, high = b.value("[atomesh.bench.tools.flow.report.pressure.min, atomesh.bench.tools.flow.report.pressure.max]")
        check(abs(low - 100000.5) < 1 and abs(high - 2e5) < 1, f"pressures from {low} to {high}")
        rates.append(b.value("Math.abs(atomesh.bench.tools.flow.report.exchange[0].rate)"))
    check(rates[1] < 0.98 * rates[0], f"closing the faults changes nothing: {rates}")
    b.shot(os.path.join(pictures, "workbench-flow.png"))
    print(f"flow: {rates[0]:.3g} m3/s with open faults, {rates[1]:.3g} with nearly closed ones", flush=True)
    b.value("(() => { const c = document.getElementById('cell-color'); c.value = 'units'; c.dispatchEvent(new Event('change')); })()")


def draw_fault(b, n, pictures):
    """Draws a fault by sticks on three sections, and makes a mesh that follows it."""
    b.tool("picks")
    b.click_element("#new-fault")
    for slice_ in (0.3, 0.5, 0.7):
        b.value(f"atomesh.bench.moveCursor(atomesh.bench.sections[0].across, Math.round({slice_ * n}))")
        b.settle()
        for share in (0.2, 0.4, 0.6, 0.8):
            b.click(*b.pixel(0, [n * (0.35 + 0.2 * share), n * share, n * slice_]))
        b.value("atomesh.bench.sections[0].top.focus()")
        b.key("Escape")
    sticks = b.value("atomesh.bench.tools.picks.surfaces[0].sticks.map(stick => stick.points.length)")
    check(sticks == [4, 4, 4], f"sticks of {sticks} points")
    b.shot(os.path.join(pictures, "workbench-picks.png"))
    b.choose("feature", "")
    b.click_element("#mesh-picks")
    b.wait(f"{STATUS}.startsWith('Done') || document.querySelector('#status.error')")
    check(b.value(STATUS).startswith("Done"), b.value(STATUS))
    b.click_element("#list-found")
    b.wait_idle()
    found = b.value("atomesh.bench.tools.picks.followed")
    check("fault_pick1" in found, f"the mesh follows {found}")
    b.shot(os.path.join(pictures, "workbench-picks-mesh.png"))


def frames(b):
    """Turns the mesh for three seconds."""
    rate = b.value("""new Promise(done => { const v = atomesh.bench.body, start = performance.now(); let count = 0;
        const step = () => { v.turn(0.05, 0.01); v.draw(); v.gl.readPixels(0, 0, 1, 1, v.gl.RGBA, v.gl.UNSIGNED_BYTE, new Uint8Array(4)); count++;
          const time = performance.now() - start; if (time < 3000) requestAnimationFrame(step); else done(1000 * count / time); }; step(); })""")
    scroll = b.value("""(() => { const bench = atomesh.bench, start = performance.now();
        for (let i = 0; i < 20; i++) { bench.cursor[2] = i; bench.sections[0].draw(); bench.sections[0].base.getContext('2d').getImageData(0, 0, 1, 1); }
        return (performance.now() - start) / 20; })()""")
    print(f"turning: {rate:.0f} frames a second; scrolling: {scroll:.0f} ms a slice", flush=True)


def accessibility(b, path):
    """Runs axe-core on each tool. A button without a name shows that it finds something."""
    with open(path, encoding="utf-8") as file:
        b.value(file.read() + "; 1")
    run = "axe.run().then(result => result.violations.map(v => v.id + ': ' + v.nodes.map(node => node.html.slice(0, 150)).join(', ')))"
    for dark in (False, True):
        b.window(1400, 1000, dark=dark)
        for tool in ("look", "paint", "edit", "picks", "flow"):
            b.tool(tool)
            found = b.value(run)
            check(not found, f"axe-core, {tool}: {found}")
    b.value("document.body.append(document.createElement('button'))")
    check(b.value(run), "axe-core finds nothing at all")
    b.value("document.body.lastChild.remove()")
    print("axe-core: 0 findings", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("page")
    parser.add_argument("program")
    parser.add_argument("pictures", nargs="?")
    parser.add_argument("--dims", type=int, default=64)
    parser.add_argument("--actions", type=int, default=40)
    parser.add_argument("--axe")
    arguments = parser.parse_args()
    browser = find_browser()
    if browser is None:
        sys.exit("no Chromium")
    with tempfile.TemporaryDirectory() as folder:
        arguments.pictures = arguments.pictures or folder
        try:
            use(browser, arguments.page, os.path.abspath(arguments.program), folder, arguments)
        except (AssertionError, RuntimeError, TimeoutError, EOFError, subprocess.SubprocessError) as error:
            sys.exit(f"error: {error}")
    print("1 passed, 0 failed")
