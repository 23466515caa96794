// The project: one file with the script and what else the page knows, and the state that survives a crash.

const PROJECT_FORMAT = 'atomesh project';
const DATABASE = 'atomesh';

/** Returns the SHA-256 of a Blob as hexadecimal digits; empty where the browser has none to offer. */
async function hashOf(blob) {
  if (!globalThis.crypto?.subtle) return '';
  const digest = await crypto.subtle.digest('SHA-256', await blob.arrayBuffer());
  return [...new Uint8Array(digest)].map(byte => byte.toString(16).padStart(2, '0')).join('');
}

/** Values that the browser keeps for this page. */
class Storage {
  async open() {
    this.database ??= new Promise((resolve, reject) => {
      const request = indexedDB.open(DATABASE, 1);
      request.onupgradeneeded = () => request.result.createObjectStore('state');
      request.onsuccess = () => resolve(request.result);
      request.onerror = () => reject(request.error);
    });
    return this.database;
  }

  async use(mode, work) {
    const database = await this.open();
    return new Promise((resolve, reject) => {
      const transaction = database.transaction('state', mode);
      const request = work(transaction.objectStore('state'));
      transaction.oncomplete = () => resolve(request.result);
      transaction.onerror = () => reject(transaction.error);
    });
  }

  get(key) { return this.use('readonly', store => store.get(key)); }

  set(key, value) { return this.use('readwrite', store => store.put(value, key)); }

  clear() { return this.use('readwrite', store => store.clear()); }
}

class Project {
  constructor(bench, controls) {
    Object.assign(this, { bench, controls, storage: new Storage(), saving: Promise.resolve(), isKept: true });
  }

  /** Returns what a project has beside the files of the image. */
  async content() {
    const { bench } = this;
    const { session } = bench;
    const picks = bench.tools.picks;
    const texts = {};
    for (const [name, blob] of Object.entries(session.files)) {
      if (!this.imageFiles().includes(name)) texts[name] = await toText(blob);
    }
    return {
      format: PROJECT_FORMAT, version: 1,
      image: { name: bench.image, files: this.imageFiles(), sha256: this.hash, bytes: session.files[bench.image]?.size },
      options: this.controls.read(), script: session.done, undone: session.undone,
      units: bench.units.known, picks: picks.surfaces, found: picks.found, flow: bench.tools.flow.points,
      view: { cursor: bench.cursor, show: bench.show }, files: texts,
    };
  }

  imageFiles() { return this.names || []; }

  /** Notes the files of the image. */
  async useImage(names) {
    this.names = names;
    this.hash = '';
    const image = this.bench.session.files[names[0]];
    // Large files are not read as a whole.
    if (image && image.size < 1 << 28) this.hash = await hashOf(image);
  }

  /** Saves the state in the browser's storage, after the saves before. */
  keep() {
    this.saving = this.saving.then(async () => {
      if (!this.isKept || this.isLoading || !this.bench.image) return;
      const { session } = this.bench;
      const content = await this.content();
      if (this.keptHash !== this.hash || this.keptName !== this.bench.image) {
        await this.storage.set('image', Object.fromEntries(this.imageFiles().map(name => [name, session.files[name]])));
        [this.keptHash, this.keptName] = [this.hash, this.bench.image];
      }
      await this.storage.set('project', content);
    }).catch(error => { this.isKept = false; this.bench.say(`The browser does not keep this session: ${error.message}`, true); });
    return this.saving;
  }

  async forget() {
    await this.saving;
    await this.storage.clear();
    [this.keptHash, this.keptName] = [null, null];
  }

  /** Brings the page into the state of a project whose image is open. */
  async load(content) {
    // Until all actions are done again, the state that is kept stays.
    this.isLoading = true;
    try {
      return await this.doAgain(content);
    } finally {
      this.isLoading = false;
    }
  }

  async doAgain(content) {
    const { bench } = this;
    const { session } = bench;
    session.put(Object.fromEntries(Object.entries(content.files).map(([name, text]) => [name, fromText(text)])));
    this.controls.write(content.options);
    bench.units.known = content.units || {};
    Object.assign(bench.tools.picks, { surfaces: content.picks || [], found: content.found || [], current: (content.picks || []).length - 1 });
    bench.tools.flow.points = content.flow || [];
    for (const line of [...content.script, ...content.undone]) {
      const reply = await bench.act(line, `Doing again: ${line}`);
      if (!reply) return false;
      if (line.startsWith('mesh ')) bench.meshed(reply, []);
    }
    for (const _ of content.undone) await bench.undo();
    Object.assign(bench.show, content.view?.show);
    if (content.view?.cursor) bench.setCursor(content.view.cursor);
    bench.fillControls();
    bench.refresh();
    bench.redraw();
    return true;
  }
}

/** Returns a file as text: as it is if it is a text, in Base64 if not. */
async function toText(blob) {
  const bytes = new Uint8Array(await blob.arrayBuffer());
  try {
    return new TextDecoder('utf-8', { fatal: true }).decode(bytes);
  } catch {
    let letters = '';
    for (let i = 0; i < bytes.length; i += 32768) letters += String.fromCharCode(...bytes.subarray(i, i + 32768));
    return { base64: btoa(letters) };
  }
}

const fromText = text => new Blob([typeof text === 'string' ? text : Uint8Array.from(atob(text.base64), letter => letter.charCodeAt(0))]);
