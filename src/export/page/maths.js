// Formats numbers, maps values to colours, and projects the box to the screen.

/** Formats a number with enough digits to distinguish it from neighbours at a distance of `step`. */
function written(value, step) {
  if (value === null || value === undefined || Number.isNaN(value)) return '–';
  if (!Number.isFinite(value)) return value > 0 ? '∞' : '−∞';
  if (Number.isInteger(value) && Math.abs(value) < 1e15 && !step) return grouped(value);
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e7 || size < 1e-4)) return value.toExponential(2).replace('-', '−').replace('e+', 'e');
  const digits = step ? Math.max(0, Math.ceil(-Math.log10(step) - 1e-9)) : Math.max(0, 3 - Math.floor(Math.log10(size || 1)));
  return grouped(Number(value.toFixed(Math.min(digits, 12))));
}

/** Formats a number with thin spaces: 1 234 567.5. */
function grouped(value) {
  const [whole, part] = String(value).replace('-', '−').split('.');
  const spaced = whole.length > 5 ? whole.replace(/\B(?=(\d{3})+$)/g, '\u202f') : whole;
  return part ? `${spaced}.${part}` : spaced;
}

/** Returns the smallest round step (1, 2 or 5 times a power of ten) that divides a length into at most `most` steps. */
function roundStep(length, most) {
  const rough = Math.abs(length) / Math.max(most, 1);
  const ten = 10 ** Math.floor(Math.log10(rough || 1));
  return [1, 2, 5, 10].map(k => k * ten).find(step => step >= rough * (1 - 1e-9)) || 10 * ten;
}

/** Returns the round numbers between two values, and their step. */
function ticks(from, to, most) {
  const [low, high] = from < to ? [from, to] : [to, from];
  const step = roundStep(high - low, most);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-6); i * step <= high + 1e-6 * step; i++) found.push(i * step);
  return { found, step };
}

/** Colour map viridis, interpolated from five of its colours. */
const VIRIDIS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
/** Colours that are easy to distinguish (Okabe and Ito), and greys for missing values and for plain cells. */
const DISTINCT = [[86, 180, 233], [230, 159, 0], [0, 158, 115], [240, 228, 66], [204, 121, 167], [0, 114, 178], [213, 94, 0], [148, 103, 189], [140, 86, 75], [127, 188, 65], [190, 190, 190], [23, 190, 207]];
const NO_VALUE = [150, 150, 150];
const PLAIN = { light: [196, 208, 220], dark: [112, 128, 144] };
/** Returns the colour of a surface. Faults are red to orange, horizons green to blue. Surfaces with consecutive numbers differ clearly. */
const KINDS = {
  fault: [[214, 69, 35], [236, 138, 60], [178, 42, 78], [240, 170, 110], [150, 62, 30]],
  horizon: [[0, 133, 110], [88, 178, 150], [22, 104, 150], [124, 190, 104], [0, 92, 84]],
};
const colorOfSurface = (kind, number) => {
  const colors = KINDS[kind] || KINDS.fault;
  return colors[(number - 1) % colors.length];
};

function ramp(t) {
  const x = Math.min(Math.max(t, 0), 1) * (VIRIDIS.length - 1);
  const k = Math.min(Math.floor(x), VIRIDIS.length - 2);
  return VIRIDIS[k].map((c, i) => Math.round(c + (x - k) * (VIRIDIS[k + 1][i] - c)));
}

const css = ([r, g, b]) => `rgb(${r} ${g} ${b})`;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** Returns the projection of points of the box, as fractions in [0, 1], to the screen: one row each for the
 *  pixels from the centre to the right, the pixels upwards, and the depth towards the viewer. */
function projection(frame, view) {
  const stretch = [1, 1, frame.flat ? 1 : view.stretch];
  const last = frame.flat ? 1 : 2;
  const edges = frame.edges.map(edge => edge.map((c, k) =>
    c * frame.aspect[k] * stretch[k] * (k === last && view.down ? -1 : 1)));
  const [cy, sy, cp, sp] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.cos(view.pitch), Math.sin(view.pitch)];
  const right = [cy, sy, 0];
  const up = [-sy * sp, cy * sp, cp];
  const towards = [sy * cp, -cy * cp, sp];
  const middle = [0, 1, 2].map(k => (edges[0][k] + edges[1][k] + edges[2][k]) / 2);
  const row = axis => {
    const along = edges.map(edge => dot(edge, axis));
    return [...along, -dot(middle, axis)];
  };
  const size = Math.hypot(...edges.map(edge => Math.hypot(...edge)));
  return { rows: [row(right), row(up), row(towards)], size, edges };
}

/** Converts a point of the box, as fractions, to physical coordinates. `readOff` returns the value on an axis. */
const worldOf = (frame, p) =>
  frame.origin.map((c, k) => c + p[0] * frame.edges[0][k] + p[1] * frame.edges[1][k] + p[2] * frame.edges[2][k]);
const readOff = (ruler, share) => ruler.first + share * (ruler.last - ruler.first);
