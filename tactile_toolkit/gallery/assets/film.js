"use strict";
// A round of touches: all of them as a grid, one of them large, its clip frame by frame.

(() => {
  const ON_OBJECT = "on the object";
  const ON_PLATE = "on the plate";
  const { element } = gallery;

  // Show one tile of a sheet of tiles in an element of any size.
  function sprite(node, source, columns, rows, tile) {
    const share = (at, count) => (count > 1 ? (100 * at) / (count - 1) : 0);
    node.style.backgroundImage = `url("${source}")`;
    node.style.backgroundSize = `${100 * columns}% ${100 * rows}%`;
    node.style.backgroundPosition = `${share(tile % columns, columns)}% ${share(Math.floor(tile / columns), rows)}%`;
  }

  // What the gel met in the end; each frame of its clip tells whether it touched anything.
  const met = (touch) => (touch.contact === null ? "" : touch.contact ? ` ${ON_OBJECT}` : ` ${ON_PLATE}`);
  const describe = (touch) =>
    `touch ${touch.number}${met(touch)}` +
    (touch.height_mm === null ? "" : `, height ${touch.height_mm.toFixed(1)} mm`);

  function player(touches, item) {
    const screen = element("div", { class: "film", role: "img" });
    screen.style.aspectRatio = `${touches.tile[0]} / ${touches.tile[1]}`;
    const play = element("button", { type: "button" }, "Play");
    const slider = element("input", { type: "range", min: "0", value: "0", "aria-label": "Frame of the clip" });
    const window_ = element("div", { class: "window", title: "frames with contact" });
    const track = element("div", { class: "track" }, slider, window_);
    const caption = element("p", { class: "caption" });
    const controls = element("div", { class: "controls" }, play, track);
    let touch = null;
    let timer = 0;

    function still() {
      const rows = Math.ceil(touches.list.length / touches.columns);
      sprite(screen, gallery.file("media", item, "-stills.jpg"), touches.columns, rows, touches.list.indexOf(touch));
    }

    function frame(at) {
      const film = touch.film;
      sprite(screen, gallery.file("media", item, `-${film.name}`), film.columns, Math.ceil(film.frames / film.columns), at);
      slider.value = at;
      const contact = at >= film.first && at <= film.last ? ", contact" : "";
      const text = `frame ${film.numbers[at]}, ${film.times_s[at].toFixed(2)} s${contact}`;
      slider.setAttribute("aria-valuetext", text);
      caption.textContent = `${describe(touch)} · ${text}`;
      screen.setAttribute("aria-label", caption.textContent);
    }

    function stop() {
      clearInterval(timer);
      timer = 0;
      play.textContent = "Play";
    }

    play.addEventListener("click", () => {
      if (timer) return stop();
      const { frames, times_s } = touch.film;
      const pace_ms = Math.max(40, (1000 * (times_s[frames - 1] - times_s[0])) / Math.max(1, frames - 1));
      play.textContent = "Pause";
      timer = setInterval(() => frame((Number(slider.value) + 1) % frames), pace_ms);
    });
    slider.addEventListener("input", () => {
      stop();
      frame(Number(slider.value));
    });

    return {
      nodes: [screen, controls, caption],
      stop,
      show(chosen) {
        stop();
        touch = chosen;
        controls.hidden = !touch.film;
        if (touch.film) {
          const { frames, first, last } = touch.film;
          slider.max = frames - 1;
          window_.style.left = `${(100 * first) / frames}%`;
          window_.style.width = `${(100 * (last + 1 - first)) / frames}%`;
          frame(last);
        } else {
          still();
          caption.textContent = describe(touch);
          screen.setAttribute("aria-label", caption.textContent);
        }
      },
    };
  }

  function touchButton(touches, item, touch) {
    const picture = element("span", { class: "still" });
    picture.style.aspectRatio = `${touches.tile[0]} / ${touches.tile[1]}`;
    const rows = Math.ceil(touches.list.length / touches.columns);
    sprite(picture, gallery.file("media", item, "-stills.jpg"), touches.columns, rows, touches.list.indexOf(touch));
    const button = element("button", { type: "button", class: "touch", "aria-label": describe(touch), tabindex: "-1" }, picture);
    button.append(element("span", { class: "number" }, String(touch.number)));
    button.classList.toggle("contact", touch.contact === true);
    return button;
  }

  gallery.showTouches = (place, touches, item) => {
    const film = player(touches, item);
    const sheet = element("div", { class: "touches", role: "group", "aria-label": "Touches of the round" });
    const choices = element("div", { class: "chips", role: "group", "aria-label": "Touches shown" });
    const buttons = touches.list.map((touch) => touchButton(touches, item, touch));
    let kept = touches.list.map((_, number) => number);

    function choose(number, focus) {
      buttons.forEach((button, each) => {
        button.tabIndex = each === number ? 0 : -1;
        button.setAttribute("aria-pressed", each === number);
      });
      film.show(touches.list[number]);
      if (focus) buttons[number].focus();
    }

    function keep(wanted, chip) {
      kept = touches.list.map((_, number) => number).filter((number) => wanted === null || touches.list[number].contact === wanted);
      buttons.forEach((button, number) => (button.hidden = !kept.includes(number)));
      [...choices.children].forEach((each) => each.setAttribute("aria-pressed", each === chip));
      if (kept.length) choose(kept[0], false);
    }

    for (const [title, wanted] of [["all", null], [ON_OBJECT, true], [ON_PLATE, false]]) {
      const count = touches.list.filter((touch) => wanted === null || touch.contact === wanted).length;
      const chip = element("button", { type: "button", class: "chip" }, `${title} `, element("span", { class: "number" }, String(count)));
      chip.disabled = count === 0;
      chip.addEventListener("click", () => keep(wanted, chip));
      choices.append(chip);
    }
    buttons.forEach((button, number) => button.addEventListener("click", () => choose(number, true)));
    sheet.addEventListener("keydown", (event) => {
      const across = Math.max(1, Math.round(sheet.clientWidth / (buttons[kept[0]]?.offsetWidth || 1)));
      const by = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: across, ArrowUp: -across }[event.key];
      const at = kept.indexOf(buttons.indexOf(document.activeElement));
      if (by === undefined || at < 0) return;
      event.preventDefault();
      choose(kept[Math.min(kept.length - 1, Math.max(0, at + by))], true);
    });
    sheet.append(...buttons);
    place.append(element("div", { class: "player" }, ...film.nodes), choices, sheet);
    keep(null, choices.firstChild);
    return film.stop;
  };
})();
