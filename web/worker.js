// Holds the session of the page: the program stays in memory and answers one request after another.

let program = null;
let current = 0;

onmessage = ({ data: { id, module, files, request, take } }) => {
  current = id;
  try {
    program ??= startProgram(module, line => postMessage({ id: current, line }));
    program.put(files || {});
    const reply = request ? program.answer(request) : null;
    const taken = {};
    for (const name of take || []) taken[name] = program.take(name);
    postMessage({ id, reply, files: taken, memoryBytes: program.memoryBytes() }, reply ? [reply.buffer] : []);
  } catch (error) {
    const isFull = error instanceof RangeError || error instanceof Exit || /memory|unreachable/.test(error.message);
    const failure = isFull ? 'memory: the browser has none left; give a larger distance or a part of the image' : String(error);
    postMessage({ id, failure });
  }
};
