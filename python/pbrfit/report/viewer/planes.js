// Maps of pbrfit.report.viewer.maps.packed: planes of whole numbers, 0 to 65535.

/** Planes by name, in the order of `units`, from the base64 text of one zlib stream. */
async function unpacked(text, units, width, height) {
  const bytes = await inflated(text);
  const count = width * height;
  const names = Object.keys(units);
  if (bytes.length !== 2 * count * names.length) throw new Error("the maps in this page are damaged");
  const planes = {};
  names.forEach((name, i) => {
    planes[name] = undone(bytes.subarray(2 * count * i, 2 * count * (i + 1)), width);
  });
  for (const name of ["red", "blue"]) {
    for (let i = 0; i < count; i++) planes[name][i] += planes.green[i] - 32768; // modulo 2^16
  }
  return planes;
}

/** The splines of pbrfit.report.viewer.lobes as texels, those of a node side by side. */
async function unpackedLobes({ axes, low, step, codes }) {
  const bytes = await inflated(codes);
  const [columns, rows] = axes.map(([cells]) => cells + 3);
  const count = columns * rows;
  if (bytes.length !== 2 * count * low.length) throw new Error("the table in this page is damaged");
  const stride = 4 * Math.ceil(low.length / 4);
  const texels = new Float32Array(stride * count);
  for (let f = 0; f < low.length; f++) {
    const plane = undone(bytes.subarray(2 * count * f, 2 * count * (f + 1)), columns);
    for (let i = 0; i < count; i++) texels[stride * i + f] = low[f] + step[f] * plane[i];
  }
  return { axes, width: (stride / 4) * columns, height: rows, texels };
}

async function inflated(text) {
  const stream = new Blob([fromBase64(text)]).stream()
    .pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function fromBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const characters = atob(text);
  const bytes = new Uint8Array(characters.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = characters.charCodeAt(i);
  return bytes;
}

/** Codes from prediction errors, high bytes before low ones; neighbours beyond the border are 0. */
function undone(bytes, width) {
  const plane = new Uint16Array(bytes.length / 2);
  const high = bytes.subarray(0, plane.length);
  const low = bytes.subarray(plane.length);
  for (let i = 0; i < plane.length; i++) {
    const first = i % width === 0;
    const a = first ? 0 : plane[i - 1];
    const b = i < width ? 0 : plane[i - width];
    const c = first || i < width ? 0 : plane[i - width - 1];
    const predicted = Math.max(Math.min(a, b), Math.min(Math.max(a, b), a + b - c));
    const stored = (high[i] << 8) | low[i];
    plane[i] = predicted + ((stored >> 1) ^ -(stored & 1));
  }
  return plane;
}

/** Four planes side by side, as a texture wants them. */
function interleaved(planes) {
  const texels = new Uint16Array(4 * planes[0].length);
  planes.forEach((plane, c) => {
    for (let i = 0; i < plane.length; i++) texels[4 * i + c] = plane[i];
  });
  return texels;
}
