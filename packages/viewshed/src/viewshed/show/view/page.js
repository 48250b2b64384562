// Script of the page: decodes frames when they are shown, draws them on a canvas, and plays them.
// Positions are meters in the level frame, x forward and y left; on the screen forward is up and left is left.
"use strict";

const element = (id) => document.getElementById(id);
const settings = JSON.parse(element("settings").textContent);
const abouts = [...document.querySelectorAll("script.about")].map((part) => JSON.parse(part.textContent));
const packed = document.querySelectorAll("script.data");
const seconds = timesOf(abouts);
const agents = [...new Set(abouts.flatMap(({ trust }) => (trust ?? []).map(([agent]) => agent)))];
const agentColor = (agent) => `hsl(${(agents.indexOf(agent) * 137 + 25) % 360} 70% 45%)`;
const [map, strip, stage, root] = [element("map"), element("strip"), element("stage"), document.documentElement];

let current = 0; // index of the requested frame
let shown = null; // its decoded arrays, with cached drawings
let base = "states"; // the layer at the bottom
const overlays = {}; // whether each layer on top is on
const camera = { x: 0, y: 0, scale: 1, isWhole: true }; // center in meters, pixels per meter

// Seconds since the first frame; 0.1 s between two frames whose times are unknown or do not increase.
function timesOf(frames) {
  const rise = (from, to) => (from && to ? Number(BigInt(to) - BigInt(from)) / 1e9 : 0);
  const period = (from, to) => (rise(from, to) > 0 ? rise(from, to) : 0.1);
  let now = 0;
  return frames.map(({ t_ns }, k) => (now += k && period(frames[k - 1].t_ns, t_ns)));
}

const bytesOf = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Split the bytes of a frame into arrays, in the order in which frames.py packs them.
function unpacked(about, bytes) {
  const [size, count] = [about.grid.cells ** 2, about.points];
  const cells = bytes.subarray(0, size);
  const deviation = about.deviation_top === null ? null : bytes.subarray(size, 2 * size);
  const columns = bytes.subarray(deviation ? 2 * size : size);
  if (columns.length !== 6 * count) throw new Error("its size is not what it says");
  const [x, y, height] = [0, 1, 2].map((column) => {
    const values = new Int16Array(count);
    for (let k = 0; k < count; k++) {
      const value = columns[2 * column * count + k] | (columns[(2 * column + 1) * count + k] << 8);
      values[k] = column < 2 && k ? values[k - 1] + value : value; // x, y are differences, wrapped to int16
    }
    return values;
  });
  return { about, cells, deviation, x, y, height };
}

// Cache the last 24 decoded frames, so that stepping back and forth is free.
const decoded = new Map();
function frame(k) {
  if (!decoded.has(k)) {
    decoded.set(k, inflated(bytesOf(packed[k].textContent)).then((bytes) => unpacked(abouts[k], bytes)));
    if (decoded.size > 24) decoded.delete(decoded.keys().next().value);
  }
  return decoded.get(k);
}

async function show(k) {
  const wanted = (current = Math.max(0, Math.min(abouts.length - 1, k)));
  const [arrays, problem] = await frame(wanted).then((done) => [done, ""], (error) => [null, error.message]);
  if (wanted !== current) return; // another frame was requested meanwhile
  shown = arrays && { ...arrays };
  element("problem").textContent = problem && `Sweep ${wanted + 1} cannot be decoded: ${problem}`;
  tell();
  redraw();
  if (wanted + 1 < abouts.length) frame(wanted + 1).catch(() => {}); // errors are reported when it is shown
}

const color = (name) => getComputedStyle(root).getPropertyValue(`--${name}`).trim();
const colorMaps = Object.fromEntries(Object.entries(settings.maps).map(([layer, text]) => [layer, bytesOf(text)]));
const stateOf = (cell) => settings.states[cell & 3];
const stepOf = (cell) => cell >> 4;

function colorAt(layer, share) {
  const at = 3 * Math.round(255 * Math.max(0, Math.min(1, share)));
  return colorMaps[layer].subarray(at, at + 3);
}

// Color of a cell's byte on the base layer: [r, g, b], or null for none.
function cellColor(byte) {
  const [step, last] = [stepOf(byte), settings.steps - 1];
  if (base === "states") return stateOf(byte)[root.dataset.theme];
  if (base === "probability") return colorAt("probability", step / last);
  if (base === "doubt") return colorAt("doubt", (2 * Math.min(step, last - step)) / (last - 1));
  return byte === 255 ? null : colorAt("deviation", byte / settings.deviation_steps);
}

// Canvas with one pixel per cell: row 0 is farthest ahead, column 0 farthest left.
function rasterOf(cells, colorOf, alpha) {
  const side = shown.about.grid.cells;
  const canvas = Object.assign(document.createElement("canvas"), { width: side, height: side });
  const colors = Array.from({ length: 256 }, (_, byte) => colorOf(byte));
  const image = new ImageData(side, side);
  for (let k = 0, at = 4 * (cells.length - 1); k < cells.length; k++, at -= 4) {
    const rgb = colors[cells[k]];
    if (!rgb) continue;
    [image.data[at], image.data[at + 1], image.data[at + 2], image.data[at + 3]] = [rgb[0], rgb[1], rgb[2], alpha];
  }
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

// Lines between visible and other cells, in cells from the front left corner; the rim of the grid is no edge.
function edgePath() {
  const { cells, about: { grid: { cells: side } } } = shown;
  const visible = (row, column) => cells[cells.length - 1 - (row * side + column)] & 4;
  const path = new Path2D();
  const line = (column, row, toColumn, toRow) => { path.moveTo(column, row); path.lineTo(toColumn, toRow); };
  for (let row = 0; row < side; row++) {
    for (let column = 0; column < side; column++) {
      const here = visible(row, column);
      if (column && here !== visible(row, column - 1)) line(column, row, column, row + 1);
      if (row && here !== visible(row - 1, column)) line(column, row, column + 1, row);
    }
  }
  return path;
}

// Point indices by bin of height, the lowest first, so that higher points are drawn on top.
function pointBins() {
  const [low, high] = settings.heights_m;
  const bins = Array.from({ length: 32 }, () => []);
  const bin = (height_cm) => Math.floor((32 * (height_cm / 100 - low)) / (high - low));
  shown.height.forEach((height_cm, k) => bins[Math.max(0, Math.min(31, bin(height_cm)))].push(k));
  return bins;
}

const middle = () => [map.clientWidth / 2, map.clientHeight / 2];
const toScreen = (x, y, [column, row] = middle()) =>
  [column - (y - camera.y) * camera.scale, row - (x - camera.x) * camera.scale];
const toLevel = (column, row, [columns, rows] = middle()) =>
  [camera.x + (rows - row) / camera.scale, camera.y + (columns - column) / camera.scale];

// Clear a canvas, match its pixels to the screen's, and return its context.
function cleared(canvas) {
  const ratio = window.devicePixelRatio;
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round(canvas.clientHeight * ratio);
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
  return context;
}

function drawMap() {
  const context = cleared(map);
  if (!shown) return;
  const { cells, half_extent_m: half, offset_m: [x, y] } = shown.about.grid;
  const [left, top] = toScreen(x + half, y + half);
  const side = 2 * half * camera.scale;
  context.imageSmoothingEnabled = false;
  const values = base === "deviation" ? shown.deviation : base === "none" ? null : shown.cells;
  if (values) context.drawImage((shown.raster ??= rasterOf(values, cellColor, 255)), left, top, side, side);
  if (overlays.monitor) drawSuspect(context, left, top, side);
  if (overlays.edge) {
    context.save();
    context.translate(left, top);
    context.scale(side / cells, side / cells);
    const inks = base === "states" ? [["edge", 1.4]] : [["page", 3], ["edge", 1.4]]; // visible on dark and on light
    for (const [ink, width] of inks) {
      Object.assign(context, { strokeStyle: color(ink), lineWidth: (width * cells) / side });
      context.stroke((shown.edge ??= edgePath()));
    }
    context.restore();
  }
  if (overlays.points) drawPoints(context);
  if (overlays.tracks) drawTracks(context);
  Object.assign(context, { strokeStyle: color("line"), lineWidth: 1 });
  context.strokeRect(left, top, side, side);
  if (overlays.rings) drawRings(context, half + Math.hypot(x, y));
  if (overlays.sensor) drawSensor(context);
  drawScale();
}

function drawPoints(context) {
  const size = Math.max(1.2, Math.min(4, 0.12 * camera.scale));
  (shown.bins ??= pointBins()).forEach((bin, k) => {
    context.fillStyle = `rgb(${colorAt("height", k / 31).join()})`;
    for (const point of bin) {
      const [column, row] = toScreen(shown.x[point] / 100, shown.y[point] / 100);
      context.fillRect(column - size / 2, row - size / 2, size, size);
    }
  });
}

// Path on the screen of a box from above: center, length, width, heading.
function boxPath([x, y, length, width, yaw]) {
  const path = new Path2D();
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  for (const [ahead, left] of [[1, 1], [1, -1], [-1, -1], [-1, 1]]) {
    const [forward, side] = [(ahead * length) / 2, (left * width) / 2];
    path.lineTo(...toScreen(x + cos * forward - sin * side, y + sin * forward + cos * side));
  }
  path.closePath();
  return path;
}

// Detections as thin gray boxes; tracks in the colors of their explanations, with a line to their place in one second.
function drawTracks(context) {
  Object.assign(context, { strokeStyle: color("quiet"), lineWidth: 1 });
  for (const box of shown.about.detections ?? []) context.stroke(boxPath(box));
  for (const [id, x, y, length, width, yaw, vx, vy, at] of shown.about.tracks ?? []) {
    const path = boxPath([x, y, Math.max(length, 1), Math.max(width, 1), yaw]);
    const ink = settings.tracks[at].color;
    Object.assign(context, { fillStyle: ink, strokeStyle: color("page"), lineWidth: 4.5 });
    context.stroke(path);
    context.globalAlpha = 0.35;
    context.fill(path);
    context.globalAlpha = 1;
    Object.assign(context, { strokeStyle: ink, lineWidth: 2.4 });
    context.stroke(path);
    if (Math.hypot(vx, vy) < 0.5) continue;
    context.beginPath();
    context.moveTo(...toScreen(x, y));
    context.lineTo(...toScreen(x + vx, y + vy));
    context.stroke();
  }
}

// The track whose box contains a point on the ground, or undefined; boxes are at least one meter long and wide.
function trackAt(x, y) {
  return (shown?.about.tracks ?? []).find(([, tx, ty, length, width, yaw]) => {
    const [cos, sin, dx, dy] = [Math.cos(yaw), Math.sin(yaw), x - tx, y - ty];
    const [ahead, left] = [cos * dx + sin * dy, cos * dy - sin * dx];
    return Math.abs(ahead) <= Math.max(length, 1) / 2 && Math.abs(left) <= Math.max(width, 1) / 2;
  });
}

// Suspect cells, and suspect sectors as arcs at the rim of the grid.
function drawSuspect(context, left, top, side) {
  const rgb = color("suspect").match(/\w\w/g).map((digits) => parseInt(digits, 16));
  shown.suspect ??= rasterOf(shown.cells, (byte) => (byte & 8 ? rgb : null), 90);
  context.drawImage(shown.suspect, left, top, side, side);
  const [count, ...suspects] = shown.about.sectors ?? [0];
  Object.assign(context, { strokeStyle: color("suspect"), lineWidth: 7 });
  for (const sector of suspects) {
    // Sector 0 begins behind (down on the screen); sectors run counterclockwise, a canvas's angles clockwise.
    const from = Math.PI / 2 - (2 * Math.PI * sector) / count;
    context.beginPath();
    context.arc(...toScreen(0, 0), side / 2 - 5, from, from - (2 * Math.PI) / count, true);
    context.stroke();
  }
}

// The largest of 1, 2, 5 times a power of ten up to the limit.
function roundLength(limit) {
  const power = 10 ** Math.floor(Math.log10(limit));
  return Math.max(...[1, 2, 5].map((step) => step * power).filter((length) => length <= limit * (1 + 1e-9)));
}

function drawRings(context, farthest) {
  const step = roundLength(Math.min(map.clientWidth, map.clientHeight) / camera.scale / 4);
  const [column, row] = toScreen(0, 0);
  Object.assign(context, { fillStyle: color("text"), textAlign: "center", lineJoin: "round" });
  for (let radius = step; radius <= farthest; radius += step) {
    Object.assign(context, { strokeStyle: color("ring"), lineWidth: 1 });
    context.beginPath();
    context.arc(column, row, radius * camera.scale, 0, 2 * Math.PI);
    context.stroke();
    const text = [`${Number(radius.toPrecision(6))} m`, column, row - radius * camera.scale - 3];
    Object.assign(context, { strokeStyle: color("page"), lineWidth: 3 });
    context.strokeText(...text);
    context.fillText(...text);
  }
}

function drawSensor(context) { // an arrow pointing forward
  const [column, row] = toScreen(0, 0);
  context.beginPath();
  for (const [right, down] of [[0, -14], [9, 9], [0, 4], [-9, 9]]) context.lineTo(column + right, row + down);
  context.closePath();
  Object.assign(context, { fillStyle: "#000", strokeStyle: "#fff", lineWidth: 3 });
  context.stroke();
  context.fill();
}

function drawScale() {
  const length_m = roundLength(map.clientWidth / camera.scale / 4);
  element("scale").textContent = `${length_m} m`;
  element("scale").style.width = `${length_m * camera.scale}px`;
}

const percent = (share) => `${Math.round(100 * share)} %`;
const number = (value) => value?.toPrecision(3) ?? "–";

// Write the facts of the frame, its alarms and the trust in agents beside the map.
function tell() {
  const about = abouts[current];
  const share = (state) => percent(about.shares[settings.states.findIndex(({ name }) => name === state)]);
  const words = {
    name: about.name, sweep: `${current + 1} of ${abouts.length}`, visible: `${Math.round(about.visible_m2)} m²`,
    hidden: share("HIDDEN"), unknown: share("UNKNOWN"), agent: about.agent, method: about.method, target: about.target,
    returns: about.returns.toLocaleString("en"), score: number(about.score), limit: number(about.limit),
    basis: [...about.basis, ...(about.notes ?? [])].join("\n"), deviation: number(about.deviation_top),
    alarms: (about.alarms ?? []).map(({ verdict, reason }) => `${verdict}: ${reason}`).join("\n"),
    clock: `${seconds[current].toFixed(2)} s of ${seconds[seconds.length - 1].toFixed(2)} s`,
  };
  for (const [id, text] of Object.entries(words)) element(id).textContent = text;
  element("trust").replaceChildren(...(about.trust ?? []).map(([agent, trust, accused, disputed, forged]) => {
    const item = document.createElement("li");
    const [swatch, name, value] = ["swatch", "", ""].map((kind) => Object.assign(document.createElement("span"), { className: kind }));
    swatch.style.background = agentColor(agent);
    name.textContent = agent + (forged ? " (forged)" : "");
    value.textContent = trust.toFixed(2) + (accused ? " accused" : disputed ? " disputed" : "");
    item.className = accused || disputed ? "doubted" : "";
    item.append(swatch, name, value);
    return item;
  }));
  strip.setAttribute("aria-valuenow", current + 1);
}

// Show the values of the cell under the pointer.
function tip(event) {
  const output = element("tip");
  const [column, row] = [event.offsetX, event.offsetY];
  const [x, y] = toLevel(column, row);
  const { cells, half_extent_m: half, offset_m: [x0, y0] } = abouts[current].grid;
  const [i, j] = [x - x0, y - y0].map((along) => Math.floor(((along + half) / (2 * half)) * cells));
  output.hidden = !shown || Math.min(i, j) < 0 || Math.max(i, j) >= cells;
  if (output.hidden) return;
  const byte = shown.cells[i * cells + j];
  const [low, high] = [stepOf(byte), stepOf(byte) + 1].map((step) => percent(step / settings.steps));
  const lines = [`x ${x.toFixed(1)} m, y ${y.toFixed(1)} m`, `${stateOf(byte).name}, probability ${low} to ${high}`];
  const share = (shown.deviation?.[i * cells + j] ?? 255) / settings.deviation_steps;
  if (share <= 1) lines.push(`deviation ${number(share * shown.about.deviation_top)}`);
  if (byte & 8) lines.push("suspect");
  const track = overlays.tracks && trackAt(x, y);
  if (track) lines.push(`track ${track[0]}: ${settings.tracks[track[8]].word}, exists with ${percent(track[9])}`, track[10]);
  output.textContent = lines.join("\n");
  output.style.left = `${Math.min(column + 14, stage.clientWidth - output.offsetWidth - 4)}px`;
  output.style.top = `${Math.min(row + 14, stage.clientHeight - output.offsetHeight - 4)}px`;
}

// Draw visible area, the monitor's score and trust over time; ticks mark alarms, the bar the frame shown.
function drawStrip() {
  const context = cleared(strip);
  const [width, height, above] = [strip.clientWidth, strip.clientHeight, 16];
  const column = (k) => 4 + ((width - 8) * k) / Math.max(1, abouts.length - 1);
  const curve = (title, unit, values, ink, align) => {
    const top = Math.max(...values.filter(Number.isFinite), 1e-9);
    Object.assign(context, { strokeStyle: ink, fillStyle: ink, lineWidth: 1.6, textAlign: align, textBaseline: "top" });
    context.fillText(`${title}, up to ${Number(top.toPrecision(3))}${unit}`, align === "left" ? 0 : width, 0);
    context.beginPath();
    values.forEach((value, k) => {
      const up = (Math.max(0, value) / top) * (height - above - 6);
      if (Number.isFinite(value)) context.lineTo(column(k), height - 3 - up);
    });
    context.stroke();
  };
  context.fillStyle = color("panel");
  context.fillRect(0, above, width, height - above);
  curve("visible area", " m²", abouts.map((about) => about.visible_m2), color("accent"), "left");
  if (abouts.some((about) => about.score !== undefined)) {
    curve("monitor's score", "", abouts.map((about) => about.score ?? NaN), color("suspect"), "right");
  }
  for (const agent of agents) {
    context.strokeStyle = agentColor(agent);
    context.beginPath();
    abouts.forEach(({ trust }, k) => {
      const row = trust?.find(([name]) => name === agent);
      if (row) context.lineTo(column(k), height - 3 - row[1] * (height - above - 6));
    });
    context.stroke();
  }
  if (agents.length) {
    Object.assign(context, { fillStyle: color("text"), textAlign: "center", textBaseline: "top" });
    context.fillText("trust in each agent, 0 to 1", width / 2, 0);
    context.fillStyle = color("suspect");
  }
  abouts.forEach((about, k) => about.alarms?.length && context.fillRect(column(k) - 1, height - 6, 3, 6));
  context.fillStyle = color("text");
  context.fillRect(column(current) - 1, above, 2, height - above);
}

let timer = 0; // timeout of the next frame; -1 while a frame is decoded, 0 while paused
function play(isOn) {
  clearTimeout(timer);
  timer = isOn ? -1 : 0;
  element("play").textContent = isOn ? "Pause" : "Play";
  if (isOn) next(current === abouts.length - 1 ? 0 : current + 1);
}

// Show a frame, and the next one after the time between them, at most 2 s.
async function next(k) {
  const begun = performance.now();
  timer = -1;
  await show(k);
  if (!timer || current !== k) return; // paused meanwhile
  if (k === abouts.length - 1) return play(false);
  const wait = Math.min(2, seconds[k + 1] - seconds[k]) / Number(element("speed").value);
  timer = setTimeout(next, Math.max(0, 1000 * wait - (performance.now() - begun)), k + 1);
}

function fit() {
  const { half_extent_m: half, offset_m: [x, y] } = abouts[current].grid;
  const scale = (0.97 * Math.min(map.clientWidth, map.clientHeight)) / (2 * half);
  Object.assign(camera, { x, y, scale, isWhole: true });
  drawMap();
}

function redraw() {
  camera.isWhole ? fit() : drawMap(); // grids may differ from frame to frame
  drawStrip();
}

// Pan so that the ground under one place of the canvas is under another, and zoom around that place.
function move(from, to, factor) {
  const [x, y] = toLevel(...from);
  camera.scale = Math.max(0.2, Math.min(400, camera.scale * factor));
  const [nowX, nowY] = toLevel(...to);
  Object.assign(camera, { x: camera.x + x - nowX, y: camera.y + y - nowY, isWhole: false });
  drawMap();
}

function choose() {
  base = document.querySelector("#bases input:checked").value;
  for (const box of document.querySelectorAll("#overlays input")) overlays[box.value] = box.checked;
  const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  root.dataset.theme = element("theme").value === "system" ? system : element("theme").value;
  for (const item of document.querySelectorAll("[data-layer]")) {
    item.hidden = item.dataset.layer !== base && !overlays[item.dataset.layer];
  }
  if (shown) Object.assign(shown, { raster: null, suspect: null });
  redraw();
}

function listen() {
  let held = null;
  const place = (event) => [event.offsetX, event.offsetY];
  map.onpointerdown = (event) => { held = place(event); map.setPointerCapture(event.pointerId); };
  map.onpointerup = map.onpointercancel = () => { held = null; };
  map.onpointerleave = () => { element("tip").hidden = true; };
  map.onpointermove = (event) => { tip(event); if (held) move(held, (held = place(event)), 1); };
  map.onwheel = (event) => { event.preventDefault(); move(place(event), place(event), 1.0015 ** -event.deltaY); };
  const go = (k) => { play(false); show(k); };
  const zoom = (factor) => move(middle(), middle(), factor);
  const seek = (event) => go(Math.round(((event.offsetX - 4) / (strip.clientWidth - 8)) * (abouts.length - 1)));
  strip.onpointerdown = (event) => { strip.setPointerCapture(event.pointerId); seek(event); };
  strip.onpointermove = (event) => { if (event.buttons & 1) seek(event); };
  const actions = {
    closer: () => zoom(1.4), farther: () => zoom(1 / 1.4), whole: fit,
    play: () => play(!timer), back: () => go(current - 1), next: () => go(current + 1),
  };
  for (const [id, action] of Object.entries(actions)) element(id).onclick = action;
  const keys = { " ": "play", ArrowLeft: "back", ArrowRight: "next", "+": "closer", "-": "farther", 0: "whole" };
  document.onkeydown = (event) => {
    const own = event.key === " " ? "select, input, button" : "select, input"; // these use the keys themselves
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches(own) || !(event.key in keys)) return;
    event.preventDefault();
    actions[keys[event.key]]();
  };
  document.onchange = choose;
  matchMedia("(prefers-color-scheme: dark)").onchange = choose;
  new ResizeObserver(redraw).observe(stage);
}

function start() {
  try { new DecompressionStream("deflate-raw"); } catch { return void (element("too_old").hidden = false); }
  strip.setAttribute("aria-valuemax", abouts.length);
  const explained = new Set(abouts.flatMap(({ tracks }) => (tracks ?? []).map((track) => track[8])));
  for (const item of document.querySelectorAll("[data-track]")) if (!explained.has(+item.dataset.track)) item.remove();
  element("if_tracks").hidden = abouts.every(({ tracks, detections }) => !tracks && !detections);
  element("if_trust").hidden = !agents.length;
  if (agents.length) strip.style.height = "110px";
  element("if_deviation").hidden = abouts.every((about) => about.deviation_top === null);
  choose();
  listen();
  show(0);
}

start();
