// Radiance .hdr panoramas, read row by row. What is wrong with a file is thrown as an Error whose
// message is for the user.

const FEWEST_ROWS = 7; // as pbrfit.model.panorama
const MOST_ROWS = 4096; // finer ones would only take time: the sharpest level has 512
const MOST_SECONDS = 20; // of reading: runs make a small file one of many pixels
const TURN = 30; // milliseconds after which the page may answer
const SCALES = Float64Array.from({ length: 256 }, (_, exponent) =>
  exponent === 0 ? 0 : 2 ** (exponent - 136));

/**
 * @param {Uint8Array} bytes content of the file
 * @returns {Promise<{rows: Float64Array[], width: number, height: number}>} rows of `narrowedRow`;
 *   the page may answer in between
 */
async function readPanorama(bytes) {
  const header = readHeader(bytes);
  const { width, height } = header;
  if (width !== 2 * height) {
    throw new Error(
      `expected a panorama twice as wide as high (equirectangular), found ${width} × ${height}`);
  }
  if (height < FEWEST_ROWS || height > MOST_ROWS) {
    throw new Error(`expected a panorama of ${2 * FEWEST_ROWS} × ${FEWEST_ROWS} to `
      + `${2 * MOST_ROWS} × ${MOST_ROWS} pixels, found ${width} × ${height}`);
  }
  const reader = new RowReader(bytes, header);
  const across = shares(width, COLUMNS, true);
  const row = new Float64Array(3 * width);
  const rows = [];
  const began = performance.now();
  let answered = began;
  while (rows.length < height) {
    const codes = reader.next();
    for (let j = 0; j < width; j++) {
      const scale = SCALES[codes[4 * j + 3]];
      for (let c = 0; c < 3; c++) row[3 * j + c] = codes[4 * j + c] * scale / header.factors[c];
    }
    rows.push(narrowedRow(row, width, across));
    const now = performance.now();
    if (now - began > 1000 * MOST_SECONDS) {
      throw new Error(`expected a panorama that is read within ${MOST_SECONDS} s, found `
        + `${width} × ${height} pixels, of which ${rows.length} rows were read`);
    }
    if (now - answered > TURN) {
      await new Promise((done) => setTimeout(done));
      answered = performance.now();
    }
  }
  return { rows, width, height };
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
  const factors = [1, 1, 1]; // what values were multiplied by
  for (let text = line(); text !== ""; text = line()) {
    const told = /^(EXPOSURE|COLORCORR)\s*=(.*)$/.exec(text);
    const numbers = told ? told[2].trim().split(/\s+/).map(Number) : [];
    if (told && numbers.length === (told[1] === "EXPOSURE" ? 1 : 3)
      && numbers.every((number) => number > 0 && Number.isFinite(number))) {
      for (let c = 0; c < 3; c++) factors[c] *= numbers[c % numbers.length];
    }
    if (text.startsWith("FORMAT=") && text !== "FORMAT=32-bit_rle_rgbe") {
      throw new Error(`expected FORMAT=32-bit_rle_rgbe, found ${text}`);
    }
  }
  const resolution = line();
  const found = /^-Y (\d+) \+X (\d+)$/.exec(resolution);
  if (!found || +found[1] < 1 || +found[2] < 1 || found[1].length + found[2].length > 12) {
    throw new Error(`expected a resolution as -Y 512 +X 1024, found ${resolution.slice(0, 80)}`);
  }
  return { height: +found[1], width: +found[2], start: position, factors };
}

/** Rows of RGBE pixels, one after the other: run lengths of each channel, of pixels, or none. */
class RowReader {
  constructor(bytes, { width, height, start }) {
    Object.assign(this, { bytes, width, height, position: start, index: 0 });
    this.row = new Uint8Array(4 * width);
    this.pixels = new Uint32Array(this.row.buffer);
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
    const { row, pixels, width } = this;
    let column = 0;
    let shift = 0;
    while (column < width) {
      const pixel = [this.byte(), this.byte(), this.byte(), this.byte()];
      if (pixel[0] === 1 && pixel[1] === 1 && pixel[2] === 1) { // repeat the one before
        const count = pixel[3] * 2 ** shift;
        if (column === 0 || column + count > width) throw this.tooLong();
        pixels.fill(pixels[column - 1], column, column + count);
        column += count;
        shift += 8;
      } else {
        row.set(pixel, 4 * column++);
        shift = 0;
      }
    }
  }
}
