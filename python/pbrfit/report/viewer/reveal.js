// A picture over the relit one, up to a border that can be moved: before and after.

const REVEAL_STEP = 0.02;

class Reveal {
  constructor(root, stage) {
    this.stage = stage;
    this.picture = root.querySelector(".relight-before");
    this.handle = root.querySelector(".relight-reveal");
    this.names = root.querySelector(".relight-names");
    this.share = 0.5;
    this.differs = false;
    const { handle } = this;
    let held = null;
    handle.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      held = event.pointerId;
      handle.setPointerCapture(held);
      event.preventDefault();
      handle.focus();
    });
    handle.addEventListener("pointermove", (event) => {
      if (event.pointerId !== held) return;
      const [left, , right] = stage.seen();
      this.move((stage.placeOf(event)[0] - left) / (right - left));
    });
    for (const kind of ["pointerup", "pointercancel"]) {
      handle.addEventListener(kind, () => { held = null; });
    }
    handle.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageUp: 5,
        PageDown: -5 };
      if (event.key in steps) this.move(this.share + steps[event.key] * REVEAL_STEP);
      else if (event.key === "Home") this.move(0);
      else if (event.key === "End") this.move(1);
      else return;
      event.preventDefault();
      event.stopPropagation(); // these keys move the light elsewhere
    });
  }

  /** @param {?{name: string, address: string}} shown the picture; null = none */
  show(shown, after) {
    const { picture, handle, names } = this;
    for (const element of [picture, handle, names]) element.hidden = !shown;
    if (!shown) this.differs = false;
    picture.classList.toggle("relight-difference", this.differs);
    handle.hidden ||= this.differs;
    if (shown) {
      if (picture.getAttribute("src") !== shown.address) picture.src = shown.address;
      picture.alt = `Picture ${shown.name}`;
      const [before, now] = names.children;
      before.textContent = this.differs ? `4 × difference of ${shown.name} and ${after}` : shown.name;
      now.textContent = this.differs ? "" : after;
      this.lay();
    }
  }

  differ() {
    this.differs = !this.differs;
  }

  move(share) {
    this.share = Math.min(1, Math.max(0, share));
    this.lay();
  }

  lay() {
    if (this.picture.hidden) return;
    const { stage } = this;
    const share = this.differs ? 1 : this.share;
    const [left, top, right, bottom] = stage.seen();
    const x = left + share * (right - left);
    this.handle.style.cssText = `left:${x}px;top:${top}px;height:${bottom - top}px`;
    this.names.style.cssText = `left:${left}px;width:${right - left}px;top:${bottom}px;`
      + `--share:${100 * share}%`;
    const [before, now] = this.names.children;
    before.style.visibility = x - left > before.offsetWidth + 16 ? "" : "hidden";
    now.style.visibility = right - x > now.offsetWidth + 16 ? "" : "hidden";
    const part = (x - stage.at[0]) / stage.size[0];
    this.picture.style.clipPath = `inset(0 ${100 * (1 - part)}% 0 0)`;
    this.handle.setAttribute("aria-valuenow", Math.round(100 * share));
    this.handle.setAttribute("aria-valuetext", `${Math.round(100 * share)} % picture`);
  }
}
