// State of the page, and its response to keys, pointers and controls.

const element = id => document.getElementById(id);
const facts = JSON.parse(element('facts').textContent);
const frame = facts.frame;
const flat = frame.flat = facts.dimensions === 2;
const page = {
  flat, facts, ratio: 1, picked: null, range: [0, 1], array: null, palette: null, kindsShown: [],
  cut: { at: [facts.steps, facts.steps, facts.steps], turned: [false, false, false], mode: 'corner' },
  view: {}, look: {}, ready: false, frames: 0, firstFrame: null,
  dark: matchMedia('(prefers-color-scheme: dark)').matches,
};
// Scripts that inspect the page, such as its tests, use this object.
window.atomesh = page;

const firstView = () => ({
  yaw: flat ? 0 : 0.55, pitch: flat ? Math.PI / 2 : 0.42, zoom: 1, move: [0, 0],
  stretch: 1, down: frame.down,
});
const DARK = { line: [0.06, 0.08, 0.1, 0.75], box: [0.45, 0.5, 0.56, 1], ground: [18, 22, 26] };
const LIGHT = { line: [0.1, 0.13, 0.16, 0.6], box: [0.55, 0.6, 0.65, 1], ground: [238, 241, 244] };

let scene = null, labels = null, mesh = null, asked = false, stale = true;

/** Requests one redraw in the next frame. */
function redraw(rebuild = false) {
  stale = stale || rebuild;
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; if (scene) show(); });
}

function way() {
  const { rows, size } = projection(frame, page.view);
  const canvas = scene.canvas;
  const bounds = [0, 1].map(k => rows[k].slice(0, 3).reduce((sum, c) => sum + Math.abs(c), 0));
  // Margins for axes and their numbers, and for legends on the left or below.
  const narrow = canvas.width / page.ratio < 600;
  const axes = narrow ? [84, 60] : [130, 90];
  const legends = narrow ? [26, 130] : [110, flat ? 20 : 0];
  const room = axes.map((c, k) => (c + legends[k]) * page.ratio);
  page.aside = legends.map(c => c * page.ratio / 2);
  page.fit = page.fit || Math.min((canvas.width - room[0]) / bounds[0], (canvas.height - room[1]) / bounds[1]);
  const scale = page.fit * page.view.zoom;
  const moved = rows.map((row, k) => row.map((c, i) => c * scale + (i === 3 && k < 2 ? page.view.move[k] * scale + page.aside[k] : 0)));
  return { rows: moved, scale, halfSize: [canvas.width / 2, canvas.height / 2, Math.max(size * scale, 1)] };
}

function show() {
  if (resized()) page.fit = 0;
  if (stale) {
    scene.build(page.cut, page.colorOfCell, page.colorOfSurface);
    page.triangles = scene.cells.triangles.count;
    page.visibleFaces = scene.visibleFaces;
    stale = false;
  }
  const theme = page.dark ? DARK : LIGHT;
  page.look = {
    ...theme,
    cells: element('cells').checked, painted: page.painted, features: element('features').checked,
    line: !element('edges').checked ? [0, 0, 0, 0] : page.painted ? facts.image.line.map(c => c / 255) : theme.line,
    featureLine: element('edges').checked ? [...theme.line.slice(0, 3), 0.3] : [0, 0, 0, 0],
    lineWidth: 0.55 * page.ratio,
    sections: page.sections(),
  };
  page.way = way();
  scene.draw(page.way, page.look);
  labels.draw(page, page.way);
  if (page.frames++ === 0) page.firstFrame = performance.now();
}

/** Fits the canvases to the window. */
function resized() {
  page.ratio = Math.min(devicePixelRatio || 1, 2);
  const stage = element('stage');
  const [width, height] = [stage.clientWidth, stage.clientHeight].map(c => Math.max(1, Math.round(c * page.ratio)));
  if (scene.canvas.width === width && scene.canvas.height === height) return false;
  for (const canvas of [scene.canvas, labels.canvas]) { canvas.width = width; canvas.height = height; }
  return true;
}

// Colours.

/** Returns the names and colours of the integer values of an array, if there are few. */
function categories(array) {
  if (!array.whole || array.high - array.low > 5000) return null;
  const words = [...new Set(array.words)].filter(word => word !== 65535).sort((a, b) => a - b);
  if (words.length > DISTINCT.length || words.length === 0) return null;
  return words.map((word, i) => {
    const value = array.low + array.step * word;
    return { word, color: DISTINCT[i % DISTINCT.length], name: array.names[value] || String(value), short: String(value) };
  });
}

/** Menu entry that paints cells with the image itself. No array has this name. */
const PAINTED = '\u0000image';

function chooseColor(name) {
  const array = mesh.arrays.find(array => array.name === name) || null;
  page.array = array;
  page.painted = name === PAINTED;
  page.range = array ? [array.low, array.high] : [0, 1];
  element('range').hidden = !array || !!array.categories;
  element('color').value = name;
  if (array) { element('low').value = Number(array.low.toPrecision(5)); element('high').value = Number(array.high.toPrecision(5)); }
  recolor();
}

function recolor() {
  const { array } = page;
  const plain = page.dark ? PLAIN.dark : PLAIN.light;
  if (!array) page.colorOfCell = () => plain;
  else if (array.categories) {
    const byWord = new Map(array.categories.map(c => [c.word, c.color]));
    page.colorOfCell = cell => byWord.get(array.words[cell]) || NO_VALUE;
  } else {
    const [low, high] = page.range;
    const table = Array.from({ length: 256 }, (_, i) => ramp(i / 255));
    page.colorOfCell = cell => {
      const value = valueOf(array, cell);
      if (Number.isNaN(value)) return NO_VALUE;
      const share = high > low ? (value - low) / (high - low) : 0.5;
      return table[Math.round(255 * Math.min(Math.max(share, 0), 1))];
    };
  }
  page.colorOfSurface = number => colorOfSurface(facts.surfaces[number - 1], number);
  drawHistogram(array || (facts.about.report.quality ? null : mesh.arrays.find(other => /^(volume|area)$/.test(other.name))), facts.about.report);
  redraw(true);
}

// Controls.

function slider(parent, name, max, value, change) {
  const row = document.createElement('label');
  row.className = 'row';
  const label = document.createElement('span'), input = document.createElement('input'), output = document.createElement('output');
  label.className = 'name';
  label.textContent = label.title = name;
  Object.assign(input, { type: 'range', min: 0, max, step: 1, value });
  input.setAttribute('aria-label', `${parent.id === 'cuts' ? 'Cut along' : 'Section across'} ${name}`);
  row.append(label, input, output);
  parent.append(row);
  input.addEventListener('input', () => change(Number(input.value)));
  return { row, input, output };
}

function makeControls() {
  const { steps } = facts;
  const axes = flat ? [0, 1] : [0, 1, 2];
  page.cutSliders = axes.map(k => {
    const part = slider(element('cuts'), frame.names[k], steps, page.cut.at[k], at => setCut(k, at));
    const turn = document.createElement('button');
    turn.className = 'turn';
    turn.textContent = '⇄';
    turn.title = `Cut from the other side of ${frame.names[k]}`;
    turn.addEventListener('click', event => { event.preventDefault(); page.cut.turned[k] = !page.cut.turned[k]; setCut(k, steps - page.cut.at[k] || page.cut.at[k]); });
    part.row.append(turn);
    return part;
  });
  if (facts.image) {
    element('sections').replaceChildren();
    page.sectionSliders = (flat ? [2] : [0, 1, 2]).map(k => {
      const count = facts.image.samples[k];
      const part = slider(element('sections'), flat ? 'image' : frame.names[k], Math.max(count - 1, 1), Math.floor(count / 2), () => { part.box.checked = true; sectionsMoved(); redraw(); });
      part.box = document.createElement('input');
      part.box.type = 'checkbox';
      part.box.checked = flat;
      part.box.setAttribute('aria-label', `Show the image${flat ? '' : ' across ' + frame.names[k]}`);
      part.box.addEventListener('change', () => redraw());
      part.row.prepend(part.box);
      if (flat) { part.input.hidden = true; part.output.hidden = true; }
      part.axis = k;
      return part;
    });
    sectionsMoved();
  } else {
    element('image-section').hidden = true;
    page.sectionSliders = [];
  }
  page.sections = () => page.sectionSliders.filter(part => part.box.checked)
    .map(part => ({ axis: part.axis, share: flat ? 0 : Number(part.input.value) / Number(part.input.max) }));

  const choices = mesh.arrays.map(array => [array.name, array.name]);
  choices.unshift(['', 'features only']);
  if (facts.image) choices.unshift([PAINTED, 'the image']);
  element('color').replaceChildren(...choices.map(([value, text]) => {
    const option = document.createElement('option');
    option.value = value;
    option.textContent = text;
    return option;
  }));
  element('color').addEventListener('change', event => chooseColor(event.target.value));
  for (const [i, id] of ['low', 'high'].entries()) {
    element(id).addEventListener('change', event => { const value = Number(event.target.value); if (Number.isFinite(value)) { page.range[i] = value; recolor(); } });
  }
  for (const id of ['cells', 'edges', 'features']) element(id).addEventListener('change', () => redraw());
  element('cut-mode').addEventListener('change', event => { page.cut.mode = event.target.value; redraw(true); });
  element('stretch').addEventListener('input', event => {
    page.view.stretch = 2 ** Number(event.target.value);
    element('stretch-value').textContent = written(page.view.stretch, 0.01);
    page.fit = 0;
    redraw();
  });
  element('stretch-label').hidden = flat;
  element('down').addEventListener('change', event => { page.view.down = event.target.checked; redraw(); });
  element('reset').addEventListener('click', reset);
  element('picture').addEventListener('click', picture);
  element('theme').addEventListener('click', () => { page.dark = !page.dark; themed(); });
  element('fold').addEventListener('click', fold);
  if (!page.kindsShown.length) { element('features').checked = false; element('features-label').hidden = true; }
  element('kinds').replaceChildren(...page.kindsShown.map(([name, [color], count]) => {
    const line = document.createElement('div'), swatch = document.createElement('span');
    swatch.className = 'swatch';
    swatch.style.background = css(color);
    line.append(swatch, `${written(count)} ${name}${count === 1 ? '' : 's'}`);
    return line;
  }));
}

function setCut(k, at) {
  page.cut.at[k] = Math.min(Math.max(at, 0), facts.steps);
  const { input, output } = page.cutSliders[k];
  input.value = page.cut.at[k];
  const whole = page.cut.at[k] >= facts.steps;
  const share = page.cut.turned[k] ? 1 - page.cut.at[k] / facts.steps : page.cut.at[k] / facts.steps;
  const ruler = frame.rulers[k];
  output.textContent = whole ? 'off' : written(readOff(ruler, share), roundStep(ruler.last - ruler.first, 400));
  redraw(true);
}

function sectionsMoved() {
  for (const part of page.sectionSliders) {
    if (flat) continue;
    const ruler = frame.rulers[part.axis];
    part.output.textContent = written(readOff(ruler, Number(part.input.value) / Number(part.input.max)), roundStep(ruler.last - ruler.first, 400));
  }
}

function reset() {
  page.view = firstView();
  page.fit = 0;
  page.picked = null;
  element('picked').hidden = true;
  element('stretch').value = 0;
  element('stretch-value').textContent = '1';
  element('down').checked = page.view.down;
  page.cut.turned = [false, false, false];
  // In 3-D, a corner that faces the first view is cut open: half of each axis.
  const half = Math.round(facts.steps / 2);
  const towards = projection(frame, page.view).rows[2];
  for (let k = 0; k < (flat ? 2 : 3); k++) {
    page.cut.turned[k] = !flat && towards[k] < 0;
    setCut(k, flat ? facts.steps : half);
  }
  redraw(true);
}

function fold() {
  const folded = element('panel').classList.toggle('folded');
  element('fold').setAttribute('aria-expanded', String(!folded));
  redraw();
}

function themed() {
  document.documentElement.dataset.theme = page.dark ? 'dark' : 'light';
  if (scene) recolor();
}

/** Saves the picture with all labels as a file. */
function picture() {
  show();
  const canvas = document.createElement('canvas');
  Object.assign(canvas, { width: scene.canvas.width, height: scene.canvas.height });
  const pen = canvas.getContext('2d');
  pen.drawImage(scene.canvas, 0, 0);
  pen.drawImage(labels.canvas, 0, 0);
  pen.font = `${13 * page.ratio}px system-ui, "DejaVu Sans", sans-serif`;
  pen.fillStyle = labels.ink;
  pen.fillText(`${facts.about.title} — ${element('subtitle').textContent}`, 12 * page.ratio, 20 * page.ratio);
  page.lastPicture = canvas;
  canvas.toBlob(blob => {
    const link = document.createElement('a');
    link.href = URL.createObjectURL(blob);
    link.download = `${facts.about.title.replace(/[^\w.-]+/g, '-')}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }, 'image/png');
}

/** Shows the cell, the values and the position at a point of the stage. */
function ask(x, y) {
  const point = [(x - element('stage').clientWidth / 2) * page.ratio, (element('stage').clientHeight / 2 - y) * page.ratio];
  const found = scene.pick(...point, page.way, page.look);
  page.picked = found && { ...found, cell: found.kind === 'image' ? undefined : found.cell };
  element('picked').hidden = !found;
  if (found) fill(element('picked-table'), numbersAt(found));
  redraw();
}

const ONE = { tetrahedra: 'Tetrahedron', triangles: 'Triangle', polyhedra: 'Polyhedron', polygons: 'Polygon' };

function numbersAt({ kind, face, cell, place }) {
  const rows = [];
  if (kind !== 'image') rows.push([ONE[facts.cells], `number ${written(mesh.numbers[cell])}`]);
  const surface = kind !== 'image' && mesh.surfaces[face];
  if (surface) {
    rows.push(['Face on', `${facts.surfaces[surface - 1] || 'feature'}, surface ${surface}`]);
    if (mesh.beyond[face] >= 0) rows.push(['Cells beside it', `${written(mesh.numbers[mesh.owner[face]])}, ${written(mesh.numbers[mesh.beyond[face]])}`]);
  }
  worldOf(frame, place).slice(0, facts.dimensions).forEach((c, k) => {
    const reach = frame.edges.reduce((sum, edge) => sum + Math.abs(edge[k]), 0);
    rows.push([`${'xyz'[k]}${frame.units[k] ? ` [${frame.units[k]}]` : ''}`, written(c, roundStep(reach, 2000))]);
  });
  rows.push(['Sample', place.slice(0, facts.dimensions).map((p, k) => written(p * frame.samples[k], 0.1)).join(', ')]);
  if (facts.image) rows.push(['Image here', written(scene.imageAt(place), roundStep(facts.image.high - facts.image.low, 250))]);
  if (kind !== 'image') {
    for (const array of mesh.arrays) {
      const value = valueOf(array, cell);
      const name = array.names[value];
      rows.push([array.unit ? `${array.name} [${array.unit}]` : array.name, name ? `${value}, ${name}` : written(value, array.whole ? undefined : roundStep(array.high - array.low, 9999))]);
    }
  }
  return rows;
}

// Pointers and keys.

function turn(dx, dy) {
  page.view.yaw -= dx;
  page.view.pitch = Math.min(Math.max(page.view.pitch + dy, -Math.PI / 2), Math.PI / 2);
  redraw();
}

function move(dx, dy) {
  page.view.move[0] += dx * page.ratio / page.way.scale;
  page.view.move[1] -= dy * page.ratio / page.way.scale;
  redraw();
}

/** Zooms around a point of the stage. */
function zoom(factor, x, y) {
  const before = page.view.zoom;
  page.view.zoom = Math.min(Math.max(before * factor, 0.2), 200);
  const grown = page.view.zoom / before;
  const stage = element('stage');
  const off = [x - stage.clientWidth / 2, stage.clientHeight / 2 - y].map((c, k) => (c * page.ratio - page.aside[k]) / (page.fit * page.view.zoom));
  page.view.move = page.view.move.map((m, k) => m + off[k] * (1 - grown));
  redraw();
}

function listen() {
  const stage = labels.canvas;
  const fingers = new Map();
  let travelled = 0;
  const at = event => { const box = stage.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  stage.addEventListener('pointerdown', event => {
    stage.setPointerCapture(event.pointerId);
    if (fingers.size === 0) travelled = 0;
    fingers.set(event.pointerId, at(event));
  });
  stage.addEventListener('pointermove', event => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const now = at(event);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    travelled += Math.abs(dx) + Math.abs(dy);
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = p => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(apart(now) / Math.max(apart(before), 1), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
      move(dx / 2, dy / 2);
    } else if (flat || event.shiftKey || event.buttons === 2 || event.buttons === 4) move(dx, dy);
    else turn(dx * 0.008, dy * 0.008);
    fingers.set(event.pointerId, now);
  });
  const lifted = event => {
    const place = fingers.get(event.pointerId);
    fingers.delete(event.pointerId);
    if (place && fingers.size === 0 && travelled < 5 && event.type === 'pointerup' && event.button === 0) ask(...place);
  };
  stage.addEventListener('pointerup', lifted);
  stage.addEventListener('pointercancel', lifted);
  stage.addEventListener('contextmenu', event => event.preventDefault());
  stage.addEventListener('wheel', event => { event.preventDefault(); zoom(Math.exp(-event.deltaY * 0.0015), ...at(event)); }, { passive: false });
  document.addEventListener('keydown', pressed);
  new ResizeObserver(() => redraw()).observe(element('stage'));
}

const SIDES = [[0, 0], [Math.PI / 2, 0], [Math.PI, 0], [-Math.PI / 2, 0], [0, Math.PI / 2], [0, -Math.PI / 2]];

function pressed(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  // Controls handle the keys that they use themselves.
  if (/^(INPUT|SELECT|SUMMARY|BUTTON)$/.test(event.target.tagName) && (event.key.length > 1 || event.target.type === 'number' || event.target.tagName === 'SELECT')) return;
  const stage = element('stage');
  const middle = [stage.clientWidth / 2, stage.clientHeight / 2];
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[key];
  const toggles = { m: 'cells', e: 'edges', f: 'features' };
  if (arrows && (flat || event.shiftKey)) move(-30 * arrows[0], -30 * arrows[1]);
  else if (arrows) turn(0.1 * arrows[0], 0.1 * arrows[1]);
  else if (key === '+' || key === '=') zoom(1.2, ...middle);
  else if (key === '-' || key === '_') zoom(1 / 1.2, ...middle);
  else if (key === 'Enter') ask(...middle);
  else if (!flat && '123456'.includes(key)) { [page.view.yaw, page.view.pitch] = SIDES[Number(key) - 1]; redraw(); }
  else if ('xyz'.includes(key) && page.cutSliders['xyz'.indexOf(key)]) {
    const k = 'xyz'.indexOf(key);
    const step = Math.max(1, Math.round(facts.steps / 32));
    setCut(k, page.cut.at[k] + (event.shiftKey ? step : -step));
  } else if (toggles[key]) { element(toggles[key]).click(); }
  else if (key === 'i') { const on = !page.sectionSliders.some(part => part.box.checked); page.sectionSliders.forEach(part => { part.box.checked = on; }); redraw(); }
  else if (key === 'c') { const options = [...element('color').options]; chooseColor(options[(element('color').selectedIndex + 1) % options.length].value); }
  else if (key === 'r') reset();
  else if (key === 'p') picture();
  else if (key === 'd') { page.dark = !page.dark; themed(); }
  else if (key === 'h') fold();
  else return;
  event.preventDefault();
}

/** Returns notes about parts of the mesh that the page does not show. */
function shortfalls() {
  const { faces, kept } = facts.counts;
  if (!facts.thinned) return [];
  return [`Thinned to fit into a page: the cut has ${facts.steps - 1} positions along each axis, and the page has only the faces that one of these shows, ${grouped(kept)} of ${grouped(faces)}. Every cell that is shown is a cell of the mesh.`];
}

async function start() {
  themed();
  const notes = shortfalls();
  fillPanel(facts, notes);
  const { counts } = facts;
  element('subtitle').textContent = `${grouped(counts.nodes)} nodes, ${grouped(counts.cells)} ${facts.cells}${notes.length ? ' (thinned)' : ''}`;
  if (innerWidth <= 720) fold();
  mesh = await unpack(facts, element('data').textContent.trim());
  element('data').remove();
  for (const array of mesh.arrays) array.categories = categories(array);
  const counted = new Map();
  for (const kind of facts.surfaces.slice(0, facts.large_surfaces)) counted.set(kind, (counted.get(kind) || 0) + 1);
  page.kindsShown = [...counted].map(([kind, count]) => [kind, (KINDS[kind] || KINDS.fault).slice(0, 3), count]);
  page.mesh = mesh;
  scene = new Scene(element('scene'), facts, mesh);
  page.palette = scene.palette;
  labels = new Labels(element('labels'), facts, mesh);
  page.view = firstView();
  makeControls();
  reset();
  listen();
  element('message').textContent = '';
  chooseColor(facts.image ? PAINTED : '');
  page.ready = true;
}

start().catch(error => { element('message').textContent = error.message; console.error(error); });
