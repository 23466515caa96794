// A tour of two minutes: it points at one part of the page after another.

const TOUR = [
  ['views', 'One place, four views', 'Three sections and the mesh in space share a cursor. Click in a section to move it; the wheel scrolls through slices.'],
  ['display', 'How the image looks', 'Choose colours that you can tell apart, the range of values and the gain, and what is drawn over the image.'],
  ['tool-paint', 'Paint', 'Press P and click in a layer: paint flows between the surfaces. Name and colour the unit; the table has its volume.'],
  ['tool-edit', 'Atoms', 'Press A and drag an atom in a section. When you release it, its neighbourhood is meshed again.'],
  ['tool-picks', 'Picks', 'Press K, choose New fault, and click points of a stick. The next mesh follows your picks.'],
  ['tool-flow', 'Flow', 'Press F and click a source and a sink. Open or close the faults, and see the pressure.'],
  ['history-part', 'Everything can be undone', 'Each action is a line of a script, which makes the same mesh on the command line.'],
  ['save-part', 'Take it with you', 'Save the mesh, units, picks, pictures, the script, or the whole project as one file.'],
];

class Tour {
  constructor() {
    this.dialog = document.getElementById('tour');
    document.getElementById('tour-next').onclick = () => this.show(this.step + 1);
    document.getElementById('tour-back').onclick = () => this.show(this.step - 1);
    document.getElementById('tour-end').onclick = () => this.end();
    this.dialog.addEventListener('close', () => this.mark(null));
  }

  start() {
    this.dialog.show();
    this.show(0);
  }

  show(step) {
    if (step < 0) return;
    if (step >= TOUR.length) return this.end();
    this.step = step;
    const [target, title, text] = TOUR[step];
    document.getElementById('tour-title').textContent = `${title} (${step + 1} of ${TOUR.length})`;
    document.getElementById('tour-text').textContent = text;
    document.getElementById('tour-back').disabled = step === 0;
    document.getElementById('tour-next').textContent = step === TOUR.length - 1 ? 'Done' : 'Next';
    this.mark(document.getElementById(target));
    document.getElementById('tour-next').focus();
  }

  mark(element) {
    document.querySelector('.toured')?.classList.remove('toured');
    element?.classList.add('toured');
    element?.scrollIntoView({ block: 'nearest' });
  }

  end() { this.dialog.close(); }
}
