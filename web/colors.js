// Colour maps that colour-blind readers can use, and the colours of units and surfaces.

/** Stops of the colour maps, interpolated between. `balance` is for values on both sides of zero. */
const COLOR_MAPS = {
  grey: [[0, 0, 0], [255, 255, 255]],
  viridis: [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]],
  cividis: [[0, 34, 78], [35, 62, 108], [85, 91, 109], [124, 123, 120], [165, 156, 116], [210, 192, 95], [254, 232, 56]],
  balance: [[0, 18, 97], [3, 82, 133], [89, 150, 182], [204, 221, 230], [236, 229, 224], [224, 190, 160], [198, 126, 73], [137, 55, 10], [89, 0, 8]],
};
const NO_SAMPLE = [176, 96, 96];
/** Colours of units (Okabe and Ito, and more that differ from them). */
const UNIT_COLORS = ['#56b4e9', '#e69f00', '#009e73', '#f0e442', '#cc79a7', '#0072b2', '#d55e00', '#9467bd', '#8c564b', '#7fbc41', '#17becf', '#bebebe'];
const FAULT_COLOR = '#e6461e';
const HORIZON_COLOR = '#00a884';
const PICK_COLORS = ['#ff2fd0', '#00e5ff', '#ffd500', '#7cff5a'];

/** Returns 256 colours of a map, three bytes each. */
function colorTable(name) {
  const stops = COLOR_MAPS[name];
  const table = new Uint8Array(768);
  for (let i = 0; i < 256; i++) {
    const x = i / 255 * (stops.length - 1);
    const k = Math.min(Math.floor(x), stops.length - 2);
    for (let c = 0; c < 3; c++) table[3 * i + c] = Math.round(stops[k][c] + (x - k) * (stops[k + 1][c] - stops[k][c]));
  }
  return table;
}

const unitColor = number => UNIT_COLORS[(number - 1) % UNIT_COLORS.length];
const rgbOf = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16));
const hexOf = ([r, g, b]) => `#${[r, g, b].map(c => c.toString(16).padStart(2, '0')).join('')}`;
