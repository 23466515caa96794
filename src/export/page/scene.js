// Draws faces and sections with WebGL2.

/** Vertex shader of faces: positions of the corners of triangles, and marks of the sides that are edges of the face. */
const FACE_SHADER = `#version 300 es
uniform vec4 across, up, towards;
uniform vec3 halfSize;
uniform float nearer;
in vec3 place;
in float sides;
in vec4 color;
out vec3 at;
out vec3 p;
out vec3 corner;
flat out vec4 tint;
flat out int edges;
void main() {
  p = place;
  vec4 q = vec4(place, 1.0);
  at = vec3(dot(across, q), dot(up, q), dot(towards, q));
  gl_Position = vec4(at.xy / halfSize.xy, -at.z / halfSize.z - nearer, 1.0);
  int k = gl_VertexID % 3;
  corner = vec3(k == 0, k == 1, k == 2);
  tint = color;
  edges = int(sides + 0.5);
}`;
/** Shader code that returns the colour of the image at a position in the box. */
const imageColor = flat => `
uniform highp ${flat ? 'sampler2D' : 'sampler3D'} samples;
uniform sampler2D colors;
uniform vec3 dims;
vec3 imageColor(vec3 p) {
  vec3 q = (p * (dims - 1.0) + 0.5) / dims;
  float value = texture(samples, q${flat ? '.xy' : ''}).r;
  return texture(colors, vec2((value * 255.0 + 0.5) / 256.0, 0.5)).rgb;
}`;
const faceColor = flat => `#version 300 es
precision highp float;
uniform vec4 line;
uniform float width, painted, flatLight;
in vec3 at;
in vec3 p;
in vec3 corner;
flat in vec4 tint;
flat in int edges;
out vec4 result;
${imageColor(flat)}
void main() {
  vec3 normal = normalize(cross(dFdx(at), dFdy(at)));
  float facing = abs(dot(normal, normalize(vec3(-0.25, 0.35, 0.9))));
  vec3 plain = painted > 0.5 ? imageColor(p) : tint.rgb;
  vec3 lit = plain * mix(0.66 + 0.36 * facing, 1.0, flatLight);
  vec3 change = fwidth(corner);
  vec3 pixels = corner / max(change, vec3(1e-6));
  vec3 far = vec3((edges & 1) != 0 ? pixels.x : 1e6, (edges & 2) != 0 ? pixels.y : 1e6, (edges & 4) != 0 ? pixels.z : 1e6);
  float nearest = min(far.x, min(far.y, far.z));
  // Edges fade where cells are smaller than a few pixels.
  float size = 1.0 / max(max(change.x, change.y), max(change.z, 1e-6));
  float ink = (1.0 - smoothstep(width - 0.5, width + 0.5, nearest)) * smoothstep(2.5, 9.0, size);
  result = vec4(mix(lit, line.rgb, ink * line.a), 1.0);
}`;
const SECTION_SHADER = `#version 300 es
uniform vec4 across, up, towards;
uniform vec3 halfSize;
uniform float nearer;
in vec3 place;
out vec3 p;
void main() {
  p = place;
  vec4 q = vec4(place, 1.0);
  gl_Position = vec4(dot(across, q) / halfSize.x, dot(up, q) / halfSize.y, -dot(towards, q) / halfSize.z - nearer, 1.0);
}`;
const sectionColor = flat => `#version 300 es
precision highp float;
in vec3 p;
out vec4 result;
${imageColor(flat)}
void main() { result = vec4(imageColor(p), 1.0); }`;
const LINE_COLOR = `#version 300 es
precision highp float;
uniform vec4 line;
in vec3 p;
out vec4 result;
void main() { result = line; }`;

/** The twelve edges of the box, as positions of their ends. */
const BOX = [0, 1, 2].flatMap(k => [[0, 0], [0, 1], [1, 0], [1, 1]].map(([u, v]) => {
  const end = share => { const p = [0, 0, 0]; p[k] = share; p[(k + 1) % 3] = u; p[(k + 2) % 3] = v; return p; };
  return [end(0), end(1)];
}));

/** The four corners of a section. */
function sectionCorners(axis, share) {
  return [[0, 0], [1, 0], [0, 1], [1, 1]].map(([u, v]) => {
    const p = [0, 0, 0];
    p[axis] = share; p[(axis + 1) % 3] = u; p[(axis + 2) % 3] = v;
    return p;
  });
}

/** Bytes of a corner: three coordinates, marks of sides, a colour. */
const CORNER = 12;

/** Triangles on the screen, with the face and the cell of each. */
class Triangles {
  constructor() { this.count = 0; this.room = 0; }

  /** Allocates space. Existing triangles are discarded. */
  clear(triangles) {
    this.count = 0;
    if (triangles <= this.room) return;
    this.room = Math.ceil(triangles * 1.25);
    this.buffer = new ArrayBuffer(this.room * 3 * CORNER);
    this.words = new Uint16Array(this.buffer);
    this.bytes = new Uint8Array(this.buffer);
    this.face = new Uint32Array(this.room);
    this.cell = new Uint32Array(this.room);
  }

  /** Adds a face as a fan of triangles. */
  add(mesh, face, cell, [r, g, b]) {
    const { first, corners, nodes } = mesh;
    const start = first[face], size = first[face + 1] - start;
    for (let i = 1; i < size - 1; i++) {
      const sides = 1 | (i + 1 === size - 1 ? 2 : 0) | (i === 1 ? 4 : 0);
      for (let k = 0; k < 3; k++) {
        const node = 3 * corners[start + (k === 0 ? 0 : i + k - 1)];
        const at = this.count * 3 + k;
        const word = at * 6, byte = at * CORNER + 8;
        this.words[word] = nodes[node];
        this.words[word + 1] = nodes[node + 1];
        this.words[word + 2] = nodes[node + 2];
        this.words[word + 3] = sides;
        this.bytes[byte] = r; this.bytes[byte + 1] = g; this.bytes[byte + 2] = b; this.bytes[byte + 3] = 255;
      }
      this.face[this.count] = face;
      this.cell[this.count++] = cell;
    }
  }
}

class Scene {
  constructor(canvas, facts, mesh) {
    // The drawing buffer is preserved, so that the image can be read back.
    const gl = canvas.getContext('webgl2', { antialias: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error('This browser has no WebGL2, which draws the mesh; the figures beside it are complete.');
    Object.assign(this, { canvas, gl, facts, mesh });
    this.flat = facts.dimensions === 2;
    this.faceProgram = this.program(FACE_SHADER, faceColor(this.flat));
    this.lineProgram = this.program(SECTION_SHADER, LINE_COLOR);
    this.cells = this.layer();
    this.features = this.layer();
    this.box = this.places(BOX.flat(2));
    this.section = this.places(new Array(24).fill(0));
    // Without an image, the texture has one byte, because even an unused texture must be complete.
    this.loadImage(facts.image || { dims: [1, 1, 1], colors: null });
    this.hasImage = !!facts.image;
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
  }

  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    ['place', 'sides', 'color'].forEach((name, at) => gl.bindAttribLocation(program, at, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
  }

  /** Creates the vertex array of triangles. */
  layer() {
    const gl = this.gl, array = gl.createVertexArray(), buffer = gl.createBuffer();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, true, CORNER, 0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 1, gl.UNSIGNED_SHORT, false, CORNER, 6);
    gl.enableVertexAttribArray(2);
    gl.vertexAttribPointer(2, 4, gl.UNSIGNED_BYTE, true, CORNER, 8);
    return { array, buffer, triangles: new Triangles() };
  }

  /** Creates the vertex array of positions. */
  places(numbers) {
    const gl = this.gl, array = gl.createVertexArray(), buffer = gl.createBuffer();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(numbers), gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    return { array, buffer };
  }

  loadImage({ dims, colors }) {
    const gl = this.gl;
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const target = this.flat ? gl.TEXTURE_2D : gl.TEXTURE_3D;
    const bytes = this.mesh.image || new Uint8Array(1);
    this.image = { target, texture: gl.createTexture(), colors: gl.createTexture(), dims };
    gl.bindTexture(target, this.image.texture);
    if (this.flat) gl.texImage2D(target, 0, gl.R8, dims[0], dims[1], 0, gl.RED, gl.UNSIGNED_BYTE, bytes);
    else gl.texImage3D(target, 0, gl.R8, ...dims, 0, gl.RED, gl.UNSIGNED_BYTE, bytes);
    for (const way of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(target, way, gl.CLAMP_TO_EDGE);
    gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    this.palette = colors ? fromBase64(colors) : new Uint8Array(768);
    gl.bindTexture(gl.TEXTURE_2D, this.image.colors);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, this.palette);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    this.sectionProgram = this.program(SECTION_SHADER, sectionColor(this.flat));
  }

  /** Returns a byte for each cell: 1 if the cuts leave it visible. */
  shownCells(cut) {
    const { bins } = this.mesh, { steps } = this.facts;
    const count = bins.length / 3;
    const shown = new Uint8Array(count).fill(1);
    const active = [0, 1, 2].filter(k => cut.at[k] < steps);
    if (active.length === 0) return shown;
    const corner = cut.mode === 'corner';
    for (let c = 0; c < count; c++) {
      let beyond = 0;
      for (const k of active) {
        // Either the far side or the near side is hidden.
        const bin = cut.turned[k] ? steps - 1 - bins[3 * c + k] : bins[3 * c + k];
        if (bin >= cut.at[k]) beyond++;
      }
      if (corner ? beyond === active.length : beyond > 0) shown[c] = 0;
    }
    return shown;
  }

  /** Makes the triangles of the faces with exactly one visible cell, and of the faces on features. */
  build(cut, colorOfCell, colorOfSurface) {
    const { mesh } = this;
    const { owner, beyond, surfaces, first } = mesh;
    const shown = this.shownCells(cut);
    const visible = [], onFeatures = [];
    let triangles = 0, featureTriangles = 0;
    for (let f = 0; f < owner.length; f++) {
      const size = first[f + 1] - first[f] - 2;
      const a = shown[owner[f]], b = beyond[f] < 0 ? 0 : shown[beyond[f]];
      if (a !== b) { visible.push(f); triangles += size; }
      if (surfaces[f]) { onFeatures.push(f); featureTriangles += size; }
    }
    this.cells.triangles.clear(triangles);
    for (const f of visible) {
      const cell = shown[owner[f]] ? owner[f] : beyond[f];
      this.cells.triangles.add(mesh, f, cell, colorOfCell(cell));
    }
    this.features.triangles.clear(featureTriangles);
    for (const f of onFeatures) this.features.triangles.add(mesh, f, owner[f], colorOfSurface(surfaces[f]));
    const gl = this.gl;
    for (const { buffer, triangles } of [this.cells, this.features]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      if (triangles.count) gl.bufferData(gl.ARRAY_BUFFER, new Uint8Array(triangles.buffer, 0, triangles.count * 3 * CORNER), gl.DYNAMIC_DRAW);
    }
    this.shown = shown;
    this.visibleFaces = visible.length;
  }

  /** Draws the scene with the settings `look` and the projection `way`. */
  draw(way, look) {
    const { gl, canvas } = this;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...look.ground.map(c => c / 255), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const use = ({ program, uniforms }, nearer) => {
      gl.useProgram(program);
      gl.uniform4fv(uniforms.across, way.rows[0]);
      gl.uniform4fv(uniforms.up, way.rows[1]);
      gl.uniform4fv(uniforms.towards, way.rows[2]);
      gl.uniform3fv(uniforms.halfSize, way.halfSize);
      gl.uniform1f(uniforms.nearer, nearer);
      return uniforms;
    };
    const withImage = uniforms => {
      gl.activeTexture(gl.TEXTURE1);
      gl.bindTexture(gl.TEXTURE_2D, this.image.colors);
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(this.image.target, this.image.texture);
      gl.uniform1i(uniforms.samples, 0);
      gl.uniform1i(uniforms.colors, 1);
      gl.uniform3fv(uniforms.dims, this.image.dims);
    };
    const layer = ({ array, triangles }, nearer, line, painted) => {
      if (!triangles.count) return;
      const uniforms = use(this.faceProgram, nearer);
      gl.uniform4fv(uniforms.line, line);
      gl.uniform1f(uniforms.width, look.lineWidth);
      gl.uniform1f(uniforms.painted, painted ? 1 : 0);
      gl.uniform1f(uniforms.flatLight, this.flat ? 1 : 0);
      withImage(uniforms);
      gl.bindVertexArray(array);
      gl.drawArrays(gl.TRIANGLES, 0, 3 * triangles.count);
    };
    if (look.cells) layer(this.cells, 0, look.line, look.painted);
    if (look.features) layer(this.features, 2e-4, look.featureLine, false);
    for (const { axis, share } of look.sections) {
      withImage(use(this.sectionProgram, this.flat ? -1e-3 : 0));
      this.drawSection(axis, share);
      gl.uniform4fv(use(this.lineProgram, 1e-4).line, look.box);
      if (!this.flat) gl.drawArrays(gl.LINE_LOOP, 4, 4);
    }
    if (!this.flat) {
      const uniforms = use(this.lineProgram, 1e-4);
      gl.uniform4fv(uniforms.line, look.box);
      gl.bindVertexArray(this.box.array);
      gl.drawArrays(gl.LINES, 0, 24);
    }
  }

  drawSection(axis, share) {
    const { gl } = this;
    gl.bindVertexArray(this.section.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.section.buffer);
    // First the section, then its frame.
    const [a, b, c, d] = sectionCorners(axis, share);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, new Float32Array([a, b, c, d, a, b, d, c].flat()));
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /** Returns what is drawn at a point of the screen (pixels from its centre, upwards): the nearest triangle,
   *  or a section. Returns null if there is nothing. */
  pick(x, y, way, look) {
    const { nodes, corners, first } = this.mesh;
    let best = null;
    const onScreen = node => {
      const p = [nodes[node] / 65535, nodes[node + 1] / 65535, nodes[node + 2] / 65535, 1];
      return way.rows.map(row => row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3]);
    };
    const look1 = ({ triangles }, kind) => {
      let face = -1, ring = [];
      for (let t = 0; t < triangles.count; t++) {
        let i = 1;
        if (triangles.face[t] !== face) {
          face = triangles.face[t];
          ring = null;
        }
        if (ring === null) {
          ring = [];
          for (let c = first[face]; c < first[face + 1]; c++) ring.push(onScreen(3 * corners[c]));
          for (i = 1; i < ring.length - 1; i++) {
            const z = depthInside(x, y, ring[0], ring[i], ring[i + 1]);
            if (z !== null && (!best || z > best.z)) best = { kind, face, cell: triangles.cell[t], z };
          }
        }
      }
    };
    if (look.cells) look1(this.cells, 'cell');
    if (look.features) look1(this.features, 'feature');
    if (this.hasImage) {
      for (const { axis, share } of look.sections) {
        const [a, b, c, d] = sectionCorners(axis, share).map(p => way.rows.map(row => dot(row, p) + row[3]));
        const hits = [depthInside(x, y, a, b, c), depthInside(x, y, b, d, c)].filter(z => z !== null);
        if (hits.length && (!best || hits[0] > best.z + 1e-6)) best = { kind: 'image', axis, z: hits[0] };
      }
    }
    return best && { ...best, place: fromScreen([x, y, best.z], way.rows) };
  }

  /** Returns the value of the image at the nearest sample of the texture. */
  imageAt(place) {
    const { dims, low, high } = this.facts.image;
    const [i, j, k] = dims.map((n, axis) => Math.round(Math.min(Math.max(place[axis], 0), 1) * (n - 1)));
    return low + (high - low) * this.mesh.image[(k * dims[1] + j) * dims[0] + i] / 255;
  }
}

/** Returns the depth of a triangle at a point of the screen, if it covers the point. */
function depthInside(x, y, a, b, c) {
  const area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
  if (area === 0) return null;
  const u = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area;
  const v = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area;
  return u < 0 || v < 0 || u + v > 1 ? null : a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2]);
}

/** Returns the position in the box that is drawn at a point of the screen, by Cramer's rule. */
function fromScreen(point, rows) {
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const [a, b, c] = rows;
  const [p, q, r] = rows.map((row, k) => point[k] - row[3]);
  const whole = dot(a, cross(b, c));
  if (whole === 0) {
    // In 2-D there is no third edge.
    const flat = a[0] * b[1] - a[1] * b[0];
    return [(p * b[1] - q * a[1]) / flat, (q * a[0] - p * b[0]) / flat, 0];
  }
  const [bc, ca, ab] = [cross(b, c), cross(c, a), cross(a, b)];
  return [0, 1, 2].map(k => (p * bc[k] + q * ca[k] + r * ab[k]) / whole);
}
