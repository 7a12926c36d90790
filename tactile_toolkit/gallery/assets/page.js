"use strict";
// The page as a whole: the button for light and dark, links to items, and what is said without an index.

(() => {
  const button = document.getElementById("theme");
  button.addEventListener("click", theme.next);
  theme.listen((choice) => {
    button.textContent = `Theme: ${choice}`;
    gallery.repaint();
  });

  document.addEventListener("DOMContentLoaded", () => {
    if (!gallery.index) {
      document.getElementById("count").textContent =
        "items.js is missing or damaged beside this page; build the gallery again.";
      return;
    }
    const linked = /^#item-(\d+)$/.exec(location.hash);
    if (linked && Number(linked[1]) < gallery.index.ids.length) gallery.open(Number(linked[1]));
  });
})();
