// The player: opens an episode, keeps the time, and draws it whenever something changed.

const NEAR = 85; // Metres across the canvas, no fewer at first.
const FAR = 170; // A drive for which more would be needed is followed instead.

function makePlayer(dialog, data) {
  const find = (selector) => dialog.querySelector(selector);
  const canvas = find(".stage > canvas");
  const speeds = find("canvas.speeds");
  const range = find(".scrub input");
  const rate = find("select.rate");
  const play = find("[data-do=play]");
  const state = {
    list: [], index: -1, section: null, view: [], episode: null, time: 0, playing: false, camera: null,
    layers: { sets: true, plan: true, path: true, rules: true, follow: false, sides: [] },
    asked: 0, frame: 0,
  };

  // The sides that are looked at, and others that were switched on; all, where there is none of them.
  function listed() {
    const there = state.episode.sides.filter((side, i) => side && (state.view.includes(i) || state.layers.sides[i]));
    return there.length ? there : state.episode.sides.filter(Boolean);
  }

  const end = () => Math.max(...listed().map((s) => s.start + s.x.length - 1));
  const step = () => state.episode.first + state.time / state.episode.dt;
  const duration = () => (end() - state.episode.first) * state.episode.dt;

  async function open(list, index, section) {
    const asked = (state.asked += 1);
    const row = list[index];
    const episode = await unpack(row.episode);
    if (asked !== state.asked) return; // Another one was asked for meanwhile.
    episode.sides.forEach((side, i) => side && (side.outcome = row.sides[i].outcome));
    if (state.section !== section || state.view !== section.view) {
      state.layers.sides = section.names.map((_, i) => section.view.includes(i));
    }
    Object.assign(state, { list, index, section, view: section.view, episode, time: 0 });
    describe(row);
    if (!dialog.open) dialog.showModal();
    canvas.focus({ preventScroll: true });
    state.layers.follow = wholeScale() < sizeOf(canvas).width / FAR;
    layerBoxes();
    frameView();
    setPlaying(!matchMedia("(prefers-reduced-motion: reduce)").matches);
    history.replaceState(null, "", `#${encodeURIComponent(nameOf(row))}`);
  }

  function describe(row) {
    find(".top h2").textContent = nameOf(row);
    const gone = state.episode.hasScene ? "" : " · drawn without the map: its scenario file is gone, or not the one that was driven";
    find(".tags").textContent = `${row.road} · ${row.family} · ${changeWords(row, state.section)}${gone}`;
    find(".sides").replaceChildren(...row.sides.map((side, index) => {
      const box = element("div", { className: "side" });
      box.style.setProperty("--side", `var(--side-${index})`);
      const now = element("span", { className: "now" });
      const about = [side.why, side.velocity === null ? "" : `mean ${side.velocity.toFixed(1)} m/s`];
      box.append(
        now, element("b", { textContent: state.section.names[index] }), " ",
        outcomeBadge(side, data), element("p", { textContent: about.filter(Boolean).join(" · ") }),
      );
      return box;
    }));
    find(".notes").replaceChildren(...row.notes.map((note) => element("li", { textContent: `the scenario file: ${note}` })));
    const colours = palette();
    const kinds = [...new Set(state.episode.users.map((user) => user.kind))].sort((a, b) => a - b);
    find(".kinds").replaceChildren(...kinds.map((kind) => {
      const item = element("li", { textContent: data.kinds[kind][0] });
      const key = element("i");
      key.style.background = colours.kinds[kind];
      item.prepend(key);
      return item;
    }), ...ruleKeys());
    const ahead = state.episode.predictions.flatMap((block) => block.offsets);
    find(".horizon").textContent = ahead.length
      ? `${(Math.min(...ahead) * state.episode.dt).toFixed(1)} to ${(Math.max(...ahead) * state.episode.dt).toFixed(1)} s ahead` : "none";
    listSides();
  }

  // Boxes and marks of the sides that are looked at or switched on.
  function listSides() {
    const there = listed();
    dialog.querySelectorAll(".side").forEach((box, i) => { box.hidden = !state.view.includes(i) && !state.layers.sides[i]; });
    state.time = Math.min(state.time, duration());
    range.max = duration();
    const total = Math.max(duration(), 1e-6);
    find(".marks").replaceChildren(...state.episode.sides.flatMap((side, index) => {
      if (!there.includes(side)) return [];
      const mark = element("i");
      const at = (side.start + side.moment - state.episode.first) * state.episode.dt;
      mark.style.left = `${(100 * at) / total}%`;
      mark.style.background = `var(--side-${index})`;
      return [mark];
    }));
  }

  // Keys of what is there: the lights, and the unit of the numbers on signs.
  function ruleKeys() {
    const units = [...new Set(state.episode.signs.map((sign) => sign.unit).filter(Boolean))].sort();
    const key = (text, colours, border) => {
      const item = element("li", { textContent: text });
      item.prepend(...colours.map((colour) => {
        const disc = element("i", { className: "disc" });
        disc.style.background = colour;
        disc.style.borderColor = border;
        return disc;
      }));
      return item;
    };
    const lit = [...new Set(state.episode.lights.flatMap((lamp) => lamp.shown))].sort((a, b) => a - b);
    const sight = state.episode.sides.some((side) => side && side.seen) ? ["dotted: where it was seen", "faint: not seen"] : [];
    return [
      ...["dashed: start of an ego", ...sight].map((text) => element("li", { textContent: text })),
      ...(lit.length ? [key("traffic light", [...new Set(lit.map((shown) => data.lamps[shown][0]))], data.signs.rim)] : []),
      ...(units.length ? [key(`limit, ${units.join(" and ")}`, ["#ffffff"], data.signs.red)] : []),
    ];
  }

  function layerBoxes() {
    const boxes = [
      ["sets", "sets"], ["plan", "plan"], ["path", "driven path"], ["rules", "lights, signs"], ["follow", "follow (F)"],
    ].map(([key, text]) => checkbox(text, state.layers[key], (on) => {
      state.layers[key] = on;
      if (key === "follow") frameView();
    }));
    const sides = state.section.names.map((name, index) => {
      const label = checkbox(name, state.layers.sides[index], (on) => {
        state.layers.sides[index] = on;
        listSides();
      });
      label.classList.add("of");
      label.querySelector("input").after(sideKey(index));
      return label;
    });
    const legend = find(".layers legend");
    find(".layers").replaceChildren(legend, ...(sides.length > 1 ? sides : []), ...boxes);
  }

  function checkbox(text, on, changed) {
    const label = element("label");
    const box = element("input", { type: "checkbox", checked: on });
    box.addEventListener("change", () => { changed(box.checked); draw(); });
    label.append(box, ` ${text}`);
    return label;
  }

  function extent(axis) {
    const values = listed().flatMap((side) => side[axis]);
    return [Math.min(...values), Math.max(...values)];
  }

  // Pixels for a metre at which the drives are in view from beginning to end.
  function wholeScale() {
    const size = sizeOf(canvas);
    const [wide, high] = ["x", "y"].map((axis) => extent(axis)[1] - extent(axis)[0] + 36);
    return Math.min(size.width / wide, size.height / high);
  }

  function frameView() {
    const near = sizeOf(canvas).width / NEAR;
    const [x, y] = ["x", "y"].map((axis) => (extent(axis)[0] + extent(axis)[1]) / 2);
    state.camera = { scale: state.layers.follow ? near : Math.min(wholeScale(), near), x, y };
    draw();
  }

  function zoom(factor) {
    state.camera.scale = Math.min(Math.max(state.camera.scale * factor, 0.8), 60);
    draw();
  }

  function palette() {
    const style = getComputedStyle(document.documentElement);
    const get = (name) => style.getPropertyValue(`--${name}`).trim();
    const rgb = (name) => [1, 3, 5].map((i) => parseInt(get(name).slice(i, i + 2), 16));
    return {
      land: get("land"), road: get("road"), offRoad: get("off-road"), marking: get("marking"), paint: get("paint"), kerb: get("kerb"), ink: get("ink"), line: get("line"),
      faint: get("faint"), paper: get("paper"), goal: data.goal, lamps: data.lamps, signs: data.signs,
      sides: state.section.names.map((_, side) => get(`side-${side}`)), kinds: data.kinds.map(([, colour]) => colour),
      near: rgb("near"), middle: rgb("middle"), far: rgb("far"),
      outcomes: Object.fromEntries(Object.keys(data.outcomes).map((name) => [name, get(name)])),
    };
  }

  function draw() {
    if (!state.episode || !dialog.open) return;
    const colours = palette();
    const now = step();
    if (state.layers.follow) {
      const shown = state.episode.sides.filter((side, i) => side && state.layers.sides[i]);
      const there = shown.length ? shown : listed();
      // Who has been at its end for a second is left behind.
      const followed = there.filter((side) => now <= side.start + side.x.length - 1 + 1 / state.episode.dt);
      const poses = (followed.length ? followed : there).map((side) => poseAt(side, now, side.start));
      [state.camera.x, state.camera.y] = [0, 1].map((axis) => poses.reduce((sum, pose) => sum + pose[axis], 0) / poses.length);
    }
    const size = sizeOf(canvas);
    drawScene(canvas.getContext("2d"), size, state.camera, state.episode, now, state.layers, colours);
    drawSpeeds(speeds.getContext("2d"), sizeOf(speeds), state.episode, listed(), now, colours, end() - state.episode.first);
    drawRamp(colours);
    range.value = state.time;
    find(".clock").textContent = `${state.time.toFixed(1)} of ${duration().toFixed(1)} s`;
    range.setAttribute("aria-valuetext", `${state.time.toFixed(1)} seconds`);
    dialog.querySelectorAll(".side .now").forEach((label, index) => {
      const side = state.episode.sides[index];
      if (!side) { label.textContent = "not recorded"; return; }
      const at = Math.min(Math.max(Math.round(now - side.start), 0), side.v.length - 1);
      label.textContent = `${side.v[at].toFixed(1)} m/s`;
    });
  }

  function drawRamp(colours) {
    const bar = find(".ramp canvas");
    const context = bar.getContext("2d");
    for (let x = 0; x < bar.width; x += 1) {
      context.fillStyle = ramp(colours, x / (bar.width - 1));
      context.fillRect(x, 0, 1, bar.height);
    }
  }

  function setPlaying(on) {
    if (on && state.time >= duration() - 1e-6) state.time = 0;
    state.playing = on;
    play.textContent = on ? "❚❚" : "▶";
    play.setAttribute("aria-label", on ? "Pause" : "Play");
    cancelAnimationFrame(state.frame);
    let before = null;
    const tick = (now) => {
      if (!state.playing || !dialog.open) return;
      if (before !== null) state.time += ((now - before) / 1000) * Number(rate.value);
      before = now;
      if (state.time >= duration()) {
        state.time = duration();
        setPlaying(false);
        return;
      }
      draw();
      state.frame = requestAnimationFrame(tick);
    };
    if (on) state.frame = requestAnimationFrame(tick);
    draw();
  }

  function seek(time) {
    state.time = Math.min(Math.max(time, 0), duration());
    setPlaying(false);
  }

  function move(by) {
    for (let i = state.index + by; i >= 0 && i < state.list.length; i += by) {
      if (state.list[i].episode) { open(state.list, i, state.section); return; }
    }
  }

  const actions = {
    play: () => setPlaying(!state.playing),
    close: () => dialog.close(),
    next: () => move(1),
    previous: () => move(-1),
  };
  const keys = {
    " ": actions.play,
    ArrowRight: (event) => seek(state.time + (event.shiftKey ? 1 : state.episode.dt)),
    ArrowLeft: (event) => seek(state.time - (event.shiftKey ? 1 : state.episode.dt)),
    Home: () => seek(0),
    End: () => seek(duration()),
    "+": () => zoom(1.25),
    "-": () => zoom(0.8),
    n: actions.next,
    p: actions.previous,
    f: () => { state.layers.follow = !state.layers.follow; layerBoxes(); frameView(); },
  };
  dialog.addEventListener("keydown", (event) => {
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    const own = event.target.closest("button, select, input[type=checkbox]");
    if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
    if (own && (event.key === " " || own.tagName === "SELECT")) return;
    event.preventDefault();
    action(event);
  });
  dialog.addEventListener("click", (event) => {
    const button = event.target.closest("[data-do]");
    if (button) actions[button.dataset.do]();
  });
  dialog.addEventListener("close", () => {
    state.playing = false;
    state.asked += 1;
    history.replaceState(null, "", location.pathname + location.search);
  });
  range.addEventListener("input", () => seek(Number(range.value)));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(event.deltaY < 0 ? 1.15 : 1 / 1.15);
  }, { passive: false });
  canvas.addEventListener("pointermove", (event) => {
    if (!(event.buttons & 1) || state.layers.follow) return;
    state.camera.x -= event.movementX / state.camera.scale;
    state.camera.y += event.movementY / state.camera.scale;
    draw();
  });
  new ResizeObserver(draw).observe(canvas);
  return { open, draw };
}

function sizeOf(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const size = { width: canvas.clientWidth, height: canvas.clientHeight, ratio };
  const [width, height] = [Math.round(size.width * ratio), Math.round(size.height * ratio)];
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
  return size;
}
