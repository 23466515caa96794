// Fills the tables beside the mesh: measures, histograms, provenance.

/** Fills a table with rows of a name and a value. A third item that is true marks a bad value. */
function fill(table, rows) {
  table.replaceChildren(...rows.filter(row => row && row[1] !== undefined && row[1] !== '').map(([name, value, bad]) => {
    const row = document.createElement('tr');
    const head = document.createElement('th'), cell = document.createElement('td');
    head.textContent = name;
    cell.textContent = value;
    if (bad) cell.className = 'bad';
    row.append(head, cell);
    return row;
  }));
}

const percent = share => share === null || share === undefined ? '–' : `${(100 * share).toFixed(1)} %`;

/** Returns the rows with the measures of the mesh, as far as its report has them. */
function figures(facts) {
  const { report } = facts.about;
  const rows = [];
  const shape = (quality, where) => {
    const { smallest_angle: small, largest_angle: large, mean_ratio: ratio, angles } = quality;
    const degree = value => value === null ? '–' : `${value.toFixed(1)}°`;
    const kind = quality.kind === 'tetrahedra' ? 'dihedral angle' : 'angle';
    rows.push([`Smallest ${kind}${where}`, degree(small.worst), !where.includes('world') && small.worst < 10]);
    rows.push(['… of 1 % of cells below', degree(small.percent)]);
    rows.push([`Largest ${kind}${where}`, degree(large.worst), !where.includes('world') && large.worst > 170]);
    rows.push(['Cells below 30°', written(quality.below_30)]);
    rows.push(['Cells above 150°', written(quality.above_150)]);
    if (angles) rows.push(['… that no feature explains', written(angles.unexplained), angles.unexplained > 0]);
    rows.push(['Mean ratio, mean', written(quality.mean_ratio_mean, 0.001)]);
    rows.push(['Mean ratio, worst', written(ratio.worst, 0.001)]);
  };
  rows.push(['Nodes', written(facts.counts.nodes)], [facts.cells[0].toUpperCase() + facts.cells.slice(1), written(facts.counts.cells)]);
  const check = report.box || (report.voronoi && report.voronoi.check);
  if (check) {
    const sound = check.problems.length === 0;
    rows.push(['Valid, fills its box', sound ? 'yes' : check.problems.join('; '), !sound]);
  }
  if (report.quality) shape(report.quality, report.quality_physical ? ' (lattice)' : '');
  if (report.quality_physical) shape(report.quality_physical, ' (world)');
  const cells = report.voronoi;
  if (cells) {
    rows.push(['Connections', written(cells.connections)], ['… along features', written(cells.on_feature)]);
    rows.push(['Smallest of mean volume', written(cells.volumes[0], 0.001)], ['Largest of mean volume', written(cells.volumes[1], 0.001)]);
    if (cells.conforming !== null) rows.push(['Surfaces that are faces', percent(cells.conforming)]);
    rows.push(['Faces below 1 % of mean area', percent(cells.tiny_faces[3])]);
    rows.push(['Off orthogonal, worst', `${(cells.angle_physical || cells.angle)[0].toFixed(2)}°`]);
    rows.push(['Connections not positive', written(cells.non_positive_connections), cells.non_positive_connections > 0]);
  }
  if (report.lattice) rows.push(['Spacing over d, median', written(report.lattice.spacing[1], 0.01)]);
  const seconds = (report.stages || []).reduce((sum, stage) => sum + stage.seconds, 0);
  if (seconds) {
    const peak = Math.max(...report.stages.map(stage => stage.peak_mb));
    rows.push(['Time', `${written(seconds, 0.1)} s`], ['Memory', `${written(peak, 1)} MB`]);
  }
  return rows;
}

/** Shows the fidelity as rows, and its fractions as bars. */
function showFidelity(fidelity) {
  const section = document.getElementById('fidelity-section');
  section.hidden = !fidelity;
  if (!fidelity) return;
  const match = fidelity.tagged_faces || fidelity.on_feature;
  const against = { truth: 'the known truth', mask: 'a mask', detected: 'features found in the image' };
  fill(document.getElementById('fidelity'), [
    ['Compared with', against[fidelity.reference] || fidelity.reference],
    ['Feature points', written(fidelity.feature_points)],
    ['Faces on features', written(match.faces)],
    ['Hausdorff distance, samples', written(match.hausdorff, 0.01)],
    ['… 95 % of it', written(match.hausdorff_95, 0.01)],
  ]);
  const bars = [['covered within ½ sample', match.coverage_half], ['covered within 1 sample', match.coverage_one], ['faces within 1 sample', match.precision]];
  for (const gap of match.by_gap || []) bars.push([`next feature at ${gap.from}${gap.to === null ? ' or more' : ` to ${gap.to}`}`, gap.coverage_one]);
  document.getElementById('fidelity-bars').replaceChildren(...bars.filter(bar => bar[1] !== null).map(([name, share]) => {
    const row = document.createElement('div'), label = document.createElement('span'), back = document.createElement('div'), bar = document.createElement('i'), value = document.createElement('b');
    row.className = 'meter';
    label.textContent = name;
    bar.style.width = `${100 * share}%`;
    value.textContent = percent(share);
    back.append(bar);
    row.append(label, back, value);
    return row;
  }));
}

/** Returns the histogram of a cell array, or of all angles from the report. */
function histogramOf(array, report) {
  if ((!array || array.name.startsWith('min_')) && report.quality) {
    const counts = report.quality.histogram;
    return { title: `All ${report.quality.kind === 'tetrahedra' ? 'dihedral ' : ''}angles [degrees]`, counts, low: 0, high: 180 };
  }
  if (!array || array.high <= array.low) return null;
  const bins = array.categories ? array.categories.length : 36;
  const counts = new Array(bins).fill(0);
  const top = Math.round((array.high - array.low) / array.step);
  for (const word of array.words) {
    if (word === 65535) continue;
    counts[array.categories ? array.categories.findIndex(c => c.word === word) : Math.min(Math.floor(word / top * bins), bins - 1)]++;
  }
  return { title: array.unit ? `${array.name} [${array.unit}]` : array.name, counts, low: array.low, high: array.high, categories: array.categories };
}

function drawHistogram(array, report) {
  const section = document.getElementById('histogram-section'), canvas = document.getElementById('histogram');
  const data = histogramOf(array, report);
  section.hidden = !data;
  if (!data) return;
  document.getElementById('histogram-title').textContent = data.title;
  const ratio = devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth || 280, 110];
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const pen = canvas.getContext('2d'), style = getComputedStyle(document.documentElement);
  pen.scale(ratio, ratio);
  pen.font = '10px system-ui, "DejaVu Sans", sans-serif';
  const most = Math.max(...data.counts, 1), base = height - 16, wide = width / data.counts.length;
  data.counts.forEach((count, i) => {
    const tall = count ? Math.max(1, count / most * (base - 12)) : 0;
    pen.fillStyle = data.categories ? css(data.categories[i].color) : style.getPropertyValue('--bar');
    pen.fillRect(i * wide + 0.5, base - tall, Math.max(wide - 1, 1), tall);
  });
  pen.fillStyle = style.getPropertyValue('--quiet');
  pen.textBaseline = 'top';
  if (data.categories) {
    data.categories.forEach((c, i) => { pen.textAlign = 'center'; if (data.counts.length < 14) pen.fillText(c.short, (i + 0.5) * wide, base + 4); });
  } else {
    const { found, step } = ticks(data.low, data.high, 6);
    for (const value of found) {
      const at = (value - data.low) / (data.high - data.low) * width;
      pen.textAlign = at < 12 ? 'left' : at > width - 12 ? 'right' : 'center';
      pen.fillText(written(value, step), at, base + 4);
    }
  }
  pen.textAlign = 'right';
  pen.fillText(`most: ${written(most)}`, width, 0);
  canvas.setAttribute('aria-label', `Histogram of ${data.title}: ${data.counts.join(', ')}`);
}

/** Copies text to the clipboard. */
async function copy(text, button) {
  const done = () => { button.textContent = 'Copied'; setTimeout(() => { button.textContent = 'Copy'; }, 1500); };
  try {
    await navigator.clipboard.writeText(text);
    done();
  } catch {
    // Some browsers do not let local files write to the clipboard. The text is selected instead.
    getSelection().selectAllChildren(button.previousElementSibling);
    if (document.execCommand('copy')) done();
  }
}

/** Fills the parts of the panel that do not change. */
function fillPanel(facts, notes) {
  const { about } = facts, { report } = about;
  fill(document.getElementById('figures'), figures(facts));
  showFidelity(report.fidelity);
  const lines = [...notes, ...(report.notes || [])];
  document.getElementById('notes-section').hidden = lines.length === 0;
  document.getElementById('notes').replaceChildren(...lines.map(line => {
    const item = document.createElement('li');
    item.textContent = line;
    return item;
  }));
  const input = report.input;
  fill(document.getElementById('provenance'), [
    ['Program', `atomesh ${report.version || ''}`],
    ['Image', input ? input.file : ''],
    ['Samples', input ? input.dims.join(' × ') : ''],
    ['Hash', (input && input.hash) || about.input_hash],
  ]);
  const parameters = about.parameters || '';
  document.getElementById('parameters').textContent = parameters || 'not recorded in the file';
  document.getElementById('report').textContent = JSON.stringify(report, null, 1);
  for (const name of ['parameters', 'report']) {
    const button = document.getElementById(`copy-${name}`);
    button.addEventListener('click', () => copy(document.getElementById(name).textContent, button));
  }
}
