// Edits of atoms: drag, add and remove them in sections.

/** Largest distance, in pixels, of the mouse from an atom that it takes. */
const GRAB_PIXELS = 12;

class EditTool {
  constructor(bench) {
    Object.assign(this, { bench, selected: -1, drag: null, report: null });
    document.getElementById('remove-atom').onclick = () => this.remove();
    document.getElementById('add-atom').onclick = () => this.add(bench.cursor);
    document.getElementById('move-atom').onclick = () => this.selected >= 0 && this.moveTo(this.selected, bench.cursor);
    document.getElementById('take-atom').onclick = () => this.take();
  }

  get isFree() { return document.getElementById('free').checked; }

  async run(words, text) {
    const { bench } = this;
    if (bench.mesh.isEmpty) return bench.say('Make a mesh first.', true);
    const reply = await bench.act(['edit', MESH, bench.image, '-o', MESH, ...words, ...(this.isFree ? ['--free'] : [])], text);
    if (reply) {
      this.report = reply.report;
      this.selected = reply.report.atoms?.[0] ?? -1;
    }
    this.drag = null;
    bench.showQuality();
    this.showSelected();
    bench.redrawTop();
    return reply;
  }

  add(point) { return this.run(['--add', this.bench.frame.pointText(point)], 'Adding an atom …'); }

  moveTo(node, point) { return this.run(['--move', `${node}:${this.bench.frame.pointText(point)}`], 'Moving an atom …'); }

  remove() {
    if (this.selected < 0) return this.bench.say('Choose an atom first: click it, or press N at the cursor.', true);
    return this.run(['--remove', String(this.selected)], 'Removing an atom …');
  }

  /** Chooses the atom nearest to the cursor. */
  take() {
    const { mesh, cursor } = this.bench;
    let [best, found] = [Infinity, -1];
    for (let node = 0; node < mesh.nodeCount; node++) {
      let sum = 0;
      for (let k = 0; k < mesh.size; k++) sum += (mesh.nodes[mesh.size * node + k] - cursor[k]) ** 2;
      if (sum < best) [best, found] = [sum, node];
    }
    this.selected = found;
    this.showSelected();
    if (found >= 0) this.bench.setCursor(this.placeOf(found));
  }

  placeOf(node) { const { mesh } = this.bench; return Array.from(mesh.nodes.subarray(mesh.size * node, mesh.size * (node + 1))); }

  showSelected() {
    const { mesh, frame } = this.bench;
    document.getElementById('selected-atom').textContent = this.selected < 0 || this.selected >= mesh.nodeCount
      ? 'none' : `${this.selected} at ${frame.placeText(this.placeOf(this.selected))}`;
  }

  /** Returns how far from a section atoms are shown, in samples. */
  reach() {
    const { mesh } = this.bench;
    const spacing = (this.bench.frame.dims.reduce((p, n) => p * n, 1) / Math.max(1, mesh.nodeCount)) ** (1 / mesh.size);
    return 0.5 * spacing;
  }

  nearest(section, pixel) {
    let [best, found] = [GRAB_PIXELS * section.ratio, -1];
    for (const node of section.nodesNear(this.reach())) {
      const [x, y] = section.pixelOfNode(node);
      const distance = Math.hypot(x - pixel[0], y - pixel[1]);
      if (distance < best) [best, found] = [distance, node];
    }
    return found;
  }

  press(section, point, pixel, event) {
    if (this.bench.session.isBusy || !section.isInside(point)) return;
    if (event.shiftKey) return void this.add(point);
    this.selected = this.nearest(section, pixel);
    if (this.selected >= 0) {
      const from = this.placeOf(this.selected);
      this.drag = { section, node: this.selected, from, to: from, start: pixel, hasMoved: false };
    }
    this.showSelected();
    this.bench.redrawTop();
  }

  move(section, point, pixel) {
    const { drag } = this;
    if (!drag || drag.isDropped || drag.section !== section) return;
    if (Math.hypot(pixel[0] - drag.start[0], pixel[1] - drag.start[1]) > 3 * section.ratio) drag.hasMoved = true;
    // The atom stays in its plane, and in the box.
    const to = drag.from.slice();
    for (const k of [section.u, section.v]) to[k] = Math.min(Math.max(point[k], 0), this.bench.frame.dims[k] - 1);
    drag.to = to;
  }

  release() {
    const { drag } = this;
    if (!drag || drag.isDropped) return;
    if (!drag.hasMoved) { this.drag = null; return this.bench.redrawTop(); }
    drag.isDropped = true;
    this.moveTo(drag.node, drag.to);
  }

  cancel() { this.drag = null; this.bench.redrawTop(); }

  enter(section, point, event) {
    if (event.shiftKey || this.selected < 0) return this.add(point);
    return this.moveTo(this.selected, point);
  }

  key(section, event) {
    if (event.key === 'Delete' || event.key === 'Backspace') this.remove();
    else if (event.key === 'n' || event.key === 'N') this.take();
    else if (event.key === 'i' || event.key === 'I') this.add(this.bench.cursor);
    else if (event.key === 'f' || event.key === 'F') document.getElementById('free').click();
    else if (event.key === 'Escape') this.cancel();
    else return false;
    return true;
  }

  /** Finds the features that all edits need, once for each mesh that was made. */
  async enterPanel() {
    const { bench } = this;
    const line = bench.session.done.findLast(text => text.startsWith('mesh '));
    if (bench.mesh.isEmpty || line === this.prepared) return;
    this.prepared = line;
    await bench.perform(() => bench.session.prepare(MESH, bench.image, text => bench.progress?.(text)), 'Finding the features that edits need …');
  }

  leave() { this.drag = null; }

  /** Returns the figures of the last edit. */
  figures() {
    const [before, after] = this.report?.quality || [];
    if (!after) return [];
    const angle = quality => showNumber(quality?.smallest_angle?.worst ?? NaN, 3);
    return [['Cells of the last edit', `${this.report.cells[0]} → ${this.report.cells[1]}`], ['Their smallest angle', `${angle(before)}° → ${angle(after)}°`]];
  }

  draw(section, context) {
    const { bench, drag } = this;
    if (bench.toolName !== 'edit' || bench.mesh.isEmpty) return;
    const spacing = section.scale[0] * this.reach();
    if (spacing > 2 * section.ratio) {
      context.fillStyle = '#ffd200';
      context.strokeStyle = '#000000';
      context.lineWidth = 0.7 * section.ratio;
      const radius = Math.min(3.2, Math.max(1.6, spacing / section.ratio / 3)) * section.ratio;
      context.beginPath();
      for (const node of section.nodesNear(this.reach())) {
        const [x, y] = section.pixelOfNode(node);
        context.moveTo(x + radius, y);
        context.arc(x, y, radius, 0, 2 * Math.PI);
      }
      context.fill();
      context.stroke();
    }
    if (this.selected >= 0 && this.selected < bench.mesh.nodeCount) {
      const place = this.placeOf(this.selected);
      if (section.across === null || Math.abs(place[section.across] - section.at) < 2 * this.reach()) {
        section.disc(context, section.toPixel(place[section.u], place[section.v]), 5, '#ff2fd0');
      }
    }
    if (drag && drag.hasMoved) {
      const [from, to] = [drag.from, drag.to].map(place => section.toPixel(place[section.u], place[section.v]));
      context.strokeStyle = '#ff2fd0';
      context.lineWidth = 2 * section.ratio;
      context.beginPath();
      context.moveTo(...from);
      context.lineTo(...to);
      context.stroke();
      section.disc(context, to, 6, this.isFree ? '#00e5ff' : '#ff2fd0');
    }
  }
}
