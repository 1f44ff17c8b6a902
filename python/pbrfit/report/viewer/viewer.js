// The view: controls, drag, keys and the page's address change the state; the state is drawn once
// before the next frame of the screen, and never without a change.

const DEGREES_ACROSS = 180; // a drag over the whole width
const KEY_DEGREES = 5;
const ADDRESS_DELAY = 300; // ms; browsers limit how often an address may change
const STOPS = 6; // to either side of exposure 0 and of the one at the start
const RANGES = { rotate: [-180, 180], tilt: [-90, 90], exposure: [-100, 100], roughness: [-1, 1],
  metallic: [-1, 1] };
const CHOICES = { window: Object.keys(WINDOWS), tone: TONE_MAPS, view: SHOWN };
const TEXTS = {
  rotate: (value) => `${signed(value, 0)}°`,
  tilt: (value) => `${signed(value, 0)}°`,
  exposure: (value) => `${signed(value, 1)} EV`,
  roughness: (value) => signed(value, 2),
  metallic: (value) => signed(value, 2),
};
const KEYS = { ArrowLeft: ["rotate", -1], ArrowRight: ["rotate", 1], ArrowDown: ["tilt", -1],
  ArrowUp: ["tilt", 1] };

function signed(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  if (Number(text) === 0) return text;
  return (value < 0 ? "−" : "+") + text;
}

class View {
  constructor(root, data, picture) {
    Object.assign(this, { root, data, picture });
    this.lights = data.lights.map(({ name, coefficients }) =>
      ({ name, coefficients: Float64Array.from(coefficients) }));
    this.opened = null; // a panorama from a file
    this.start = { light: data.lights[0].name, window: "none", rotate: 0, tilt: 0,
      exposure: data.exposure, tone: "none", roughness: 0, metallic: 0, view: "relit" };
    this.state = { ...this.start };
    this.canvas = root.querySelector(".relight-canvas");
    this.form = root.querySelector(".relight-controls");
    this.ball = new Ball(root.querySelector(".relight-ball"));
    const { exposure } = this.form.elements;
    exposure.min = Math.min(0, data.exposure) - STOPS;
    exposure.max = Math.max(0, data.exposure) + STOPS;
    this.listMenu();
    this.listenToControls();
    this.listenToCanvas();
    this.listenToFiles();
    window.addEventListener("hashchange", () => this.readAddress());
    this.readAddress();
    this.change({}, false);
  }

  light() {
    const light = this.find(this.state.light);
    if (light !== this.opened) return light.coefficients; // what was found is shown as it is
    const kind = this.state.window;
    light.windowed[kind] ??= WINDOWS[kind](light.coefficients);
    return light.windowed[kind];
  }

  find(name) {
    const lights = this.opened ? [...this.lights, this.opened] : this.lights;
    return lights.find((light) => light.name === name);
  }

  /** New values of the state; drawn soon, and written into the address if a person made them. */
  change(values, byHand = true) {
    Object.assign(this.state, values);
    const { rotate } = this.state;
    // Both ends of the slider stay where they are, though they are the same light.
    if (Math.abs(rotate) > 180) this.state.rotate = rotate - 360 * Math.round(rotate / 360);
    for (const [name, [low, high]] of Object.entries(RANGES)) {
      this.state[name] = Math.min(high, Math.max(low, this.state[name]));
    }
    if (!this.pending) this.pending = requestAnimationFrame(() => this.draw());
    if (byHand) {
      clearTimeout(this.writing);
      this.writing = setTimeout(() => this.writeAddress(), ADDRESS_DELAY);
    }
  }

  draw() {
    cancelAnimationFrame(this.pending);
    this.pending = 0;
    const { state } = this;
    const light = turned(this.light(), state.rotate, state.tilt);
    this.picture.draw(light, state);
    this.ball.draw(light, 2 ** state.exposure, state.tone);
    const { elements } = this.form;
    elements.light.value = state.light;
    elements.window.value = state.window;
    elements.window.parentElement.hidden = this.find(state.light) !== this.opened;
    elements.tone.value = state.tone;
    elements.view.value = state.view;
    for (const name of Object.keys(RANGES)) {
      const slider = elements[name];
      const text = TEXTS[name](state[name]);
      slider.value = state[name];
      slider.setAttribute("aria-valuetext", text);
      slider.parentElement.querySelector("output").value = text;
    }
  }

  say(text, trouble = false) {
    const message = this.root.querySelector(".relight-message");
    message.textContent = text;
    message.classList.toggle("relight-trouble", trouble);
  }

  // Controls

  listMenu() {
    const menu = this.form.elements.light;
    const group = (label, lights) => {
      const element = document.createElement("optgroup");
      element.label = label;
      element.append(...lights.map(({ name }) => new Option(name, name)));
      return element;
    };
    menu.replaceChildren(group("Recovered lights", this.lights));
    if (this.opened) menu.append(group("Panorama", [this.opened]));
  }

  listenToControls() {
    const { form } = this;
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("input", ({ target }) => {
      if (target.name in RANGES) this.change({ [target.name]: Number(target.value) });
      else if (["light", "window", "tone", "view"].includes(target.name)) {
        this.change({ [target.name]: target.value });
        if (target.name === "light") this.say("");
      }
    });
    form.elements.reset.addEventListener("click", () => {
      this.say("");
      this.change(this.start);
    });
    form.elements.save.addEventListener("click", () => this.save());
  }

  /** The picture as it is shown now, a PNG of the maps' size. */
  png() {
    this.draw(); // a canvas keeps its picture until the end of this task only
    return new Promise((done) => this.canvas.toBlob(done, "image/png"));
  }

  async save() {
    const { view, light, rotate } = this.state;
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await this.png());
    link.download = `${view === "relit" ? `relit-${light}-${rotate.toFixed(0)}` : view}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  // Drag and keys

  listenToCanvas() {
    const { canvas } = this;
    let last = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (!event.isPrimary || event.button !== 0) return;
      last = event;
      canvas.setPointerCapture(event.pointerId);
      canvas.classList.add("relight-turning");
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!last || event.pointerId !== last.pointerId) return;
      const degrees = DEGREES_ACROSS / canvas.clientWidth;
      this.change({
        rotate: this.state.rotate + (event.clientX - last.clientX) * degrees,
        tilt: this.state.tilt - (event.clientY - last.clientY) * degrees,
      });
      last = event;
    });
    const end = (event) => {
      if (!last || event.pointerId !== last.pointerId) return;
      last = null;
      canvas.classList.remove("relight-turning");
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey) return;
      if (event.key === "Home") this.change({ rotate: 0, tilt: 0 });
      else if (event.key in KEYS) {
        const [name, sense] = KEYS[event.key];
        this.change({ [name]: this.state[name] + sense * (event.shiftKey ? 1 : KEY_DEGREES) });
      } else return;
      event.preventDefault();
    });
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault(); // or it never comes back
      this.say("The graphics chip was taken away; waiting for it.", true);
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.picture.prepare();
      this.say("");
      this.change({}, false);
    });
  }

  // Panoramas

  listenToFiles() {
    const stage = this.root.querySelector(".relight-stage");
    const input = this.form.elements.file;
    input.addEventListener("change", () => {
      if (input.files.length) this.open(input.files[0]);
      input.value = ""; // so that the same file can be chosen again
    });
    const drops = (on) => (event) => {
      if (!event.dataTransfer.types.includes("Files")) return;
      event.preventDefault();
      stage.classList.toggle("relight-dropping", on);
    };
    stage.addEventListener("dragover", drops(true));
    stage.addEventListener("dragleave", drops(false));
    stage.addEventListener("drop", (event) => {
      drops(false)(event);
      if (event.dataTransfer.files.length) this.open(event.dataTransfer.files[0]);
    });
  }

  async open(file) {
    try {
      const { light, lost, width, height } = readPanorama(new Uint8Array(await file.arrayBuffer()));
      const taken = this.lights.some(({ name }) => name === file.name);
      const name = taken ? `${file.name} (panorama)` : file.name;
      this.opened = { name, coefficients: light, windowed: {} };
      this.listMenu();
      this.change({ light: name });
      this.say(`${file.name}: ${width} × ${height}. ${(100 * lost).toFixed(0)} % of its energy is `
        + "in detail finer than this light has (l > 3).");
    } catch (error) {
      this.say(`${file.name}: ${error.message}`, true);
    }
  }

  // Address: #light=NAME&rotate=30&exposure=0.5, only what differs from the start

  readAddress() {
    const { hash } = window.location;
    if (!hash.includes("=")) return; // for another part of the page
    const given = new URLSearchParams(hash.slice(1));
    const values = {};
    const wrong = [];
    for (const [name, text] of given) {
      const number = Number(text);
      if (name === "light") {
        if (this.find(text)) values.light = text;
        else wrong.push(`light ${text} is not in this page; a panorama has to be opened again`);
      } else if (name in RANGES) {
        if (text.trim() !== "" && Number.isFinite(number)) values[name] = number;
        else wrong.push(`${name}: expected a number, found ${text}`);
      } else if (name in CHOICES) {
        if (CHOICES[name].includes(text)) values[name] = text;
        else wrong.push(`${name}: expected one of ${CHOICES[name].join(", ")}, found ${text}`);
      }
    }
    if (wrong.length) this.say(`Address of the page: ${wrong.join("; ")}.`, true);
    if (Object.keys(values).length === 0) return;
    this.change({ ...this.start, ...values }, false);
    this.root.scrollIntoView(); // its top, below the margin that the style gives
  }

  writeAddress() {
    const values = new URLSearchParams();
    for (const [name, value] of Object.entries(this.state)) {
      if (value === this.start[name]) continue;
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
}

async function start(root) {
  const canvas = root.querySelector(".relight-canvas");
  try {
    if (typeof DecompressionStream === "undefined") {
      throw new Error("this browser is from before 2023 and cannot unpack the maps");
    }
    const data = JSON.parse(root.querySelector(".relight-data").textContent);
    const maps = root.querySelector(".relight-maps");
    const planes = await unpacked(maps.textContent, data.units, data.width, data.height);
    maps.remove(); // megabytes of text
    if (data.lobes) data.lobes = await unpackedLobes(data.lobes);
    const picture = new Picture(canvas, data, planes, SHADERS);
    root.view = new View(root, data, picture);
    canvas.hidden = false;
    root.querySelector(".relight-static").hidden = true;
    root.querySelector("fieldset").disabled = false;
    root.dataset.state = "ready";
  } catch (error) {
    const message = root.querySelector(".relight-message");
    message.textContent = `No interactive view: ${error.message}. This is one picture of it.`;
    message.classList.add("relight-trouble");
    root.dataset.state = "static";
  }
}

document.querySelectorAll(".relight-view").forEach(start);
