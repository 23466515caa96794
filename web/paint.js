// Units: paint that flows from seeds, names, colours, and their volumes.

/** Names and colours of units, and the table of their volumes. */
class Units {
  constructor(bench) {
    this.bench = bench;
    this.reset();
  }

  reset() { this.known = {}; }

  nameOf(number) { return this.known[number]?.name || `unit ${number}`; }

  colorOf(number) { return this.known[number]?.color || unitColor(number); }

  set(number, changes) {
    this.known[number] = { ...this.known[number], ...changes };
    this.bench.paletteVersion++;
    this.bench.redraw();
    this.bench.changed?.();
  }

  /** Returns the seeds of the last action that painted, as [point, number], or its word `auto` or `blocks`, and its other options. */
  painted() {
    const line = this.bench.session.done.findLast(text => text.startsWith(`paint ${MESH} `) || text.startsWith('mesh '));
    const words = line?.startsWith('paint ') ? line.split(' ') : [];
    const seeds = words.filter((_, i) => words[i - 1] === '--seed');
    const word = seeds.find(seed => seed === 'auto' || seed === 'blocks') || null;
    return { word, seeds: word ? [] : seeds.map(seed => seed.split('=')).map(([point, number]) => [point, +number]) };
  }

  /** Returns the units of the mesh: number, cells, volume. */
  totals() {
    const { mesh } = this.bench;
    const [region, volume] = [mesh.cellArrays.region, mesh.cellArrays.volume || mesh.cellArrays.area];
    const sums = new Map();
    for (let cell = 0; region && cell < mesh.cellCount; cell++) {
      const number = Math.round(region[cell]);
      if (number <= 0) continue;
      const sum = sums.get(number) || [0, 0];
      sum[0]++;
      sum[1] += volume ? volume[cell] : 0;
      sums.set(number, sum);
    }
    return [...sums].sort((a, b) => a[0] - b[0]);
  }

  /** Fills the table. */
  refresh() {
    const { bench } = this;
    const totals = this.totals();
    const unit = bench.frame && bench.frame.units.every(u => u && u === bench.frame.units[0]) ? `${bench.frame.units[0]}${bench.mesh.size === 3 ? '³' : '²'}` : '';
    const row = ([number, [cells, volume]]) => make('tr', {},
      make('td', {}, make('input', { type: 'color', value: this.colorOf(number), 'aria-label': `Colour of ${this.nameOf(number)}`, onchange: event => this.set(number, { color: event.target.value }) })),
      make('td', {}, make('input', { className: 'name', value: this.nameOf(number), 'aria-label': `Name of unit ${number}`, onchange: event => this.set(number, { name: event.target.value.trim() }) })),
      make('td', { className: 'number' }, showNumber(volume)),
      make('td', { className: 'number' }, String(cells)),
      make('td', {}, make('input', { type: 'checkbox', checked: !bench.hiddenUnits.has(number), 'aria-label': `Show ${this.nameOf(number)}`,
        onchange: event => { bench.hiddenUnits[event.target.checked ? 'delete' : 'add'](number); bench.redraw(); } })));
    document.getElementById('unit-rows').replaceChildren(...totals.map(row));
    document.getElementById('volume-unit').textContent = unit ? ` [${unit}]` : '';
    document.getElementById('no-units').hidden = totals.length > 0;
    for (const id of ['unit', 'merge-from', 'merge-into']) {
      const select = document.getElementById(id);
      const chosen = select.value;
      const options = totals.map(([number]) => make('option', { value: String(number) }, this.nameOf(number)));
      if (id === 'unit') options.unshift(make('option', { value: '' }, 'a new unit'));
      select.replaceChildren(...options);
      if ([...select.options].some(option => option.value === chosen)) select.value = chosen;
    }
  }
}

/** Paints: a click starts a unit, or continues the chosen one; with Shift it removes the nearest seed. */
class PaintTool {
  constructor(bench) {
    this.bench = bench;
    const id = name => document.getElementById(name);
    id('paint-blocks').onclick = () => this.run(['--seed', 'blocks'], 'Painting fault blocks …');
    id('paint-auto').onclick = () => this.run(['--seed', 'auto'], 'Painting every block …');
    id('merge').onclick = () => this.merge(+id('merge-from').value, +id('merge-into').value);
    id('clear-paint').onclick = () => this.removeLast();
  }

  options() {
    const id = name => document.getElementById(name);
    const words = [];
    const [neck, level] = ['neck', 'level'].map(name => parseNumber(id(name).value));
    if (Number.isFinite(neck)) words.push('--neck', String(neck));
    if (Number.isFinite(level)) words.push('--level', String(level));
    if (id('paint-image').checked) words.push('--image', this.bench.image);
    return words;
  }

  async run(seeds, text) {
    const { bench } = this;
    if (bench.mesh.isEmpty) return bench.say('Make a mesh first.', true);
    bench.show.color = 'units';
    bench.fillControls();
    return bench.act(['paint', MESH, '-o', MESH, ...seeds, ...this.options()], text);
  }

  words(seeds) { return seeds.flatMap(([point, number]) => ['--seed', `${point}=${number}`]); }

  /** Paints from a place. */
  paint(point) {
    const { bench } = this;
    const { seeds } = bench.units.painted();
    const chosen = +document.getElementById('unit').value;
    const number = chosen || 1 + Math.max(0, ...seeds.map(seed => seed[1]));
    return this.run(this.words([...seeds, [bench.frame.pointText(point), number]]), 'Painting …');
  }

  /** Makes one unit of two. */
  merge(from, into) {
    const { seeds, word } = this.bench.units.painted();
    if (word) return this.bench.say(`These units were painted by ${word}; paint them by clicks to merge them.`, true);
    if (!from || !into || from === into) return this.bench.say('Choose two different units.', true);
    return this.run(this.words(seeds.map(([point, number]) => [point, number === from ? into : number])), 'Merging …');
  }

  /** Paints without the last seed. */
  removeLast() {
    const { seeds } = this.bench.units.painted();
    if (seeds.length < 2) return this.bench.say('Use Undo to remove the only seed.', true);
    return this.run(this.words(seeds.slice(0, -1)), 'Painting …');
  }

  press(section, point) { if (section.isInside(point)) this.paint(point); }

  hit({ point }) { this.paint(point); }

  enter(section, point) { this.paint(point); }

  /** Shows the cell under the mouse, and the seeds near the section. */
  draw(section, context) {
    const { bench } = this;
    if (bench.toolName !== 'paint' || bench.mesh.isEmpty) return;
    const point = section.hover || bench.cursor;
    const cell = bench.mesh.cellAt(point);
    const polygon = cell >= 0 && section.polygonOf(cell);
    if (polygon && (section.hover || document.activeElement === section.top)) {
      context.beginPath();
      polygon.forEach((pixel, i) => (i ? context.lineTo(...pixel) : context.moveTo(...pixel)));
      context.closePath();
      context.fillStyle = '#ffffff99';
      context.fill();
      context.strokeStyle = '#000000';
      context.lineWidth = 1.5 * section.ratio;
      context.stroke();
    }
    for (const [text, number] of bench.units.painted().seeds) {
      const index = bench.frame.toIndex(text.split(',').map(Number));
      if (section.across !== null && Math.abs(index[section.across] - section.at) > 3) continue;
      section.disc(context, section.toPixel(index[section.u], index[section.v]), 5, bench.units.colorOf(number));
    }
  }
}
