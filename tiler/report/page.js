"use strict";
// The map: pictures of the page drawn on a canvas, and over them tiles, outlines of files, features, checkpoints.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const canvas = document.getElementById("canvas");
  const told = document.getElementById("told");
  const legend = document.getElementById("legend");
  const pen = canvas.getContext("2d");
  const keys = told.textContent;
  const [west, south, east, north] = data.extent;
  const KEY = 0, WEST = 1, SOUTH = 2, EAST = 3, NORTH = 4, STATE = 5, POINTS = 6, SECONDS = 7, TRIES = 8, MARKED = 9, ERROR = 10;
  const STATES = {
    done: ["done", "#2f7fd0"], again: ["done with a wider halo", "#7a5bc7"], marked: ["done, not certified", "#e0a100"],
    failed: ["failed", "#d1341f"], waiting: ["not done", "#8a8f8c"],
  };
  const MOST_ZOOM = 64;
  const view = { x: (west + east) / 2, y: (south + north) / 2, scale: 1, fit: 1 };
  const shown = { picture: "", shaded: true, tiles: "state", stage: 0, files: false, checkpoints: true, problems: true };
  const LEAST_WINDOW = 1 / 20, RING = 9;
  let linked = null;
  let chosen = -1, asked = false, dragged = null, slowest = 1, quickest = 0;

  document.documentElement.classList.add("scripted");

  const image = (name) => document.getElementById(`picture-${name}`);
  const stage = () => data.stages[shown.stage];
  const stateOf = (tile) => tile[STATE] !== "done" ? tile[STATE] : tile[MARKED] ? "marked" : tile[TRIES] > 1 ? "again" : "done";
  const column = (x) => (x - view.x) * view.scale + canvas.clientWidth / 2;
  const row = (y) => (view.y - y) * view.scale + canvas.clientHeight / 2;
  const box = (t) => [column(t[WEST]), row(t[NORTH]), (t[EAST] - t[WEST]) * view.scale, (t[NORTH] - t[SOUTH]) * view.scale];

  function timeColour(seconds) {
    if (seconds === null) return "#8a8f8c";
    const share = slowest > quickest ? (seconds - quickest) / (slowest - quickest) : 0;
    return data.time_colours[Math.round(share * (data.time_colours.length - 1))];
  }

  function draw() {
    asked = false;
    const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, high = canvas.clientHeight;
    if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
      canvas.width = Math.round(wide * ratio);
      canvas.height = Math.round(high * ratio);
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, wide, high);
    const place = [column(west), row(north), (east - west) * view.scale, (north - south) * view.scale];
    const picture = shown.picture && image(shown.picture);
    if (picture) {
      pen.imageSmoothingEnabled = place[2] < 3 * picture.naturalWidth;
      pen.drawImage(picture, ...place);
      if (shown.shaded && shown.picture !== "hillshade") {
        pen.globalCompositeOperation = "multiply";
        pen.drawImage(image("hillshade"), ...place);
        pen.globalCompositeOperation = "source-over";
      }
    }
    drawTiles();
    if (shown.files) drawFiles();
    for (const layer of data.shapes) if (shown[layer.name]) drawShapes(layer);
    if (shown.checkpoints) drawCheckpoints();
    if (shown.problems) drawProblems();
  }

  function drawTiles() {
    if (shown.tiles === "none" || !data.stages.length) return;
    const ink = getComputedStyle(canvas).color;
    stage().tiles.forEach((tile, i) => {
      const [x, y, w, h] = box(tile);
      if (x > canvas.clientWidth || y > canvas.clientHeight || x + w < 0 || y + h < 0) return;
      const state = stateOf(tile);
      const plain = shown.tiles === "state" && state === "done" && shown.picture;
      pen.globalAlpha = plain ? 0 : state === "failed" || shown.tiles === "time" ? 0.6 : 0.4;
      pen.fillStyle = shown.tiles === "time" ? timeColour(tile[SECONDS]) : STATES[state][1];
      pen.fillRect(x, y, w, h);
      pen.globalAlpha = 1;
      pen.strokeStyle = shown.tiles === "state" ? STATES[state][1] : "#ffffff80";
      pen.lineWidth = state === "failed" ? 2 : 1;
      if (w > 3) pen.strokeRect(x + 0.5, y + 0.5, w - 1, h - 1);
      if (i === chosen) {
        pen.strokeStyle = ink;
        pen.lineWidth = 3;
        pen.strokeRect(x, y, w, h);
      }
    });
  }

  function drawFiles() {
    pen.strokeStyle = "#c2247b";
    pen.lineWidth = 1.5;
    pen.setLineDash([6, 4]);
    for (const file of data.files) pen.strokeRect(...box(file));
    pen.setLineDash([]);
  }

  function drawShapes(layer) {
    pen.strokeStyle = pen.fillStyle = layer.colour;
    pen.lineWidth = 2;
    pen.beginPath();
    for (const line of layer.lines)
      for (let i = 0; i < line.length; i += 2) pen[i ? "lineTo" : "moveTo"](column(line[i]), row(line[i + 1]));
    if (layer.tinted) {
      pen.globalAlpha = 0.3;
      pen.fill("evenodd");
      pen.globalAlpha = 1;
    }
    pen.stroke();
  }

  function drawCheckpoints() {
    for (const [, x, y, difference, outlier] of data.checkpoints) {
      const share = difference === null ? 0 : Math.min(Math.abs(difference) / data.checkpoint_range, 1);
      const far = difference > 0 ? [178, 24, 43] : [33, 102, 172];
      pen.beginPath();
      pen.arc(column(x), row(y), 5, 0, 2 * Math.PI);
      pen.fillStyle = difference === null ? "#777" : `rgb(${far.map((c) => Math.round(247 + (c - 247) * share)).join()})`;
      pen.fill();
      pen.lineWidth = outlier ? 2.5 : 1;
      pen.strokeStyle = "#000";
      pen.stroke();
    }
  }

  function drawProblems() {
    pen.lineWidth = 2;
    for (const place of data.problems) {
      pen.strokeStyle = "#d1341f";
      pen.beginPath();
      pen.arc(column((place[WEST] + place[EAST]) / 2), row((place[SOUTH] + place[NORTH]) / 2), RING, 0, 2 * Math.PI);
      pen.stroke();
    }
    if (linked) {
      pen.strokeStyle = getComputedStyle(canvas).color;
      pen.strokeRect(...box(linked));
    }
  }

  function showPlace(place) {
    const least = LEAST_WINDOW * Math.max(east - west, north - south) || 1;
    const wide = Math.max(2 * (place[EAST] - place[WEST]), least), high = Math.max(2 * (place[NORTH] - place[SOUTH]), least);
    linked = place;
    view.x = (place[WEST] + place[EAST]) / 2;
    view.y = (place[SOUTH] + place[NORTH]) / 2;
    view.scale = Math.min(canvas.clientWidth / wide, canvas.clientHeight / high, view.fit * MOST_ZOOM);
    told.textContent = place[KEY];
    ask();
  }

  function ask() {
    if (!asked) {
      asked = true;
      requestAnimationFrame(draw);
    }
  }

  function fitAll() {
    view.fit = Math.min(canvas.clientWidth / (east - west || 1), canvas.clientHeight / (north - south || 1)) * 0.96;
    Object.assign(view, { x: (west + east) / 2, y: (south + north) / 2, scale: view.fit });
    ask();
  }

  function zoom(factor, atColumn = canvas.clientWidth / 2, atRow = canvas.clientHeight / 2) {
    const scale = Math.min(Math.max(view.scale * factor, view.fit / 4), view.fit * MOST_ZOOM);
    const dx = atColumn - canvas.clientWidth / 2, dy = atRow - canvas.clientHeight / 2;
    view.x += dx / view.scale - dx / scale;
    view.y -= dy / view.scale - dy / scale;
    view.scale = scale;
    ask();
  }

  function move(columns, rows) {
    view.x = Math.min(Math.max(view.x + columns / view.scale, west), east);
    view.y = Math.min(Math.max(view.y - rows / view.scale, south), north);
    ask();
  }

  function tileText(tile) {
    const parts = [`tile ${tile[KEY]}`, STATES[stateOf(tile)][0], `${tile[POINTS].toLocaleString("en")} points`];
    if (tile[SECONDS] !== null) parts.push(`${tile[SECONDS]} s`);
    if (tile[TRIES] > 1) parts.push(`${tile[TRIES]} tries`);
    if (tile[MARKED]) parts.push(`${tile[MARKED].toLocaleString("en")} not certified`);
    if (tile[ERROR]) parts.push(tile[ERROR]);
    return parts.join(", ");
  }

  function choose(step) {
    if (!data.stages.length) return;
    const tiles = stage().tiles;
    chosen = (chosen + step + tiles.length) % tiles.length;
    const tile = tiles[chosen];
    view.x = (tile[WEST] + tile[EAST]) / 2;
    view.y = (tile[SOUTH] + tile[NORTH]) / 2;
    told.textContent = tileText(tile);
    ask();
  }

  function tell(event) {
    const place = canvas.getBoundingClientRect();
    const left = event.clientX - place.left, top = event.clientY - place.top;
    const x = view.x + (left - canvas.clientWidth / 2) / view.scale;
    const y = view.y - (top - canvas.clientHeight / 2) / view.scale;
    const parts = [`${x.toFixed(1)}, ${y.toFixed(1)}`];
    const inside = (t) => x >= t[WEST] && x < t[EAST] && y >= t[SOUTH] && y < t[NORTH];
    for (const [name, px, py, difference] of shown.checkpoints ? data.checkpoints : [])
      if (Math.hypot(column(px) - left, row(py) - top) < 7)
        parts.push(`checkpoint ${name}: ${difference === null ? "no height" : `${difference.toFixed(3)} ${data.checkpoint_unit}`}`);
    for (const place of shown.problems ? data.problems : [])
      if (Math.hypot(column((place[WEST] + place[EAST]) / 2) - left, row((place[SOUTH] + place[NORTH]) / 2) - top) < RING) parts.push(place[KEY]);
    if (data.stages.length && shown.tiles !== "none") parts.push(...stage().tiles.filter(inside).map(tileText));
    if (shown.files) parts.push(...data.files.filter(inside).map((file) => file[KEY]));
    told.textContent = parts.join(" · ");
  }

  function swatch(colour, text) {
    const item = document.createElement("span"), patch = document.createElement("i");
    item.className = "swatch";
    patch.style.background = colour;
    item.append(patch, ` ${text}`);
    return item;
  }

  function explain() {
    legend.replaceChildren();
    const picture = data.pictures.find((p) => p.name === shown.picture);
    for (const [colour, text] of picture ? picture.legend : []) legend.append(swatch(colour, text));
    for (const layer of data.shapes) if (shown[layer.name]) legend.append(swatch(layer.colour, layer.title));
    if (!data.stages.length || shown.tiles === "none") return;
    const tiles = stage().tiles;
    const seconds = tiles.map((t) => t[SECONDS]).filter((s) => s !== null);
    quickest = seconds.reduce((a, b) => Math.min(a, b), Infinity);
    slowest = seconds.reduce((a, b) => Math.max(a, b), 0);
    if (shown.tiles === "time") {
      if (!seconds.length) return;
      legend.append(swatch(timeColour(quickest), `${quickest} s`), swatch(timeColour(slowest), `${slowest} s`));
      return;
    }
    for (const [state, [text, colour]] of Object.entries(STATES)) {
      const n = tiles.filter((t) => stateOf(t) === state).length;
      if (n) legend.append(swatch(colour, `${n.toLocaleString("en")} ${n === 1 ? "tile" : "tiles"} ${text}`));
    }
  }

  function change(name, value) {
    shown[name] = value;
    if (name === "stage") chosen = -1;
    explain();
    ask();
  }

  function add(text, control) {
    const label = document.createElement("label");
    label.append(text, control);
    document.getElementById("controls").append(label);
  }

  function addChoice(text, name, choices) {
    const control = document.createElement("select");
    control.id = `choose-${name}`;
    for (const [value, title] of choices) control.add(new Option(title, value, false, String(shown[name]) === String(value)));
    control.addEventListener("change", () => change(name, name === "stage" ? Number(control.value) : control.value));
    add(text, control);
  }

  function addSwitch(text, name) {
    const control = document.createElement("input");
    control.type = "checkbox";
    control.id = `choose-${name}`;
    control.checked = shown[name];
    control.addEventListener("change", () => change(name, control.checked));
    add(text, control);
  }

  function addButton(text, title, action) {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", textContent: text, title });
    button.setAttribute("aria-label", title);
    button.addEventListener("click", action);
    document.getElementById("controls").append(button);
  }

  if (data.pictures.length) {
    shown.picture = "dtm";
    addChoice("Picture", "picture", [...data.pictures.map((p) => [p.name, p.title]), ["", "none"]]);
    addSwitch("shaded", "shaded");
  }
  if (data.stages.length) {
    addChoice("Tiles", "tiles", [["state", "state"], ["time", "time"], ["none", "none"]]);
    addChoice("of", "stage", data.stages.map((s, i) => [i, s.title]));
  }
  if (data.files.length) addSwitch("files", "files");
  for (const layer of data.shapes) {
    shown[layer.name] = true;
    addSwitch(layer.title, layer.name);
  }
  if (data.checkpoints.length) addSwitch("checkpoints", "checkpoints");
  if (data.problems.length) addSwitch("problems", "problems");
  addButton("+", "Zoom in", () => zoom(1.5));
  addButton("\u2212", "Zoom out", () => zoom(1 / 1.5));
  addButton("All", "Show all", fitAll);

  canvas.addEventListener("wheel", (event) => {
    // The page scrolls as usual unless the map has the focus.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
  }, { passive: false });
  canvas.addEventListener("dblclick", (event) => zoom(2, event.offsetX, event.offsetY));
  canvas.addEventListener("pointerdown", (event) => {
    dragged = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
    canvas.classList.add("dragged");
  });
  canvas.addEventListener("pointermove", (event) => {
    if (dragged) {
      move(dragged[0] - event.clientX, dragged[1] - event.clientY);
      dragged = [event.clientX, event.clientY];
    }
    tell(event);
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, () => {
      dragged = null;
      canvas.classList.remove("dragged");
    });
  canvas.addEventListener("pointerleave", () => { told.textContent = keys; });
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const actions = {
      ArrowLeft: () => move(-60, 0), ArrowRight: () => move(60, 0), ArrowUp: () => move(0, -60), ArrowDown: () => move(0, 60),
      "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5), "0": fitAll, n: () => choose(1), p: () => choose(-1),
    };
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (action) {
      event.preventDefault();
      action();
    }
  });
  for (const link of document.querySelectorAll("a[data-place]"))
    link.addEventListener("click", () => showPlace([link.closest("tr").textContent, ...link.dataset.place.split(",").map(Number)]));
  new ResizeObserver(() => {
    const whole = view.scale === view.fit;
    if (whole) fitAll(); else ask();
  }).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", ask);
  explain();
  fitAll();
  Promise.all(data.pictures.map((p) => image(p.name).decode())).then(ask, ask).then(() => {
    document.documentElement.dataset.ready = "yes";
  });
})();
