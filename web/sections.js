// Sections through the image: samples, the mesh cut by the plane, the cursor, and what a tool shows there.

/** Number of colours into which the values of cells are divided in a section. */
const CELL_COLORS = 32;
/** Names of the axes along which the vertical of a survey lies. */
const VERTICAL = /^(time|depth|sample|z)$/;

/** Lines or polygons as several paths: the time to draw one grows faster than its length. */
class Paths {
  constructor() { Object.assign(this, { paths: [], count: 0 }); }

  /** Returns the path for the next line or polygon. */
  next() {
    if (this.count++ % 64 === 0) this.paths.push(new Path2D());
    return this.paths.at(-1);
  }
}

/** One section: a canvas for image and mesh, and one above it for cursor, atoms and picks. */
class Section {
  /** `across` is the axis that the section is perpendicular to; null in 2-D. */
  constructor(bench, across) {
    Object.assign(this, { bench, across, zoom: 1, shift: [0, 0], hover: null });
    const { frame } = bench;
    const axes = frame.dims.map((_, k) => k).filter(k => k !== across);
    const vertical = frame.dims.length - 1 - [...frame.names].reverse().findIndex(name => VERTICAL.test(name));
    [this.u, this.v] = axes.includes(vertical) && vertical < frame.dims.length ? [axes.find(k => k !== vertical), vertical] : axes;
    // The z axis of a scan points to the head.
    this.isFlipped = frame.isScan && this.v === 2;
    this.makeElements();
    this.listen();
  }

  makeElements() {
    const { frame } = this.bench;
    this.element = document.createElement('figure');
    this.element.className = 'view section';
    this.base = document.createElement('canvas');
    this.top = document.createElement('canvas');
    this.top.tabIndex = 0;
    this.top.setAttribute('role', 'application');
    this.top.setAttribute('aria-roledescription', 'section of the image');
    const name = this.across === null ? 'image' : frame.sectionName(this.across);
    this.top.setAttribute('aria-label', `Section ${name}: ${frame.names[this.u]} to the right, ${frame.names[this.v]} ${this.isFlipped ? 'up' : 'down'}. ` +
      'Arrow keys move the cursor, Page Up and Page Down change the slice, Enter uses the tool.');
    const stage = document.createElement('div');
    stage.className = 'stage';
    stage.append(this.base, this.top);
    this.element.append(stage);
    this.caption = document.createElement('figcaption');
    this.title = document.createElement('span');
    this.title.textContent = name;
    this.caption.append(this.title);
    if (this.across !== null) {
      this.slider = document.createElement('input');
      Object.assign(this.slider, { type: 'range', min: 0, max: frame.dims[this.across] - 1, step: 1 });
      this.slider.setAttribute('aria-label', `Slice along ${frame.names[this.across]}`);
      this.slider.addEventListener('input', () => this.bench.moveCursor(this.across, +this.slider.value));
      this.output = document.createElement('output');
      this.caption.append(this.slider, this.output);
    }
    this.element.append(this.caption);
    new ResizeObserver(() => this.bench.redraw()).observe(stage);
  }

  get at() { return this.across === null ? 0 : this.bench.cursor[this.across]; }

  /** Sets the scale and the position of the image in the canvas. */
  fit() {
    const stage = this.top.parentElement;
    const ratio = Math.min(devicePixelRatio, 2);
    const [width, height] = [Math.max(1, Math.round(stage.clientWidth * ratio)), Math.max(1, Math.round(stage.clientHeight * ratio))];
    for (const canvas of [this.base, this.top]) if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    this.ratio = ratio;
    const { frame } = this.bench;
    const lengths = [this.u, this.v].map(k => Math.max(1, frame.dims[k] - 1) * (frame.isIsotropic ? frame.spacing[k] : 1));
    const room = [width, height].map(c => 0.94 * c);
    const scales = [0, 1].map(k => room[k] / lengths[k]);
    const same = Math.min(...scales);
    this.scale = [this.u, this.v].map((axis, k) =>
      this.zoom * (frame.isIsotropic ? same * frame.spacing[axis] : scales[k]));
    this.offset = [width, height].map((c, k) => (c - this.scale[k] * (frame.dims[[this.u, this.v][k]] - 1)) / 2 + this.shift[k]);
  }

  /** Returns the pixel of indices along u and v. */
  toPixel(a, b) {
    const { dims } = this.bench.frame;
    return [this.offset[0] + this.scale[0] * a, this.offset[1] + this.scale[1] * (this.isFlipped ? dims[this.v] - 1 - b : b)];
  }

  /** Returns the indices along all axes of a pixel. */
  toIndex(x, y) {
    const { dims } = this.bench.frame;
    const point = this.bench.cursor.slice();
    point[this.u] = (x - this.offset[0]) / this.scale[0];
    const b = (y - this.offset[1]) / this.scale[1];
    point[this.v] = this.isFlipped ? dims[this.v] - 1 - b : b;
    return point;
  }

  /** Returns `true` if a point is in the image. */
  isInside(point) {
    const { dims } = this.bench.frame;
    return [this.u, this.v].every(k => point[k] >= 0 && point[k] <= dims[k] - 1);
  }

  /** Draws image and mesh. */
  draw() {
    this.fit();
    const context = this.base.getContext('2d');
    context.clearRect(0, 0, this.base.width, this.base.height);
    this.drawImage(context);
    if (!this.bench.mesh.isEmpty) this.drawMesh(context);
    if (this.across !== null) {
      this.slider.value = Math.round(this.at);
      const { frame } = this.bench;
      this.output.textContent = frame.sliceText(this.across, this.at);
      this.slider.setAttribute('aria-valuetext', this.output.textContent);
    }
    this.drawTop();
  }

  drawImage(context) {
    const { bench, u, v } = this;
    const { dims } = bench.frame;
    const picture = bench.slicePicture(this.across, Math.round(this.at), u, v);
    if (!picture) return;
    this.picture = picture;
    const [x, y] = this.toPixel(-0.5, this.isFlipped ? dims[v] - 0.5 : -0.5);
    context.imageSmoothingEnabled = false;
    context.save();
    context.translate(x, y);
    context.scale(this.scale[0] * dims[u] / picture.width, this.scale[1] * dims[v] / picture.height);
    if (this.isFlipped) { context.translate(0, picture.height); context.scale(1, -1); }
    context.drawImage(picture, 0, 0);
    context.restore();
  }

  /** Calls `use` for each cell that the section cuts, with its polygon: indices along u and v, one after the other. */
  eachPolygon(use) {
    const { mesh } = this.bench;
    const { u, v, across } = this;
    const { size, nodes, corners } = mesh;
    const polygon = new Float64Array(8);
    if (across === null) {
      for (let cell = 0; cell < mesh.cellCount; cell++) {
        for (let k = 0; k < 3; k++) {
          polygon[2 * k] = nodes[2 * corners[3 * cell + k] + u];
          polygon[2 * k + 1] = nodes[2 * corners[3 * cell + k] + v];
        }
        use(cell, polygon, 3);
      }
      return;
    }
    const at = this.planeAt;
    mesh.eachNear(across, at, cell => {
      const [below, above] = [[], []];
      for (let k = 0; k < 4; k++) {
        const node = 3 * corners[4 * cell + k];
        (nodes[node + across] < at ? below : above).push(node);
      }
      if (below.length === 0 || above.length === 0) return;
      const pairs = below.length === 2
        ? [[below[0], above[0]], [below[0], above[1]], [below[1], above[1]], [below[1], above[0]]]
        : below.flatMap(a => above.map(b => [a, b]));
      pairs.forEach(([a, b], i) => {
        const share = (at - nodes[a + across]) / (nodes[b + across] - nodes[a + across]);
        polygon[2 * i] = nodes[a + u] + share * (nodes[b + u] - nodes[a + u]);
        polygon[2 * i + 1] = nodes[a + v] + share * (nodes[b + v] - nodes[a + v]);
      });
      use(cell, polygon, pairs.length);
    });
  }

  /** Returns the position of the plane, a little off the samples, where nodes of the sides lie. */
  get planeAt() {
    const last = this.bench.frame.dims[this.across] - 1;
    return Math.min(Math.max(this.at, 1e-3), last - 1e-3) + 1e-4;
  }

  drawMesh(context) {
    const { bench } = this;
    const { mesh, show } = bench;
    const colorOf = bench.cellColoring(CELL_COLORS);
    const fills = new Map();
    const isHidden = bench.hiddenUnits.size > 0 ? cell => bench.hiddenUnits.has(Math.round(mesh.cellArrays.region?.[cell] ?? 0)) : () => false;
    this.eachPolygon((cell, polygon, count) => {
      const color = colorOf && colorOf(cell);
      if (!color || isHidden(cell)) return;
      if (!fills.has(color)) fills.set(color, new Paths());
      const path = fills.get(color).next();
      path.moveTo(...this.toPixel(polygon[0], polygon[1]));
      for (let i = 1; i < count; i++) path.lineTo(...this.toPixel(polygon[2 * i], polygon[2 * i + 1]));
      path.closePath();
    });
    context.globalAlpha = show.opacity;
    for (const [color, { paths }] of fills) {
      context.fillStyle = color;
      for (const path of paths) context.fill(path);
    }
    context.globalAlpha = 1;
    const [edges, faults, horizons, borders] = [0, 1, 2, 3].map(() => new Paths());
    const region = mesh.cellArrays.region;
    const horizonBits = mesh.cellArrays.horizon_faces;
    this.eachSegment((cell, k, a, b) => {
      const beyond = mesh.neighbours[(mesh.size + 1) * cell + k];
      const line = list => { const path = list.next(); path.moveTo(...a); path.lineTo(...b); };
      if (show.features && mesh.isFeature(cell, k)) line(horizonBits && horizonBits[cell] >> k & 1 ? horizons : faults);
      else if (show.units && region && beyond >= 0 && region[cell] !== region[beyond]) line(borders);
      else if (show.edges) line(edges);
    });
    context.lineJoin = 'round';
    const stroke = ({ paths }, color, width) => {
      [context.strokeStyle, context.lineWidth] = [color, width * this.ratio];
      for (const path of paths) context.stroke(path);
    };
    if (show.edges) {
      context.globalAlpha = 0.75;
      stroke(edges, show.map === 'grey' ? '#3fa3f5' : '#ffffff', 0.8);
      context.globalAlpha = 1;
    }
    stroke(borders, '#ffffff', 2.4);
    stroke(borders, '#202020', 1.2);
    stroke(horizons, HORIZON_COLOR, 2.2);
    stroke(faults, FAULT_COLOR, 2.2);
  }

  /** Calls `use` once for each face (in 2-D edge) that the section cuts, with the pixels of its ends. */
  eachSegment(use) {
    const { mesh } = this.bench;
    const { u, v, across } = this;
    const { nodes, corners, neighbours } = mesh;
    if (across === null) {
      for (let cell = 0; cell < mesh.cellCount; cell++) {
        for (let k = 0; k < 3; k++) {
          if (neighbours[3 * cell + k] > cell) continue;
          const [a, b] = [(k + 1) % 3, (k + 2) % 3].map(i => 2 * corners[3 * cell + i]);
          use(cell, k, this.toPixel(nodes[a + u], nodes[a + v]), this.toPixel(nodes[b + u], nodes[b + v]));
        }
      }
      return;
    }
    const at = this.planeAt;
    const ends = [0, 0, 0, 0];
    mesh.eachNear(across, at, cell => {
      let sides = 0;
      for (let k = 0; k < 4; k++) if (nodes[3 * corners[4 * cell + k] + across] < at) sides |= 1 << k;
      if (sides === 0 || sides === 15) return;
      for (let k = 0; k < 4; k++) {
        if (neighbours[4 * cell + k] > cell) continue;
        const face = FACES[k];
        let count = 0;
        for (let i = 0; i < 3; i++) {
          const [p, q] = [face[i], face[(i + 1) % 3]];
          if ((sides >> p & 1) === (sides >> q & 1)) continue;
          const [a, b] = [3 * corners[4 * cell + p], 3 * corners[4 * cell + q]];
          const share = (at - nodes[a + across]) / (nodes[b + across] - nodes[a + across]);
          ends[count++] = nodes[a + u] + share * (nodes[b + u] - nodes[a + u]);
          ends[count++] = nodes[a + v] + share * (nodes[b + v] - nodes[a + v]);
        }
        if (count === 4) use(cell, k, this.toPixel(ends[0], ends[1]), this.toPixel(ends[2], ends[3]));
      }
    });
  }

  /** Returns the polygon, in pixels, in which the section cuts a cell. */
  polygonOf(wanted) {
    let found = null;
    this.eachPolygon((cell, polygon, count) => {
      if (cell === wanted) found = Array.from({ length: count }, (_, i) => this.toPixel(polygon[2 * i], polygon[2 * i + 1]));
    });
    return found;
  }

  /** Returns the nodes of the cells that the section cuts which lie within `reach` samples of it. */
  nodesNear(reach) {
    const { mesh } = this.bench;
    if (this.across === null) return Array.from({ length: mesh.nodeCount }, (_, n) => n);
    const found = new Set();
    const at = this.at;
    mesh.eachNear(this.across, at, cell => {
      for (let k = 0; k < 4; k++) {
        const node = mesh.corners[4 * cell + k];
        if (Math.abs(mesh.nodes[3 * node + this.across] - at) <= reach) found.add(node);
      }
    });
    return [...found];
  }

  /** Returns the pixel of a node. */
  pixelOfNode(node) {
    const { nodes, size } = this.bench.mesh;
    return this.toPixel(nodes[size * node + this.u], nodes[size * node + this.v]);
  }

  /** Draws the cursor, what the mouse points at, and what the tools show. */
  drawTop() {
    const { bench } = this;
    const context = this.top.getContext('2d');
    context.clearRect(0, 0, this.top.width, this.top.height);
    context.lineWidth = this.ratio;
    const [x, y] = this.toPixel(bench.cursor[this.u], bench.cursor[this.v]);
    context.setLineDash([6, 4]);
    for (const [color, offset] of [['#000000', 0], ['#ffffff', 5]]) {
      context.strokeStyle = color;
      context.lineDashOffset = offset;
      context.beginPath();
      context.moveTo(x, 0); context.lineTo(x, this.top.height);
      context.moveTo(0, y); context.lineTo(this.top.width, y);
      context.globalAlpha = 0.6;
      context.stroke();
    }
    context.globalAlpha = 1;
    context.setLineDash([]);
    for (const tool of Object.values(bench.tools)) tool.draw?.(this, context);
  }

  /** Draws a disc with a border. */
  disc(context, [x, y], radius, color) {
    context.beginPath();
    context.arc(x, y, radius * this.ratio, 0, 2 * Math.PI);
    context.fillStyle = color;
    context.fill();
    context.strokeStyle = '#ffffff';
    context.lineWidth = this.ratio;
    context.stroke();
  }

  // Mouse, fingers and keys.

  listen() {
    const { top, bench } = this;
    const at = event => { const box = top.getBoundingClientRect(); return [(event.clientX - box.left) * this.ratio, (event.clientY - box.top) * this.ratio]; };
    let pan = null;
    top.addEventListener('pointerdown', event => {
      top.focus();
      top.setPointerCapture(event.pointerId);
      const pixel = at(event);
      if (event.button !== 0) { pan = pixel; return; }
      if (event.altKey) return bench.setCursor(this.toIndex(...pixel));
      bench.tool.press?.(this, this.toIndex(...pixel), pixel, event);
    });
    top.addEventListener('pointermove', event => {
      const pixel = at(event);
      if (pan) {
        this.shift = this.shift.map((c, k) => c + pixel[k] - pan[k]);
        pan = pixel;
        return bench.redraw();
      }
      const point = this.toIndex(...pixel);
      this.hover = this.isInside(point) ? point : null;
      if (this.hover) bench.showPlace(this.hover);
      bench.tool.move?.(this, point, pixel, event);
      bench.redrawTop();
    });
    const release = event => {
      if (pan) { pan = null; return; }
      if (event.type === 'pointerup' && event.button === 0 && !event.altKey) bench.tool.release?.(this, this.toIndex(...at(event)), at(event), event);
      if (event.type === 'pointercancel') bench.tool.cancel?.();
    };
    top.addEventListener('pointerup', release);
    top.addEventListener('pointercancel', release);
    top.addEventListener('pointerleave', () => { this.hover = null; bench.redrawTop(); });
    top.addEventListener('contextmenu', event => event.preventDefault());
    top.addEventListener('wheel', event => {
      event.preventDefault();
      if (event.ctrlKey || this.across === null) return this.zoomAt(Math.exp(-event.deltaY * 0.002), at(event));
      bench.moveCursor(this.across, Math.round(bench.cursor[this.across]) + Math.sign(event.deltaY));
    }, { passive: false });
    top.addEventListener('keydown', event => this.pressed(event));
  }

  zoomAt(factor, [x, y]) {
    const zoom = Math.min(Math.max(this.zoom * factor, 0.5), 40);
    const grown = zoom / this.zoom;
    const middle = [this.top.width / 2, this.top.height / 2];
    this.shift = this.shift.map((c, k) => grown * c + (1 - grown) * ([x, y][k] - middle[k]));
    this.zoom = zoom;
    this.bench.redraw();
  }

  pressed(event) {
    if (event.ctrlKey || event.metaKey) return;
    const { bench } = this;
    const far = event.shiftKey ? 10 : 1;
    const step = { ArrowLeft: [this.u, -1], ArrowRight: [this.u, 1], ArrowUp: [this.v, this.isFlipped ? 1 : -1], ArrowDown: [this.v, this.isFlipped ? -1 : 1],
      PageUp: [this.across, -1], PageDown: [this.across, 1] }[event.key];
    if (step && step[0] !== null) bench.moveCursor(step[0], bench.cursor[step[0]] + far * step[1]);
    else if (event.key === 'Enter') bench.tool.enter?.(this, bench.cursor.slice(), event);
    else if (event.key === '+' || event.key === '=') this.zoomAt(1.25, this.toPixel(bench.cursor[this.u], bench.cursor[this.v]));
    else if (event.key === '-') this.zoomAt(0.8, this.toPixel(bench.cursor[this.u], bench.cursor[this.v]));
    else if (event.key === '0') { [this.zoom, this.shift] = [1, [0, 0]]; bench.redraw(); }
    else if (!bench.tool.key?.(this, event)) return;
    event.preventDefault();
    event.stopPropagation();
  }
}
