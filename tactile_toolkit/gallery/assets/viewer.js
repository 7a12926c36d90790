"use strict";
// A mesh in three dimensions: drawn by three.js, turned by pointer, touch and keys, drawn again only when
// something changes.

(() => {
  const { element } = gallery;
  const FIELD_OF_VIEW_DEG = 30;
  const GRID_MM = 10;
  const OBLIQUE = { turn: -Math.PI / 2 + 0.35, rise: 0.8 }; // from where a digit is read, a little to the right
  const ABOVE = { turn: -Math.PI / 2, rise: Math.PI / 2 - 0.001 };
  let view = null; // one for the page: browsers give few drawing contexts

  async function numbers(text, count) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const values = new Int32Array(count);
    let value = 0;
    for (let i = 0; i < count; i += 1) {
      const zigzag =
        (bytes[i] | (bytes[i + count] << 8) | (bytes[i + 2 * count] << 16) | (bytes[i + 3 * count] << 24)) >>> 0;
      value += (zigzag >>> 1) ^ -(zigzag & 1);
      values[i] = value;
    }
    return values;
  }

  async function geometry(mesh) {
    const count = mesh.vertex_count;
    const steps = await numbers(mesh.vertices, 3 * count);
    const corners = new Float32Array(3 * count);
    for (let axis = 0; axis < 3; axis += 1) {
      for (let i = 0; i < count; i += 1) {
        corners[3 * i + axis] = mesh.low_mm[axis] + steps[axis * count + i] * mesh.step_mm;
      }
    }
    const made = new THREE.BufferGeometry();
    made.setAttribute("position", new THREE.BufferAttribute(corners, 3));
    made.setIndex(new THREE.BufferAttribute(new Uint32Array(await numbers(mesh.faces, 3 * mesh.face_count)), 1));
    let first = 0;
    for (const [faces, paint] of mesh.parts) {
      made.addGroup(3 * first, 3 * faces, paint === "other" ? 1 : 0);
      first += faces;
    }
    made.computeVertexNormals();
    made.computeBoundingBox();
    return made;
  }

  function colour(name) {
    return new THREE.Color(getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  }

  // Paints are lit in linear light; the ground behind is not lit at all.
  const paint = (name) => colour(name).convertSRGBToLinear();

  function makeView() {
    const canvas = element("canvas", { tabindex: "0", role: "img" });
    const renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    renderer.outputEncoding = THREE.sRGBEncoding;
    renderer.setPixelRatio(Math.min(2, devicePixelRatio || 1));
    const scene = new THREE.Scene();
    const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, 1, 5000);
    camera.up.set(0, 0, 1);
    const lamp = new THREE.DirectionalLight(0xffffff, 0.75);
    scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8f98, 0.55), lamp, lamp.target);
    const made = { canvas, renderer, scene, camera, lamp, solid: null, grid: null, at: { ...OBLIQUE, zoom: 1 } };
    steer(made);
    new ResizeObserver(() => draw(made)).observe(canvas);
    return made;
  }

  function draw(v) {
    const { clientWidth: width, clientHeight: height } = v.canvas;
    if (!v.solid || !width || !height) return;
    const { turn, rise, zoom } = v.at;
    const aspect = width / height;
    const half = (FIELD_OF_VIEW_DEG * Math.PI) / 360;
    const narrowest = Math.min(half, Math.atan(Math.tan(half) * aspect));
    const distance = (v.radius / Math.sin(narrowest)) * 1.02 / zoom;
    const flat = Math.cos(rise);
    const way = new THREE.Vector3(flat * Math.cos(turn), flat * Math.sin(turn), Math.sin(rise));
    v.camera.position.copy(v.centre).addScaledVector(way, distance);
    v.camera.lookAt(v.centre);
    v.camera.aspect = aspect;
    v.camera.near = Math.max(0.01 * v.radius, distance - 4 * v.radius);
    v.camera.far = distance + 8 * v.radius;
    v.camera.updateProjectionMatrix();
    // The lamp hangs beside the viewer's left shoulder wherever the viewer goes.
    const side = new THREE.Vector3(-0.6, 0.7, 0.4).applyQuaternion(v.camera.quaternion);
    v.lamp.position.copy(v.centre).addScaledVector(side, distance);
    v.lamp.target.position.copy(v.centre);
    v.renderer.setSize(width, height, false);
    v.renderer.render(v.scene, v.camera);
    v.canvas.dataset.drawn = String(Number(v.canvas.dataset.drawn || 0) + 1);
  }

  function move(v, turn, rise, zoom = 1) {
    const most = Math.PI / 2 - 0.001;
    v.at.turn += turn;
    v.at.rise = Math.min(most, Math.max(-most, v.at.rise + rise));
    v.at.zoom = Math.min(12, Math.max(0.3, v.at.zoom * zoom));
    draw(v);
  }

  function steer(v) {
    const fingers = new Map();
    const spread = () => {
      const [a, b] = [...fingers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    v.canvas.addEventListener("pointerdown", (event) => {
      v.canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    v.canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const apart = fingers.size > 1 ? spread() : 0;
      const now = { x: event.clientX, y: event.clientY };
      fingers.set(event.pointerId, now);
      if (fingers.size > 1) move(v, 0, 0, spread() / Math.max(1, apart));
      else move(v, (before.x - now.x) * 0.008, (now.y - before.y) * 0.008);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      v.canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
    }
    v.canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        move(v, 0, 0, Math.exp(-event.deltaY * 0.0012));
      },
      { passive: false },
    );
    const keys = {
      ArrowLeft: [-0.17, 0],
      ArrowRight: [0.17, 0],
      ArrowUp: [0, 0.12],
      ArrowDown: [0, -0.12],
      "+": [0, 0, 1.2],
      "=": [0, 0, 1.2],
      "-": [0, 0, 1 / 1.2],
    };
    v.canvas.addEventListener("keydown", (event) => {
      if (event.key === "0") place(v, OBLIQUE);
      else if (event.key in keys && !event.ctrlKey && !event.metaKey) move(v, ...keys[event.key]);
      else return;
      event.preventDefault();
    });
  }

  function place(v, where) {
    v.at = { ...where, zoom: 1 };
    draw(v);
  }

  function drop(v, name) {
    const old = v[name];
    v[name] = null;
    if (!old) return;
    v.scene.remove(old);
    old.geometry.dispose();
    [old.material].flat().forEach((material) => material.dispose());
  }

  // The plate: lines every 10 mm, and the ground behind it.
  function floor(v) {
    drop(v, "grid");
    const box = v.solid.geometry.boundingBox;
    const reach = Math.max(box.max.x - box.min.x, box.max.y - box.min.y) + 2 * GRID_MM;
    const cells = 2 * Math.ceil(reach / GRID_MM / 2);
    const line = paint("--viewer-line");
    v.grid = new THREE.GridHelper(cells * GRID_MM, cells, line, line);
    v.grid.rotation.x = Math.PI / 2;
    const whole = (value) => Math.round(value / GRID_MM) * GRID_MM;
    v.grid.position.set(whole(v.centre.x), whole(v.centre.y), box.min.z);
    v.scene.add(v.grid);
    v.scene.background = colour("--viewer-back");
  }

  function fill(v, shape, flat) {
    drop(v, "solid");
    const box = shape.boundingBox;
    v.centre = box.getCenter(new THREE.Vector3());
    v.radius = box.getSize(new THREE.Vector3()).length() / 2;
    const paints = ["--paint-main", "--paint-other"].map(
      (name) => new THREE.MeshStandardMaterial({ color: paint(name), roughness: 0.62, flatShading: flat }),
    );
    v.solid = new THREE.Mesh(shape, paints);
    v.scene.add(v.solid);
    floor(v);
  }

  gallery.repaint = () => {
    if (!view?.solid) return;
    ["--paint-main", "--paint-other"].forEach((name, number) => view.solid.material[number].color.copy(paint(name)));
    floor(view);
    draw(view);
  };

  function picture(node, item, problem) {
    node.append(
      element("p", { class: "notice", role: "status" }, problem),
      element("img", { class: "fallback", alt: "", src: gallery.file("thumbs", item, ".png") }),
    );
    return () => {};
  }

  // Show a mesh in an element; `wanted` tells whether it still is when all is read.
  gallery.showMesh = async (node, mesh, title, item, wanted) => {
    if (typeof THREE === "undefined") await gallery.script(`${gallery.files}/assets/three.js`);
    let shape;
    try {
      view ??= makeView();
      shape = await geometry(mesh);
    } catch (error) {
      return picture(node, item, `The 3D view cannot be shown here (${error.message}); this is the thumbnail.`);
    }
    if (!wanted()) return () => {};
    fill(view, shape, mesh.flat);
    view.canvas.setAttribute("aria-label", `3D view of ${title}; arrow keys turn, plus and minus zoom, 0 resets`);
    const oblique = element("button", { type: "button" }, "Oblique");
    const above = element("button", { type: "button" }, "From above");
    oblique.addEventListener("click", () => place(view, OBLIQUE));
    above.addEventListener("click", () => place(view, ABOVE));
    const hint = element("span", { class: "caption" }, `grid ${GRID_MM} mm · drag or arrow keys turn; wheel, pinch or + − zoom; 0 resets`);
    node.append(
      element("div", { class: "stage" }, view.canvas),
      element("div", { class: "controls" }, oblique, above, hint),
    );
    place(view, OBLIQUE);
    if (document.activeElement.id === "item-title") view.canvas.focus();
    return () => {
      drop(view, "solid");
      drop(view, "grid");
    };
  };
})();
