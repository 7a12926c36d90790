"use strict";
// The column of filters: a row of chips for a few values, a list for many.

(() => {
  const MOST_CHIPS = 14;
  const { element } = gallery;
  const find = (id) => document.getElementById(id);
  const refreshers = [];

  function chips(facet, place) {
    const wanted = gallery.chosen[place];
    const buttons = facet.values.map((value, number) => {
      const count = element("span", { class: "number" });
      const button = element("button", { type: "button", class: "chip", "aria-pressed": "false" }, value, " ", count);
      button.addEventListener("click", () => {
        if (!wanted.delete(number)) wanted.add(number);
        gallery.update();
      });
      return { button, count };
    });
    refreshers.push((counts) =>
      buttons.forEach(({ button, count }, number) => {
        count.textContent = counts[place][number].toLocaleString("en");
        button.setAttribute("aria-pressed", wanted.has(number));
        button.classList.toggle("void", counts[place][number] === 0);
      }),
    );
    const legend = element("legend", {}, facet.title);
    return element("fieldset", {}, legend, element("div", { class: "chips" }, ...buttons.map((b) => b.button)));
  }

  function list(facet, place) {
    const wanted = gallery.chosen[place];
    const options = facet.values.map((value, number) => element("option", { value: String(number) }, value));
    const every = element("option", { value: "" }, `any (${facet.values.length})`);
    const select = element("select", {}, every, ...options);
    select.addEventListener("change", () => {
      wanted.clear();
      if (select.value !== "") wanted.add(Number(select.value));
      gallery.update();
    });
    refreshers.push((counts) => {
      options.forEach((option, number) => {
        option.textContent = `${facet.values[number]} (${counts[place][number].toLocaleString("en")})`;
      });
      select.value = wanted.size ? String([...wanted][0]) : "";
    });
    return element("label", { class: "field" }, element("span", {}, facet.title), select);
  }

  function sorting() {
    const sort = find("sort");
    sort.append(element("option", { value: "" }, "order of the data"));
    gallery.index.measures.forEach((measure, number) => {
      if (measure.values.every((value) => value === null)) return;
      sort.append(element("option", { value: `${number} up` }, `${measure.title}, smallest first`));
      sort.append(element("option", { value: `${number} down` }, `${measure.title}, largest first`));
    });
    sort.addEventListener("change", () => {
      const [number, way] = sort.value.split(" ");
      gallery.sort = sort.value === "" ? -1 : Number(number);
      gallery.descending = way === "down";
      gallery.update();
    });
  }

  function clear() {
    gallery.chosen.forEach((wanted) => wanted.clear());
    gallery.search = find("search").value = "";
    gallery.sort = -1;
    find("sort").value = "";
    gallery.update();
  }

  gallery.begin.push(() => {
    gallery.index.facets.forEach((facet, place) => {
      if (!facet.values.length) return;
      const make = facet.values.length > MOST_CHIPS ? list : chips;
      find("facets").append(make(facet, place));
    });
    sorting();
    find("search").addEventListener("input", () => {
      gallery.search = find("search").value.trim().toLowerCase();
      gallery.update();
    });
    find("clear").addEventListener("click", clear);
    find("filters").addEventListener("submit", (event) => event.preventDefault());
    document.addEventListener("keydown", (event) => {
      const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(document.activeElement.tagName);
      if (event.key !== "/" || typing || document.querySelector("dialog[open]")) return;
      event.preventDefault();
      find("filter-box").open = true;
      find("search").focus();
    });
    if (matchMedia("(max-width: 760px)").matches) find("filter-box").open = false;
  });

  gallery.changed.push(() => {
    const counts = gallery.index.facets.map((_, place) => gallery.counts(place));
    refreshers.forEach((refresh) => refresh(counts));
    // Not disabled: who presses it keeps the focus there.
    const untouched = !gallery.search && gallery.sort < 0 && gallery.chosen.every((wanted) => !wanted.size);
    find("clear").setAttribute("aria-disabled", untouched);
  });
})();
