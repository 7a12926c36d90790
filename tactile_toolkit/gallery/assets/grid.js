"use strict";
// The grid of thumbnails. Only tiles near the viewport exist, so that any number of items scrolls smoothly;
// focus stays on the grid itself and the active tile is named to assistive technology.

(() => {
  const CAPTION_PX = 46;
  const GAP_PX = 10;
  const { element } = gallery;
  const grid = document.getElementById("grid");
  const tiles = new Map(); // place in `shown` -> tile
  let shown = [];
  let active = 0;
  let columns = 1;
  let tile_px = 100;
  let started = false;

  const step = () => tile_px + CAPTION_PX + GAP_PX;

  function measure() {
    const width = grid.clientWidth;
    const least = width < 480 ? 88 : 132;
    columns = Math.max(2, Math.floor((width + GAP_PX) / (least + GAP_PX)));
    tile_px = (width - GAP_PX * (columns - 1)) / columns;
    grid.style.height = `${Math.ceil(shown.length / columns) * step()}px`;
  }

  function tile(place) {
    const item = shown[place];
    const { ids, titles } = gallery.index;
    const picture = element("img", { alt: "", loading: "lazy", decoding: "async", draggable: "false" });
    picture.src = gallery.file("thumbs", item, ".png");
    const made = element(
      "div",
      { id: `tile-${item}`, class: "tile", role: "option", "data-item": item, "aria-label": `${titles[item]}, id ${ids[item]}`, title: ids[item] },
      picture,
      element("span", { class: "name" }, titles[item]),
      element("span", { class: "id" }, ids[item]),
    );
    made.addEventListener("click", () => open(place));
    return made;
  }

  function put(place, node) {
    node.style.width = `${tile_px}px`;
    node.style.height = `${tile_px + CAPTION_PX}px`;
    node.style.transform = `translate(${(place % columns) * (tile_px + GAP_PX)}px, ${Math.floor(place / columns) * step()}px)`;
    node.setAttribute("aria-setsize", shown.length);
    node.setAttribute("aria-posinset", place + 1);
    node.setAttribute("aria-selected", place === active);
    node.classList.toggle("active", place === active);
  }

  // Make the tiles of the viewport and of half a viewport around it; drop all others.
  function draw() {
    const top = -grid.getBoundingClientRect().top;
    const first = Math.max(0, Math.floor((top - innerHeight / 2) / step())) * columns;
    const last = Math.min(shown.length, Math.ceil((top + innerHeight * 1.5) / step()) * columns);
    const wanted = new Set();
    for (let place = first; place < last; place += 1) wanted.add(place);
    if (active < shown.length) wanted.add(active); // it is named as the active one, so it must exist
    for (const [place, node] of tiles) {
      if (!wanted.has(place)) {
        node.remove();
        tiles.delete(place);
      }
    }
    for (const place of [...wanted].sort((a, b) => a - b)) {
      if (!tiles.has(place)) {
        tiles.set(place, tile(place));
        grid.append(tiles.get(place));
      }
      put(place, tiles.get(place));
    }
    if (shown.length) grid.setAttribute("aria-activedescendant", `tile-${shown[active]}`);
    else grid.removeAttribute("aria-activedescendant");
  }

  let waiting = false;
  function drawSoon() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      draw();
    });
  }

  function relayout() {
    measure();
    draw();
  }

  function reveal() {
    const rowTop = grid.getBoundingClientRect().top + Math.floor(active / columns) * step();
    const covered = document.querySelector(".top").offsetHeight + GAP_PX;
    if (rowTop < covered) scrollBy(0, rowTop - covered);
    else if (rowTop + step() > innerHeight) scrollBy(0, rowTop + step() - innerHeight + GAP_PX);
  }

  // The best match stands first: bring it into view when the choice changes.
  function toTop() {
    const covered = document.querySelector(".top").offsetHeight + GAP_PX;
    const top = grid.getBoundingClientRect().top;
    if (top < covered) scrollBy(0, top - covered);
  }

  function open(place) {
    active = place;
    draw();
    grid.focus({ preventScroll: true });
    gallery.open(shown[place]);
  }

  const moves = {
    ArrowRight: () => 1,
    ArrowLeft: () => -1,
    ArrowDown: () => columns,
    ArrowUp: () => -columns,
    PageDown: () => columns * Math.max(1, Math.floor(innerHeight / step()) - 1),
    PageUp: () => -columns * Math.max(1, Math.floor(innerHeight / step()) - 1),
    Home: () => -shown.length,
    End: () => shown.length,
  };

  grid.addEventListener("keydown", (event) => {
    if (!shown.length || event.altKey || event.ctrlKey || event.metaKey) return;
    if (event.key === "Enter" || event.key === " ") {
      event.preventDefault();
      open(active);
    } else if (event.key in moves) {
      event.preventDefault();
      active = Math.min(shown.length - 1, Math.max(0, active + moves[event.key]()));
      reveal();
      draw();
    }
  });

  // Items before and after one, for the dialog; moves the active tile along.
  gallery.neighbour = (item, by) => {
    const place = shown.indexOf(item) + by;
    return place >= 0 && place < shown.length ? shown[place] : null;
  };

  gallery.activate = (item) => {
    const place = shown.indexOf(item);
    if (place < 0) return;
    active = place;
    reveal();
    draw();
  };

  gallery.changed.push(() => {
    const kept = shown[active];
    shown = gallery.matches();
    active = Math.max(0, shown.indexOf(kept));
    tiles.forEach((node) => node.remove());
    tiles.clear();
    document.getElementById("empty").hidden = shown.length > 0;
    const all = gallery.index.ids.length;
    const part = shown.length === all ? "" : `${shown.length.toLocaleString("en")} of `;
    document.getElementById("count").textContent = `${part}${all.toLocaleString("en")} ${gallery.noun(all)}`;
    measure();
    if (started) toTop();
    started = true;
    draw();
  });

  gallery.begin.push(() => {
    grid.setAttribute("aria-label", gallery.index.nouns[1]);
    addEventListener("scroll", drawSoon, { passive: true });
    new ResizeObserver(relayout).observe(grid.parentElement);
    addEventListener("resize", drawSoon);
  });
})();
