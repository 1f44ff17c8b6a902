// The view: controls, pointers, keys and the page's address change the state; the state is drawn
// once before the next frame of the screen, and never without a change.

const DEGREES_ACROSS = 180; // a drag over the whole width, under SH light
const KEY_DEGREES = 5;
const KEY_PAN = 60; // pixels
const ADDRESS_DELAY = 300; // ms; browsers limit how often an address may change
const SLOW_FRAME = 45; // ms; slower than this, moving lights are drawn with every other pixel
const METERED = 96; // pixels along the longer side of what an exposure is found with
const TEXTS = {
  azimuth: (value) => `${signed(value, 0)}°`,
  elevation: (value) => `${signed(value, 0)}°`,
  ambient: (value) => value.toFixed(2),
  softness: (value) => `${value.toFixed(0)}°`,
  rotate: (value) => `${signed(value, 0)}°`,
  tilt: (value) => `${signed(value, 0)}°`,
  exposure: (value) => `${signed(value, 1)} EV`,
  roughness: (value) => signed(value, 2),
  metallic: (value) => signed(value, 2),
};
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };

function signed(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  if (Number(text) === 0) return text;
  return (value < 0 ? "−" : "+") + text;
}

/** Degrees within −180 to 180; both ends stay, though they are the same. */
function wrapped(degrees) {
  return Math.abs(degrees) > 180 ? degrees - 360 * Math.round(degrees / 360) : degrees;
}

/** Scroll the bar that a label is in until all of it is seen; never the page. */
function bring(label) {
  const bar = label.parentElement;
  const [left, right] = [label.offsetLeft - 48, label.offsetLeft + label.offsetWidth + 48];
  if (left < bar.scrollLeft) bar.scrollLeft = left;
  else if (right > bar.scrollLeft + bar.clientWidth) bar.scrollLeft = right - bar.clientWidth;
}

class View {
  constructor(root, data, picture) {
    Object.assign(this, { root, data, picture });
    this.lights = data.lights.map(({ sh, ...light }) =>
      ({ ...light, sh: sh && Float64Array.from(sh) }));
    this.around = Float64Array.from(data.lamp.around);
    this.opened = null; // a panorama from a file
    const { azimuth, elevation, ambient } = data.lamp;
    this.form = root.querySelector("form");
    this.start = { light: "", azimuth, elevation, ambient, softness: 0, rotate: 0, tilt: 0,
      exposure: 0, tone: "neutral", roughness: 0, metallic: 0, view: "relit", of: "albedo",
      picture: "" };
    this.state = { ...this.start };
    this.hand = false;
    this.stride = 1;
    this.canvas = root.querySelector(".relight-canvas");
    this.marker = root.querySelector(".relight-lamp");
    const sheet = root.querySelector(".relight-sheet");
    for (const className of ["relight-deviation", "relight-before"]) {
      sheet.append(Object.assign(new Image(), { className, hidden: true }));
    }
    if (data.mask) sheet.querySelector(".relight-before").style.maskImage = data.mask;
    this.ball = new Ball(root.querySelector(".relight-ball"));
    this.stageElement = root.querySelector(".relight-stage");
    this.stage = new Stage(this.stageElement, sheet, data,
      () => this.lay());
    this.reveal = new Reveal(root, this.stage);
    this.originals = new Map([...root.querySelectorAll("img[data-original]")]
      .map((image) => [image.parentElement.querySelector("input").value, image.src]));
    this.root.querySelector("[data-compared]").hidden = this.originals.size === 0;
    this.form.elements.compare.hidden = this.originals.size === 0;
    const deviations = Object.keys(data.deviations).length > 0;
    root.querySelector("input[value=uncertainty]").closest("label").hidden = !deviations;
    if (!document.fullscreenEnabled) this.form.elements.fullscreen.hidden = true;
    this.listenToControls();
    this.listenToCanvas();
    this.listenToKeys();
    this.listenToFiles();
    window.addEventListener("hashchange", () => this.readAddress());
    this.readAddress();
    this.change({}, false);
  }

  // Lights

  find(name) {
    const lights = this.opened ? [...this.lights, this.opened] : this.lights;
    return lights.find((light) => light.name === name);
  }

  /** What the picture is drawn with: {sh, lamps, environment}. */
  drawn() {
    const { state } = this;
    if (state.light === "") {
      const direction = directionOf(state.azimuth, state.elevation);
      return { lamps: partsOfLamp(direction, state.softness),
        sh: state.ambient ? this.around.map((value) => state.ambient * value) : null };
    }
    const light = this.find(state.light);
    const { sh, environment } = light;
    const { rotate, tilt } = state;
    return { environment, sh: sh && turned(sh, rotate, tilt), lamps: (light.lamps ?? []).map((lamp) =>
      ({ ...lamp, direction: directionTurned(lamp.direction, rotate, tilt) })) };
  }

  /** Light from a direction as a mirror ball shows it. */
  seen({ sh, environment }) {
    if (!environment) return (direction) => radianceFrom(sh, basis(direction));
    const { rotate, tilt } = this.state;
    return (direction) =>
      radianceOfGrid(environment.levels[1], directionBefore(direction, rotate, tilt));
  }

  /** Stops in all: those that bring the light to white, and those that were added. */
  exposure() {
    const { light, exposure } = this.state;
    return (light === "" ? this.data.lamp.exposure : this.find(light).exposure) + exposure;
  }

  /** Stops that bring the 98th percentile under a panorama to white, to a tenth. */
  metered(environment) {
    const { picture, data, canvas } = this;
    const { gl } = picture;
    const stride = Math.max(1, Math.ceil(Math.max(data.width, data.height) / METERED));
    const state = { ...this.start, tone: "none" };
    let exposure = 0;
    for (let step = 0; step < 12; step++) {
      picture.draw({ environment, lamps: [] }, state, exposure, stride);
      const codes = new Uint8Array(4 * canvas.width * canvas.height);
      gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, codes);
      const inside = codes.filter((_, i) => i % 4 < 3 && codes[i - (i % 4) + 3] > 0).sort();
      if (inside.length === 0) return 0;
      const code = inside[Math.floor(0.98 * (inside.length - 1))] / 255;
      const linear = code <= 0.04045 ? code / 12.92 : ((code + 0.055) / 1.055) ** 2.4;
      if (linear > 0.95) exposure -= 3;
      else if (linear < 0.05) exposure += 3;
      else return Math.round(10 * (exposure - Math.log2(linear))) / 10;
    }
    return exposure;
  }

  // State

  /** New values of the state; drawn soon, and written into the address if a person made them. */
  change(values, byHand = true) {
    const { state } = this;
    Object.assign(state, values);
    state.rotate = wrapped(state.rotate);
    state.azimuth = wrapped(state.azimuth);
    for (const [name, [low, high]] of Object.entries(RANGES)) {
      state[name] = Math.min(high, Math.max(low, state[name]));
    }
    this.redraw();
    if (byHand) {
      clearTimeout(this.writing);
      this.writing = setTimeout(() => writeAddress(state, this.start), ADDRESS_DELAY);
    }
  }

  redraw() {
    if (!this.pending) this.pending = requestAnimationFrame((time) => this.draw(time));
  }

  draw(time = 0) {
    cancelAnimationFrame(this.pending);
    this.pending = 0;
    this.govern(time);
    const light = this.drawn();
    this.picture.draw(light, this.state, this.exposure(), this.stride);
    this.show(light);
  }

  /** Fewer pixels while a light is moved on a slow machine, all of them when it rests. */
  govern(time) {
    if (!this.moving) this.stride = 1;
    else if (this.lastFrame && time > this.lastFrame) {
      const slow = time - this.lastFrame > SLOW_FRAME && time - this.lastFrame < 1000;
      this.slowFrames = slow ? (this.slowFrames ?? 0) + 1 : 0;
      if (this.slowFrames >= 3 && this.stride < 4) {
        this.stride *= 2;
        this.slowFrames = 0;
      }
    }
    this.lastFrame = time;
  }

  /** Bring the controls to the state. */
  show(light) {
    const { state, root, data } = this;
    const { elements } = this.form;
    for (const name of ["light", "view"]) {
      for (const input of root.querySelectorAll(`input[name=${name}]`)) {
        const checked = input.value === state[name];
        // A bar that is too narrow for all brings what was chosen into sight.
        if (checked && !input.checked) bring(input.parentElement);
        input.checked = checked;
      }
    }
    for (const name of ["tone", "picture"]) elements[name].value = state[name];
    for (const name of Object.keys(RANGES)) {
      const slider = elements[name];
      const text = TEXTS[name](state[name]);
      slider.value = state[name];
      slider.setAttribute("aria-valuetext", text);
      slider.parentElement.querySelector("output").value = text;
    }
    const lamp = state.light === "";
    const shown = { lamp, sh: !lamp };
    for (const part of root.querySelectorAll("[data-of]")) part.hidden = !shown[part.dataset.of];
    const relit = state.view === "relit" || state.view === "strips";
    this.marker.hidden = !lamp || !relit;
    if (!lamp && (light.sh || light.environment) && !elements.adjust.parentElement.disabled) {
      this.ball.draw(this.seen(light), 2 ** this.exposure(), state.tone);
    }
    const address = this.originals.get(state.picture);
    this.reveal.show(address ? { name: state.picture, address } : null,
      state.view === "strips" ? "split" : state.view);
    elements.compare.setAttribute("aria-pressed", Boolean(address));
    this.showDeviation(state.view === "uncertainty" ? data.deviations[state.of] : null);
    this.showLegend();
    this.lay();
  }

  showDeviation(address) {
    const picture = this.root.querySelector(".relight-deviation");
    picture.hidden = !address;
    this.canvas.classList.toggle("relight-under", Boolean(address));
    if (!address) return;
    if (picture.getAttribute("src") !== address) picture.src = address;
    picture.alt = `Standard deviation of ${this.state.of}`;
  }

  showLegend() {
    const legend = this.root.querySelector(".relight-legend");
    const { view, of } = this.state;
    legend.hidden = view !== "uncertainty" && view !== "strips";
    const key = `${view} ${of}`;
    if (legend.hidden || legend.dataset.key === key) return;
    legend.dataset.key = key;
    if (view === "strips") {
      legend.replaceChildren(...SHOWN.slice(0, 5).map((name) => {
        const part = document.createElement("span");
        part.textContent = name;
        return part;
      }));
      return;
    }
    const focused = legend.contains(document.activeElement);
    const part = (tag, look, text) => Object.assign(document.createElement(tag),
      { className: look, textContent: text });
    const menu = document.createElement("select");
    menu.name = "of";
    menu.setAttribute("aria-label", "Uncertainty of");
    menu.append(...CHOICES.of.map((name) => new Option(name, name, false, name === of)));
    legend.replaceChildren(menu, part("span", "", "± 0.001"), part("i", "relight-scale", ""),
      part("span", "", "± 1"), part("i", "relight-poor", ""), part("span", "", "not determined"));
    if (focused) menu.focus();
  }

  /** What stands over the picture, after that moved or the state changed. */
  lay() {
    const { stage, marker } = this;
    if (!stage || !this.reveal) return;
    const [left, top, right, bottom] = stage.seen();
    const [u, v] = placeOf(directionOf(this.state.azimuth, this.state.elevation));
    marker.style.left = `${left + (0.5 + 0.5 * u) * (right - left)}px`;
    marker.style.top = `${top + (0.5 - 0.5 * v) * (bottom - top)}px`;
    marker.classList.toggle("relight-behind", Math.abs(wrapped(this.state.azimuth)) > 90);
    const legend = this.root.querySelector(".relight-legend");
    const [from, to] = legend.dataset.key?.startsWith("strips") ? stage.boxSeen() : [left, right];
    Object.assign(legend.style,
      { left: `${from}px`, width: `${to - from}px`, top: `${bottom}px` });
    this.root.querySelector(".relight-zoom").value = stage.resting ? "fit"
      : `${Math.round(100 * stage.scale * (window.devicePixelRatio || 1))} %`;
    this.reveal.lay();
  }

  say(text, trouble = false) {
    const message = this.root.querySelector(".relight-message");
    message.textContent = text;
    message.classList.toggle("relight-trouble", trouble);
    clearTimeout(this.saying);
    if (text && !trouble) this.saying = setTimeout(() => this.say(""), 12000);
  }

  // Controls

  listenToControls() {
    const { root } = this;
    this.form.addEventListener("submit", (event) => event.preventDefault());
    root.addEventListener("input", ({ target }) => {
      if (target.name in RANGES) this.change({ [target.name]: Number(target.value) });
      else if (target.name === "light") this.choose(target.value);
      else if (target.name === "picture") this.compareWith(target.value);
      else if (["tone", "view", "of"].includes(target.name)) {
        this.change({ [target.name]: target.value });
      }
    });
    const does = {
      compare: () => this.compare(),
      hand: () => this.setHand(!this.hand),
      zoomin: () => this.stage.zoomBy(KEY_ZOOM),
      zoomout: () => this.stage.zoomBy(1 / KEY_ZOOM),
      fullscreen: () => this.toggleFullscreen(),
      adjust: () => this.adjust(),
      help: () => root.querySelector(".relight-keys").showModal(),
      close: () => root.querySelector(".relight-keys").close(),
      reset: () => this.reset(),
      save: () => this.save(),
    };
    for (const [name, done] of Object.entries(does)) {
      this.form.elements[name].addEventListener("click", done);
    }
  }

  /** The light of a picture, which is also the one that is compared with; "" = the lamp. */
  choose(name) {
    this.say("");
    const compared = this.state.picture && this.originals.has(name) ? { picture: name } : {};
    this.change({ light: name, ...compared });
  }

  compare() {
    const { state, originals } = this;
    if (originals.size === 0) return;
    const name = originals.has(state.light) ? state.light : originals.keys().next().value;
    this.compareWith(state.picture ? "" : name);
  }

  /** Show a picture beside its reconstruction, under its own light; "" = none. */
  compareWith(picture) {
    this.change(picture ? { picture, light: picture, rotate: 0, tilt: 0 } : { picture });
  }

  /** The difference of both in place of a border, or the border again. */
  differ() {
    if (!this.state.picture) this.compare();
    this.reveal.differ();
    this.redraw();
  }

  setHand(hand) {
    this.hand = hand;
    this.form.elements.hand.setAttribute("aria-pressed", hand);
    this.canvas.classList.toggle("relight-pannable", hand);
  }

  adjust() {
    const { adjust } = this.form.elements;
    const panel = this.root.querySelector(".relight-panel");
    panel.hidden = !panel.hidden;
    adjust.setAttribute("aria-expanded", !panel.hidden);
    this.stageElement.classList.toggle("relight-adjusting", !panel.hidden);
    this.stage.lay();
  }

  toggleFullscreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else this.root.requestFullscreen().catch(() => this.say("Full screen is not allowed here."));
  }

  reset() {
    this.say("");
    this.stage.reset();
    this.change({ ...this.start });
  }

  /** The picture as it is shown now, a PNG of the maps' size. */
  png() {
    this.moving = false;
    this.draw(); // a canvas keeps its picture until the end of this task only
    return new Promise((done) => this.canvas.toBlob(done, "image/png"));
  }

  async save() {
    const { view, light, rotate, azimuth, elevation } = this.state;
    const lit = light === "" ? `lamp-${azimuth.toFixed(0)}-${elevation.toFixed(0)}`
      : `${light}-${rotate.toFixed(0)}`;
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await this.png());
    link.download = `${view === "relit" ? `relit-${lit}` : view}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  // Pointers and keys

  listenToCanvas() {
    const { canvas, stage } = this;
    listenToPointers(canvas, stage, () => this.hand || this.space, {
      begin: (place) => {
        this.moving = true;
        canvas.focus({ preventScroll: true });
        canvas.classList.add("relight-turning");
        if (this.state.light === "") this.lampTo(place);
      },
      move: (place, x, y) => {
        if (this.state.light === "") {
          this.lampTo(place);
          return;
        }
        const degrees = DEGREES_ACROSS / (stage.size[0] / stage.zoom);
        this.change({ rotate: this.state.rotate + x * degrees,
          tilt: this.state.tilt - y * degrees });
      },
      end: () => {
        this.moving = false;
        canvas.classList.remove("relight-turning");
        if (this.stride > 1) this.redraw();
      },
    });
    listenToWheel(canvas, stage);
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

  /** The lamp to where a place of the stage points. */
  lampTo([x, y]) {
    const [left, top, right, bottom] = this.stage.seen();
    const u = (2 * (x - left)) / (right - left) - 1;
    const v = 1 - (2 * (y - top)) / (bottom - top);
    this.change(anglesOf(directionAt(u, v)));
  }

  listenToKeys() {
    const { root, canvas } = this;
    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented) return;
      const { target } = event;
      if (document.querySelector("dialog[open]")) return;
      if (target !== document.body && !root.contains(target)) return;
      if (target.closest("select, input[type=range]")) return;
      const typed = this.onKey(event, target === canvas);
      if (typed) event.preventDefault();
    });
    document.addEventListener("keyup", (event) => {
      if (event.key === " ") this.space = false;
    });
  }

  /** Whether a key meant something. Arrows and Space belong to the picture alone. */
  onKey({ key, shiftKey }, onPicture) {
    const { state, root } = this;
    if (onPicture && key in ARROWS) {
      const [x, y] = ARROWS[key];
      if (this.hand) this.stage.pan(-KEY_PAN * x, KEY_PAN * y);
      else {
        const by = shiftKey ? 1 : KEY_DEGREES;
        if (state.light === "") {
          this.change({ azimuth: state.azimuth + by * x, elevation: state.elevation + by * y });
        } else this.change({ rotate: state.rotate + by * x, tilt: state.tilt + by * y });
      }
      return true;
    }
    if (onPicture && key === " ") return (this.space = true);
    if (onPicture && key === "Home") {
      const { azimuth, elevation } = this.start;
      this.change({ rotate: 0, tilt: 0, azimuth, elevation });
      return true;
    }
    const views = [...root.querySelectorAll("label:not([hidden]) > input[name=view]")];
    const choices = [...root.querySelectorAll("input[name=light]")].map(({ value }) => value);
    const step = (by) => {
      const next = choices.indexOf(state.light) + by;
      this.choose(choices[(next + choices.length) % choices.length]);
    };
    const does = {
      "+": () => this.stage.zoomBy(KEY_ZOOM),
      "=": () => this.stage.zoomBy(KEY_ZOOM),
      "-": () => this.stage.zoomBy(1 / KEY_ZOOM),
      0: () => this.stage.reset(),
      a: () => this.adjust(),
      c: () => this.compare(),
      d: () => this.differ(),
      f: () => this.toggleFullscreen(),
      h: () => this.setHand(!this.hand),
      l: () => this.choose(""),
      r: () => this.reset(),
      "[": () => step(-1),
      "]": () => step(1),
      "?": () => root.querySelector(".relight-keys").showModal(),
    };
    const done = does[key.toLowerCase()];
    if (done) done();
    else if (/^[1-7]$/.test(key)) {
      const view = CHOICES.view[Number(key) - 1];
      if (!views.some(({ value }) => value === view)) return false;
      this.change({ view });
    } else return false;
    return true;
  }

  // Panoramas

  listenToFiles() {
    const stage = this.stageElement;
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
      this.say(`Reading ${file.name} …`);
      const { rows, width, height } = await readPanorama(
        new Uint8Array(await file.arrayBuffer()));
      const environment = await blurred(rows);
      environment.unit = halfUnit(environment);
      const taken = this.lights.some(({ name }) => name === file.name);
      const name = taken ? `${file.name} (panorama)` : file.name;
      this.opened = { name, environment, exposure: this.metered(environment) };
      this.addTile(name);
      this.choose(name);
      this.say(`${file.name}: ${width} × ${height}.`);
    } catch (error) {
      this.say(`${file.name}: ${error.message}`, true);
      this.redraw();
    }
  }

  /** A tile for the panorama, with a mirror ball; it takes the place of the one before. */
  addTile(name) {
    const film = this.root.querySelector(".relight-film");
    film.querySelector(".relight-opened")?.remove();
    const tile = document.createElement("label");
    tile.className = "relight-tile relight-opened";
    tile.title = name;
    const input = document.createElement("input");
    Object.assign(input, { type: "radio", name: "light", value: name });
    const ball = document.createElement("canvas");
    ball.width = ball.height = 96;
    new Ball(ball).draw(this.seen(this.opened), 2 ** this.opened.exposure, "neutral");
    const text = document.createElement("span");
    text.textContent = name;
    tile.append(input, ball, text);
    film.querySelector(".relight-file").after(tile);
  }

  // Address

  readAddress() {
    const has = (name, text) => (name === "picture" ? this.originals.has(text)
      : text === "" || Boolean(this.find(text)));
    const read = readAddress(window.location.hash, has);
    if (!read) return;
    const { values, wrong } = read;
    if (wrong.length) this.say(`Address of the page: ${wrong.join("; ")}.`, true);
    if (Object.keys(values).length === 0) return;
    this.change({ ...this.start, ...values }, false);
    this.root.scrollIntoView();
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
    data.box = boxOf(planes.facing, data.width, data.height);
    data.mask = maskOf(planes.facing, data.width, data.height);
    if (data.lobes) data.lobes = await unpackedLobes(data.lobes);
    const picture = new Picture(canvas, data, planes, SHADERS);
    for (const part of root.querySelectorAll("fieldset")) part.disabled = false;
    canvas.hidden = false;
    root.view = new View(root, data, picture);
    root.view.draw();
    root.querySelector(".relight-static").hidden = true;
    root.dataset.state = "ready";
  } catch (error) {
    const message = root.querySelector(".relight-message");
    message.textContent = `No interactive view: ${error.message}. This is one picture of it.`;
    message.classList.add("relight-trouble");
    for (const part of root.querySelectorAll("fieldset")) part.disabled = true;
    root.dataset.state = "static";
  }
}

document.querySelectorAll(".relight-view").forEach(start);
