// Runs one command of the program. The page starts a worker for each command and ends it to cancel.

onmessage = ({ data: { module, args, files } }) => {
  try {
    postMessage({ result: runProgram(module, args, files, line => postMessage({ line })) });
  } catch (error) {
    const isFull = error instanceof RangeError || /memory|unreachable/.test(error.message);
    const text = isFull ? 'memory: the browser has none left; give a larger distance or a part of the image' : String(error);
    postMessage({ result: { code: 101, output: '', files: {}, memoryBytes: 0 }, line: `error: ${text}` });
  }
};
