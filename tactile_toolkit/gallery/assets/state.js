"use strict";
// What the page knows: the index of items, what is chosen, and the contents that were loaded.

const gallery = {
  files: document.documentElement.dataset.files, // the folder of all files but the page
  index: null,
  chosen: [], // one set of value numbers per facet
  search: "",
  sort: -1, // number of a measure, or -1 for the order of the data
  descending: false,
  begin: [], // called when the index is there
  changed: [], // called when the choice changes

  start(index) {
    this.index = index;
    this.chosen = index.facets.map(() => new Set());
    this.begin.forEach((call) => call());
    this.update();
  },

  update() {
    this.changed.forEach((call) => call());
  },

  passes(item, except) {
    if (this.search && !this.index.ids[item].toLowerCase().includes(this.search)) return false;
    return this.index.facets.every((facet, place) => {
      const wanted = this.chosen[place];
      return place === except || !wanted.size || facet.rows[item].some((value) => wanted.has(value));
    });
  },

  // Numbers of the items that match, in the order to show them in.
  matches() {
    const found = this.index.ids.map((_, item) => item).filter((item) => this.passes(item));
    if (this.sort >= 0) {
      const values = this.index.measures[this.sort].values;
      const sign = this.descending ? -1 : 1;
      const last = (item) => (values[item] === null ? 1 : 0); // unknown ones come last either way
      found.sort((a, b) => last(a) - last(b) || sign * (values[a] - values[b]) || a - b);
    }
    if (this.search) {
      const exact = (item) => (this.index.ids[item].toLowerCase() === this.search ? 0 : 1);
      found.sort((a, b) => exact(a) - exact(b));
    }
    return found;
  },

  // How many items each value of a facet would show, with all other facets as they are.
  counts(place) {
    const facet = this.index.facets[place];
    const counts = new Array(facet.values.length).fill(0);
    facet.rows.forEach((values, item) => {
      if (this.passes(item, place)) values.forEach((value) => (counts[value] += 1));
    });
    return counts;
  },

  file(folder, item, ending) {
    return `${this.files}/${folder}/${String(item).padStart(6, "0")}${ending}`;
  },

  noun(count) {
    return this.index.nouns[count === 1 ? 0 : 1];
  },
};

// Pages on a file system may load scripts, not data: every content is a script that calls `receive`.
const contents = new Map();

gallery.receive = (item, content) => contents.get(item)?.resolve(content);

gallery.load = (item) => {
  if (contents.has(item)) return contents.get(item).promise;
  const entry = {};
  entry.promise = new Promise((resolve, reject) => Object.assign(entry, { resolve, reject }));
  contents.set(item, entry);
  const file = gallery.file("items", item, ".js");
  gallery
    .script(file)
    .then(() => entry.reject(new Error(`${file} is damaged; build the gallery again`))) // no effect once received
    .catch((error) => {
      contents.delete(item);
      entry.reject(error);
    });
  while (contents.size > 12) contents.delete(contents.keys().next().value); // a bound on memory
  return entry.promise;
};

gallery.script = (source) =>
  new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = source;
    script.addEventListener("load", () => resolve(script.remove()));
    script.addEventListener("error", () => {
      script.remove();
      reject(new Error(`${source} is missing next to this page; build the gallery again`));
    });
    document.head.append(script);
  });

// The only way elements are made here: texts are never read as HTML.
gallery.element = (name, attributes = {}, ...children) => {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === true) made.setAttribute(key, "");
    else if (value !== false && value !== null) made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
};
