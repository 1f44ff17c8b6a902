// The theme's button. What it chose is remembered where the browser allows that.
(() => {
  const root = document.documentElement;
  const kept = (change) => {
    try {
      return change(window.localStorage);
    } catch {
      return null; // pages from files, or inside of others, may have no storage
    }
  };
  const name = "pbrfit-theme";
  const chosen = kept((storage) => storage.getItem(name));
  if (chosen === "dark" || chosen === "light") root.dataset.theme = chosen;
  document.addEventListener("DOMContentLoaded", () => {
    for (const button of document.querySelectorAll("button.theme")) {
      button.hidden = false;
      button.addEventListener("click", () => {
        const light = getComputedStyle(root).colorScheme === "light";
        root.dataset.theme = light ? "dark" : "light";
        kept((storage) => storage.setItem(name, root.dataset.theme));
      });
    }
  });
})();
