// A panorama blurred by round lobes of growing width, as rust/environment/blurred.rs has it.

const COLUMNS = 1024; // of the sharpest level
const LEVELS = 8;
const SHARPEST = (2 * 2 * Math.PI) / COLUMNS; // σ_0, radians
const HEMISPHERE_LEVEL = 3; // whose grid hemispheres have
const HORIZON = 0.2; // n·l up to which the even hemisphere grows
const REACH = 4.5; // where sums end, in σ
const LARGEST_HALF = 30000; // of radiance in textures of half precision

/** What of `from` cells goes into each of `to`: first cell and weights, which sum to 1. */
function shares(from, to, wraps) {
  const ratio = from / to;
  return Array.from({ length: to }, (_, i) => {
    if (ratio >= 1) {
      const [start, end] = [i * ratio, (i + 1) * ratio];
      const first = Math.floor(start);
      const last = Math.min(Math.ceil(end), from);
      return { first, weights: Array.from({ length: last - first }, (_unused, j) =>
        Math.max(0, Math.min(end, first + j + 1) - Math.max(start, first + j)) / ratio) };
    }
    let centre = (i + 0.5) * ratio - 0.5;
    if (!wraps) centre = Math.min(Math.max(centre, 0), from - 1);
    const first = Math.floor(centre);
    return { first, weights: [1 - (centre - first), centre - first] };
  });
}

/** One row of RGB on the columns of the sharpest level; `across` are its `shares`. */
function narrowedRow(row, width, across) {
  const narrow = new Float64Array(3 * COLUMNS);
  for (let i = 0; i < COLUMNS; i++) {
    const { first, weights } = across[i];
    for (let j = 0; j < weights.length; j++) {
      const from = 3 * ((((first + j) % width) + width) % width);
      for (let c = 0; c < 3; c++) narrow[3 * i + c] += weights[j] * row[from + c];
    }
  }
  return narrow;
}

/** Rows of `narrowedRow` as the sharpest level's grid. */
function sourceOf(rows) {
  const texels = new Float32Array(3 * COLUMNS * (COLUMNS / 2));
  shares(rows.length, COLUMNS / 2, false).forEach(({ first, weights }, i) => {
    const sum = new Float64Array(3 * COLUMNS);
    weights.forEach((weight, j) => {
      const row = rows[Math.min(first + j, rows.length - 1)];
      for (let x = 0; x < sum.length; x++) sum[x] += weight * row[x];
    });
    texels.set(sum, 3 * COLUMNS * i);
  });
  return { columns: COLUMNS, texels };
}

/** Part of the sphere that a row covers. */
function areaOf(row, rows) {
  const edge = (i) => Math.sin(Math.PI * (0.5 - i / rows));
  return 0.5 * (edge(row) - edge(row + 1));
}

/** With half as many rows and columns: means by solid angle. */
function halved({ columns, texels }) {
  const [rows, half] = [columns / 2, columns / 2];
  const found = new Float32Array((texels.length / 4));
  for (let i = 0; i < rows / 2; i++) {
    const upper = areaOf(2 * i, rows);
    const part = upper / (upper + areaOf(2 * i + 1, rows));
    for (let j = 0; j < half; j++) {
      for (let c = 0; c < 3; c++) {
        const at = 3 * (2 * i * columns + 2 * j) + c;
        const below = at + 3 * columns;
        found[3 * (i * half + j) + c] = part * 0.5 * (texels[at] + texels[at + 3])
          + (1 - part) * 0.5 * (texels[below] + texels[below + 3]);
      }
    }
  }
  return { columns: half, texels: found };
}

/** Means weighted by `lobe` of the cosine, of all within `reach` radians; on the same grid. */
function convolved({ columns, texels }, lobe, reach) {
  const rows = columns / 2;
  const wide = 3 * columns;
  const doubled = new Float64Array(2 * wide * rows); // rows twice, so that sums cross the edge
  for (let i = 0; i < rows; i++) {
    const row = texels.subarray(i * wide, (i + 1) * wide);
    doubled.set(row, 2 * i * wide);
    doubled.set(row, (2 * i + 1) * wide);
  }
  const turns = Float64Array.from({ length: columns / 2 + 1 }, (_, d) =>
    Math.cos((2 * Math.PI * d) / columns));
  const least = Math.cos(Math.min(reach, Math.PI)) - 1e-12;
  const height = (i) => Math.PI * (0.5 - (i + 0.5) / rows);
  const found = new Float32Array(texels.length);
  const sums = new Float64Array(wide);
  for (let i = 0; i < rows; i++) {
    sums.fill(0);
    let total = 0;
    for (let other = 0; other < rows; other++) {
      if (Math.abs(height(i) - height(other)) > reach) continue;
      const even = Math.sin(height(i)) * Math.sin(height(other));
      const swing = Math.cos(height(i)) * Math.cos(height(other));
      const area = areaOf(other, rows);
      const start = 2 * other * wide;
      for (let d = 0; d <= columns / 2; d++) {
        const cosine = even + swing * turns[d];
        if (cosine < least) break;
        const weight = area * lobe(cosine);
        if (weight === 0) continue;
        const both = d !== 0 && 2 * d !== columns;
        total += both ? 2 * weight : weight;
        const right = start + 3 * d;
        const left = start + 3 * (columns - d);
        if (both) {
          for (let x = 0; x < wide; x++) sums[x] += weight * (doubled[right + x] + doubled[left + x]);
        } else {
          for (let x = 0; x < wide; x++) sums[x] += weight * doubled[right + x];
        }
      }
    }
    for (let x = 0; x < wide; x++) found[i * wide + x] = sums[x] / total;
  }
  return { columns, texels: found };
}

/**
 * @param {Float64Array[]} rows of `narrowedRow`
 * @returns {Promise<{levels: Array, hemispheres: Array}>} grids; the page may answer in between
 */
async function blurred(rows) {
  let source = sourceOf(rows);
  const levels = [];
  let hemispheres = null;
  for (let j = 0; j < LEVELS; j++) {
    const width = SHARPEST * 2 ** j;
    const texel = (2 * Math.PI) / source.columns;
    const variance = width * width - texel * texel * (1 / 12 + 1 / 6);
    levels.push(convolved(source, (cosine) => Math.exp((cosine - 1) / variance), REACH * width));
    if (j === HEMISPHERE_LEVEL) {
      hemispheres = [
        convolved(source, (cosine) => Math.min(1, Math.max(0, cosine) / HORIZON), Math.PI),
        convolved(source, (cosine) => Math.max(0, cosine), Math.PI),
      ];
    }
    source = halved(source);
    await new Promise((done) => setTimeout(done));
  }
  return { levels, hemispheres };
}

/** Four numbers a texel for WebGL, in units that half precision holds. */
function halfTexels({ texels }, unit) {
  const found = new Float32Array((texels.length / 3) * 4);
  for (let i = 0, j = 0; i < texels.length; i += 3, j += 4) {
    for (let c = 0; c < 3; c++) found[j + c] = texels[i + c] / unit;
  }
  return found;
}

/** What of radiance is 1 in textures. */
function halfUnit({ levels, hemispheres }) {
  let largest = 0;
  for (const { texels } of [...levels, ...hemispheres]) {
    for (const value of texels) largest = Math.max(largest, value);
  }
  return largest > 0 ? largest / LARGEST_HALF : 1;
}

/** Light from a direction, of a grid: the texel that it is in. */
function radianceOfGrid({ columns, texels }, [x, y, z]) {
  const across = 0.5 + Math.atan2(x, -z) / (2 * Math.PI);
  const down = 0.5 - Math.asin(Math.max(-1, Math.min(1, y))) / Math.PI;
  const column = Math.min(columns - 1, Math.floor(across * columns));
  const row = Math.min(columns / 2 - 1, Math.floor((down * columns) / 2));
  const at = 3 * (row * columns + column);
  return [texels[at], texels[at + 1], texels[at + 2]];
}

/** The direction that one comes from that is turned as `turned` turns lights. */
function directionBefore([x, y, z], rotate, tilt) {
  const a = (rotate * Math.PI) / 180;
  const b = (tilt * Math.PI) / 180;
  const level = y * Math.sin(b) + z * Math.cos(b);
  return [x * Math.cos(a) - level * Math.sin(a), y * Math.cos(b) - z * Math.sin(b),
    x * Math.sin(a) + level * Math.cos(a)];
}
