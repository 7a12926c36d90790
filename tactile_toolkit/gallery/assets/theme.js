"use strict";
// Light or dark: as the system says until the reader chooses. Loaded before anything is drawn.

const theme = (() => {
  const choices = ["auto", "light", "dark"];
  const system = matchMedia("(prefers-color-scheme: dark)");
  const listeners = [];

  function stored() {
    try {
      return localStorage.getItem("gallery-theme");
    } catch {
      return null; // some browsers keep nothing for pages of a file system
    }
  }

  let choice = choices.includes(stored()) ? stored() : "auto";

  function apply() {
    const dark = choice === "dark" || (choice === "auto" && system.matches);
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    listeners.forEach((call) => call(choice));
  }

  system.addEventListener("change", apply);
  apply();

  return {
    listen(call) {
      listeners.push(call);
      call(choice);
    },
    next() {
      choice = choices[(choices.indexOf(choice) + 1) % choices.length];
      try {
        localStorage.setItem("gallery-theme", choice);
      } catch {
        // the choice holds until the page is left
      }
      apply();
    },
  };
})();
