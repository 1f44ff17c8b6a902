// Radiance .hdr panoramas: read row by row and projected to an SH light. What is wrong with a file
// is thrown as an Error whose message is for the user.

const FEWEST_ROWS = 7; // as pbrfit.panorama; with fewer, `solidAngles` is not exact for l = 3

/**
 * @param {Uint8Array} bytes content of the file
 * @returns {{light: Float64Array, lost: number, width: number, height: number}} lost: share of
 *   ∫ E² dω beyond l = 3, over all channels
 */
function readPanorama(bytes) {
  const header = readHeader(bytes);
  const { width, height } = header;
  if (width !== 2 * height) {
    throw new Error(
      `expected a panorama twice as wide as high (equirectangular), found ${width} × ${height}`);
  }
  if (height < FEWEST_ROWS) {
    throw new Error(`expected a panorama of ${2 * FEWEST_ROWS} × ${FEWEST_ROWS} pixels or more, `
      + `found ${width} × ${height}`);
  }
  const reader = new RowReader(bytes, header);
  const angles = solidAngles(height, width);
  // A row enters the projection through its Fourier sums Σ E cos mφ and Σ E sin mφ, m <= 3, alone.
  const waves = [];
  for (let m = 0; m <= 3; m++) {
    for (const wave of [Math.cos, Math.sin]) {
      waves.push(Float64Array.from({ length: width }, (_, j) =>
        wave(m * 2 * Math.PI * ((j + 0.5) / width - 0.5))));
    }
  }
  const light = new Float64Array(48);
  let energy = 0;
  for (let i = 0; i < height; i++) {
    const row = reader.next();
    const sums = waves.map(() => [0, 0, 0]);
    for (let j = 0; j < width; j++) {
      const exponent = row[4 * j + 3];
      if (exponent === 0) continue;
      const scale = 2 ** (exponent - 136);
      for (let c = 0; c < 3; c++) {
        const value = row[4 * j + c] * scale;
        energy += angles[i] * value * value;
        for (let w = 0; w < 8; w++) sums[w][c] += value * waves[w][j];
      }
    }
    // The row without its higher frequencies, at 8 points: products with SH need no more.
    for (let p = 0; p < EXACT; p++) {
      const u = (p + 0.5) / EXACT;
      const phi = 2 * Math.PI * (u - 0.5);
      const color = [0, 1, 2].map((c) => {
        let value = sums[0][c];
        for (let m = 1; m <= 3; m++) {
          value += 2 * (sums[2 * m][c] * Math.cos(m * phi) + sums[2 * m + 1][c] * Math.sin(m * phi));
        }
        return (angles[i] * value) / EXACT;
      });
      project(light, panoramaDirection(u, (i + 0.5) / height), color);
    }
  }
  const kept = light.reduce((sum, value) => sum + value * value, 0);
  const lost = energy > 0 ? Math.min(1, Math.max(0, 1 - kept / energy)) : 0;
  return { light, lost, width, height };
}

/** Lines up to an empty one, then the resolution. */
function readHeader(bytes) {
  let position = 0;
  const line = () => {
    const end = bytes.indexOf(10, position);
    if (end < 0 || end - position > 4096) {
      throw new Error("expected a Radiance .hdr file, found a header without end");
    }
    const text = String.fromCharCode(...bytes.subarray(position, end)).trim();
    position = end + 1;
    return text;
  };
  if (bytes[0] !== 35 || bytes[1] !== 63) { // "#?"
    throw new Error("expected a Radiance .hdr file, found something else");
  }
  for (let text = line(); text !== ""; text = line()) {
    if (text.startsWith("FORMAT=") && text !== "FORMAT=32-bit_rle_rgbe") {
      throw new Error(`expected FORMAT=32-bit_rle_rgbe, found ${text}`);
    }
  }
  const resolution = line();
  const found = /^-Y (\d+) \+X (\d+)$/.exec(resolution);
  if (!found || +found[1] < 1 || +found[2] < 1 || found[1].length + found[2].length > 12) {
    throw new Error(`expected a resolution as -Y 512 +X 1024, found ${resolution.slice(0, 80)}`);
  }
  return { height: +found[1], width: +found[2], start: position };
}

/** Rows of RGBE pixels, one after the other: run lengths of each channel, of pixels, or none. */
class RowReader {
  constructor(bytes, { width, height, start }) {
    Object.assign(this, { bytes, width, height, position: start, index: 0 });
    this.row = new Uint8Array(4 * width);
  }

  next() {
    const { bytes, position, width } = this;
    const channels = width < 32768 && bytes[position] === 2
      && bytes[position + 1] === 2 && bytes[position + 2] < 128;
    if (channels) this.runsOfChannels();
    else this.runsOfPixels();
    this.index++;
    return this.row;
  }

  byte() {
    if (this.position >= this.bytes.length) {
      throw new Error(`expected ${this.height} rows, found the end of the file in row ${this.index}`);
    }
    return this.bytes[this.position++];
  }

  tooLong() {
    return new Error(`expected ${this.width} pixels a row, found more in row ${this.index}`);
  }

  runsOfChannels() {
    const { row, width, bytes, position } = this;
    if (bytes[position + 2] * 256 + bytes[position + 3] !== width) throw this.tooLong();
    this.position += 4;
    for (let channel = 0; channel < 4; channel++) {
      let column = 0;
      while (column < width) {
        let count = this.byte();
        const run = count > 128;
        if (run) count -= 128;
        if (count === 0 || column + count > width) throw this.tooLong();
        const value = run ? this.byte() : 0;
        for (; count > 0; count--) row[4 * column++ + channel] = run ? value : this.byte();
      }
    }
  }

  runsOfPixels() {
    const { row, width } = this;
    let column = 0;
    let shift = 0;
    while (column < width) {
      const pixel = [this.byte(), this.byte(), this.byte(), this.byte()];
      if (pixel[0] === 1 && pixel[1] === 1 && pixel[2] === 1) { // repeat the one before
        const count = pixel[3] * 2 ** shift;
        if (column === 0 || column + count > width) throw this.tooLong();
        for (let i = 0; i < count; i++, column++) {
          row.copyWithin(4 * column, 4 * column - 4, 4 * column);
        }
        shift += 8;
      } else {
        row.set(pixel, 4 * column++);
        shift = 0;
      }
    }
  }
}
