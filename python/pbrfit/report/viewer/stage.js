// The stage: where the picture lies on it, how large, and what pointers do there.

const MOST_ZOOM = 32;
const WHEEL_ZOOM = 0.0015; // per pixel that a wheel scrolls, as a natural logarithm
const KEY_ZOOM = 1.25;
const AROUND = 0.94; // share of the room that what was fitted has at first
const PIXELS_SEEN = 8; // screen pixels to one of the maps from which on, zoomed in, they have edges

/** Place and size of the picture; `changed` is called when they change. */
class Stage {
  constructor(element, sheet, data, changed) {
    Object.assign(this, { element, sheet, data, changed });
    this.zoom = 1;
    this.centre = [0.5, 0.5]; // the place of the picture that is in the middle of the stage
    this.resting = true; // whether it lies as at first, with all that was fitted in sight
    new ResizeObserver(() => this.lay()).observe(element);
    this.lay();
  }

  /** Room that is free of bars, in pixels of the stage: left, top, width, height. */
  room() {
    const { clientWidth: width, clientHeight: height } = this.element;
    const style = getComputedStyle(this.element);
    const [top, right, bottom, left] = ["Top", "Right", "Bottom", "Left"].map((side) =>
      parseFloat(style[`padding${side}`]) || 0);
    return [left, top, Math.max(1, width - left - right), Math.max(1, height - top - bottom)];
  }

  lay() {
    const { width, height } = this.data;
    const [left, top, wide, tall] = this.room();
    const fit = Math.min(wide / width, tall / height);
    if (this.resting) {
      const [west, north, east, south] = this.data.box;
      const most = Math.min(wide / (fit * (east - west)), tall / (fit * (south - north)));
      this.zoom = Math.max(1, AROUND * most);
      this.centre = [(west + east) / (2 * width), (north + south) / (2 * height)];
    }
    const size = [fit * width * this.zoom, fit * height * this.zoom];
    const free = [wide, tall];
    const at = [left, top].map((edge, i) => {
      // Its edges stay where they are at first, or outside: as far as zooming about a pixel leads.
      const most = 0.5 - 0.5 / this.zoom;
      this.centre[i] = Math.min(0.5 + most, Math.max(0.5 - most, this.centre[i]));
      return edge + free[i] / 2 - this.centre[i] * size[i];
    });
    Object.assign(this, { at, size, scale: fit * this.zoom });
    const { style } = this.sheet;
    style.width = `${fit * width}px`;
    style.height = `${fit * height}px`;
    style.transform = `translate(${at[0]}px, ${at[1]}px) scale(${this.zoom})`;
    this.sheet.classList.toggle("relight-pixels", this.data.tiny
      || (this.zoom > 1 && this.scale >= PIXELS_SEEN));
    this.changed();
  }

  /** Zoom by a factor about a place of the stage. */
  zoomAbout([x, y], factor) {
    const before = this.zoom;
    this.resting = false;
    // As far as one pixel in 16 of the screen, for small maps at least eight times.
    const most = Math.max(8, MOST_ZOOM / Math.max(1e-9, this.scale / before));
    this.zoom = Math.min(Math.min(most, 4096), Math.max(1, before * factor));
    const [left, top, wide, tall] = this.room();
    const size = this.size.map((value) => (value * this.zoom) / before);
    const place = [(x - this.at[0]) / this.size[0], (y - this.at[1]) / this.size[1]];
    this.centre = [place[0] + (left + wide / 2 - x) / size[0],
      place[1] + (top + tall / 2 - y) / size[1]];
    this.lay();
  }

  zoomBy(factor) {
    const [left, top, wide, tall] = this.room();
    this.zoomAbout([left + wide / 2, top + tall / 2], factor);
  }

  pan(x, y) {
    this.resting = false;
    this.centre = [this.centre[0] - x / this.size[0], this.centre[1] - y / this.size[1]];
    this.lay();
  }

  reset() {
    this.resting = true;
    this.lay();
  }

  /** What is seen of the picture, in pixels of the stage: left, top, right, bottom. */
  seen() {
    const [left, top, wide, tall] = this.room();
    const { at, size } = this;
    return [Math.max(at[0], left), Math.max(at[1], top),
      Math.min(at[0] + size[0], left + wide), Math.min(at[1] + size[1], top + tall)];
  }

  /** Left and right of what was fitted, as far as it is seen, in pixels of the stage. */
  boxSeen() {
    const [left, , right] = this.seen();
    const [west, , east] = this.data.box;
    const { at, size, data } = this;
    return [west, east].map((x) =>
      Math.min(right, Math.max(left, at[0] + (size[0] * x) / data.width)));
  }

  /** A pointer's place, in pixels of the stage. */
  placeOf(event) {
    const box = this.element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }
}

/**
 * Pointers on the stage. One, with mouse, pen or a finger, moves the light; the hand (a mode, the
 * space bar or the middle button) moves the picture; two fingers do that and zoom.
 * @param light {begin(place), move(place, x, y), end()}
 */
function listenToPointers(canvas, stage, hand, light) {
  const target = stage.element;
  // Beside the picture a mouse goes on to move the light; a finger scrolls the page.
  const counts = ({ target: on, pointerType }) =>
    on === canvas || (on === target && pointerType !== "touch");
  const pointers = new Map();
  let doing = ""; // "light", "pan" or "pinch"
  const pinch = () => {
    const [[a, b], [c, d]] = [...pointers.values()];
    return { middle: [(a + c) / 2, (b + d) / 2], apart: Math.max(1, Math.hypot(c - a, d - b)) };
  };
  const become = (what) => {
    if (doing === "light" && what !== "light") light.end();
    doing = what;
    target.classList.toggle("relight-panning", what === "pan");
  };
  target.addEventListener("pointerdown", (event) => {
    if (!counts(event)) return;
    const middle = event.button === 1;
    if (event.button !== 0 && !middle) return;
    if (middle) event.preventDefault(); // or the page scrolls by itself
    target.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, stage.placeOf(event));
    if (pointers.size === 2) become("pinch");
    else if (pointers.size > 2) return;
    else if (middle || hand()) become("pan");
    else {
      become("light");
      light.begin(stage.placeOf(event));
    }
  });
  target.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return;
    const place = stage.placeOf(event);
    const before = doing === "pinch" && pointers.size === 2 ? pinch() : null;
    pointers.set(event.pointerId, place);
    const [x, y] = [place[0] - last[0], place[1] - last[1]];
    if (before) {
      const after = pinch();
      stage.pan(after.middle[0] - before.middle[0], after.middle[1] - before.middle[1]);
      stage.zoomAbout(after.middle, after.apart / before.apart);
    } else if (doing === "pan") stage.pan(x, y);
    else if (doing === "light") light.move(place, x, y);
  });
  const end = (event) => {
    if (!pointers.delete(event.pointerId)) return;
    // A finger that stays after two does nothing, so that the light does not jump.
    become(pointers.size ? "rest" : "");
  };
  target.addEventListener("pointerup", end);
  target.addEventListener("pointercancel", end);
  target.addEventListener("dblclick", (event) => {
    if (event.target === canvas || event.target === target) stage.reset();
  });
}

/** The wheel zooms, but leaves a page alone that is scrolled, or is about to be. */
function listenToWheel(target, stage) {
  let last = 0;
  target.addEventListener("wheel", (event) => {
    const alone = !event.ctrlKey && !document.fullscreenElement;
    const zooming = event.timeStamp - last < 400; // what zoomed out does not go on to scroll
    const whole = stage.resting || stage.zoom === 1;
    if (alone && window.scrollY > 0 && whole) return;
    if (alone && event.deltaY > 0 && whole && !zooming) return;
    event.preventDefault();
    last = event.timeStamp;
    const unit = [1, 16, 400][event.deltaMode];
    const pixels = Math.max(-240, Math.min(240, event.deltaY * unit)) * (event.ctrlKey ? 4 : 1);
    stage.zoomAbout(stage.placeOf(event), Math.exp(-pixels * WHEEL_ZOOM));
  }, { passive: false });
}
