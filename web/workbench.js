// The workbench: sections and body of one image and its mesh, one cursor, tools, and the history of actions.

const MESH = 'mesh.vtu';
const FLOW = 'flow.vtu';

/** Returns the number of a text, with a point or a decimal comma; NaN if it is none. */
const parseNumber = text => (/^\s*[-+]?(\d+([.,]\d*)?|[.,]\d+)(e[-+]?\d+)?\s*$/i.test(text) ? parseFloat(text.replace(',', '.')) : NaN);

/** Formats a number with the decimal sign of the reader. */
const showNumber = (value, digits = 4) =>
  (Number.isFinite(value) ? value.toLocaleString(undefined, { maximumSignificantDigits: digits, useGrouping: false }) : '–');

/** Makes an element with attributes, listeners (names that begin with `on`) and children. */
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith('on')) element.addEventListener(name.slice(2), value);
    else if (name in element && name !== 'list') element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** The frame of an image, with the words for its axes. */
class ImageFrame extends Frame {
  constructor(info) {
    super(info.image);
    this.isScan = this.units.length === 3 && this.units.every(unit => unit === 'mm');
    const spread = Math.max(...this.spacing) / Math.min(...this.spacing);
    this.isIsotropic = this.units.every(unit => unit === this.units[0]) && spread < 8;
  }

  /** Returns the name of the section across an axis. */
  sectionName(axis) {
    if (this.isScan) return ['sagittal', 'coronal', 'axial'][axis];
    return this.names[axis];
  }

  /** Returns the coordinate of a slice: the physical one if the axis is along a coordinate, else the index. */
  sliceText(axis, index) {
    const step = this.steps[axis];
    const along = step.findIndex((c, k) => c !== 0 && step.every((other, j) => j === k || other === 0));
    if (along < 0) return String(Math.round(index));
    return `${showNumber(this.origin[along] + Math.round(index) * step[along], 7)}${this.units[along] ? ` ${this.units[along]}` : ''}`;
  }

  /** Returns a place in physical coordinates for people. */
  placeText(index) {
    return this.toPhysical(index).map((c, k) => `${showNumber(c, 7)}${this.units[k] ? ` ${this.units[k]}` : ''}`).join('; ');
  }
}

class Bench {
  constructor(session, element, say) {
    Object.assign(this, { session, element, say, frame: null, samples: null, sections: [], body: null, models: {}, tools: {}, tool: {} });
    this.units = new Units(this);
    this.hiddenUnits = new Set();
    this.paletteVersion = 0;
    this.show = { map: 'grey', gain: 1, low: 0, high: 1, edges: true, features: true, units: true, cells: true, cut: true, slices: true, color: 'units', opacity: 0.45 };
    this.pictures = new Map();
    this.dirty = { all: false, top: false, body: false };
    this.actions = [];
    this.measures = {};
  }

  /** Shows an image. `samples` has its dims and values, or is null if the image is too large to show. */
  open(info, image, samples) {
    this.frame = new ImageFrame(info);
    Object.assign(this, { info, image, samples, models: {}, pictures: new Map() });
    this.cursor = this.frame.dims.map(n => (n - 1) >> 1);
    this.units.reset();
    this.hiddenUnits.clear();
    if (samples) this.setRange();
    this.body = this.frame.dims.length === 3 ? new Body(this) : null;
    this.sections = (this.body ? [2, 1, 0] : [null]).map(across => new Section(this, across));
    const views = document.getElementById('views');
    views.replaceChildren(...this.sections.map(section => section.element), ...(this.body ? [this.body.element] : []));
    views.classList.toggle('flat', !this.body);
    for (const label of document.querySelectorAll('.space')) label.hidden = !this.body;
    this.tools = { look: new LookTool(this), paint: new PaintTool(this), edit: new EditTool(this), picks: new PickTool(this), flow: new FlowTool(this) };
    this.choose('look');
    this.fillControls();
    this.refresh();
    this.redraw();
  }

  /** Sets the range of values that the colours show. */
  setRange() {
    const { values } = this.samples;
    const step = Math.max(1, Math.floor(values.length / 50000));
    const sorted = values.filter((value, i) => i % step === 0 && Number.isFinite(value)).sort();
    const at = share => sorted[Math.floor(share * (sorted.length - 1))] ?? 0;
    [this.show.low, this.show.high] = [at(0.01), at(0.99)];
    if (this.show.low === this.show.high) this.show.high = this.show.low + 1;
    if (at(0.25) < 0 && at(0.75) > 0) {
      const size = Math.max(-this.show.low, this.show.high);
      [this.show.low, this.show.high] = [-size, size];
    }
  }

  get meshName() { return this.show.color === 'pressure' && this.models[FLOW] ? FLOW : MESH; }

  /** The mesh that is shown; an empty one if there is none. */
  get mesh() { return this.models[this.meshName] || (this.models[MESH] ??= new MeshModel(this.frame)); }

  get background() { return matchMedia('(prefers-color-scheme: dark)').matches ? [0.07, 0.086, 0.1] : [0.93, 0.945, 0.957]; }

  // Pictures of slices.

  /** Returns a canvas with the samples of a slice in the colours of the map. */
  slicePicture(across, at, u, v) {
    if (!this.samples) return null;
    const { dims, values } = this.samples;
    const { map, low, high, gain } = this.show;
    const key = [map, low, high, gain, at].join(' ');
    const known = this.pictures.get(across);
    if (known?.key === key) return known.canvas;
    const canvas = known?.canvas || document.createElement('canvas');
    if (canvas.width !== dims[u] || canvas.height !== dims[v]) [canvas.width, canvas.height] = [dims[u], dims[v]];
    const context = canvas.getContext('2d');
    const picture = context.createImageData(dims[u], dims[v]);
    const pixels = new Uint32Array(picture.data.buffer);
    const table = colorTable(map);
    const colors = Uint32Array.from({ length: 256 }, (_, i) => 0xff000000 | table[3 * i + 2] << 16 | table[3 * i + 1] << 8 | table[3 * i]);
    const none = 0xff000000 | NO_SAMPLE[2] << 16 | NO_SAMPLE[1] << 8 | NO_SAMPLE[0];
    const strides = dims.map((_, k) => dims.slice(0, k).reduce((product, n) => product * n, 1));
    const start = across === null ? 0 : at * strides[across];
    const middle = (low + high) / 2;
    const factor = 255 * gain / (high - low);
    for (let j = 0, i = 0; j < dims[v]; j++) {
      for (let k = 0, sample = start + j * strides[v]; k < dims[u]; k++, i++, sample += strides[u]) {
        const value = values[sample];
        pixels[i] = value === value ? colors[Math.min(255, Math.max(0, 127.5 + (value - middle) * factor)) | 0] : none;
      }
    }
    context.putImageData(picture, 0, 0);
    this.pictures.set(across, { key, canvas });
    return canvas;
  }

  /** Returns the sample nearest to a point. */
  sampleAt(point) {
    if (!this.samples) return NaN;
    const { dims, values } = this.samples;
    let [at, stride] = [0, 1];
    for (let k = 0; k < dims.length; k++) {
      at += stride * Math.min(dims[k] - 1, Math.max(0, Math.round(point[k])));
      stride *= dims[k];
    }
    return values[at];
  }

  /** Returns a function that returns the colour of a cell, or null for none; null if cells have no colours. */
  cellColoring(count) {
    const { mesh, show } = this;
    if (show.color === 'units') {
      const region = mesh.cellArrays.region;
      if (!region || !show.units) return null;
      return cell => { const number = Math.round(region[cell]); return number > 0 ? this.units.colorOf(number) : null; };
    }
    const name = show.color === 'angle' ? ['min_dihedral', 'min_angle'].find(array => mesh.cellArrays[array]) : show.color === 'pressure' ? 'pressure' : null;
    const values = name && (mesh.cellArrays[name] || mesh.nodeArrays[name]);
    if (!values) return null;
    const [low, high] = name === 'pressure' ? mesh.rangeOf(values, mesh.cellArrays[name] ? mesh.cellCount : mesh.nodeCount) : [0, 60];
    const table = colorTable(name === 'pressure' ? 'balance' : 'viridis');
    const colors = Array.from({ length: count }, (_, i) => {
      const k = Math.round(i / (count - 1) * 255);
      return hexOf([table[3 * k], table[3 * k + 1], table[3 * k + 2]]);
    });
    this.legend = [low, high, table];
    return cell => colors[Math.min(count - 1, Math.max(0, Math.floor((mesh.valueOf(name, cell) - low) / (high - low || 1) * count)))];
  }

  // The cursor.

  setCursor(point) {
    this.cursor = point.map((c, k) => Math.min(Math.max(c, 0), this.frame.dims[k] - 1));
    this.showPlace(this.cursor);
    this.redraw();
  }

  moveCursor(axis, value) {
    const point = this.cursor.slice();
    point[axis] = value;
    this.setCursor(point);
  }

  /** Shows coordinates, sample and unit of a place. */
  showPlace(point) {
    const { mesh } = this;
    const words = [this.frame.placeText(point), `value ${showNumber(this.sampleAt(point))}`];
    if (!mesh.isEmpty && mesh.cellArrays.region) {
      const cell = mesh.cellAt(point);
      const number = cell < 0 ? 0 : Math.round(mesh.cellArrays.region[cell]);
      if (number > 0) words.push(this.units.nameOf(number));
      if (cell >= 0 && mesh.nodeArrays.pressure) words.push(`${showNumber(mesh.valueOf('pressure', cell))} Pa`);
    }
    document.getElementById('place').textContent = words.join(' · ');
  }

  // Drawing, once a frame at most.

  redraw() { this.schedule('all'); }

  redrawTop() { this.schedule('top'); }

  redrawBody() { this.schedule('body'); }

  schedule(what) {
    const isWaiting = Object.values(this.dirty).some(Boolean);
    this.dirty[what] = true;
    if (!isWaiting) requestAnimationFrame(() => this.drawNow());
  }

  drawNow() {
    const { all, top, body } = this.dirty;
    this.dirty = { all: false, top: false, body: false };
    if (!this.frame || this.element.hidden) return;
    if (all) this.sections.forEach(section => section.draw());
    else if (top) this.sections.forEach(section => section.drawTop());
    if (all || body) this.body?.draw();
    this.drawnAt = performance.now();
  }

  // Actions.

  /** Runs a line of a script, applies what it changed, and shows its error if it fails. Returns the reply; null after an error. */
  async act(words, text) {
    return this.perform(() => this.session.run(words, { onLine: line => this.progress?.(line) }), text);
  }

  async perform(work, text) {
    const start = performance.now();
    this.say(text);
    // Long actions can be cancelled.
    const timer = setTimeout(() => this.setCancellable(true), 1000);
    try {
      const reply = await work();
      const answered = performance.now();
      if (reply.patch) this.apply(reply);
      this.redraw();
      await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
      this.measures = { program: answered - start, total: performance.now() - start, cells: reply.arrays?.cells?.length ?? 0 };
      this.say('');
      this.changed?.();
      return reply;
    } catch (error) {
      this.say(error.message.replace(/^error: /, ''), error.message !== 'cancelled');
      this.redraw();
      return null;
    } finally {
      clearTimeout(timer);
      this.setCancellable(false);
    }
  }

  setCancellable(isLong) {
    const row = document.getElementById('progress-row');
    if (isLong) document.getElementById('progress').removeAttribute('value');
    row.hidden = !isLong;
  }

  /** Applies what an action changed. */
  apply(reply) {
    const { patch } = reply;
    const model = this.models[patch.mesh] ??= new MeshModel(this.frame);
    if (patch.dimensions === 0) {
      delete this.models[patch.mesh];
    } else if (reply.arrays.cells.length > 0 || !model.isEmpty) {
      model.apply(reply);
    }
    this.lastReport = reply.report || this.lastReport;
    this.refresh();
  }

  async undo() { if (this.session.done.length > 1) await this.perform(() => this.session.undo(), 'Undoing …'); }

  async redo() { if (this.session.undone.length > 0) await this.perform(() => this.session.redo(), 'Redoing …'); }

  // The panel.

  choose(name) {
    if (this.tool.leave) this.tool.leave();
    this.tool = this.tools[name];
    this.toolName = name;
    for (const button of document.querySelectorAll('[data-tool]')) button.setAttribute('aria-pressed', String(button.dataset.tool === name));
    for (const panel of document.querySelectorAll('[data-panel]')) panel.hidden = panel.dataset.panel !== name;
    this.tool.enterPanel?.();
    this.redraw();
  }

  fillControls() {
    const { show } = this;
    const id = name => document.getElementById(name);
    id('map').value = show.map;
    id('low').value = showNumber(show.low);
    id('high').value = showNumber(show.high);
    id('gain').value = Math.log2(show.gain);
    for (const name of ['edges', 'features', 'units', 'cells', 'cut', 'slices']) id(`show-${name}`).checked = show[name];
    id('cell-color').value = show.color;
    id('opacity').value = show.opacity;
  }

  /** Updates everything in the panel that depends on the mesh and on the history. */
  refresh() {
    const { session, mesh } = this;
    const hasMesh = !mesh.isEmpty;
    for (const part of document.querySelectorAll('[data-needs-mesh]')) part.disabled = !hasMesh;
    document.getElementById('undo').disabled = session.done.length < 2;
    document.getElementById('redo').disabled = session.undone.length === 0;
    const item = (line, isUndone) => make('li', { className: isUndone ? 'undone' : '' }, make('code', {}, line));
    document.getElementById('history').replaceChildren(...session.done.map(line => item(line, false)), ...session.undone.map(line => item(line, true)));
    this.units.refresh();
    this.showQuality();
    for (const tool of Object.values(this.tools)) tool.refresh?.();
  }

  /** Shows the quality of the mesh. */
  showQuality() {
    const { mesh } = this;
    const table = document.getElementById('quality');
    const angles = mesh.cellArrays.min_dihedral || mesh.cellArrays.min_angle;
    if (mesh.isEmpty || !angles) return table.replaceChildren();
    let [least, poor, onFeature, features] = [Infinity, 0, 0, 0];
    for (let cell = 0; cell < mesh.cellCount; cell++) {
      if (angles[cell] < least) least = angles[cell];
      if (angles[cell] < (mesh.size === 3 ? 15 : 20)) poor++;
      const bits = (mesh.cellArrays.feature_faces || mesh.cellArrays.feature_edges)?.[cell] ?? 0;
      for (let k = 0; k <= mesh.size; k++) if (bits >> k & 1) features++;
    }
    onFeature = Math.round(features / 2);
    const rows = [['Nodes', mesh.nodeCount], ['Cells', mesh.cellCount], ['Smallest angle', `${showNumber(least, 3)}°`],
      [`Cells under ${mesh.size === 3 ? 15 : 20}°`, poor], ['Faces on features', onFeature], ...(this.tools.edit?.figures() || [])];
    table.replaceChildren(...rows.map(([name, value]) => make('tr', {}, make('th', { scope: 'row' }, name), make('td', {}, String(value)))));
  }

  listen() {
    const id = name => document.getElementById(name);
    for (const button of document.querySelectorAll('[data-tool]')) button.addEventListener('click', () => this.choose(button.dataset.tool));
    id('undo').addEventListener('click', () => this.undo());
    id('redo').addEventListener('click', () => this.redo());
    id('map').addEventListener('change', event => { this.show.map = event.target.value; this.redraw(); });
    const range = () => {
      const [low, high] = ['low', 'high'].map(name => parseNumber(id(name).value));
      const isRange = low < high;
      for (const name of ['low', 'high']) id(name).setAttribute('aria-invalid', String(!isRange));
      if (isRange) Object.assign(this.show, { low, high });
      this.redraw();
    };
    id('low').addEventListener('change', range);
    id('high').addEventListener('change', range);
    id('gain').addEventListener('input', event => { this.show.gain = 2 ** event.target.value; this.redraw(); });
    for (const name of ['edges', 'features', 'units', 'cells', 'cut', 'slices']) {
      id(`show-${name}`).addEventListener('change', event => { this.show[name] = event.target.checked; this.redraw(); });
    }
    id('cell-color').addEventListener('change', event => { this.show.color = event.target.value; this.refresh(); this.redraw(); });
    id('opacity').addEventListener('input', event => { this.show.opacity = +event.target.value; this.redraw(); });
    document.addEventListener('keydown', event => this.pressed(event));
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.redraw());
  }

  pressed(event) {
    if (this.element.hidden || !this.frame) return;
    const isText = /^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName) && !/^(range|checkbox|radio|button)$/.test(event.target.type || '');
    const key = event.key.toLowerCase();
    if ((event.ctrlKey || event.metaKey) && !isText && (key === 'z' || key === 'y')) {
      event.preventDefault();
      if (key === 'y' || event.shiftKey) this.redo();
      else this.undo();
      return;
    }
    if (isText || event.ctrlKey || event.metaKey || event.altKey) return;
    const tools = { l: 'look', p: 'paint', a: 'edit', k: 'picks', f: 'flow' };
    const toggles = { m: 'show-edges', t: 'show-features', u: 'show-units', c: 'show-cut' };
    if (tools[key] && !this.tool.key?.(null, event)) this.choose(tools[key]);
    else if (toggles[key]) document.getElementById(toggles[key]).click();
    else return;
    event.preventDefault();
  }
}

/** Looks: a click moves the cursor. */
class LookTool {
  constructor(bench) { this.bench = bench; this.isDown = false; }

  press(section, point) { this.isDown = true; this.bench.setCursor(point); }

  move(section, point) { if (this.isDown) this.bench.setCursor(point); }

  release() { this.isDown = false; }

  cancel() { this.isDown = false; }
}
