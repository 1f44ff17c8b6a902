// Maps of pbrfit.report.viewer.maps.packed: planes of whole numbers, 0 to 65535.

/** Planes by name, in the order of `units`, from the base64 text of one zlib stream. */
async function unpacked(text, units, width, height) {
  const stream = new Blob([fromBase64(text)]).stream()
    .pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = width * height;
  const names = Object.keys(units);
  if (bytes.length !== 2 * count * names.length) throw new Error("the maps in this page are damaged");
  const planes = {};
  names.forEach((name, i) => {
    const high = bytes.subarray(2 * count * i, 2 * count * i + count);
    const low = bytes.subarray(2 * count * i + count, 2 * count * (i + 1));
    planes[name] = undone(high, low, width);
  });
  for (const name of ["red", "blue"]) {
    for (let i = 0; i < count; i++) planes[name][i] += planes.green[i] - 32768; // modulo 2^16
  }
  return planes;
}

function fromBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const characters = atob(text);
  const bytes = new Uint8Array(characters.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = characters.charCodeAt(i);
  return bytes;
}

/** Codes from prediction errors; neighbours beyond the border are 0. */
function undone(high, low, width) {
  const plane = new Uint16Array(high.length);
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
