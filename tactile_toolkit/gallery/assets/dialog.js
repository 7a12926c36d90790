"use strict";
// One item: what it looks like, and what is known of it.

(() => {
  const { element } = gallery;
  const find = (id) => document.getElementById(id);
  const dialog = find("item");
  const place = find("shown");
  let current = null;
  let leave = () => {};

  const text = (value, measure) =>
    value === null
      ? "unknown"
      : `${value.toLocaleString("en", { minimumFractionDigits: measure.decimals, maximumFractionDigits: measure.decimals })} ${measure.unit}`.trim();

  function facts(item, content) {
    const { facets, measures, ids } = gallery.index;
    const pairs = [["Id", ids[item]], ...(content?.notes ?? [])];
    facets.forEach((facet) => {
      const values = facet.rows[item].map((value) => facet.values[value]);
      if (values.length) pairs.push([facet.title, values.join(", ")]);
    });
    measures.forEach((measure) => pairs.push([measure.title, text(measure.values[item], measure)]));
    find("facts").replaceChildren(
      ...pairs.map(([title, value]) => element("div", {}, element("dt", {}, title), element("dd", {}, value))),
    );
  }

  async function show(item) {
    leave();
    leave = () => {};
    current = item;
    const title = gallery.index.titles[item];
    find("item-title").textContent = `${title} · ${gallery.index.ids[item]}`;
    find("previous").disabled = gallery.neighbour(item, -1) === null;
    find("next").disabled = gallery.neighbour(item, 1) === null;
    place.replaceChildren(element("p", { class: "notice", role: "status" }, "Loading…"));
    facts(item, null);
    try {
      const content = await gallery.load(item);
      if (current !== item || !dialog.open) return;
      facts(item, content);
      place.replaceChildren();
      const wanted = () => current === item && dialog.open;
      const done = content.mesh
        ? await gallery.showMesh(place, content.mesh, title, item, wanted)
        : gallery.showTouches(place, content.touches, item);
      if (wanted()) leave = done;
    } catch (error) {
      if (current === item) place.replaceChildren(element("p", { class: "notice", role: "alert" }, error.message));
    }
  }

  function go(by) {
    const item = gallery.neighbour(current, by);
    if (item === null) return;
    gallery.activate(item);
    mark(item);
    show(item);
  }

  function mark(item) {
    // Replaced, not added: going back in the browser leaves the page, not the item.
    try {
      history.replaceState(null, "", item === null ? "#" : `#item-${item}`);
    } catch {
      // without a link to the item, then
    }
  }

  gallery.open = (item) => {
    if (!dialog.open) dialog.showModal();
    gallery.activate(item);
    mark(item);
    show(item);
  };

  find("previous").addEventListener("click", () => go(-1));
  find("next").addEventListener("click", () => go(1));
  find("close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close(); // beside the box
  });
  dialog.addEventListener("close", () => {
    leave();
    leave = () => {};
    current = null;
    place.replaceChildren();
    mark(null);
    find("grid").focus({ preventScroll: true });
  });
  dialog.addEventListener("keydown", (event) => {
    const by = { PageUp: -1, PageDown: 1 }[event.key];
    if (by === undefined) return;
    event.preventDefault();
    go(by);
  });
})();
