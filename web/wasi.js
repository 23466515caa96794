// Runs a WASI program (preview 1) with files in memory. It has no access to anything else.

const [BAD_DESCRIPTOR, EXISTS, INVALID, IS_FOLDER, NO_ENTRY, NO_CALL, NOT_FOLDER, NOT_EMPTY] = [8, 20, 28, 31, 44, 52, 54, 55];
const [DEVICE, FOLDER, FILE] = [2, 3, 4];
const FIRST_DESCRIPTOR = 4;
const READ_AHEAD_BYTES = 1 << 20;

/** Thrown by a system call that the program is told has failed. */
class CallError extends Error {
  constructor(number) {
    super(`system call failed: ${number}`);
    this.number = number;
  }
}

/** Thrown when the program ends. */
class Exit extends Error {
  constructor(code) {
    super(`exit code ${code}`);
    this.code = code;
  }
}

/** A file: bytes in memory, or a Blob of which only the bytes that are needed are read. */
class MemoryFile {
  constructor(blob) {
    this.blob = blob || null;
    this.bytes = new Uint8Array(0);
    this.size = blob ? blob.size : 0;
    this.start = 0;
  }

  /** Returns at most `count` bytes from `position` on. */
  read(position, count) {
    const end = Math.min(position + count, this.size);
    if (position >= end) return new Uint8Array(0);
    if (this.blob && (position < this.start || end > this.start + this.bytes.length)) {
      const part = this.blob.slice(position, Math.max(end, position + READ_AHEAD_BYTES));
      this.bytes = new Uint8Array(new FileReaderSync().readAsArrayBuffer(part));
      this.start = position;
    }
    return this.bytes.subarray(position - this.start, end - this.start);
  }

  write(position, bytes) {
    const end = position + bytes.length;
    this.resize(Math.max(this.size, end));
    this.bytes.set(bytes, position);
  }

  resize(size) {
    if (this.blob) {
      const all = new Uint8Array(new FileReaderSync().readAsArrayBuffer(this.blob));
      [this.bytes, this.blob, this.start] = [all, null, 0];
    }
    if (size > this.bytes.length) {
      const larger = new Uint8Array(Math.max(size, 2 * this.bytes.length, 4096));
      larger.set(this.bytes.subarray(0, this.size));
      this.bytes = larger;
    } else {
      this.bytes.fill(0, size, Math.max(size, this.size));
    }
    this.size = size;
  }

  toBlob() {
    return this.blob || new Blob([this.bytes.subarray(0, this.size)]);
  }
}

/**
 * Starts a program that stays in memory, and returns functions that use it. `onError` receives each line of
 * standard error.
 */
function startProgram(module, onError) {
  const encode = text => new TextEncoder().encode(text);
  const decode = bytes => new TextDecoder().decode(bytes);
  const errorDecoder = new TextDecoder();
  const tree = new Map([['', null]]);
  const open = new Map();
  // Standard output as bytes, and the lines of standard error that are not complete.
  let [input, output, errors] = [new Uint8Array(0), [], ''];
  let nextDescriptor = FIRST_DESCRIPTOR;
  let memory = null;

  const view = () => new DataView(memory.buffer);
  const bytesAt = (pointer, length) => new Uint8Array(memory.buffer, pointer, length);
  const putU32 = (pointer, value) => view().setUint32(pointer, value, true);
  const putU64 = (pointer, value) => view().setBigUint64(pointer, BigInt(value), true);

  /** Returns the path in `tree`, without leading, double and single dots. */
  const pathAt = (descriptor, pointer, length) => {
    const base = descriptor === 3 ? '' : opened(descriptor).path;
    const parts = [];
    for (const part of `${base}/${decode(bytesAt(pointer, length).slice())}`.split('/')) {
      if (part === '..') parts.pop();
      else if (part !== '' && part !== '.') parts.push(part);
    }
    return parts.join('/');
  };
  const parentOf = path => path.slice(0, Math.max(0, path.lastIndexOf('/')));
  const isFolder = path => tree.has(path) && tree.get(path) === null;
  const find = path => {
    if (!tree.has(path)) throw new CallError(NO_ENTRY);
    return tree.get(path);
  };
  const childrenOf = path => [...tree.keys()].filter(other => other !== '' && parentOf(other) === path);
  const opened = descriptor => {
    if (!open.has(descriptor)) throw new CallError(BAD_DESCRIPTOR);
    return open.get(descriptor);
  };
  const openedFile = descriptor => {
    const entry = opened(descriptor);
    if (entry.file === null) throw new CallError(IS_FOLDER);
    return entry;
  };
  open.set(3, { path: '', file: null, position: 0 });

  /** Calls `use` for each of the program's buffers until it returns fewer bytes than one holds. */
  const eachBuffer = (pointer, count, total, use) => {
    let sum = 0;
    for (let i = 0; i < count; i++) {
      const start = view().getUint32(pointer + 8 * i, true);
      const length = view().getUint32(pointer + 8 * i + 4, true);
      const done = use(bytesAt(start, length), sum);
      sum += done;
      if (done < length) break;
    }
    putU32(total, sum);
  };
  const readFrom = (file, position, pointer, count, total) =>
    eachBuffer(pointer, count, total, (buffer, sum) => {
      const bytes = file.read(position + sum, buffer.length);
      buffer.set(bytes);
      return bytes.length;
    });

  /** Passes complete lines of standard error on. */
  const flushLines = () => {
    const lines = errors.split('\n');
    errors = lines.pop();
    lines.forEach(onError);
  };
  const putStatus = (pointer, kind, size) => {
    bytesAt(pointer, 64).fill(0);
    view().setUint8(pointer + 16, kind);
    putU64(pointer + 24, 1);
    putU64(pointer + 32, size);
  };
  const putStrings = (strings, pointers, texts) => {
    for (const string of strings) {
      const bytes = encode(`${string}\0`);
      putU32(pointers, texts);
      bytesAt(texts, bytes.length).set(bytes);
      pointers += 4;
      texts += bytes.length;
    }
  };
  const putSizes = (strings, count, size) => {
    putU32(count, strings.length);
    putU32(size, strings.reduce((sum, string) => sum + encode(`${string}\0`).length, 0));
  };
  const move = (path, target) => {
    const node = find(path);
    if (node === null) {
      for (const child of childrenOf(path)) move(child, target + child.slice(path.length));
    }
    tree.delete(path);
    tree.set(target, node);
  };

  const calls = {
    args_sizes_get: (count, size) => putSizes(['atomesh'], count, size),
    args_get: (pointers, texts) => putStrings(['atomesh'], pointers, texts),
    environ_sizes_get: (count, size) => putSizes([], count, size),
    environ_get: () => {},
    clock_time_get(clock, _, pointer) {
      const milliseconds = clock === 0 ? Date.now() : performance.now();
      putU64(pointer, Math.round(milliseconds * 1e6));
    },
    random_get(pointer, length) {
      for (let i = 0; i < length; i += 65536) {
        crypto.getRandomValues(bytesAt(pointer + i, Math.min(65536, length - i)));
      }
    },
    proc_exit(code) {
      throw new Exit(code);
    },
    sched_yield: () => {},
    fd_prestat_get(descriptor, pointer) {
      if (descriptor !== 3) throw new CallError(BAD_DESCRIPTOR);
      putU32(pointer, 0);
      putU32(pointer + 4, 1);
    },
    fd_prestat_dir_name: (_, pointer) => bytesAt(pointer, 1).set(encode('/')),
    fd_fdstat_get(descriptor, pointer) {
      const kind = descriptor < 3 ? DEVICE : opened(descriptor).file ? FILE : FOLDER;
      bytesAt(pointer, 24).fill(0);
      view().setUint8(pointer, kind);
      // All rights: a device that can seek is no terminal.
      view().setBigUint64(pointer + 8, 0xffffffffffffffffn, true);
      view().setBigUint64(pointer + 16, 0xffffffffffffffffn, true);
    },
    fd_fdstat_set_flags: () => {},
    fd_filestat_get(descriptor, pointer) {
      const file = descriptor < 3 ? null : opened(descriptor).file;
      putStatus(pointer, descriptor < 3 ? DEVICE : file ? FILE : FOLDER, file ? file.size : 0);
    },
    fd_filestat_set_size: (descriptor, size) => openedFile(descriptor).file.resize(Number(size)),
    fd_close(descriptor) {
      opened(descriptor);
      open.delete(descriptor);
    },
    fd_sync: () => {},
    fd_datasync: () => {},
    fd_read(descriptor, pointer, count, total) {
      if (descriptor === 0) {
        return eachBuffer(pointer, count, total, buffer => {
          const part = input.subarray(0, buffer.length);
          buffer.set(part);
          input = input.subarray(part.length);
          return part.length;
        });
      }
      const entry = openedFile(descriptor);
      readFrom(entry.file, entry.position, pointer, count, total);
      entry.position += view().getUint32(total, true);
    },
    fd_pread(descriptor, pointer, count, position, total) {
      readFrom(openedFile(descriptor).file, Number(position), pointer, count, total);
    },
    fd_write(descriptor, pointer, count, total) {
      if (descriptor < 3) {
        eachBuffer(pointer, count, total, buffer => {
          if (descriptor === 1) output.push(buffer.slice());
          else errors += errorDecoder.decode(buffer.slice(), { stream: true });
          return buffer.length;
        });
        if (descriptor === 2) flushLines();
        return;
      }
      const entry = openedFile(descriptor);
      eachBuffer(pointer, count, total, buffer => {
        entry.file.write(entry.appends ? entry.file.size : entry.position, buffer);
        entry.position += buffer.length;
        return buffer.length;
      });
    },
    fd_pwrite(descriptor, pointer, count, position, total) {
      const { file } = openedFile(descriptor);
      eachBuffer(pointer, count, total, (buffer, sum) => {
        file.write(Number(position) + sum, buffer);
        return buffer.length;
      });
    },
    fd_seek(descriptor, offset, whence, pointer) {
      const entry = openedFile(descriptor);
      const position = Number(offset) + [0, entry.position, entry.file.size][whence];
      if (position < 0) throw new CallError(INVALID);
      entry.position = position;
      putU64(pointer, position);
    },
    fd_tell: (descriptor, pointer) => putU64(pointer, openedFile(descriptor).position),
    fd_readdir(descriptor, pointer, length, cookie, total) {
      const children = childrenOf(opened(descriptor).path);
      let used = 0;
      for (let i = Number(cookie); i < children.length && used < length; i++) {
        const name = encode(children[i].slice(parentOf(children[i]).length).replace('/', ''));
        const entry = new DataView(new ArrayBuffer(24 + name.length));
        entry.setBigUint64(0, BigInt(i + 1), true);
        entry.setUint32(16, name.length, true);
        entry.setUint8(20, isFolder(children[i]) ? FOLDER : FILE);
        new Uint8Array(entry.buffer).set(name, 24);
        const bytes = new Uint8Array(entry.buffer).subarray(0, length - used);
        bytesAt(pointer + used, bytes.length).set(bytes);
        used += bytes.length;
      }
      putU32(total, used);
    },
    path_open(folder, _, name, nameLength, flags, _rights, _inherited, fileFlags, pointer) {
      const path = pathAt(folder, name, nameLength);
      const [creates, wantsFolder, isExclusive, truncates] = [1, 2, 4, 8].map(bit => (flags & bit) !== 0);
      if (tree.has(path) && creates && isExclusive) throw new CallError(EXISTS);
      if (!tree.has(path) && creates) {
        if (!isFolder(parentOf(path))) throw new CallError(NO_ENTRY);
        tree.set(path, new MemoryFile(null));
      }
      const file = find(path);
      if (file !== null && wantsFolder) throw new CallError(NOT_FOLDER);
      if (file !== null && truncates) file.resize(0);
      open.set(nextDescriptor, { path, file, position: 0, appends: (fileFlags & 1) !== 0 });
      putU32(pointer, nextDescriptor++);
    },
    path_filestat_get(folder, _, name, nameLength, pointer) {
      const file = find(pathAt(folder, name, nameLength));
      putStatus(pointer, file ? FILE : FOLDER, file ? file.size : 0);
    },
    path_create_directory(folder, name, nameLength) {
      const path = pathAt(folder, name, nameLength);
      if (tree.has(path)) throw new CallError(EXISTS);
      if (!isFolder(parentOf(path))) throw new CallError(NO_ENTRY);
      tree.set(path, null);
    },
    path_remove_directory(folder, name, nameLength) {
      const path = pathAt(folder, name, nameLength);
      if (find(path) !== null) throw new CallError(NOT_FOLDER);
      if (childrenOf(path).length > 0) throw new CallError(NOT_EMPTY);
      tree.delete(path);
    },
    path_unlink_file(folder, name, nameLength) {
      const path = pathAt(folder, name, nameLength);
      if (find(path) === null) throw new CallError(IS_FOLDER);
      tree.delete(path);
    },
    path_rename(folder, name, nameLength, newFolder, newName, newLength) {
      const target = pathAt(newFolder, newName, newLength);
      if (isFolder(target) && childrenOf(target).length > 0) throw new CallError(NOT_EMPTY);
      move(pathAt(folder, name, nameLength), target);
    },
    path_link(folder, _, name, nameLength, newFolder, newName, newLength) {
      const target = pathAt(newFolder, newName, newLength);
      if (tree.has(target)) throw new CallError(EXISTS);
      tree.set(target, find(pathAt(folder, name, nameLength)));
    },
    path_readlink(folder, name, nameLength) {
      find(pathAt(folder, name, nameLength));
      throw new CallError(INVALID);
    },
  };

  /** Returns a function for the program that calls `call` and returns its error number. */
  const wrap = call => (...values) => {
    try {
      call(...values);
      return 0;
    } catch (error) {
      if (error instanceof CallError) return error.number;
      throw error;
    }
  };
  const imports = {};
  for (const { module: group, name } of WebAssembly.Module.imports(module)) {
    (imports[group] ??= {})[name] = calls[name] ? wrap(calls[name]) : () => NO_CALL;
  }
  const instance = new WebAssembly.Instance(module, imports);
  memory = instance.exports.memory;
  instance.exports._start();

  return {
    /** Puts files, Blobs by name, where the program finds them. */
    put(files) {
      for (const [name, blob] of Object.entries(files)) tree.set(name, new MemoryFile(blob));
    },

    /** Returns the file of this name as a Blob and removes it; null if there is none. */
    take(name) {
      const file = tree.get(name);
      if (!file) return null;
      tree.delete(name);
      return file.toBlob();
    },

    /** Returns the bytes with which the program answers a request. */
    answer(request) {
      [input, output] = [encode(JSON.stringify(request)), []];
      instance.exports.answer_request();
      const reply = new Uint8Array(output.reduce((sum, part) => sum + part.length, 0));
      let at = 0;
      for (const part of output) {
        reply.set(part, at);
        at += part.length;
      }
      output = [];
      return reply;
    },

    /** Returns the size of the program's memory. */
    memoryBytes: () => memory.buffer.byteLength,
  };
}
