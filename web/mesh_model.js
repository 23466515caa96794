// The mesh of the page: nodes and cells as arrays, which patches of the program bring up to date.

/** Nodes of the face of a tetrahedron opposite each of its nodes. */
const FACES = [[1, 3, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2]];

/** Returns an array with room for `length` elements that begins as `array` does. */
function withRoom(array, length) {
  if (array.length >= length) return array;
  const larger = new array.constructor(Math.ceil(1.2 * length));
  larger.set(array);
  return larger;
}

/** An affine map between indices of samples and physical coordinates, which have the same number of axes. */
class Frame {
  /** `info` is the description of an image by `atomesh info`. */
  constructor(info) {
    this.dims = info.axes.map(axis => axis.count);
    this.names = info.axes.map(axis => axis.name);
    this.spacing = info.axes.map(axis => axis.spacing);
    this.units = info.units;
    this.origin = info.origin;
    this.steps = info.axes.map(axis => axis.step);
    this.inverse = inverseOf(this.steps[0].map((_, c) => this.steps.map(step => step[c])));
  }

  toIndex(x) {
    const from = x.map((c, k) => c - this.origin[k]);
    return this.inverse.map(row => row.reduce((sum, c, k) => sum + c * from[k], 0));
  }

  toPhysical(index) {
    return this.origin.map((c, k) => index.reduce((sum, i, axis) => sum + i * this.steps[axis][k], c));
  }

  /** Returns a point in physical coordinates as the program reads it, rounded to a thousandth of a sample. */
  pointText(index) {
    const step = Math.min(...this.spacing) / 1000;
    const digits = Math.max(0, Math.min(12, Math.ceil(-Math.log10(step))));
    return this.toPhysical(index).map(c => String(+c.toFixed(digits))).join(',');
  }
}

/** Returns the inverse of a square matrix of two or three rows, by Gauss and Jordan. */
function inverseOf(matrix) {
  const size = matrix.length;
  const rows = matrix.map((row, i) => [...row, ...row.map((_, k) => Number(i === k))]);
  for (let i = 0; i < size; i++) {
    let pivot = i;
    for (let k = i; k < size; k++) if (Math.abs(rows[k][i]) > Math.abs(rows[pivot][i])) pivot = k;
    [rows[i], rows[pivot]] = [rows[pivot], rows[i]];
    rows[i] = rows[i].map(c => c / rows[i][i]);
    for (let k = 0; k < size; k++) {
      if (k !== i) rows[k] = rows[k].map((c, j) => c - rows[k][i] * rows[i][j]);
    }
  }
  return rows.map(row => row.slice(size));
}

/** A mesh of triangles or tetrahedra. Nodes are at indices of samples. */
class MeshModel {
  constructor(frame) {
    Object.assign(this, { frame, size: frame.dims.length, nodeCount: 0, cellCount: 0, version: 0 });
    this.nodes = new Float32Array(0);
    this.corners = new Uint32Array(0);
    this.neighbours = new Int32Array(0);
    this.cellArrays = {};
    this.nodeArrays = {};
  }

  /** Returns `true` if the mesh has cells that can be drawn. */
  get isEmpty() { return this.cellCount === 0; }

  /** Brings the mesh up to date by a reply of the program. */
  apply({ patch, arrays }) {
    const { size } = this;
    const isNew = this.cellCount === 0 || arrays.cells.length === patch.cells[1];
    if (isNew) this.cellCount = 0;
    const [before, after] = [this.cellCount, patch.cells[1]];
    this.nodeCount = patch.nodes[1];
    this.nodes = withRoom(this.nodes, size * this.nodeCount);
    this.corners = withRoom(this.corners, (size + 1) * after);
    this.neighbours = withRoom(this.neighbours, (size + 1) * after);
    const { nodes, positions, cells, corners } = arrays;
    this.setPositions(nodes, positions);
    if (!isNew) this.unlink(cells, before, after);
    for (let i = 0; i < cells.length; i++) {
      for (let k = 0; k <= size; k++) this.corners[(size + 1) * cells[i] + k] = corners[(size + 1) * i + k];
    }
    this.cellCount = after;
    this.link(cells);
    this.setArrays(this.cellArrays, arrays, 'cell', patch.cell_arrays, after);
    this.setArrays(this.nodeArrays, arrays, 'node', patch.node_arrays, this.nodeCount);
    if (nodes.length + cells.length > 0) this.slices = null;
    this.version++;
  }

  setPositions(nodes, positions) {
    const { size, frame } = this;
    for (let i = 0; i < nodes.length; i++) {
      for (let k = 0; k < size; k++) {
        let sum = 0;
        for (let c = 0; c < size; c++) sum += frame.inverse[k][c] * (positions[size * i + c] - frame.origin[c]);
        this.nodes[size * nodes[i] + k] = sum;
      }
    }
  }

  setArrays(target, arrays, owner, names, count) {
    for (const name of Object.keys(target)) if (!names.includes(name)) delete target[name];
    for (const name of names) {
      target[name] = withRoom(target[name] || new Float32Array(0), count);
      const [indices, values] = [arrays[`${owner} indices ${name}`], arrays[`${owner} values ${name}`]];
      for (let i = 0; indices && i < indices.length; i++) target[name][indices[i]] = values[i];
    }
  }

  /** Makes the neighbours of cells that change, and of those that are removed, forget them. */
  unlink(cells, before, after) {
    const forget = cell => {
      const per = this.size + 1;
      for (let k = 0; k < per; k++) {
        const beyond = this.neighbours[per * cell + k];
        if (beyond < 0) continue;
        for (let j = 0; j < per; j++) if (this.neighbours[per * beyond + j] === cell) this.neighbours[per * beyond + j] = -2;
        this.open.add(beyond);
      }
    };
    this.open = new Set();
    for (const cell of cells) if (cell < before) forget(cell);
    for (let cell = after; cell < before; cell++) forget(cell);
  }

  /** Finds the neighbours of cells, and those of cells that have forgotten one of theirs. */
  link(cells) {
    const per = this.size + 1;
    const changed = new Set(this.open || []);
    this.open = null;
    for (const cell of cells) {
      changed.delete(cell);
      this.neighbours.fill(-2, per * cell, per * cell + per);
    }
    const all = [...changed].filter(cell => cell < this.cellCount);
    const total = (cells.length + all.length) * per;
    // An open hash table of faces that wait for their second cell.
    const room = 1 << Math.ceil(Math.log2(Math.max(16, 1.7 * total)));
    const table = new Int32Array(room).fill(-1);
    const at = (face, which) => {
      const cell = Math.floor(face / per);
      return this.corners[per * cell + which];
    };
    const sorted = new Uint32Array(4);
    const keyOf = face => {
      const [cell, k] = [Math.floor(face / per), face % per];
      let n = 0;
      for (let i = 0; i < per; i++) {
        if (i === k) continue;
        const node = at(face, i);
        let j = n++;
        while (j > 0 && sorted[j - 1] > node) { sorted[j] = sorted[j - 1]; j--; }
        sorted[j] = node;
      }
      return cell;
    };
    const visit = cell => {
      for (let k = 0; k < per; k++) {
        const face = per * cell + k;
        if (this.neighbours[face] !== -2) continue;
        keyOf(face);
        const [a, b, c] = [sorted[0], sorted[1], this.size === 3 ? sorted[2] : 0];
        let slot = (Math.imul(a, 73856093) ^ Math.imul(b, 19349663) ^ Math.imul(c, 83492791)) & (room - 1);
        for (;;) {
          const other = table[slot];
          if (other === -1) { table[slot] = face; break; }
          if (this.neighbours[other] === -2) {
            const otherCell = keyOf(other);
            if (otherCell !== cell && sorted[0] === a && sorted[1] === b && (this.size === 2 || sorted[2] === c)) {
              this.neighbours[face] = otherCell;
              this.neighbours[other] = cell;
              break;
            }
          }
          slot = (slot + 1) & (room - 1);
        }
      }
    };
    for (const cell of cells) visit(cell);
    for (const cell of all) visit(cell);
    for (const list of [cells, all]) {
      for (const cell of list) {
        for (let k = 0; k < per; k++) if (this.neighbours[per * cell + k] === -2) this.neighbours[per * cell + k] = -1;
      }
    }
  }

  /** Returns for an axis the cells in the order of their lowest coordinate, and how far cells reach. */
  sliceIndex(axis) {
    this.slices ??= [];
    if (this.slices[axis]) return this.slices[axis];
    const { size, nodes, corners, cellCount } = this;
    const per = size + 1;
    const bins = this.frame.dims[axis];
    const start = new Uint32Array(bins + 1);
    const bin = new Uint16Array(cellCount);
    let reach = 0;
    for (let cell = 0; cell < cellCount; cell++) {
      let [low, high] = [Infinity, -Infinity];
      for (let k = 0; k < per; k++) {
        const x = nodes[size * corners[per * cell + k] + axis];
        if (x < low) low = x;
        if (x > high) high = x;
      }
      bin[cell] = Math.min(Math.max(Math.floor(low), 0), bins - 1);
      start[bin[cell] + 1]++;
      if (high - low > reach) reach = high - low;
    }
    for (let i = 0; i < bins; i++) start[i + 1] += start[i];
    const next = start.slice();
    const order = new Uint32Array(cellCount);
    for (let cell = 0; cell < cellCount; cell++) order[next[bin[cell]]++] = cell;
    return this.slices[axis] = { start, order, reach: Math.ceil(reach) + 1 };
  }

  /** Calls `use` with each cell that may be cut by the plane at position `at` of an axis. */
  eachNear(axis, at, use) {
    const { start, order, reach } = this.sliceIndex(axis);
    const last = Math.min(Math.max(Math.floor(at), 0), this.frame.dims[axis] - 1);
    const first = Math.max(0, last - reach);
    for (let i = start[first]; i < start[last + 1]; i++) use(order[i]);
  }

  /** Returns the cell that contains a point, at indices of samples; -1 if there is none. */
  cellAt(point) {
    const { size } = this;
    const axis = size - 1;
    let found = -1, best = -1e-4;
    this.eachNear(axis, point[axis], cell => {
      const least = this.leastShare(cell, point);
      if (least > best) [found, best] = [cell, least];
    });
    return found;
  }

  /** Returns the least barycentric coordinate of a point in a cell. */
  leastShare(cell, point) {
    const { size, nodes, corners } = this;
    const corner = (k, c) => nodes[size * corners[(size + 1) * cell + k] + c];
    const edges = [];
    for (let k = 1; k <= size; k++) edges.push(Array.from({ length: size }, (_, c) => corner(k, c) - corner(0, c)));
    const from = Array.from({ length: size }, (_, c) => point[c] - corner(0, c));
    const volume = determinant(edges);
    let [least, rest] = [Infinity, 1];
    for (let k = 0; k < size; k++) {
      const share = determinant(edges.map((edge, i) => (i === k ? from : edge))) / volume;
      rest -= share;
      least = Math.min(least, share);
    }
    return Math.min(least, rest);
  }

  /** Returns `true` if face `k` of a cell is marked as lying on a feature. */
  isFeature(cell, k) {
    const bits = this.cellArrays.feature_faces || this.cellArrays.feature_edges;
    return bits !== undefined && (bits[cell] >> k & 1) === 1;
  }

  /** Returns the range of the values of an array. */
  rangeOf(values, count) {
    let [low, high] = [Infinity, -Infinity];
    for (let i = 0; i < count; i++) {
      if (values[i] < low) low = values[i];
      if (values[i] > high) high = values[i];
    }
    return [low, high];
  }

  /** Returns the value of a cell in an array of cells, or the mean of its nodes in an array of nodes. */
  valueOf(name, cell) {
    if (this.cellArrays[name]) return this.cellArrays[name][cell];
    const values = this.nodeArrays[name];
    const per = this.size + 1;
    let sum = 0;
    for (let k = 0; k < per; k++) sum += values[this.corners[per * cell + k]];
    return sum / per;
  }
}

const determinant = m => m.length === 2
  ? m[0][0] * m[1][1] - m[0][1] * m[1][0]
  : m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
    m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
