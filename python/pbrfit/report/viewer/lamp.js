// Lamps: directions to them as angles, as vectors, and as places on the picture.

const RIM = 88; // degrees from the viewer's axis at the edge of the picture

/** Unit vector to a light: azimuth from +Z towards +X, elevation towards +Y, in degrees. */
function directionOf(azimuth, elevation) {
  const a = (azimuth * Math.PI) / 180;
  const e = (elevation * Math.PI) / 180;
  return [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)];
}

function anglesOf([x, y, z]) {
  const degrees = 180 / Math.PI;
  return { azimuth: Math.atan2(x, z) * degrees,
    elevation: Math.asin(Math.max(-1, Math.min(1, y))) * degrees };
}

/**
 * The direction that a place on the picture stands for: the middle is the viewer's, the edge almost
 * the picture's plane, and angles grow evenly between. u to the right and v up, −1 to 1.
 */
function directionAt(u, v) {
  const radius = Math.hypot(u, v);
  if (radius === 0) return [0, 0, 1];
  const angle = (Math.min(radius, 1) * RIM * Math.PI) / 180;
  const across = Math.sin(angle) / radius;
  return [u * across, v * across, Math.cos(angle)];
}

/** The place of a direction, at the edge where light comes from behind. */
function placeOf([x, y, z]) {
  const across = Math.hypot(x, y);
  if (across === 0) return z > 0 ? [0, 0] : [0, 1];
  const radius = Math.min(1, (Math.atan2(across, z) * 180) / Math.PI / RIM);
  return [(x / across) * radius, (y / across) * radius];
}

const SOFT_PARTS = 16;
const GOLDEN_ANGLE = Math.PI * (3 - Math.sqrt(5));

/**
 * Small disks that a disk-shaped lamp is made of, as rust/lamps/surface.rs has them.
 * @param {number} softness angular radius in degrees, 0 = a point
 */
function partsOfLamp(direction, softness) {
  if (softness === 0) return [{ direction, color: [1, 1, 1], extent: 0 }];
  const [x, y, z] = direction;
  const sign = z < 0 || Object.is(z, -0) ? -1 : 1;
  const a = -1 / (sign + z);
  const b = x * y * a;
  const across = [1 + sign * x * x * a, sign * b, -sign * x];
  const up = [b, sign + y * y * a, -y];
  const radius = (softness * Math.PI) / 180;
  return Array.from({ length: SOFT_PARTS }, (_, k) => {
    const from = radius * Math.sqrt((k + 0.5) / SOFT_PARTS);
    const turn = k * GOLDEN_ANGLE;
    const aside = [0, 1, 2].map((i) => Math.cos(turn) * across[i] + Math.sin(turn) * up[i]);
    return { direction: direction.map((d, i) => Math.cos(from) * d + Math.sin(from) * aside[i]),
      color: [0, 1, 2].map(() => 1 / SOFT_PARTS), extent: radius / Math.sqrt(SOFT_PARTS) };
  });
}

/** A direction turned as `turned` turns lights. */
function directionTurned([x, y, z], rotate, tilt) {
  const a = (rotate * Math.PI) / 180;
  const b = (tilt * Math.PI) / 180;
  const level = z * Math.cos(a) - x * Math.sin(a);
  return [x * Math.cos(a) + z * Math.sin(a), y * Math.cos(b) + level * Math.sin(b),
    level * Math.cos(b) - y * Math.sin(b)];
}
