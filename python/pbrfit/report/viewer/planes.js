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

/** Left, top, right and bottom of what was fitted, in pixels: where the plane is not 0. */
function boxOf(facing, width, height) {
  const box = [width, height, 0, 0];
  facing.forEach((code, i) => {
    if (!code) return;
    const [x, y] = [i % width, Math.floor(i / width)];
    box[0] = Math.min(box[0], x);
    box[1] = Math.min(box[1], y);
    box[2] = Math.max(box[2], x + 1);
    box[3] = Math.max(box[3], y + 1);
  });
  return box;
}

/** What was fitted as a picture for CSS masks, opaque there; "" where that is all. */
function maskOf(facing, width, height) {
  if (facing.every(Boolean)) return "";
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const context = canvas.getContext("2d");
  const picture = context.createImageData(width, height);
  facing.forEach((code, i) => { picture.data[4 * i + 3] = code ? 255 : 0; });
  context.putImageData(picture, 0, 0);
  return `url(${canvas.toDataURL()})`;
}

// Nodes to a cell of the splines: between these the shader interpolates in straight lines, which
// takes 24 texels a pixel where splines would take 96; off by at most 0.002, where n·v is near 0.
const NODES = 6;

/** The splines of pbrfit.report.viewer.lobes at NODES to a cell, as texels, those of a node side by side. */
async function unpackedLobes({ axes, low, step, codes }) {
  const bytes = await inflated(codes);
  const [columns, rows] = axes.map(([cells]) => cells + 3);
  const count = columns * rows;
  if (bytes.length !== 2 * count * low.length) throw new Error("the table in this page is damaged");
  const [width, height] = axes.map(([cells]) => NODES * cells + 1);
  const stride = 4 * Math.ceil(low.length / 4);
  const texels = new Float32Array(stride * width * height);
  const line = new Float64Array(width * rows);
  for (let f = 0; f < low.length; f++) {
    const plane = undone(bytes.subarray(2 * count * f, 2 * count * (f + 1)), columns);
    for (let x = 0; x < width; x++) {
      const [cell, weights] = splinesAt(x, axes[0][0]);
      for (let j = 0; j < rows; j++) {
        let sum = 0;
        for (let i = 0; i < 4; i++) sum += weights[i] * plane[columns * j + cell + i];
        line[width * j + x] = sum;
      }
    }
    for (let y = 0; y < height; y++) {
      const [cell, weights] = splinesAt(y, axes[1][0]);
      for (let x = 0; x < width; x++) {
        let sum = 0;
        for (let j = 0; j < 4; j++) sum += weights[j] * line[width * (cell + j) + x];
        texels[stride * (width * y + x) + f] = low[f] + step[f] * sum;
      }
    }
  }
  const finer = axes.map(([cells, ...bend]) => [NODES * cells, ...bend]);
  return { axes: finer, width: (stride / 4) * width, height, texels };
}

/** The cell of a node, and the four cubic B-splines there that are not 0. */
function splinesAt(node, cells) {
  const cell = Math.min(Math.floor(node / NODES), cells - 1);
  const p = node / NODES - cell;
  const r = 1 - p;
  return [cell, [r ** 3, 4 - 3 * p * p * (1 + r), 4 - 3 * r * r * (1 + p), p ** 3]
    .map((value) => value / 6)];
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
