// The page: reads an image, makes its mesh, and connects the workbench with the controls and the files.

const $ = id => document.getElementById(id);
const MAX_SECTION_SAMPLES = 1 << 26;
// Memory of a job of `mesh` for each sample: 44 MB for 64^3 samples on Linux.
const BYTES_PER_SAMPLE = 170;
const PAGE_BYTES = 2 ** 32;
const EXPORTS = [['msh', 'msh', 'Gmsh'], ['inp', 'inp', 'Abaqus, CalculiX'], ['nastran', 'bdf', 'NASTRAN'], ['stl', 'stl', 'STL']];
/** Controls whose values a project keeps. */
const OPTIONS = ['feature', 'distance', 'threshold', 'cells', 'neck', 'level'];

/** Returns the program, compiled. */
async function compile() {
  const bytes = Uint8Array.from(atob($('program').textContent), letter => letter.charCodeAt(0));
  $('program').remove();
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  return WebAssembly.compile(await new Response(stream).arrayBuffer());
}

function say(text, isError = false) {
  $('status').textContent = text;
  $('status').classList.toggle('error', isError);
}

const workerUrl = URL.createObjectURL(new Blob([$('worker').textContent], { type: 'text/javascript' }));
const session = new Session(compile(), workerUrl);
const bench = new Bench(session, $('bench'), say);
const controls = {
  read: () => Object.fromEntries(OPTIONS.map(id => [id, $(id).value])),
  write: values => { for (const id of OPTIONS) if (values?.[id] !== undefined) $(id).value = values[id]; updateCommand(); },
};
const project = new Project(bench, controls);
const tour = new Tour();
const state = window.atomesh = { session, bench, project, info: null, image: null };

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
    $('controls').disabled = !state.info;
    $('downloads').disabled = false;
    $('progress-row').hidden = true;
  }
}

/** Reads the image that the user gives: the files of a drop, the first of which is named on the command line. A project is opened. */
function useFiles(list) {
  const files = Object.fromEntries([...list].map(file => [file.name, file]));
  const names = Object.keys(files);
  const saved = names.find(name => name.endsWith('.atomesh'));
  if (saved) busy(`Reading ${saved} …`, () => openProject(files, saved));
  else if (names.length > 0) busy(`Reading ${names[0]} …`, async () => { await showImage(names[0], files); await project.keep(); });
}

/** Makes a synthetic image. */
function useExample() {
  const [kind, name, dims] = $('example').value.split(' ');
  busy('Making an image …', async () => {
    session.reset();
    const { files } = await session.run(['synth', kind, '-o', name, '--dims', dims], { take: [name] });
    await showImage(name, files);
    await project.keep();
  });
}

async function showImage(name, files) {
  Object.assign(state, { image: name, info: null });
  $('results').hidden = true;
  session.reset();
  session.put(files);
  const { report: info } = await session.run(['info', name]);
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
  let samples = null;
  if (count <= MAX_SECTION_SAMPLES) {
    say('Drawing sections …');
    const { files: made } = await session.run(['convert', name, 'sections.npy'], { take: ['sections.npy'] });
    samples = { dims, values: await readNpy(made['sections.npy']) };
  }
  $('no-sections').hidden = samples !== null;
  for (const id of ['image-section', 'options', 'bench']) $(id).hidden = false;
  bench.open(info, name, samples);
  await project.useImage(Object.keys(files));
  state.info = info;
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

/** Returns the arguments of the job as the controls say. Decimal commas become points. */
function meshArgs(more = []) {
  const args = ['mesh', state.image, '-o', MESH];
  for (const id of ['feature', 'distance', 'cells', 'threshold']) {
    const value = $(id).value.trim();
    if (value !== '' && !more.includes(`--${id}`)) args.push(`--${id}`, id === 'distance' ? value.replace(/,/g, '.') : value.replace(/^(\d+),(\d+)$/, '$1.$2'));
  }
  return [...args, ...more];
}

function updateCommand() {
  if (state.image) $('command').textContent = `atomesh ${meshArgs().map(quoted).join(' ')}`;
}

/** Makes a mesh, with `more` options than those of the controls. */
function makeMesh(more = []) {
  return busy('Starting …', async () => {
    const start = performance.now();
    $('progress-row').hidden = false;
    $('progress').value = 0;
    let stage = '';
    const notes = [];
    const onLine = line => {
      const percent = /^([\d.]+) %$/.exec(line);
      if (percent) $('progress').value = percent[1];
      else if (line.endsWith(' ...')) stage = line.slice(0, -4);
      else if (line.startsWith('note')) notes.push(line);
      say(`${stage}, ${((performance.now() - start) / 1000).toFixed(0)} s`);
    };
    const reply = await session.run(meshArgs(more), { onLine });
    bench.apply(reply);
    bench.redraw();
    state.seconds = (performance.now() - start) / 1000;
    bench.meshed(reply, notes);
    await showResults();
    $('bench').scrollIntoView();
    say(`Done in ${state.seconds.toFixed(1)} s, with ${formatBytes(session.memoryBytes)} of memory.`);
    await project.keep();
  });
}

/** Shows the files to save, and the page of a mesh whose cells the workbench does not draw. */
async function showResults() {
  $('results').hidden = false;
  const isDrawn = !bench.mesh.isEmpty;
  $('viewer').hidden = isDrawn;
  if (!isDrawn) {
    const { files } = await session.run(['report', state.image, MESH, '-o', 'mesh.html'], { take: ['mesh.html'] });
    URL.revokeObjectURL($('viewer').src);
    $('viewer').src = URL.createObjectURL(new Blob([files['mesh.html']], { type: 'text/html' }));
  }
  listDownloads();
}

/** Returns the file that a line of a script writes. */
const written = async (words, name) => (await session.run(words, { take: [name] })).files[name];

/** Returns what can be saved: name, title, and a function that returns the file. */
function downloads() {
  const { tools } = bench;
  const list = [
    [MESH, 'The mesh, for ParaView and this program', () => session.meshFile(MESH)],
    ['surfaces.vtp', 'Faces on features', () => written(['surface', MESH, '-o', 'surfaces.vtp'], 'surfaces.vtp')],
    ['mesh.html', 'The mesh as a page of its own', () => written(['report', state.image, MESH, '-o', 'mesh.html'], 'mesh.html')],
    ['report.json', 'All figures of the mesh', () => new Blob([JSON.stringify(state.report, null, 2)])],
  ];
  if ($('cells').value !== 'voronoi') {
    for (const [format, ending, title] of EXPORTS) {
      list.push([`mesh.${ending}`, title, () => written(['export', MESH, '--to', format, '-o', `mesh.${ending}`], `mesh.${ending}`)]);
    }
  }
  if (bench.units.totals().length > 0) {
    list.push(['units.csv', 'Volumes of the units', () => new Blob([unitTable()])]);
    for (const ending of ['vtp', 'ts']) list.push([`units.${ending}`, 'The closed surface of each unit', () => unitSurfaces(`units.${ending}`)]);
  }
  if (bench.models[FLOW]) list.push([FLOW, 'Pressure and velocity', () => session.meshFile(FLOW)]);
  for (const [name, blob] of Object.entries(tools.picks?.files() || {})) list.push([name, 'Picks', () => blob]);
  return [...list,
    ['script.txt', 'The actions, for atomesh script', () => new Blob([session.script()])],
    ['sections.png', 'What is shown, as a picture', () => picture()],
    [`${state.image.replace(/\.[^.]*$/, '')}.atomesh`, 'The project: script, units, picks; not the image', async () => new Blob([JSON.stringify(await project.content(), null, 1)])],
  ];
}

function listDownloads() {
  $('download-list').replaceChildren(...downloads().map(([name, title, make_]) => make('button', {
    title, onclick: () => busy(`Writing ${name} …`, async () => { save(name, await make_()); say(`${name} is written.`); }),
  }, name)));
}

function unitTable() {
  const rows = bench.units.totals().map(([number, [cells, volume]]) => `${number},"${bench.units.nameOf(number).replace(/"/g, '""')}",${cells},${volume}`);
  return `unit,name,cells,volume\n${rows.join('\n')}\n`;
}

/** Writes the surfaces around the units by painting once more, which is undone. */
async function unitSurfaces(name) {
  const line = session.done.findLast(text => text.startsWith(`paint ${MESH} `));
  if (!line) throw new Error('units: were not painted here; paint them first');
  const { files } = await session.request({ do: 'run', line: `${line} --surface-out ${name}` }, { take: [name] });
  await session.undo();
  bench.refresh();
  return files[name];
}

/** Returns a picture of the views. */
function picture() {
  const canvases = [...bench.sections.map(section => [section.base, section.top]), ...(bench.body ? [[bench.body.canvas]] : [])];
  const boxes = canvases.map(([canvas]) => canvas.getBoundingClientRect());
  const left = Math.min(...boxes.map(box => box.left));
  const top = Math.min(...boxes.map(box => box.top));
  const canvas = make('canvas', { width: Math.ceil(Math.max(...boxes.map(box => box.right)) - left), height: Math.ceil(Math.max(...boxes.map(box => box.bottom)) - top) });
  const context = canvas.getContext('2d');
  canvases.forEach((layers, i) => layers.forEach(layer => context.drawImage(layer, boxes[i].left - left, boxes[i].top - top, boxes[i].width, boxes[i].height)));
  return new Promise(resolve => canvas.toBlob(resolve, 'image/png'));
}

/** Lets the user save a file. */
function save(name, blob) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

/** Opens a project file, beside which the image may lie. */
async function openProject(files, name) {
  const content = JSON.parse(await files[name].text());
  if (content.format !== PROJECT_FORMAT) throw new Error(`${name}: is no project of this page; give a file that it saved`);
  const given = Object.fromEntries(content.image.files.filter(file => files[file]).map(file => [file, files[file]]));
  const open = content.image.files.every(file => session.files[file]) ? Object.fromEntries(content.image.files.map(file => [file, session.files[file]])) : {};
  const image = Object.keys(given).length > 0 ? given : open;
  if (!image[content.image.name]) throw new Error(`${name}: needs its image; drop it together with ${content.image.files.join(', ')}`);
  await loadProject(content, image);
}

/** Opens the image of a project, and does its actions again. */
async function loadProject(content, image) {
  if (content.image.sha256 && (await hashOf(image[content.image.name])) !== content.image.sha256) {
    throw new Error(`${content.image.name}: is not the image of this project; give the file with the same content`);
  }
  await showImage(content.image.name, image);
  if (!await project.load(content)) return;
  if (session.done.length > 0) await showResults();
  await project.keep();
}

/** Offers the state that the browser has kept. */
async function offerLast() {
  const last = await project.storage.get('project').catch(() => null);
  if (!last) return;
  $('last-name').textContent = `${last.image.name}, ${last.script.length} actions`;
  $('last').hidden = false;
  $('restore').onclick = () => busy('Restoring …', async () => {
    $('last').hidden = true;
    await loadProject(last, await project.storage.get('image'));
  });
}

async function forgetAll() {
  await project.forget();
  $('last').hidden = true;
  say('The browser keeps nothing of your data now.');
}

bench.makeMesh = makeMesh;
bench.meshed = (reply, notes) => {
  state.report = reply.report;
  $('report').textContent = [reply.text, ...notes].join('\n');
};
bench.progress = line => { if (line.endsWith(' ...')) say(`${line.slice(0, -4)} …`); };
bench.changed = () => { listDownloads(); project.keep(); };
bench.listen();
$('file').addEventListener('change', event => useFiles(event.target.files));
$('make-example').addEventListener('click', useExample);
$('mesh').addEventListener('click', () => makeMesh());
$('cancel').addEventListener('click', () => session.cancel());
$('options').addEventListener('input', updateCommand);
$('start-tour').addEventListener('click', () => tour.start());
for (const id of ['forget', 'forget-last']) $(id).addEventListener('click', forgetAll);
for (const kind of ['dragover', 'dragleave', 'drop']) {
  document.addEventListener(kind, event => {
    event.preventDefault();
    $('drop').classList.toggle('over', kind === 'dragover');
    if (kind === 'drop') useFiles(event.dataTransfer.files);
  });
}
session.module.then(async () => { await offerLast(); state.ready = true; say(''); }, error => say(`This browser cannot run the program: ${error.message}`, true));
