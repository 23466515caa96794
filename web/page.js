// The page: reads the user's choices, runs commands of the program in a worker, and shows the results.

const $ = id => document.getElementById(id);
const MAX_SECTION_SAMPLES = 1 << 26;
// Memory of a job of `mesh` for each sample: 44 MB for 64^3 samples on Linux.
const BYTES_PER_SAMPLE = 170;
const PAGE_BYTES = 2 ** 32;
const EXPORTS = [['msh', 'msh', 'Gmsh'], ['inp', 'inp', 'Abaqus, CalculiX'], ['nastran', 'bdf', 'NASTRAN'], ['stl', 'stl', 'STL']];

const state = { image: null, files: {}, info: null, worker: null, outputs: {}, samples: null, module: null };
window.atomesh = state;

/** Returns the program, compiled. */
async function compile() {
  const bytes = Uint8Array.from(atob($('program').textContent), letter => letter.charCodeAt(0));
  $('program').remove();
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  return WebAssembly.compile(await new Response(stream).arrayBuffer());
}

const workerUrl = URL.createObjectURL(new Blob([$('worker').textContent], { type: 'text/javascript' }));

/**
 * Runs a command, such as ['info', 'a.nii'], on the files and returns its result with `errors`, the lines of standard
 * error. Throws the text of the error if the command fails.
 */
async function run(args, files, onLine = () => {}) {
  const module = await state.module;
  return new Promise((resolve, reject) => {
    const worker = new Worker(workerUrl);
    state.worker = { end: () => { worker.terminate(); reject(new Error('cancelled')); } };
    const errors = [];
    worker.onerror = event => reject(new Error(event.message));
    worker.onmessage = ({ data: { line, result } }) => {
      if (line !== undefined) {
        errors.push(line);
        onLine(line);
      }
      if (result === undefined) return;
      worker.terminate();
      if (result.code === 0) resolve({ ...result, errors });
      else reject(new Error(errors.filter(text => text.startsWith('error')).join('\n') || `exit code ${result.code}`));
    };
    worker.postMessage({ module, args: ['atomesh', ...args], files });
  });
}

function say(text, isError = false) {
  $('status').textContent = text;
  $('status').classList.toggle('error', isError);
}

/** Runs `work` while the controls are disabled, and shows its error if it fails. */
async function busy(text, work) {
  $('controls').disabled = true;
  $('downloads').disabled = true;
  say(text);
  try {
    await work();
  } catch (error) {
    say(error.message.replace(/^error: /, ''), error.message !== 'cancelled');
  } finally {
    state.worker = null;
    $('controls').disabled = !state.info;
    $('downloads').disabled = false;
    $('progress-row').hidden = true;
  }
}

/** Reads the image that the user gives: the files of a drop, the first of which is named on the command line. */
function useFiles(list) {
  const files = Object.fromEntries([...list].map(file => [file.name, file]));
  const [name] = Object.keys(files);
  if (name) busy(`Reading ${name} …`, () => showImage(name, files));
}

/** Makes a synthetic image. */
function useExample() {
  const [kind, name, dims] = $('example').value.split(' ');
  busy('Making an image …', async () => {
    const { files } = await run(['synth', kind, '-o', name, '--dims', dims], {});
    await showImage(name, files);
  });
}

async function showImage(name, files) {
  [state.image, state.files, state.info] = [name, files, null];
  $('results').hidden = true;
  const { output } = await run(['info', name, '--json'], files);
  const info = JSON.parse(output);
  if (!info.image) throw new Error(`${name}: is no image; give a seismic volume, a scan or a picture`);
  const dims = info.image.axes.map(axis => axis.count);
  const count = dims.reduce((product, n) => product * n, 1);
  $('image-name').textContent = name;
  $('image-facts').textContent = `${info.format}, ${dims.join(' × ')} samples`;
  const needed = count * BYTES_PER_SAMPLE;
  const isLarge = needed > PAGE_BYTES;
  $('memory').textContent = `Needs about ${formatBytes(needed)} of the 4 GB that a page can use` +
    (isLarge ? '; a job that does not fit is refused before it begins. Use the program, or a part of the image.' : '.');
  $('memory').classList.toggle('error', isLarge);
  state.samples = null;
  if (count <= MAX_SECTION_SAMPLES) {
    say('Drawing sections …');
    const { files: made } = await run(['convert', name, 'sections.npy'], files);
    state.samples = { dims, values: await readNpy(made['sections.npy']) };
  }
  state.info = info;
  showSections(info);
  $('image-section').hidden = false;
  $('options').hidden = false;
  updateCommand();
  say('');
}

const formatBytes = bytes => bytes < 1e9 ? `${Math.ceil(bytes / 1e6)} MB` : `${(bytes / 1e9).toFixed(1)} GB`;

/** Returns the numbers of a file in NumPy's format that the program has written. */
async function readNpy(blob) {
  const buffer = await blob.arrayBuffer();
  const start = 10 + new DataView(buffer).getUint16(8, true);
  return new Float32Array(buffer.slice(start));
}

/** Makes a canvas and a slider for each section: one in 2-D, three in 3-D. */
function showSections(info) {
  const { axes } = info.image;
  $('sections').replaceChildren();
  $('no-sections').hidden = state.samples !== null;
  if (!state.samples) return;
  const finite = state.samples.values.filter((value, i) => i % 7 === 0 && Number.isFinite(value)).sort();
  state.samples.range = [0.01, 0.99].map(share => finite[Math.floor(share * (finite.length - 1))]);
  for (const across of axes.length === 3 ? [2, 1, 0] : [null]) {
    const figure = document.createElement('figure');
    const canvas = document.createElement('canvas');
    const [u, v] = axes.map((_, k) => k).filter(k => k !== across);
    canvas.setAttribute('role', 'img');
    canvas.setAttribute('aria-label', `${axes[u].name} to the right, ${axes[v].name} down`);
    figure.append(canvas);
    let slider = { value: 0 };
    if (across !== null) {
      const label = document.createElement('label');
      slider = document.createElement('input');
      Object.assign(slider, { type: 'range', min: 0, max: axes[across].count - 1, value: axes[across].count >> 1 });
      const text = document.createElement('output');
      const update = () => { text.textContent = slider.value; };
      slider.addEventListener('input', () => { update(); drawSection(canvas, u, v, across, +slider.value); });
      update();
      label.append(axes[across].name, slider, text);
      figure.append(label);
    }
    $('sections').append(figure);
    drawSection(canvas, u, v, across, +slider.value);
  }
}

/** Draws the samples at index `at` of axis `across`, with axis `u` to the right and axis `v` down. */
function drawSection(canvas, u, v, across, at) {
  const { dims, values, range: [low, high] } = state.samples;
  const strides = dims.map((_, k) => dims.slice(0, k).reduce((product, n) => product * n, 1));
  [canvas.width, canvas.height] = [dims[u], dims[v]];
  const picture = new ImageData(dims[u], dims[v]);
  const first = across === null ? 0 : at * strides[across];
  for (let j = 0, i = 0; j < dims[v]; j++) {
    for (let k = 0; k < dims[u]; k++, i += 4) {
      const value = values[first + k * strides[u] + j * strides[v]];
      const grey = 255 * (value - low) / (high - low);
      picture.data.set(Number.isNaN(value) ? [176, 96, 96, 255] : [grey, grey, grey, 255], i);
    }
  }
  canvas.getContext('2d').putImageData(picture, 0, 0);
}

/** Returns the arguments of the job as the controls say. */
function meshArgs() {
  const args = ['mesh', state.image, '-o', 'mesh.vtu'];
  const add = (option, id) => { if ($(id).value !== '') args.push(option, $(id).value); };
  add('--feature', 'feature');
  add('--distance', 'distance');
  add('--cells', 'cells');
  add('--threshold', 'threshold');
  return args;
}

function updateCommand() {
  if (state.image) $('command').textContent = `atomesh ${meshArgs().map(arg => /[^\w.:,=+-]/.test(arg) ? `'${arg}'` : arg).join(' ')}`;
}

function mesh() {
  busy('Starting …', async () => {
    const start = performance.now();
    $('results').hidden = true;
    $('progress-row').hidden = false;
    $('progress').value = 0;
    let stage = '';
    const onLine = line => {
      const percent = /^([\d.]+) %$/.exec(line);
      if (percent) $('progress').value = percent[1];
      else if (line.endsWith(' ...')) stage = line.slice(0, -4);
      say(`${stage}, ${((performance.now() - start) / 1000).toFixed(0)} s`);
    };
    const args = [...meshArgs(), '--page', 'mesh.html', '--report', 'report.json', '--surfaces', 'surfaces.vtp'];
    const result = await run(args, state.files, onLine);
    state.outputs = result.files;
    state.seconds = (performance.now() - start) / 1000;
    say(`Done in ${state.seconds.toFixed(1)} s, with ${formatBytes(result.memoryBytes)} of memory.`);
    showResults(result);
  });
}

function showResults(result) {
  $('results').hidden = false;
  $('report').textContent = [result.output, ...result.errors.filter(line => line.startsWith('note'))].join('\n');
  URL.revokeObjectURL($('viewer').src);
  $('viewer').src = URL.createObjectURL(new Blob([result.files['mesh.html']], { type: 'text/html' }));
  const list = $('download-list');
  list.replaceChildren();
  const button = (name, title, click) => {
    const made = document.createElement('button');
    made.textContent = name;
    made.title = title;
    made.addEventListener('click', click);
    list.append(made);
  };
  const titles = { 'mesh.vtu': 'The mesh, for ParaView and this program', 'surfaces.vtp': 'Faces on features',
    'mesh.html': 'The viewer as a page of its own', 'report.json': 'All figures' };
  for (const name of Object.keys(titles)) {
    if (result.files[name]) button(name, titles[name], () => save(name, result.files[name]));
  }
  for (const [format, ending, title] of $('cells').value === 'voronoi' ? [] : EXPORTS) {
    button(`mesh.${ending}`, title, () => busy(`Writing mesh.${ending} …`, async () => {
      const name = `mesh.${ending}`;
      const { files } = await run(['export', 'mesh.vtu', '--to', format, '-o', name], { 'mesh.vtu': state.outputs['mesh.vtu'] });
      save(name, files[name]);
      say(`${name} is written.`);
    }));
  }
}

/** Lets the user save a file. */
function save(name, blob) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

$('file').addEventListener('change', event => useFiles(event.target.files));
$('make-example').addEventListener('click', useExample);
$('mesh').addEventListener('click', mesh);
$('cancel').addEventListener('click', () => state.worker?.end());
$('options').addEventListener('input', updateCommand);
for (const kind of ['dragover', 'dragleave', 'drop']) {
  document.addEventListener(kind, event => {
    event.preventDefault();
    $('drop').classList.toggle('over', kind === 'dragover');
    if (kind === 'drop') useFiles(event.dataTransfer.files);
  });
}
state.module = compile();
state.module.then(() => { state.ready = true; say(''); }, error => say(`This browser cannot run the program: ${error.message}`, true));
