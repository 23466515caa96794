// The mesh in space, drawn with WebGL2: cells with a corner open at the cursor, features, and the three sections.

const BODY_VERTEX = `#version 300 es
uniform mat4 project;
in vec3 place;
in vec4 tint;
out vec3 at;
out vec3 corner;
flat out vec4 color;
void main() {
  gl_Position = project * vec4(place, 1.0);
  at = gl_Position.xyz;
  int k = gl_VertexID % 3;
  corner = vec3(k == 0, k == 1, k == 2);
  color = tint;
}`;
const BODY_FRAGMENT = `#version 300 es
precision highp float;
uniform vec2 size;
uniform float edges;
in vec3 at;
in vec3 corner;
flat in vec4 color;
out vec4 result;
void main() {
  vec3 normal = normalize(cross(dFdx(at) * vec3(size, 1.0), dFdy(at) * vec3(size, 1.0)));
  float facing = abs(dot(normal, normalize(vec3(-0.25, 0.35, 0.9))));
  vec3 lit = color.rgb * mix(0.62, 1.02, facing);
  vec3 pixels = corner / max(fwidth(corner), vec3(1e-6));
  float nearest = min(pixels.x, min(pixels.y, pixels.z));
  float ink = edges * (1.0 - smoothstep(0.2, 1.2, nearest));
  result = vec4(mix(lit, vec3(0.1, 0.13, 0.17), ink), 1.0);
}`;
const SLICE_VERTEX = `#version 300 es
uniform mat4 project;
in vec3 place;
in vec2 share;
out vec2 p;
void main() { gl_Position = project * vec4(place, 1.0); p = share; }`;
const SLICE_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture;
in vec2 p;
out vec4 result;
void main() { result = vec4(texture(picture, p).rgb, 1.0); }`;
const LINE_VERTEX = `#version 300 es
uniform mat4 project;
in vec3 place;
void main() { gl_Position = project * vec4(place, 1.0); }`;
const LINE_FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 color;
out vec4 result;
void main() { result = vec4(color, 1.0); }`;

const PLAIN_CELL = [176, 190, 204];

/** The 3-D view. */
class Body {
  constructor(bench) {
    Object.assign(this, { bench, yaw: -0.7, pitch: 0.45, zoom: 1, move: [0, 0], built: '', triangles: 0, frames: 0 });
    this.element = document.createElement('figure');
    this.element.className = 'view body';
    this.canvas = document.createElement('canvas');
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute('role', 'application');
    this.canvas.setAttribute('aria-roledescription', 'mesh in space');
    this.canvas.setAttribute('aria-label', 'The mesh in space. Arrow keys turn it, plus and minus zoom, 1 to 6 show its sides, 0 resets the view.');
    const stage = document.createElement('div');
    stage.className = 'stage';
    stage.append(this.canvas);
    const caption = document.createElement('figcaption');
    this.message = document.createElement('span');
    this.message.textContent = '3-D';
    caption.append(this.message);
    this.element.append(stage, caption);
    new ResizeObserver(() => this.bench.redraw()).observe(stage);
    const { frame } = bench;
    const lengths = frame.dims.map((n, k) => Math.max(1, n - 1) * (frame.isIsotropic ? frame.spacing[k] : 1));
    const longest = frame.isIsotropic ? Math.max(...lengths) : 1;
    // In a survey of mixed units each axis fills the box, the vertical one less.
    this.size = frame.isIsotropic ? lengths.map(c => c / longest) : frame.names.map(name => (VERTICAL.test(name) ? 0.6 : 1));
    const vertical = frame.names.findIndex(name => VERTICAL.test(name));
    this.up = vertical < 0 ? 2 : vertical;
    this.isFlipped = frame.isScan;
    this.start();
    this.listen();
  }

  start() {
    const gl = this.gl = this.canvas.getContext('webgl2', { antialias: false, preserveDrawingBuffer: true });
    if (!gl) { this.message.textContent = 'This browser has no WebGL2: no 3-D view.'; return; }
    const program = (vertex, fragment) => {
      const made = gl.createProgram();
      for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, text);
        gl.compileShader(shader);
        if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
        gl.attachShader(made, shader);
      }
      gl.linkProgram(made);
      return made;
    };
    this.programs = { body: program(BODY_VERTEX, BODY_FRAGMENT), slice: program(SLICE_VERTEX, SLICE_FRAGMENT), line: program(LINE_VERTEX, LINE_FRAGMENT) };
    this.buffer = gl.createBuffer();
    this.sliceBuffer = gl.createBuffer();
    this.lineBuffer = gl.createBuffer();
    this.textures = [0, 1, 2].map(() => gl.createTexture());
  }

  /** Returns a point of the box, in [-1, 1] at most, of indices of samples. */
  toBox(index) {
    const { dims } = this.bench.frame;
    return index.map((c, k) => this.size[k] * (c / Math.max(1, dims[k] - 1) - 0.5));
  }

  /** Collects the triangles between cells that are shown and cells that are not, and those on features. */
  build() {
    const { bench } = this;
    const { mesh, show, cursor, frame, hiddenUnits } = bench;
    const key = JSON.stringify([mesh.version, bench.meshName, show.cells, show.features, show.cut, show.units, show.color, [...hiddenUnits], show.cut ? [cursor, this.opens] : null, bench.paletteVersion]);
    if (key === this.built) return;
    this.built = key;
    const { nodes, corners, neighbours, cellCount } = mesh;
    const region = mesh.cellArrays.region;
    const isShown = new Uint8Array(cellCount);
    const { opens } = this;
    for (let cell = 0; cell < cellCount; cell++) {
      let shown = show.cells;
      if (shown && show.cut) {
        let isOpen = true;
        for (let k = 0; k < 3 && isOpen; k++) {
          let sum = 0;
          for (let i = 0; i < 4; i++) sum += nodes[3 * corners[4 * cell + i] + k];
          isOpen = opens[k] * (sum / 4 - cursor[k]) > 0;
        }
        shown = !isOpen;
      }
      if (shown && hiddenUnits.size > 0 && region) shown = !hiddenUnits.has(Math.round(region[cell]));
      isShown[cell] = shown ? 1 : 0;
    }
    const colorOf = bench.cellColoring(256);
    const parsed = new Map();
    const rgb = color => { if (!parsed.has(color)) parsed.set(color, rgbOf(color)); return parsed.get(color); };
    const horizonBits = mesh.cellArrays.horizon_faces;
    const [fault, horizon] = [FAULT_COLOR, HORIZON_COLOR].map(rgbOf);
    // The scale and the position of each axis.
    const scale = frame.dims.map((n, k) => this.size[k] / Math.max(1, n - 1));
    let room = 1 << 14, count = 0;
    let data = new ArrayBuffer(48 * room);
    let [floats, bytes] = [new Float32Array(data), new Uint8Array(data)];
    this.faceCells = [];
    for (let cell = 0; cell < cellCount; cell++) {
      for (let k = 0; k < 4; k++) {
        const beyond = neighbours[4 * cell + k];
        const isSide = isShown[cell] && (beyond < 0 || !isShown[beyond]);
        const isFeature = show.features && beyond > cell && !isShown[cell] && !isShown[beyond] && mesh.isFeature(cell, k);
        if (!isSide && !isFeature) continue;
        let color = PLAIN_CELL;
        if (mesh.isFeature(cell, k) && show.features) color = horizonBits && horizonBits[cell] >> k & 1 ? horizon : fault;
        else if (colorOf) color = rgb(colorOf(cell) || '#b0becc');
        if (count === room) {
          room *= 2;
          const larger = new ArrayBuffer(48 * room);
          new Uint8Array(larger).set(bytes);
          [data, floats, bytes] = [larger, new Float32Array(larger), new Uint8Array(larger)];
        }
        for (let i = 0; i < 3; i++) {
          const node = 3 * corners[4 * cell + FACES[k][i]];
          const at = 12 * count + 4 * i;
          for (let c = 0; c < 3; c++) floats[at + c] = nodes[node + c] * scale[c] - this.size[c] / 2;
          const byte = 4 * (at + 3);
          bytes[byte] = color[0]; bytes[byte + 1] = color[1]; bytes[byte + 2] = color[2]; bytes[byte + 3] = 255;
        }
        this.faceCells.push(cell);
        count++;
      }
    }
    this.places = floats.subarray(0, 12 * count);
    this.triangles = count;
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, bytes.subarray(0, 48 * count), gl.DYNAMIC_DRAW);
  }

  /** Returns for each axis the side, 1 or -1, that faces the viewer. */
  get opens() {
    const rows = this.axes();
    return [0, 1, 2].map(k => (rows[2][k] >= 0 ? 1 : -1));
  }

  /** Returns the directions to the right, upwards and to the viewer, along the axes of the box. */
  axes() {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const up = this.isFlipped ? 1 : -1;
    // In a frame whose third axis points upwards.
    const rows = [[cy, sy, 0], [-sy * sp, cy * sp, cp], [sy * cp, -cy * cp, sp]];
    const [first, second] = [0, 1, 2].filter(k => k !== this.up);
    return rows.map(row => {
      const made = [0, 0, 0];
      [made[first], made[second], made[this.up]] = [row[0], row[1], up * row[2]];
      return made;
    });
  }

  matrix() {
    const { width, height } = this.canvas;
    const rows = this.axes();
    const scale = 1.15 * this.zoom * Math.min(width, height) / Math.hypot(...this.size) / 1;
    const [sx, sy] = [2 * scale / width, 2 * scale / height].map(c => c * 0.85);
    const [mx, my] = this.move;
    return new Float32Array([
      rows[0][0] * sx, rows[1][0] * sy, -rows[2][0] * 0.5, 0,
      rows[0][1] * sx, rows[1][1] * sy, -rows[2][1] * 0.5, 0,
      rows[0][2] * sx, rows[1][2] * sy, -rows[2][2] * 0.5, 0,
      2 * mx / width, -2 * my / height, 0, 1]);
  }

  draw() {
    const { gl, canvas, bench } = this;
    if (!gl) return;
    const ratio = Math.min(devicePixelRatio, 1.5);
    const stage = canvas.parentElement;
    const [width, height] = [Math.max(1, Math.round(stage.clientWidth * ratio)), Math.max(1, Math.round(stage.clientHeight * ratio))];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    this.build();
    gl.viewport(0, 0, width, height);
    gl.clearColor(...bench.background, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const matrix = this.matrix();
    const use = program => {
      gl.useProgram(program);
      gl.uniformMatrix4fv(gl.getUniformLocation(program, 'project'), false, matrix);
    };
    const attribute = (program, name, size, type, normalised, stride, offset) => {
      const place = gl.getAttribLocation(program, name);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, type, normalised, stride, offset);
    };
    if (this.triangles > 0) {
      const program = this.programs.body;
      use(program);
      gl.uniform2f(gl.getUniformLocation(program, 'size'), width / 2, height / 2);
      gl.uniform1f(gl.getUniformLocation(program, 'edges'), bench.show.edges ? 0.55 : 0);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
      attribute(program, 'place', 3, gl.FLOAT, false, 16, 0);
      attribute(program, 'tint', 4, gl.UNSIGNED_BYTE, true, 16, 12);
      gl.drawArrays(gl.TRIANGLES, 0, 3 * this.triangles);
    }
    if (bench.show.slices) this.drawSlices(use, attribute);
    this.drawLines(use, attribute);
    this.frames++;
  }

  /** Draws the three sections where they lie. */
  drawSlices(use, attribute) {
    const { gl, bench } = this;
    const program = this.programs.slice;
    use(program);
    for (const section of bench.sections) {
      const { u, v, across, picture } = section;
      if (!picture) continue;
      const { dims } = bench.frame;
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D, this.textures[across]);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
      for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
      const vertices = [[0, 0], [1, 0], [0, 1], [1, 1]].flatMap(([a, b]) => {
        const index = [0, 0, 0];
        [index[u], index[v], index[across]] = [a * (dims[u] - 1), b * (dims[v] - 1), section.at];
        return [...this.toBox(index), (a * (dims[u] - 1) + 0.5) / dims[u], (b * (dims[v] - 1) + 0.5) / dims[v]];
      });
      gl.bindBuffer(gl.ARRAY_BUFFER, this.sliceBuffer);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(vertices), gl.DYNAMIC_DRAW);
      attribute(program, 'place', 3, gl.FLOAT, false, 20, 0);
      attribute(program, 'share', 2, gl.FLOAT, false, 20, 12);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }
  }

  /** Draws the box, the lines where the sections cross, and the lines of tools. */
  drawLines(use, attribute) {
    const { gl, bench } = this;
    const program = this.programs.line;
    use(program);
    const { dims } = bench.frame;
    const draw = (points, color) => {
      gl.uniform3f(gl.getUniformLocation(program, 'color'), ...color.map(c => c / 255));
      gl.bindBuffer(gl.ARRAY_BUFFER, this.lineBuffer);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points.flatMap(point => this.toBox(point))), gl.DYNAMIC_DRAW);
      attribute(program, 'place', 3, gl.FLOAT, false, 12, 0);
      gl.drawArrays(gl.LINES, 0, points.length);
    };
    const box = [0, 1, 2].flatMap(k => [[0, 0], [0, 1], [1, 0], [1, 1]].flatMap(([a, b]) => [0, 1].map(end => {
      const point = [0, 0, 0];
      [point[k], point[(k + 1) % 3], point[(k + 2) % 3]] = [end * (dims[k] - 1), a * (dims[(k + 1) % 3] - 1), b * (dims[(k + 2) % 3] - 1)];
      return point;
    })));
    draw(box, [128, 140, 152]);
    if (bench.show.slices) {
      draw([0, 1, 2].flatMap(k => [0, dims[k] - 1].map(end => bench.cursor.map((c, i) => (i === k ? end : c)))), [255, 210, 0]);
    }
    for (const tool of Object.values(bench.tools)) tool.lines?.((points, color) => points.length > 1 && draw(points.slice(1).flatMap((p, i) => [points[i], p]), rgbOf(color)));
  }

  /** Returns the place, at indices of samples, and the cell that are drawn at a pixel; null if there is nothing. */
  pick(x, y) {
    const { width, height } = this.canvas;
    const m = this.matrix();
    const [px, py] = [2 * x / width - 1, 1 - 2 * y / height];
    const project = (p, o) => [
      m[0] * p[o] + m[4] * p[o + 1] + m[8] * p[o + 2] + m[12],
      m[1] * p[o] + m[5] * p[o + 1] + m[9] * p[o + 2] + m[13],
      m[2] * p[o] + m[6] * p[o + 1] + m[10] * p[o + 2]];
    let [best, found] = [Infinity, null];
    for (let t = 0; t < this.triangles; t++) {
      const [a, b, c] = [0, 4, 8].map(o => project(this.places, 12 * t + o));
      const area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
      const s = ((px - a[0]) * (c[1] - a[1]) - (py - a[1]) * (c[0] - a[0])) / area;
      const r = ((b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0])) / area;
      if (!(s >= 0 && r >= 0 && s + r <= 1)) continue;
      const depth = a[2] + s * (b[2] - a[2]) + r * (c[2] - a[2]);
      if (depth >= best) continue;
      best = depth;
      const corner = (o, k) => this.places[12 * t + o + k];
      const { dims } = this.bench.frame;
      const cell = this.faceCells[t];
      // A place a little inside the cell.
      const middle = [0, 1, 2].map(k => [0, 1, 2, 3].reduce((sum, i) => sum + this.bench.mesh.nodes[3 * this.bench.mesh.corners[4 * cell + i] + k], 0) / 4);
      const point = [0, 1, 2].map(k => {
        const place = corner(0, k) + s * (corner(4, k) - corner(0, k)) + r * (corner(8, k) - corner(0, k));
        return (place / this.size[k] + 0.5) * Math.max(1, dims[k] - 1);
      });
      found = { cell, point: point.map((c, k) => c + 0.05 * (middle[k] - c)) };
    }
    return found;
  }

  listen() {
    const { canvas } = this;
    const at = event => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
    const fingers = new Map();
    let travelled = 0;
    canvas.addEventListener('pointerdown', event => {
      canvas.focus();
      canvas.setPointerCapture(event.pointerId);
      if (fingers.size === 0) travelled = 0;
      fingers.set(event.pointerId, at(event));
    });
    canvas.addEventListener('pointermove', event => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const now = at(event);
      const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
      travelled += Math.abs(dx) + Math.abs(dy);
      if (fingers.size === 2) {
        const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
        const apart = p => Math.hypot(p[0] - other[0], p[1] - other[1]);
        this.zoom *= apart(now) / Math.max(1, apart(before));
      } else if (event.shiftKey || event.buttons > 1) this.move = [this.move[0] + dx, this.move[1] + dy];
      else if (travelled > 4) this.turn(-0.008 * dx, 0.008 * dy);
      fingers.set(event.pointerId, now);
      this.bench.redrawBody();
    });
    const lift = event => {
      const had = fingers.delete(event.pointerId);
      if (!had || travelled > 4 || event.type !== 'pointerup' || event.button !== 0) return;
      const ratio = canvas.width / canvas.clientWidth;
      const hit = this.pick(...at(event).map(c => c * ratio));
      if (hit) this.bench.tool.hit ? this.bench.tool.hit(hit, event) : this.bench.setCursor(hit.point);
    };
    canvas.addEventListener('pointerup', lift);
    canvas.addEventListener('pointercancel', lift);
    canvas.addEventListener('contextmenu', event => event.preventDefault());
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      this.zoom = Math.min(Math.max(this.zoom * Math.exp(-event.deltaY * 0.0015), 0.2), 100);
      this.bench.redrawBody();
    }, { passive: false });
    canvas.addEventListener('keydown', event => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const turn = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
      const sides = [[0, 0], [Math.PI / 2, 0], [Math.PI, 0], [-Math.PI / 2, 0], [0, Math.PI / 2], [0, -Math.PI / 2]];
      if (turn) this.turn(...turn);
      else if (event.key === '+' || event.key === '=') this.zoom *= 1.2;
      else if (event.key === '-') this.zoom /= 1.2;
      else if (event.key === '0') Object.assign(this, { yaw: -0.7, pitch: 0.45, zoom: 1, move: [0, 0] });
      else if ('123456'.includes(event.key)) [this.yaw, this.pitch] = sides[event.key - 1];
      else return;
      event.preventDefault();
      event.stopPropagation();
      this.bench.redrawBody();
    });
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(Math.max(this.pitch + pitch, -Math.PI / 2), Math.PI / 2);
  }
}
