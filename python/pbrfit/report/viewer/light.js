// SH lights: 16 coefficients × 3 channels in a Float64Array, index 3k + channel, k = l(l+1)+m,
// camera space. The same basis, senses of rotation and solid angles as in the Python package.

const BASIS = [
  () => Math.sqrt(1 / (4 * Math.PI)),
  (x, y) => Math.sqrt(3 / (4 * Math.PI)) * y,
  (x, y, z) => Math.sqrt(3 / (4 * Math.PI)) * z,
  (x) => Math.sqrt(3 / (4 * Math.PI)) * x,
  (x, y) => Math.sqrt(15 / (4 * Math.PI)) * x * y,
  (x, y, z) => Math.sqrt(15 / (4 * Math.PI)) * y * z,
  (x, y, z) => Math.sqrt(5 / (16 * Math.PI)) * (3 * z * z - 1),
  (x, y, z) => Math.sqrt(15 / (4 * Math.PI)) * x * z,
  (x, y) => Math.sqrt(15 / (16 * Math.PI)) * (x * x - y * y),
  (x, y) => Math.sqrt(35 / (32 * Math.PI)) * y * (3 * x * x - y * y),
  (x, y, z) => Math.sqrt(105 / (4 * Math.PI)) * x * y * z,
  (x, y, z) => Math.sqrt(21 / (32 * Math.PI)) * y * (5 * z * z - 1),
  (x, y, z) => Math.sqrt(7 / (16 * Math.PI)) * z * (5 * z * z - 3),
  (x, y, z) => Math.sqrt(21 / (32 * Math.PI)) * x * (5 * z * z - 1),
  (x, y, z) => Math.sqrt(105 / (16 * Math.PI)) * z * (x * x - y * y),
  (x, y, z) => Math.sqrt(35 / (32 * Math.PI)) * x * (x * x - 3 * y * y),
];

function basis(direction) {
  return BASIS.map((term) => term(...direction));
}

/** Add the basis of a direction, times a colour, to coefficients. */
function project(light, direction, color) {
  basis(direction).forEach((value, k) => {
    for (let c = 0; c < 3; c++) light[3 * k + c] += value * color[c];
  });
}

/** Radiance that comes from a direction: three channels, may be negative. */
function radianceFrom(light, terms) {
  const color = [0, 0, 0];
  for (let k = 0; k < 16; k++) {
    for (let c = 0; c < 3; c++) color[c] += terms[k] * light[3 * k + c];
  }
  return color;
}

// Rows of a panorama that integrate products of two SH of l <= 3 exactly, with as many columns.
const EXACT = 8;

/** Direction of column position u and row position v, both 0 to 1, of a panorama. */
function panoramaDirection(u, v) {
  const phi = 2 * Math.PI * (u - 0.5);
  const theta = Math.PI * (0.5 - v);
  return [Math.sin(phi) * Math.cos(theta), Math.sin(theta), -Math.cos(phi) * Math.cos(theta)];
}

/** Solid angle of a pixel of each row: Fejér's first rule, as pbrfit.panorama.solid_angles. */
function solidAngles(height, width) {
  return Float64Array.from({ length: height }, (_, i) => {
    const theta = (Math.PI * (i + 0.5)) / height;
    let series = 0;
    for (let k = 1; 2 * k <= height; k++) series += Math.cos(2 * k * theta) / (4 * k * k - 1);
    return ((2 * Math.PI) / width) * (2 / height) * (1 - 2 * series);
  });
}

/**
 * The light turned by `rotate` degrees about +Y, from +Z towards +X, then tilted by `tilt` degrees
 * about X, from +Z towards +Y: radiance from a direction is what it was from the one turned back.
 */
function turned(light, rotate, tilt) {
  const result = new Float64Array(48);
  const weights = solidAngles(EXACT, EXACT);
  for (let i = 0; i < EXACT; i++) {
    for (let j = 0; j < EXACT; j++) {
      const direction = panoramaDirection((j + 0.5) / EXACT, (i + 0.5) / EXACT);
      const back = directionBefore(direction, rotate, tilt);
      const color = radianceFrom(light, basis(back)).map((value) => value * weights[i]);
      project(result, direction, color);
    }
  }
  return result;
}

/** What a screen shows of radiance times `gain`, 0 to 255: as pbrfit.display.encoded. */
function displayed(radiance, gain, toneMap) {
  let color = radiance.map((value) => Math.max(0, value * gain));
  if (toneMap === "neutral") color = neutral(color);
  return color.map((value) => {
    const c = Math.min(1, value);
    return 255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
  });
}

/** Khronos PBR Neutral Tone Mapper, 2024. */
function neutral(radiance) {
  const least = Math.min(...radiance);
  const color = radiance.map((c) => c - (least < 0.08 ? least - 6.25 * least * least : 0.04));
  const peak = Math.max(...color);
  if (peak < 0.76) return color;
  const lowered = 1 - 0.24 ** 2 / (peak + 0.24 - 0.76);
  const grey = 1 - 1 / (0.15 * (peak - lowered) + 1);
  return color.map((c) => ((c * lowered) / peak) * (1 - grey) + lowered * grey);
}

/** The light as a mirror ball shows it that an orthographic camera sees. */
class Ball {
  constructor(canvas) {
    this.context = canvas.getContext("2d");
    this.picture = this.context.createImageData(canvas.width, canvas.height);
    this.pixels = []; // where, how opaque, and the direction that is seen
    const size = canvas.width;
    const margin = 1 + 2 / size;
    for (let i = 0; i < size; i++) {
      for (let j = 0; j < size; j++) {
        const x = ((2 * j + 1) / size - 1) * margin;
        const y = (1 - (2 * i + 1) / size) * margin;
        // The border fades over a pixel instead of ending in steps.
        const opaque = Math.min(1, 0.5 * size * (1 - Math.hypot(x, y)) + 0.5);
        if (opaque <= 0) continue;
        const z = Math.sqrt(Math.max(0, 1 - x * x - y * y));
        const mirror = [2 * z * x, 2 * z * y, 2 * z * z - 1]; // of (0, 0, 1) at (x, y, z)
        this.pixels.push([4 * (i * size + j), 255 * opaque, mirror]);
      }
    }
  }

  /** @param radianceOf {(direction) => number[]} light from a direction */
  draw(radianceOf, gain, toneMap) {
    const { data } = this.picture;
    for (const [place, opaque, direction] of this.pixels) {
      const color = displayed(radianceOf(direction), gain, toneMap);
      for (let c = 0; c < 3; c++) data[place + c] = color[c];
      data[place + 3] = opaque;
    }
    this.context.putImageData(this.picture, 0, 0);
  }
}
