"use strict";
// Draws the plots of a page and moves their cursors, the film and the map together. A page with a
// clock (the time and place of a drive) has one cursor for all plots, which is a time; else each
// group of plots has its own, which is a value of the x axis.
(async () => {
const byId = (id) => document.getElementById(id), root = document.documentElement;
const MARGIN = { l: 62, r: 10, t: 6, b: 40, autoexpand: false };

const theme = byId("theme");
theme.value = root.className;
theme.addEventListener("change", () => {
  root.className = theme.value;
  try { localStorage.setItem("iits-mj theme", theme.value); } catch { }
  root.dispatchEvent(new Event("recolor"));
});
if (!byId("page-data")) return;

async function unpacked(id) {
  const packed = byId(id).textContent;
  const bytes = Uint8Array.fromBase64 ? Uint8Array.fromBase64(packed)
    : Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(plain).arrayBuffer();
}
const page = JSON.parse(byId("page-data").textContent), arrays = [];
try {
  const script = document.createElement("script"), buffer = await unpacked("arrays");
  let offset = 0;
  for (const size of page.sizes) {
    arrays.push(new Float32Array(buffer, offset, size));
    offset += 4 * size;
  }
  script.textContent = new TextDecoder().decode(await unpacked("plotly"));
  document.head.append(script);
} catch (error) {
  byId("failed").hidden = false;
  byId("failed").textContent = `This browser cannot draw the plots (${error.message}): use one of `
    + "2024 or later. The table below each plot has its numbers.";
  return;
}

// --- numbers ------------------------------------------------------------------------------------
const clocks = (page.clocks || []).map((clock) => Object.fromEntries(
  Object.entries(clock).map(([name, place]) => [name, arrays[place]])));
const clock = clocks[0];
let axis = 0, now = 0, playing = false, replay = null, dark = matchMedia("(prefers-color-scheme: dark)");
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const last = (values) => values[values.length - 1];
// The first place whose value is not less; the values never decrease.
function place(values, value) {
  let low = 0, high = values.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < value) low = middle + 1; else high = middle;
  }
  return low;
}
function nearest(values, value) {
  const k = place(values, value);
  return k > 0 && value - values[k - 1] < values[k] - value ? k - 1 : k;
}
function interpolated(x, y, value) {
  const k = Math.max(place(x, value), 1), span = x[k] - x[k - 1];
  const share = span > 0 ? clamp((value - x[k - 1]) / span, 0, 1) : 1;
  return y[k - 1] + share * (y[k] - y[k - 1]);
}
const text = (value, digits) => value.toFixed(digits).replace("-", "\u2212");
const unitOf = (label) => (label.match(/\[(.*)\]/) || ["", ""])[1].replace(/^[-1]$/, "");
const ofAxis = (list) => list[Math.min(axis, list.length - 1)];

// --- plots --------------------------------------------------------------------------------------
const groups = new Map(), plots = page.plots.map((plot, number) => {
  const figure = byId(`plot-${number}`), canvas = figure.querySelector(".canvas");
  if (!groups.has(plot.group)) groups.set(plot.group, { plots: [], range: null, at: null });
  const made = { ...plot, canvas, drawn: false, cluster: groups.get(plot.group),
    buttons: plot.lines.map((_, k) => figure.querySelector(`[data-line="${k}"]`)), hidden: new Set(),
    clocked: plot.group === "drive" };
  made.digits = made.lines.map((line) => {
    const most = arrays[line.y[0]].reduce((m, v) => Math.max(m, Math.abs(v) || 0), 0);
    return plot.whole ? 0 : clamp(2 - Math.floor(Math.log10(most || 1)), 0, 4);
  });
  made.cluster.plots.push(made);
  canvas.plot = made;
  return made;
});
const map = plots.find((plot) => plot.group === "map");

const probe = document.body.appendChild(document.createElement("i"));
probe.hidden = true;
function color(name) {
  probe.style.color = `var(--${name})`;
  return getComputedStyle(probe).color;
}
function fullRange(group) {
  let low = Infinity, high = -Infinity;
  for (const plot of group.plots.filter((p) => p.series)) {
    for (const x of plot.lines.map((line) => arrays[ofAxis(line.x)])) {
      low = Math.min(low, x[0]);
      high = Math.max(high, last(x));
    }
  }
  return [low, high];
}
const rangeOf = (group) => group.range || fullRange(group);

function traces(plot) {
  const unit = unitOf(plot.y), xUnit = unitOf(ofAxis(plot.x));
  return plot.lines.map((line, k) => ({
    x: arrays[ofAxis(line.x)], y: arrays[ofAxis(line.y)], name: line.label,
    mode: line.marks ? "markers" : "lines", visible: !plot.hidden.has(k),
    line: { color: color(line.style), width: 1.8, dash: line.dash, simplify: false,
      shape: plot.whole && plot.series ? "hv" : "linear" },
    marker: { color: color(line.style), size: 9, symbol: line.symbol || "circle" },
    fill: line.fill ? "toself" : "none", connectgaps: false,
    hovertemplate: `${line.label} %{y:.4~g} ${unit}<br>%{x:.4~g} ${xUnit}<extra></extra>`,
  }));
}
function layout(plot) {
  const ink = color("ink"), grid = { gridcolor: color("line"), linecolor: color("control"),
    zeroline: false, color: ink };
  const made = { margin: MARGIN, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    width: plot.canvas.clientWidth, height: plot.canvas.clientHeight, showlegend: false,
    font: { color: ink, size: 12, family: "system-ui, sans-serif" },
    hovermode: plot.series ? false : "closest",
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    xaxis: { ...grid, title: { text: ofAxis(plot.x), standoff: 4 } },
    yaxis: { ...grid, title: { text: plot.y, standoff: 2 }, nticks: 6 } };
  if (plot.series) made.xaxis.range = [...rangeOf(plot.cluster)];
  if (plot.step) made.yaxis.dtick = plot.step;
  if (plot.range) made.yaxis.range = [...plot.range];
  if (plot.drawn && !plot.series) {
    for (const name of ["xaxis", "yaxis"]) made[name].range = [...plot.canvas._fullLayout[name].range];
  }
  if (plot.plan) Object.assign(made.yaxis, { scaleanchor: "x", scaleratio: 1 });
  return made;
}
function draw(plot) {
  Plotly.react(plot.canvas, traces(plot), layout(plot),
    { displayModeBar: false, doubleClick: false }).then(() => showCursor(plot));
  if (!plot.drawn) {
    plot.drawn = true;
    plot.canvas.on("plotly_afterplot", () => showCursor(plot));
    plot.canvas.on("plotly_relayout", (change) => {
      const low = change["xaxis.range[0]"], high = change["xaxis.range[1]"];
      if (plot.series && low !== undefined) setRange(plot.cluster, [low, high]);
    });
    plot.canvas.on("plotly_doubleclick", () => zoomAll(plot));
  }
}
const redraw = () => plots.filter((plot) => plot.drawn).forEach(draw);
const drawAll = () => plots.forEach(draw);
function zoomAll(plot) {
  if (plot.series) setRange(plot.cluster, null);
  else Plotly.relayout(plot.canvas, { "xaxis.autorange": true, "yaxis.autorange": true });
}
function setRange(group, range) {
  const [low, high] = fullRange(group);
  group.range = range && [Math.max(range[0], low), Math.min(range[1], high)];
  if (range && !(group.range[1] > group.range[0])) group.range = null;
  for (const plot of group.plots.filter((p) => p.drawn && p.series)) {
    const change = { "xaxis.range": [...rangeOf(group)] };
    if (!range && !plot.range) change["yaxis.autorange"] = true;
    Plotly.relayout(plot.canvas, change);
  }
}
function zoom(group, factor) {
  const [low, high] = rangeOf(group), x = clamp(cursorX(group), low, high);
  setRange(group, [x - factor * (x - low), x + factor * (high - x)]);
}

// --- cursor -------------------------------------------------------------------------------------
const cursorX = (group) => clock && axis && group.at !== null && group.plots[0].clocked
  ? interpolated(clock.time, clock.station, group.at) : group.at;
// The time of another drive that belongs to the cursor: the same time, or the time at the place.
const timeOf = (other, at) => other === clock || !axis ? at
  : interpolated(other.station, other.time, interpolated(clock.time, clock.station, at));
function valueAt(plot, line, x) {
  const own = clock && plot.clocked && arrays[line.x[0]] === clock.time
    && arrays[last(line.x)] === clock.station;
  const values = arrays[ofAxis(line.x)], k = own ? nearest(clock.time, plot.cluster.at) : nearest(values, x);
  const step = values.length > 1 ? (last(values) - values[0]) / (values.length - 1) : 0;
  return own || Math.abs(values[k] - x) <= 2 * step ? arrays[ofAxis(line.y)][k] : NaN;
}
function overlay(canvas, kind, number) {
  const all = canvas.querySelectorAll(`.${kind}`);
  if (all[number]) return all[number];
  const made = document.createElement("div");
  made.className = kind;
  return canvas.appendChild(made);
}
function pixel(plot, name, value) {
  const [low, high] = plot.canvas._fullLayout[`${name}axis`].range;
  const { clientWidth: width, clientHeight: height } = plot.canvas, share = (value - low) / (high - low);
  if (!(share >= -1e-6 && share <= 1 + 1e-6)) return null;
  return name === "x" ? MARGIN.l + share * (width - MARGIN.l - MARGIN.r)
    : height - MARGIN.b - share * (height - MARGIN.t - MARGIN.b);
}
function showCursor(plot) {
  if (!plot.drawn) return;
  if (plot === map) return showTrucks();
  const group = plot.cluster;
  if (!plot.series || group.at === null) return;
  const x = cursorX(group), bar = overlay(plot.canvas, "cursor", 0), left = pixel(plot, "x", x);
  bar.hidden = left === null;
  bar.style.left = `${left}px`;
  const unit = unitOf(plot.y), shown = plot.lines.map((line, k) => {
    const value = valueAt(plot, line, x);
    const words = Number.isFinite(value) ? `${text(value, plot.digits[k])} ${unit}`.trim() : "\u2013";
    if (plot.buttons[k]) plot.buttons[k].querySelector(".value").textContent = words;
    return `${line.label} ${words}`;
  });
  const [low, high] = fullRange(group), where = `${text(x, 1)} ${unitOf(ofAxis(plot.x))}`;
  const spoken = { valuemin: low, valuemax: high, valuenow: x, valuetext: `${where}: ${shown.join(", ")}` };
  for (const [name, value] of Object.entries(spoken)) plot.canvas.setAttribute(`aria-${name}`, value);
}
function showTrucks() {
  if (!map.drawn) return;
  clocks.forEach((own, number) => {
    const time = timeOf(own, now), k = nearest(own.time, time);
    const mark = overlay(map.canvas, "truck", number);
    const left = pixel(map, "x", interpolated(own.time, own.x, time));
    const top = pixel(map, "y", interpolated(own.time, own.y, time));
    mark.hidden = left === null || top === null;
    mark.style.cssText = `left: ${left}px; top: ${top}px; --color: var(--c${number}); `
      + `transform: rotate(${-own.yaw[k]}rad)`;
  });
}
function follow() {
  if (!map.drawn || !byId("follow").checked) return;
  const x = interpolated(clock.time, clock.x, now), y = interpolated(clock.time, clock.y, now);
  const { clientWidth: width, clientHeight: height } = map.canvas, reach = 80;
  const tall = reach * (height - MARGIN.t - MARGIN.b) / (width - MARGIN.l - MARGIN.r);
  Plotly.relayout(map.canvas, { "xaxis.range": [x - reach, x + reach], "yaxis.range": [y - tall, y + tall] });
}
// Moves the cursor of a group; `cause`, a film or the replay, has moved it, if any.
function moveTo(group, at, cause) {
  const clocked = clock && group.plots[0].clocked;
  const [low, high] = clocked ? [clock.time[0], last(clock.time)] : fullRange(group);
  group.at = clamp(at, low, high);
  if (clocked) {
    now = group.at;
    const station = interpolated(clock.time, clock.station, group.at);
    const words = `${text(group.at, 1)} s \u00b7 ${text(station, 1)} m`;
    byId("time").value = group.at;
    byId("time").setAttribute("aria-valuetext", words);
    byId("now").textContent = words;
    for (const film of films) if (film !== cause) seek(film, timeOf(film.clock, group.at));
    if (replay && replay !== cause) replay.contentWindow.postMessage({ time: now }, "*");
    follow();
    showTrucks();
  }
  group.plots.forEach(showCursor);
}
function moveBy(group, steps) {
  const clocked = clock && group.plots[0].clocked, [low, high] = rangeOf(group);
  const step = clocked ? (last(clock.time) - clock.time[0]) / (clock.time.length - 1) : (high - low) / 200;
  moveTo(group, group.at + steps * step);
}
function pointed(plot, event) {
  const box = plot.canvas.getBoundingClientRect(), [low, high] = rangeOf(plot.cluster);
  const share = (event.clientX - box.left - MARGIN.l) / (box.width - MARGIN.l - MARGIN.r);
  if (share < 0 || share > 1) return;
  const x = low + share * (high - low);
  moveTo(plot.cluster, plot.clocked && axis ? interpolated(clock.station, clock.time, x) : x);
}
const KEYS = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: 50, PageDown: -50 };
function pressed(plot, event) {
  const group = plot.cluster, far = event.shiftKey ? 10 : 1;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key in KEYS) moveBy(group, far * KEYS[event.key]);
  else if (event.key === "Home" || event.key === "End") moveTo(group, event.key === "Home" ? -Infinity : Infinity);
  else if (event.key === "+" || event.key === "=") zoom(group, 0.5);
  else if (event.key === "-") zoom(group, 2);
  else if (event.key === "0") setRange(group, null);
  else return;
  event.preventDefault();
}

// --- film ---------------------------------------------------------------------------------------
const films = [...document.querySelectorAll(".film")].map((figure, number) => {
  const film = { element: figure.querySelector("video"), clock: clocks[number], wanted: null };
  const gone = () => {
    film.element.hidden = true;
    figure.querySelector(".missing").hidden = false;
    films.splice(films.indexOf(film), 1);
  };
  film.element.addEventListener("error", gone);
  if (film.element.error) setTimeout(gone);
  film.element.addEventListener("seeking", () => {
    if (film.wanted === null && !playing && film === films[0]) moveTo(groups.get("drive"), film.element.currentTime, film);
  });
  film.element.addEventListener("seeked", () => {
    const wanted = film.wanted;
    film.wanted = null;
    if (wanted !== null && Math.abs(wanted - film.element.currentTime) > 0.03) seek(film, wanted);
  });
  film.element.addEventListener("play", () => play(true));
  film.element.addEventListener("pause", () => play(false));
  return film;
});
function seek(film, time) {
  const busy = film.element.seeking, bound = Math.min(time, (film.element.duration || time));
  film.wanted = bound;
  if (!busy && Math.abs(film.element.currentTime - bound) > 0.02) film.element.currentTime = bound;
  else if (!busy) film.wanted = null;
}
function play(on) {
  if (playing === on) return;
  playing = on;
  byId("play").textContent = on ? "\u23f8" : "\u25b6";
  byId("play").setAttribute("aria-label", on ? "Pause" : "Play");
  const group = groups.get("drive"), film = films[0];
  if (on && group.at >= last(clock.time)) moveTo(group, clock.time[0]);
  if (film) on ? film.element.play().catch(() => play(false)) : film.element.pause();
  let before = performance.now();
  requestAnimationFrame(function next(stamp) {
    if (!playing) return;
    moveTo(group, film ? film.element.currentTime : group.at + (stamp - before) / 1000, film);
    before = stamp;
    if (group.at >= last(clock.time)) play(false);
    else requestAnimationFrame(next);
  });
}

// --- events -------------------------------------------------------------------------------------
for (const plot of plots) {
  plot.buttons.forEach((button, k) => button?.addEventListener("click", () => {
    const hide = !plot.hidden.delete(k);
    if (hide) plot.hidden.add(k);
    button.setAttribute("aria-pressed", !hide);
    draw(plot);
  }));
  if (!plot.series) continue;
  plot.canvas.tabIndex = 0;
  plot.canvas.setAttribute("role", "slider");
  plot.canvas.setAttribute("aria-label", `${plot.title}, cursor`);
  plot.canvas.addEventListener("keydown", (event) => pressed(plot, event));
  plot.canvas.addEventListener("pointermove", (event) => {
    if (!playing && event.pointerType === "mouse" && !event.buttons) pointed(plot, event);
  });
  plot.canvas.addEventListener("click", (event) => pointed(plot, event));
}
for (const group of groups.values()) {
  group.at = clock && group.plots[0].clocked ? clock.time[0] : fullRange(group)[0];
}
if (clock) {
  const group = groups.get("drive"), slider = byId("time");
  Object.assign(slider, { min: clock.time[0], max: last(clock.time),
    step: (last(clock.time) - clock.time[0]) / Math.max(clock.time.length - 1, 1) });
  slider.addEventListener("input", () => moveTo(group, Number(slider.value)));
  byId("play").addEventListener("click", () => play(!playing));
  byId("nearer").addEventListener("click", () => zoom(group, 0.5));
  byId("farther").addEventListener("click", () => zoom(group, 2));
  byId("all").addEventListener("click", () => setRange(group, null));
  for (const choice of document.getElementsByName("axis")) choice.addEventListener("change", () => {
    axis = Number(choice.value);
    group.range = null;
    redraw();
    moveTo(group, group.at);
  });
  byId("follow").addEventListener("change", () => byId("follow").checked ? follow() : zoomAll(map));
  now = group.at;
  moveTo(group, group.at);
}

byId("replay")?.addEventListener("click", (event) => {
  replay = document.createElement("iframe");
  Object.assign(replay, { src: event.target.dataset.source, title: "The drive in 3-D" });
  event.target.closest("p").before(replay);
  event.target.remove();
  replay.addEventListener("load", () => moveTo(groups.get("drive"), now));
  replay.focus();
});
addEventListener("message", ({ source, data }) => {
  if (replay && source === replay.contentWindow && Number.isFinite(data?.time)) {
    play(false);
    moveTo(groups.get("drive"), data.time, replay);
  }
});

// A plot is drawn when it comes near the window: pages have up to some hundred plots.
const watch = new IntersectionObserver((entries) => entries.forEach((entry) => {
  if (entry.isIntersecting && !entry.target.plot.drawn) draw(entry.target.plot);
}), { rootMargin: "600px" });
plots.forEach((plot) => watch.observe(plot.canvas));
new ResizeObserver(redraw).observe(byId("content"));
root.addEventListener("recolor", redraw);
dark.addEventListener("change", redraw);
addEventListener("beforeprint", drawAll);
matchMedia("print").addEventListener("change", redraw);
})();
