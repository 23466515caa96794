// The session with the program, which stays in memory in a worker as long as the page is open.

const ARRAYS = { u32: Uint32Array, f32: Float32Array, f64: Float64Array };

/** Returns the reply of the program: its JSON, with `arrays` by name. */
function readReply(bytes) {
  const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true);
  const reply = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
  const body = bytes.slice(4 + length);
  reply.arrays = Object.fromEntries((reply.arrays || []).map(([name, kind, start, count]) =>
    [name, new ARRAYS[kind](body.buffer, start, count)]));
  return reply;
}

/** Returns a word of a script: in quotation marks if it has blanks or marks itself. */
const quoted = word => !/[\s'"]/.test(word) && word !== '' ? word : word.includes("'") ? `"${word}"` : `'${word}'`;

/** The program in its worker. One request is carried out after another. */
class Session {
  /** `module` is the promise of the compiled program. */
  constructor(module, workerUrl) {
    Object.assign(this, { module, workerUrl, worker: null, files: {}, done: [], undone: [], memoryBytes: 0, number: 0 });
    this.queue = Promise.resolve();
    this.pending = null;
    this.isBusy = false;
  }

  /** Gives files, Blobs by name, to the program. */
  put(files) {
    Object.assign(this.files, files);
    this.unsent = { ...this.unsent, ...files };
  }

  /** Forgets all files and actions. */
  reset() {
    this.end('cancelled');
    Object.assign(this, { files: {}, done: [], undone: [] });
  }

  /** Ends the worker, and with it what it is doing. */
  end(reason) {
    this.worker?.terminate();
    this.worker = null;
    const { pending } = this;
    this.pending = null;
    pending?.reject(new Error(reason));
  }

  /** Cancels the present action. The actions before it are done again when the session is used next. */
  cancel() {
    this.end('cancelled');
  }

  /** Sends a message to the worker and returns its answer. */
  async send(message, onLine) {
    const module = await this.module;
    if (!this.worker) {
      this.worker = new Worker(this.workerUrl);
      this.unsent = this.files;
    }
    const { worker } = this;
    return new Promise((resolve, reject) => {
      const id = ++this.number;
      this.pending = { reject };
      const fail = text => { this.pending = null; this.end(text); reject(new Error(text)); };
      worker.onerror = event => fail(event.message);
      worker.onmessage = ({ data }) => {
        if (data.id !== id) return;
        if (data.line !== undefined) return onLine(data.line);
        if (data.failure) return fail(data.failure);
        this.pending = null;
        this.memoryBytes = data.memoryBytes;
        resolve(data);
      };
      worker.postMessage({ id, module, files: this.unsent, ...message });
      this.unsent = {};
    });
  }

  /** Does all actions again in a new worker. */
  async restore(onLine) {
    const [done, undone] = [this.done, this.undone];
    onLine('Restoring the session ...');
    for (const line of [...done, ...undone]) {
      const { reply } = await this.send({ request: { do: 'run', line } }, onLine);
      const { error } = readReply(reply);
      if (error) throw new Error(error);
    }
    for (const _ of undone) await this.send({ request: { do: 'undo' } }, onLine);
  }

  /** Waits for earlier requests, then carries out one and returns its reply, with the `files` of the names in `take`. */
  request(request, { take = [], onLine = () => {} } = {}) {
    const work = async () => {
      this.isBusy = true;
      try {
        if (!this.worker && this.done.length + this.undone.length > 0) await this.restore(onLine);
        const { reply: bytes, files } = await this.send({ request, take }, onLine);
        const reply = bytes ? readReply(bytes) : {};
        if (reply.done) [this.done, this.undone] = [reply.done, reply.undone];
        if (reply.error) throw new Error(reply.error);
        return { ...reply, files };
      } finally {
        this.isBusy = false;
      }
    };
    const result = this.queue.then(work);
    this.queue = result.catch(() => {});
    return result;
  }

  /** Runs a line of a script. */
  run(words, options) {
    return this.request({ do: 'run', line: typeof words === 'string' ? words : words.map(quoted).join(' ') }, options);
  }

  /** Prepares edits, so that the first one takes no longer than later ones. */
  prepare(mesh, image, onLine) { return this.request({ do: 'prepare', mesh, image }, { onLine }); }

  undo() { return this.request({ do: 'undo' }); }

  redo() { return this.request({ do: 'redo' }); }

  /** Returns the file of a mesh in memory. */
  async meshFile(name) {
    const { files } = await this.request({ do: 'write', mesh: name }, { take: [name] });
    return files[name];
  }

  /** Returns the script of all actions that are not undone. */
  script() {
    return this.done.map(line => `${line}\n`).join('');
  }
}
