// Picks: fault sticks and points of horizons, drawn on sections, which the next mesh follows.

/** Number of samples around a pick in which snapping looks for a trough, a peak or a break. */
const SNAP_REACH = 6;

/** Returns the position, in samples, of the nearest trough, peak or break of a trace near `at`; `at` if there is none. */
function snapped(trace, at, kind) {
  const value = i => trace[Math.min(Math.max(i, 0), trace.length - 1)];
  const strength = kind === 'trough' ? i => -value(i) : kind === 'peak' ? value : i => Math.abs(value(i + 1) - value(i - 1));
  let [best, found] = [Infinity, at];
  for (let i = Math.max(1, Math.ceil(at - SNAP_REACH)); i <= Math.min(trace.length - 2, at + SNAP_REACH); i++) {
    const [before, here, after] = [strength(i - 1), strength(i), strength(i + 1)];
    if (!(here >= before && here > after)) continue;
    const bend = before - 2 * here + after;
    const place = i + (bend < 0 ? Math.min(0.5, Math.max(-0.5, 0.5 * (before - after) / bend)) : 0);
    if (Math.abs(place - at) < best) [best, found] = [Math.abs(place - at), place];
  }
  return found;
}

class PickTool {
  constructor(bench) {
    Object.assign(this, { bench, surfaces: [], current: -1, open: false, found: [], followed: [] });
    const id = name => document.getElementById(name);
    id('new-fault').onclick = () => this.addSurface('fault');
    id('new-horizon').onclick = () => this.addSurface('horizon');
    id('end-stick').onclick = () => this.endStick();
    id('remove-pick').onclick = () => this.removePoint();
    id('mesh-picks').onclick = () => this.mesh();
    id('pick-here').onclick = () => this.bench.sections[0] && this.add(this.bench.sections[0], this.bench.cursor);
    id('list-found').onclick = () => this.listFound();
  }

  addSurface(kind) {
    const count = this.surfaces.filter(surface => surface.kind === kind).length;
    this.surfaces.push({ name: `${kind}_pick${count + 1}`, kind, sticks: [] });
    this.select(this.surfaces.length - 1);
    this.save();
  }

  select(index) {
    this.current = index;
    this.open = false;
    this.refresh();
    this.bench.redraw();
  }

  /** Adds a point to the present stick. A stick lies in one section. */
  add(section, point) {
    if (this.current < 0) this.addSurface('fault');
    const surface = this.surfaces[this.current];
    const place = this.snap(section, point);
    const last = surface.sticks.at(-1);
    const continues = this.open && last && last.across === section.across && Math.round(last.at) === Math.round(section.at);
    if (continues) last.points.push(place);
    else surface.sticks.push({ across: section.across, at: section.at, points: [place] });
    this.open = true;
    this.save();
    this.refresh();
    this.bench.redraw();
  }

  snap(section, point) {
    const kind = document.getElementById('snap').value;
    const { frame, samples } = this.bench;
    if (kind === '' || !samples) return point;
    // Along the trace: down the section; breaks of a fault lie beside one another, along u.
    const axis = kind === 'break' && this.surfaces[this.current]?.kind === 'fault' ? section.u : section.v;
    const trace = Float32Array.from({ length: frame.dims[axis] }, (_, i) => this.bench.sampleAt(point.map((c, k) => (k === axis ? i : c))));
    return point.map((c, k) => (k === axis ? snapped(trace, c, kind) : c));
  }

  endStick() { this.open = false; this.refresh(); }

  removePoint() {
    const surface = this.surfaces[this.current];
    const stick = surface?.sticks.at(-1);
    if (!stick) return;
    stick.points.pop();
    if (stick.points.length === 0) surface.sticks.pop();
    this.save();
    this.refresh();
    this.bench.redraw();
  }

  /** Returns the table of a surface's picks, in physical coordinates. */
  file(surface) {
    const { frame } = this.bench;
    const names = ['x', 'y', 'z'].slice(0, frame.dims.length);
    const lines = surface.sticks.flatMap((stick, number) => stick.points.map(point =>
      [...frame.pointText(point).split(','), ...(surface.kind === 'fault' ? [number + 1] : [])].join(',')));
    return `${[...names, ...(surface.kind === 'fault' ? ['stick'] : [])].join(',')}\n${lines.join('\n')}\n`;
  }

  /** Returns the files of all surfaces that have picks, by name. */
  files() {
    const full = this.surfaces.filter(surface => surface.sticks.some(stick => stick.points.length > 0));
    return Object.fromEntries(full.map(surface => [`${surface.name}.csv`, new Blob([this.file(surface)])]));
  }

  /** Returns the options of `mesh` for the picks and for the found surfaces that stay. */
  options() {
    const words = this.surfaces.filter(surface => surface.sticks.length > 0)
      .flatMap(surface => ['--surface', `${surface.name}.csv:${surface.name},${surface.kind}`]);
    for (const found of this.found.filter(surface => surface.isKept)) words.push('--surface', `found.vtp:${found.name}`);
    return words;
  }

  /** Makes the mesh again with the picks. */
  async mesh() {
    const { bench } = this;
    const options = this.options();
    if (options.length === 0) return bench.say('Draw picks first: choose New fault or New horizon, and click in a section.', true);
    bench.session.put(this.files());
    // Found surfaces that were listed replace the detection.
    if (this.found.length > 0) options.push('--feature', 'none');
    await bench.makeMesh(options);
  }

  /** Lists the surfaces that the mesh follows, so that some of them can be dropped. */
  async listFound() {
    const { bench } = this;
    const reply = await bench.perform(() => bench.session.run(['surface', MESH, '-o', 'found.vtp'], { take: ['found.vtp'] }), 'Listing surfaces …');
    if (!reply) return;
    bench.session.put({ 'found.vtp': reply.files['found.vtp'] });
    const named = (reply.report.surfaces || []).map(surface => ({ name: surface.name || `${surface.kind}${surface.surface}`, area: surface.area ?? surface.length,
      confidence: surface.confidence, isKept: true }));
    // The picks are followed in any case.
    this.found = named.filter(surface => !this.surfaces.some(own => own.name === surface.name));
    this.followed = named.map(surface => surface.name);
    this.refresh();
  }

  press(section, point) { if (section.isInside(point)) this.add(section, point); }

  enter(section, point) { this.add(section, point); }

  key(section, event) {
    if (event.key === 'Backspace' || event.key === 'Delete') this.removePoint();
    else if (event.key === 'Escape' || event.key === 'n' || event.key === 'N') this.endStick();
    else return false;
    return true;
  }

  leave() { this.open = false; }

  save() { this.bench.changed?.(); }

  refresh() {
    const rows = this.surfaces.map((surface, index) => {
      const points = surface.sticks.reduce((sum, stick) => sum + stick.points.length, 0);
      return make('tr', {},
        make('td', {}, make('input', { type: 'radio', name: 'pick-surface', checked: index === this.current, 'aria-label': `Draw ${surface.name}`, onchange: () => this.select(index) })),
        make('td', {}, make('input', { className: 'name', value: surface.name, 'aria-label': `Name of ${surface.kind} ${index + 1}`,
          onchange: event => { surface.name = event.target.value.replace(/[^\w-]+/g, '_') || surface.name; this.save(); this.refresh(); } })),
        make('td', { className: 'number' }, `${surface.sticks.length} / ${points}`),
        make('td', {}, make('button', { 'aria-label': `Delete ${surface.name}`, onclick: () => { this.surfaces.splice(index, 1); this.select(this.surfaces.length - 1); this.save(); } }, 'Delete')));
    });
    document.getElementById('pick-rows').replaceChildren(...rows);
    document.getElementById('found-rows').replaceChildren(...this.found.map(surface => make('li', {}, make('label', {},
      make('input', { type: 'checkbox', checked: surface.isKept, onchange: event => { surface.isKept = event.target.checked; } }),
      ` ${surface.name}${surface.area === undefined ? '' : `, ${showNumber(surface.area)}`}${surface.confidence === undefined || surface.confidence === null ? '' : `, confidence ${showNumber(surface.confidence, 2)}`}`))));
  }

  colorOf(index) { return PICK_COLORS[index % PICK_COLORS.length]; }

  /** Calls `draw` with the points and the colour of each stick, in space. */
  lines(draw) {
    this.surfaces.forEach((surface, index) => surface.sticks.forEach(stick => draw(stick.points, this.colorOf(index))));
  }

  draw(section, context) {
    this.surfaces.forEach((surface, index) => surface.sticks.forEach(stick => {
      const isHere = section.across === null || (stick.across === section.across && Math.abs(stick.at - section.at) < 1.5);
      const crossing = stick.points.filter(point => section.across === null || Math.abs(point[section.across] - section.at) < 1.5);
      const pixels = (isHere ? stick.points : crossing).map(point => section.toPixel(point[section.u], point[section.v]));
      if (isHere && pixels.length > 1) {
        context.beginPath();
        pixels.forEach((pixel, i) => (i ? context.lineTo(...pixel) : context.moveTo(...pixel)));
        context.strokeStyle = this.colorOf(index);
        context.lineWidth = 2.5 * section.ratio;
        context.stroke();
      }
      for (const pixel of pixels) section.disc(context, pixel, isHere ? 4 : 3, this.colorOf(index));
    }));
  }
}
