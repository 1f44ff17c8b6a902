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
