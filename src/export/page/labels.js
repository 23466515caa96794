// Draws text and lines over the scene: axes, legends, a scale bar, the selected cell.

class Labels {
  constructor(canvas, facts, mesh) {
    Object.assign(this, { canvas, facts, mesh, pen: canvas.getContext('2d') });
  }

  /** Draws everything. `page` is the state of the page, `way` the projection to the screen. */
  draw(page, way) {
    const { pen, canvas } = this;
    const ratio = page.ratio;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    const style = getComputedStyle(document.documentElement);
    this.ink = style.getPropertyValue('--ink').trim();
    this.quiet = style.getPropertyValue('--quiet').trim();
    this.paper = style.getPropertyValue('--ground').trim();
    this.accent = style.getPropertyValue('--accent').trim();
    this.width = canvas.width / ratio;
    this.height = canvas.height / ratio;
    pen.font = '12px system-ui, "DejaVu Sans", sans-serif';
    pen.lineJoin = 'round';
    this.screen = p => {
      const [x, y] = way.rows.map(row => dot(row, p) + row[3]);
      return [this.width / 2 + x / ratio, this.height / 2 - y / ratio];
    };
    if (page.flat) this.featureLines(page);
    this.pickedCell(page);
    this.axes(page, way);
    this.legends(page);
    this.scale(page, way);
  }

  /** Draws text with an outline in the background colour. */
  text(text, x, y, align = 'left', color = this.ink) {
    const { pen } = this;
    pen.textAlign = align;
    pen.textBaseline = 'middle';
    pen.lineWidth = 3;
    pen.strokeStyle = this.paper;
    pen.strokeText(text, x, y);
    pen.fillStyle = color;
    pen.fillText(text, x, y);
  }

  path(points, closed = false) {
    this.pen.beginPath();
    points.forEach(([x, y], i) => i ? this.pen.lineTo(x, y) : this.pen.moveTo(x, y));
    if (closed) this.pen.closePath();
    this.pen.stroke();
  }

  node(n) {
    const { nodes } = this.mesh;
    return [nodes[3 * n] / 65535, nodes[3 * n + 1] / 65535, nodes[3 * n + 2] / 65535];
  }

  featureLines(page) {
    if (!page.look.features) return;
    const { ends, lines } = this.mesh;
    this.pen.lineWidth = 2.2;
    this.pen.lineCap = 'round';
    for (let i = 0; i < lines.length; i++) {
      this.pen.strokeStyle = css(page.colorOfSurface(lines[i]));
      this.path([this.screen(this.node(ends[2 * i])), this.screen(this.node(ends[2 * i + 1]))]);
    }
  }

  /** Draws the edges of the selected cell in front of everything. */
  pickedCell(page) {
    if (!page.picked || page.picked.cell === undefined) return;
    const { owner, beyond, first, corners } = this.mesh;
    this.pen.lineWidth = 2;
    this.pen.strokeStyle = this.accent;
    for (let f = 0; f < owner.length; f++) {
      if (owner[f] !== page.picked.cell && beyond[f] !== page.picked.cell) continue;
      const ring = [];
      for (let c = first[f]; c < first[f + 1]; c++) ring.push(this.screen(this.node(corners[c])));
      this.path(ring, true);
    }
    const [x, y] = this.screen(page.picked.place);
    this.pen.fillStyle = this.accent;
    this.pen.beginPath();
    this.pen.arc(x, y, 3, 0, 7);
    this.pen.fill();
  }

  /** Draws each axis along one of its four edges: an edge on the outline, low and to the left. */
  axes(page, way) {
    const { frame } = this.facts;
    for (let k = 0; k < (page.flat ? 2 : 3); k++) {
      const row = way.rows[2];
      const others = [(k + 1) % 3, (k + 2) % 3];
      let edge = null;
      for (const [u, v] of page.flat ? [[0, 0], [0, 1], [1, 0]] : [[0, 0], [0, 1], [1, 0], [1, 1]]) {
        // At an edge on the outline, one of the two sides faces the viewer and the other does not.
        const faces = [u, v].map((share, i) => (share ? 1 : -1) * row[others[i]] > 0);
        if (!page.flat && faces[0] === faces[1]) continue;
        if (page.flat && [u, v][others.indexOf(2)] === 1) continue;
        const end = share => { const p = [0, 0, 0]; p[k] = share; p[others[0]] = u; p[others[1]] = v; return p; };
        const ends = [this.screen(end(0)), this.screen(end(1))];
        const middle = [(ends[0][0] + ends[1][0]) / 2, (ends[0][1] + ends[1][1]) / 2];
        const steep = Math.abs(ends[1][1] - ends[0][1]) > 2 * Math.abs(ends[1][0] - ends[0][0]);
        const merit = steep ? -middle[0] : middle[1];
        if (!edge || merit > edge.merit) edge = { merit, ends, middle };
      }
      if (edge) this.axis(frame.rulers[k], edge);
    }
  }

  axis(ruler, { ends: [a, b], middle }) {
    const long = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (long < 40) return;
    // Labels are placed away from the middle of the box.
    let out = [(b[1] - a[1]) / long, -(b[0] - a[0]) / long];
    const centre = this.screen([0.5, 0.5, this.facts.dimensions === 2 ? 0 : 0.5]);
    if (out[0] * (middle[0] - centre[0]) + out[1] * (middle[1] - centre[1]) < 0) out = out.map(c => -c);
    const { found, step } = ticks(ruler.first, ruler.last, Math.max(2, Math.floor(long / 75)));
    this.pen.strokeStyle = this.quiet;
    this.pen.lineWidth = 1;
    this.path([a, b]);
    const align = out[0] > 0.35 ? 'left' : out[0] < -0.35 ? 'right' : 'center';
    let wide = 0;
    for (const value of found) {
      const share = (value - ruler.first) / (ruler.last - ruler.first);
      const at = [0, 1].map(i => a[i] + share * (b[i] - a[i]));
      this.pen.strokeStyle = this.quiet;
      this.pen.lineWidth = 1;
      this.path([at, at.map((c, i) => c + 5 * out[i])]);
      const label = written(value, step);
      wide = Math.max(wide, this.pen.measureText(label).width);
      this.text(label, at[0] + 9 * out[0], at[1] + 13 * out[1], align, this.quiet);
    }
    const away = 20 + Math.abs(out[0]) * wide + 14 * Math.abs(out[1]);
    const half = this.pen.measureText(ruler.label).width / 2;
    const clamp = x => Math.min(Math.max(x, half + 4), this.width - half - 4);
    if (Math.abs(b[1] - a[1]) > 2 * Math.abs(b[0] - a[0])) {
      // The title of a vertical axis is above its upper end.
      const top = a[1] < b[1] ? a : b;
      return this.text(ruler.label, clamp(top[0]), Math.max(top[1] - 16, 10), 'center');
    }
    const x = middle[0] + away * out[0] + (align === 'left' ? half : align === 'right' ? -half : 0);
    const y = middle[1] + away * out[1];
    this.text(ruler.label, clamp(x), Math.min(Math.max(y, 10), this.height - 10), 'center');
  }

  /** Draws the legends of the colours. */
  legends(page) {
    let x = 14;
    const bottom = this.height - 48;
    const high = this.width < 600 ? 74 : 150;
    const array = page.array;
    if (page.look.cells && array) {
      const title = array.unit ? `${array.name} [${array.unit}]` : array.name;
      x = array.categories
        ? this.swatches(title, array.categories.map(c => [[css(c.color)], c.name]), x, bottom, high)
        : this.bar(title, page.range, t => css(ramp(t)), x, bottom, high);
    }
    const image = this.facts.image;
    if (image && (page.look.sections.length || (page.look.cells && page.painted))) {
      const color = t => css([...page.palette.subarray(3 * Math.round(255 * t), 3 * Math.round(255 * t) + 3)]);
      x = this.bar('image', [image.low, image.high], color, x, bottom, high);
    }
    if (page.look.features && page.kindsShown.length) {
      this.swatches('features', page.kindsShown.map(([name, colors]) => [colors.map(css), name]), x, bottom, high);
    }
  }

  bar(title, [low, high], color, x, bottom, tall) {
    const { pen } = this;
    for (let i = 0; i < tall; i++) {
      pen.fillStyle = color(i / (tall - 1));
      pen.fillRect(x, bottom - i - 1, 14, 1.5);
    }
    pen.strokeStyle = this.quiet;
    pen.lineWidth = 1;
    pen.strokeRect(x + 0.5, bottom - tall + 0.5, 14, tall - 1);
    this.text(title, x, bottom - tall - 12);
    let wide = pen.measureText(title).width;
    const { found, step } = ticks(low, high, Math.floor(tall / 24));
    for (const value of high > low ? found : [low]) {
      const y = bottom - (high > low ? (value - low) / (high - low) : 0.5) * tall;
      pen.strokeStyle = this.quiet;
      pen.lineWidth = 1;
      this.path([[x + 14, y], [x + 18, y]]);
      const label = written(value, step);
      this.text(label, x + 22, y);
      wide = Math.max(wide, 24 + pen.measureText(label).width);
    }
    return x + wide + 22;
  }

  swatches(title, entries, x, bottom, tall) {
    const { pen } = this;
    const line = 17;
    const most = Math.max(1, Math.floor(tall / line));
    const shown = entries.slice(0, most);
    const top = bottom - shown.length * line;
    this.text(title, x, top - 8);
    let wide = pen.measureText(title).width;
    shown.forEach(([colors, name], i) => {
      colors.forEach((color, k) => {
        pen.fillStyle = color;
        pen.fillRect(x + k * 12 / colors.length, top + i * line + 3, 12 / colors.length, 12);
      });
      this.text(name, x + 18, top + i * line + 9);
      wide = Math.max(wide, 18 + pen.measureText(name).width);
    });
    return x + wide + 22;
  }

  /** Draws a scale bar in physical units, if the first two coordinates have the same unit. */
  scale(page, way) {
    const { frame } = this.facts;
    const unit = frame.units[0];
    const perLength = way.scale / page.ratio;
    const length = roundStep(120 / perLength, 1) > 170 / perLength ? roundStep(60 / perLength, 1) : roundStep(120 / perLength, 1);
    const wide = length * perLength;
    const [x, y] = [14, this.height - 18];
    this.pen.strokeStyle = this.ink;
    this.pen.lineWidth = 1.5;
    this.path([[x, y - 4], [x, y], [x + wide, y], [x + wide, y - 4]]);
    this.text(`${written(length, length)}${unit ? ' ' + unit : ''}`, x + wide + 8, y - 2);
  }
}
