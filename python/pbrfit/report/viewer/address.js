// The page's address: #light=NAME&rotate=30&exposure=0.5, only what differs from the start.

const RANGES = { azimuth: [-180, 180], elevation: [-90, 90], ambient: [0, 1], softness: [0, 45],
  rotate: [-180, 180], tilt: [-90, 90], exposure: [-100, 100], roughness: [-1, 1], metallic: [-1, 1] };
const CHOICES = { tone: TONE_MAPS,
  view: [...SHOWN.slice(0, 5), "uncertainty", "strips"],
  of: ["albedo", "roughness", "metallic"] };

/**
 * What an address asks for.
 * @param has {(name, text) => boolean} whether there is such a light, or picture
 * @returns {?{values: Object, wrong: string[]}} null where it is of another part of the page
 */
function readAddress(hash, has) {
  if (!hash.includes("=")) return null;
  const values = {};
  const wrong = [];
  for (const [name, text] of new URLSearchParams(hash.slice(1))) {
    const number = Number(text);
    if (name === "light" || name === "picture") {
      if (has(name, text)) values[name] = text;
      else if (name === "picture") wrong.push(`picture ${text} is not in this page`);
      else wrong.push(`light ${text} is not in this page; a panorama has to be opened again`);
    } else if (name in RANGES) {
      if (text.trim() !== "" && Number.isFinite(number)) values[name] = number;
      else wrong.push(`${name}: expected a number, found ${text}`);
    } else if (name in CHOICES) {
      if (CHOICES[name].includes(text)) values[name] = text;
      else wrong.push(`${name}: expected one of ${CHOICES[name].join(", ")}, found ${text}`);
    }
  }
  return { values, wrong };
}

function writeAddress(state, start) {
  const values = new URLSearchParams();
  for (const [name, value] of Object.entries(state)) {
    if (value === start[name]) continue;
    values.set(name, typeof value === "number" ? String(+value.toFixed(4)) : value);
  }
  const address = window.location.pathname + window.location.search;
  const text = values.toString();
  try {
    window.history.replaceState(null, "", text ? `${address}#${text}` : address);
  } catch {
    // Pages inside of other pages may not have an address of their own.
  }
}
