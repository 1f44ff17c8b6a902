// Pictures in buttons of class "zoom" open in a dialog that fills the window.
(() => {
  const dialog = document.createElement("dialog");
  dialog.className = "enlarged";
  const picture = document.createElement("img");
  const caption = document.createElement("p");
  const close = document.createElement("button");
  close.type = "button";
  close.textContent = "Close";
  close.addEventListener("click", () => dialog.close());
  dialog.append(picture, caption, close);
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog || event.target === picture) dialog.close();
  });
  document.body.append(dialog);
  for (const button of document.querySelectorAll("button.zoom")) {
    button.addEventListener("click", () => {
      const small = button.querySelector("img");
      picture.src = small.src;
      picture.alt = small.alt;
      picture.className = small.className;
      caption.textContent = small.alt;
      dialog.showModal();
    });
  }
})();
// A link to a section unfolds it.
(() => {
  const unfold = () => {
    const section = document.getElementById(window.location.hash.slice(1));
    const folded = section?.matches("section") && section.querySelector("details");
    if (!folded) return;
    folded.open = true;
    section.scrollIntoView();
  };
  window.addEventListener("hashchange", unfold);
  unfold();
  // What a verdict says goes away with a click elsewhere, or with Escape.
  const verdicts = document.querySelectorAll("details.verdict");
  const close = (except) => verdicts.forEach((one) => {
    if (one !== except) one.open = false;
  });
  document.addEventListener("pointerdown", ({ target }) => close(target.closest("details.verdict")));
  document.addEventListener("keydown", ({ key }) => {
    if (key === "Escape") close(null);
  });
})();
