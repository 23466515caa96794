// Unpacks the mesh from the text in the page, which pack.rs has written.

/** Decodes Base64. */
function fromBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

/** Decompresses bytes that zlib has compressed. */
async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Decodes numbers with seven bits per byte. */
function numbers(bytes, count) {
  const found = new Uint32Array(count);
  let at = 0;
  for (let i = 0; i < count; i++) {
    let byte = bytes[at++];
    let number = byte & 127;
    for (let shift = 7; byte & 128; shift += 7) {
      byte = bytes[at++];
      number |= (byte & 127) << shift;
    }
    found[i] = number;
  }
  return found;
}

const unzigzag = number => (number >>> 1) ^ -(number & 1);

/** Returns the mesh and its values as the page uses them. */
async function unpack(facts, text) {
  const bytes = await inflate(fromBase64(text));
  const streams = {};
  let start = 0;
  for (const [name, count, size] of facts.streams) {
    streams[name] = { bytes: bytes.subarray(start, start + size), count };
    start += size;
  }
  const read = name => numbers(streams[name].bytes, streams[name].count);

  const steps = read('nodes');
  const nodes = new Uint16Array(steps.length);
  const place = [0, 0, 0];
  for (let i = 0; i < steps.length; i++) nodes[i] = place[i % 3] += unzigzag(steps[i]);

  let newest = 0;
  const nodesBehind = behind => {
    for (let i = 0; i < behind.length; i++) {
      const back = behind[i];
      behind[i] = newest - back;
      if (back === 0) newest++;
    }
    return behind;
  };
  const corners = nodesBehind(read('corners'));
  const ends = nodesBehind(read('ends'));

  const sizes = read('sizes');
  const first = new Uint32Array(sizes.length + 1);
  for (let f = 0; f < sizes.length; f++) first[f + 1] = first[f] + sizes[f];
  const owner = read('owners');
  for (let f = 1; f < owner.length; f++) owner[f] += owner[f - 1];
  const beyond = new Int32Array(owner.length);
  const steps2 = read('beyond');
  for (let f = 0; f < beyond.length; f++) beyond[f] = steps2[f] ? owner[f] + steps2[f] : -1;
  const cellNumbers = read('numbers');
  let number = 0;
  for (let c = 0; c < cellNumbers.length; c++) cellNumbers[c] = number += unzigzag(cellNumbers[c]);

  const words = name => {
    const { bytes, count } = streams[name];
    const found = new Uint16Array(count);
    for (let i = 0; i < count; i++) found[i] = bytes[i] | bytes[count + i] << 8;
    return found;
  };
  let image = null;
  if (facts.image) {
    image = streams.image.bytes.slice();
    const width = facts.image.dims[0];
    for (let row = 0; row < image.length; row += width) {
      for (let i = row + 1; i < row + width; i++) image[i] += image[i - 1];
    }
  }
  return {
    nodes, corners, first, owner, beyond, image, ends,
    surfaces: read('surfaces'), lines: read('lines'),
    numbers: cellNumbers, bins: streams.bins.bytes,
    arrays: facts.arrays.map(array => ({ ...array, words: words('array ' + array.name), names: array.words })),
  };
}

/** Returns the value of a cell in an array, or NaN if it is missing. */
const valueOf = (array, cell) =>
  array.words[cell] === 65535 ? NaN : array.low + array.step * array.words[cell];
