// Flow: sources and sinks by clicks, pressures on sides, faults open, closed or in between.

class FlowTool {
  constructor(bench) {
    Object.assign(this, { bench, points: [], report: null });
    const id = name => document.getElementById(name);
    id('run-flow').onclick = () => this.run();
    id('clear-flow').onclick = () => { this.points = []; this.refresh(); bench.redraw(); };
    id('flow-here').onclick = () => this.add(bench.cursor);
    const sides = id('sides');
    sides.replaceChildren(...bench.frame.dims.flatMap((_, k) => ['min', 'max'].map(end => {
      const side = `${'xyz'[k]}${end}`;
      return make('label', {}, `${side} (${bench.frame.names[k]}) `, make('input', { size: 8, placeholder: 'closed', 'data-side': side, inputMode: 'decimal' }));
    })));
  }

  add(point) {
    const kind = document.querySelector('input[name="flow-kind"]:checked').value;
    this.points.push({ kind, point });
    this.refresh();
    this.bench.redraw();
  }

  press(section, point) { if (section.isInside(point)) this.add(point); }

  hit({ point }) { this.add(point); }

  enter(section, point) { this.add(point); }

  key(section, event) {
    if (event.key !== 'Backspace' && event.key !== 'Delete') return false;
    this.points.pop();
    this.refresh();
    this.bench.redraw();
    return true;
  }

  words() {
    const { frame } = this.bench;
    const words = this.points.flatMap(({ kind, point }) => [`--${kind}`, frame.pointText(point)]);
    for (const input of document.querySelectorAll('[data-side]')) {
      const value = parseNumber(input.value);
      if (Number.isFinite(value)) words.push('--pressure', `${input.dataset.side}=${value}`);
    }
    const how = document.getElementById('faults').value;
    const factor = parseNumber(document.getElementById('fault-factor').value);
    words.push('--faults', how === 'factor' && Number.isFinite(factor) ? String(factor) : how === 'factor' ? '0.01' : how);
    return words;
  }

  async run() {
    const { bench } = this;
    if (!bench.models[MESH] || bench.models[MESH].isEmpty) return bench.say('Make a mesh first.', true);
    const reply = await bench.act(['flow', MESH, '-o', FLOW, ...this.words()], 'Computing the flow …');
    if (!reply) return;
    this.report = reply.report;
    bench.show.color = 'pressure';
    bench.fillControls();
    bench.refresh();
    bench.redraw();
  }

  refresh() {
    document.getElementById('flow-points').replaceChildren(...this.points.map(({ kind, point }, i) => make('li', {},
      `${kind} at ${this.bench.frame.placeText(point)} `,
      make('button', { 'aria-label': `Delete ${kind} ${i + 1}`, onclick: () => { this.points.splice(i, 1); this.refresh(); this.bench.redraw(); } }, 'Delete'))));
    const { report } = this;
    const rows = report ? [['Pressure', `${showNumber(report.pressure.min)} to ${showNumber(report.pressure.max)} Pa`],
      ['Rate across faults', `${showNumber(report.faults.total_rate_across)} m³/s`], ['Largest jump at a fault', `${showNumber(report.faults.max_jump)} Pa`],
      ...report.by_fault.map(fault => [`Across ${fault.name}`, `${showNumber(fault.total_rate_across)} m³/s`])] : [];
    document.getElementById('flow-figures').replaceChildren(...rows.map(([name, value]) => make('tr', {}, make('th', { scope: 'row' }, name), make('td', {}, value))));
  }

  draw(section, context) {
    for (const { kind, point } of this.points) {
      if (section.across !== null && Math.abs(point[section.across] - section.at) > 3) continue;
      const pixel = section.toPixel(point[section.u], point[section.v]);
      section.disc(context, pixel, 7, kind === 'source' ? '#d55e00' : '#0072b2');
      context.fillStyle = '#ffffff';
      context.font = `bold ${11 * section.ratio}px sans-serif`;
      context.textAlign = 'center';
      context.textBaseline = 'middle';
      context.fillText(kind === 'source' ? '+' : '−', ...pixel);
    }
  }
}
