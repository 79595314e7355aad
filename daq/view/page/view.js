// The page of a log: it asks the server for decimated data and draws them. It sends GET requests only.
"use strict";

const $ = (id) => document.getElementById(id);
const MAX_PANELS = 12, PANEL_PX = 150, LIVE_S = 60, POLL_MS = 1000, IDLE_POLL_MS = 5000;
const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3], [4, 4], [12, 4]];  // beside the colours
const BAD = /^(warning|stop|stop-code|decided|invalid|retry|silence|disk|clock|skipped)$/;

const page = {
  log: 0, content: null, view: [0, 1], selection: null, intervals: [], ticked: new Set(), panels: [],
  track: null, trackNear: null, hover: null, asked: 0, timer: null, listed: "",
};

/** Return an element with properties, attributes and children. Texts become text nodes, never HTML. */
function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name in element) element[name] = value; else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const number = (value, digits) => (value === null || value === undefined ? "-" : value.toFixed(digits));
const seconds = (value) => value.toFixed(3);

async function ask(path, parameters = {}) {
  const query = new URLSearchParams();
  for (const [name, value] of Object.entries(parameters)) {
    for (const item of Array.isArray(value) ? value : [value]) query.append(name, item);
  }
  const answer = await fetch(`api/${path}?${query}`);
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}

function say(text) {
  $("message").textContent = text;
  $("message").hidden = !text;
}

// ---- what is remembered while the tab lives

function store() {
  const kept = { ticked: [...page.ticked], intervals: page.intervals, view: page.view };
  sessionStorage.setItem(`log ${page.log}`, JSON.stringify(kept));
}

function restore() {
  let kept = null;
  try { kept = JSON.parse(sessionStorage.getItem(`log ${page.log}`)); } catch { /* nothing was kept */ }
  page.ticked = new Set(kept ? kept.ticked : []);
  page.intervals = kept ? kept.intervals : [];
  return kept;
}

// ---- signals

function signalsOf(content) {
  return content.tables.flatMap((table) => table.signals.map((signal) => ({ ...signal, table })));
}

/** Tick the signals that tell most about a run, for at most four panels: commands, shaft speeds, force, speed, yaw rate. */
function tickFirst(content) {
  const signals = signalsOf(content);
  for (const name of ["n_cmd", "rpm", "force", "speed", "r", "yaw"]) {
    if (panelsOf(content).length >= 4) break;
    for (const signal of signals) if (signal.name === name && signal.table.device !== "signals") page.ticked.add(signal.id);
  }
  if (!page.ticked.size) for (const signal of signals.slice(0, 4)) page.ticked.add(signal.id);
}

function listSignals(content) {
  const all = signalsOf(content);
  const key = all.map((signal) => signal.id).join();
  if (key === page.listed) return;
  page.listed = key;
  const groups = new Map();
  for (const table of content.tables) {
    if (!groups.has(table.device)) groups.set(table.device, []);
    groups.get(table.device).push(table);
  }
  const boxes = [];
  for (const [device, tables] of groups) {
    const box = make("fieldset", {}, make("legend", {}, device));
    for (const table of tables) {
      if (!table.signals.length) continue;
      if (table.title) box.append(make("h4", {}, `${table.title} (${table.topic})`));
      for (const signal of table.signals) {
        const tick = make("input", { type: "checkbox", checked: page.ticked.has(signal.id) });
        tick.dataset.id = signal.id;
        tick.addEventListener("change", () => {
          if (tick.checked) page.ticked.add(signal.id); else page.ticked.delete(signal.id);
          build();
        });
        const label = make("label", { className: "signal" }, tick,
          make("span", {}, signal.name, " ", make("small", {}, signal.unit ? `[${signal.unit}]` : "")));
        label.dataset.text = `${device} ${table.title} ${table.topic} ${signal.name} ${signal.unit}`.toLowerCase();
        box.append(label);
      }
    }
    boxes.push(box);
  }
  $("signals").replaceChildren(...boxes);
  filterSignals();
}

function filterSignals() {
  const words = $("search").value.toLowerCase().split(/\s+/).filter(Boolean);
  for (const label of $("signals").querySelectorAll("label")) {
    label.hidden = !words.every((word) => label.dataset.text.includes(word));
  }
  for (const box of $("signals").querySelectorAll("fieldset")) {
    box.hidden = !box.querySelector("label:not([hidden])");
  }
}

/** Return the ticked signals as groups, one for each panel: signals of the same name and unit share one. */
function panelsOf(content) {
  const groups = new Map();
  for (const signal of signalsOf(content)) {
    if (!page.ticked.has(signal.id)) continue;
    const key = signal.table.device === "signals" ? signal.id : `${signal.name} ${signal.unit}`;
    if (!groups.has(key)) groups.set(key, []);
    groups.get(key).push(signal);
  }
  return [...groups.values()];
}

// ---- plots

function build() {
  for (const panel of page.panels) panel.plot.destroy();
  page.panels = [];
  const groups = panelsOf(page.content);
  const shown = groups.slice(0, MAX_PANELS);
  $("plots").replaceChildren();
  for (const signals of shown) page.panels.push(panelOf(signals, signals === shown.at(-1)));
  $("no-plot").hidden = shown.length > 0;
  $("no-plot").textContent = groups.length ? "" : "Tick signals to plot them.";
  if (groups.length > MAX_PANELS) {
    $("no-plot").hidden = false;
    $("no-plot").textContent = `${groups.length - MAX_PANELS} more ticked signals are not shown: at most ${MAX_PANELS} plots.`;
  }
  store();
  refresh();
}

const widthOfPlots = () => Math.max($("plots").clientWidth, 200);

function panelOf(signals, last) {
  const { name, unit } = signals[0];
  const values = signals.map(() => make("b", {}, ""));
  const key = make("ul", {}, ...signals.map((signal, k) => make("li", {}, sample(k),
    `${signal.table.device === "signals" ? "" : `${signal.table.device} ${signal.table.title.split(" ").slice(1).join(" ")}`.trim()} `, values[k])));
  const place = make("div", {});
  $("plots").append(make("div", { className: "panel" }, make("h4", {}, unit ? `${name} [${unit}]` : name), key, place));
  const axis = { stroke: colour("--soft"), grid: { stroke: colour("--rule"), width: 1 }, ticks: { stroke: colour("--rule"), width: 1 }, font: "12px system-ui, sans-serif" };
  const options = {
    width: widthOfPlots(), height: PANEL_PX + (last ? 34 : 0), legend: { show: false }, pxAlign: 1,
    scales: { x: { time: false, range: () => page.view }, y: { range: (u, low, high) => (low === null ? [-1, 1] : uPlot.rangeNum(low, high === low ? low + 1 : high, 0.08, true)) } },
    axes: [
      { ...axis, size: last ? 44 : 8, label: last ? "time [s of the log]" : undefined, labelSize: 18, labelFont: "12px system-ui, sans-serif", values: last ? undefined : () => [] },
      { ...axis, size: 62, space: 20 },  // a panel is low: with the usual 30 px between ticks, an axis can have one
    ],
    series: [{}, ...signals.map((signal, k) => ({
      label: signal.name, stroke: colour(`--s${k % 6}`), width: 1.4, dash: DASHES[k % 6], spanGaps: false,
      points: { show: (u) => pointsShown(u) }, paths: signal.held ? uPlot.paths.stepped({ align: 1 }) : undefined,
    }))],
    cursor: { drag: { x: false, y: false }, sync: { key: "view" }, y: false, points: { size: 6 } },
    hooks: { draw: [drawMarks], setCursor: [(u) => showValues(u, signals, values)] },
  };
  const plot = new uPlot(options, [[], ...signals.map(() => [])], place);
  listen(plot);
  return { plot, signals };
}

/** Show single samples as points where few are in view. */
const pointsShown = (u) => u.data[0].length < widthOfPlots() / 8;

function sample(k) {
  const ns = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(ns, "svg"), line = document.createElementNS(ns, "line");
  for (const [name, value] of [["width", 26], ["height", 8], ["aria-hidden", "true"]]) svg.setAttribute(name, value);
  for (const [name, value] of [["x2", 26], ["y1", 4], ["y2", 4], ["stroke", colour(`--s${k % 6}`)], ["stroke-width", 2], ["stroke-dasharray", DASHES[k % 6].join(" ") || "none"]]) line.setAttribute(name, value);
  svg.append(line);
  return svg;
}

/** Show the value of each signal at the cursor: that of the sample at or before it. */
function showValues(u, signals, values) {
  const left = u.cursor.left;
  const inside = left !== null && left !== undefined && left >= 0;
  const t = inside ? u.posToVal(left, "x") : null;
  if (u === page.panels[0]?.plot && t !== page.hover) { page.hover = t; drawMap(); }
  signals.forEach((signal, k) => {
    let text = "";
    if (inside) {
      const times = u.data[0], column = u.data[k + 1];
      let place = u.cursor.idx ?? -1;
      while (place >= 0 && (times[place] > t || column[place] === undefined)) place -= 1;
      if (place >= 0 && column[place] !== null) text = Number(column[place].toPrecision(6)).toString();
    }
    values[k].textContent = text;
  });
}

function drawMarks(u) {
  const context = u.ctx, { left, top, width, height } = u.bbox;
  const band = (from, to, fill, edge) => {
    const a = Math.max(u.valToPos(from, "x", true), left), b = Math.min(u.valToPos(to, "x", true), left + width);
    if (b <= a) return;
    context.fillStyle = fill;
    context.fillRect(a, top, b - a, height);
    if (edge) { context.strokeStyle = edge; context.strokeRect(a, top + 1, b - a, height - 2); }
  };
  context.save();
  context.lineWidth = devicePixelRatio;
  context.setLineDash([]);
  for (const [from, to] of page.intervals) band(from, to, colour("--kept"), colour("--good"));
  if (page.selection) band(...page.selection, colour("--select"), colour("--link"));
  if ($("marks").checked) {
    const first = u === page.panels[0]?.plot;
    const free = [-Infinity, -Infinity];  // by row of labels: faults have the second one
    context.textAlign = "left"; context.textBaseline = "alphabetic";
    context.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    let drawn = 0;
    for (const event of shownEvents()) {
      if (event.t < page.view[0] || event.t > page.view[1] || drawn > 300) continue;
      drawn += 1;
      const x = Math.round(u.valToPos(event.t, "x", true)) + 0.5;
      const bad = BAD.test(event.kind);
      context.strokeStyle = colour(bad ? "--mark-bad" : "--mark");
      context.setLineDash(bad ? [] : [4 * devicePixelRatio, 4 * devicePixelRatio]);
      context.beginPath(); context.moveTo(x, top); context.lineTo(x, top + height); context.stroke();
      if (first && x > free[Number(bad)]) {
        const text = `${bad ? "! " : ""}${event.kind === "segment" ? event.text : `${event.kind}: ${event.text}`}`.slice(0, 26);
        context.fillStyle = context.strokeStyle;
        const end = x + context.measureText(text).width + 10 * devicePixelRatio;
        if (end < left + width) { context.fillText(text, x + 4 * devicePixelRatio, top + (bad ? 24 : 11) * devicePixelRatio); free[Number(bad)] = end; }
      }
    }
  }
  context.restore();
}

const redraw = () => { for (const { plot } of page.panels) plot.redraw(false); drawMap(); };

/** Select by dragging, pan with Shift or the middle button, and zoom by the wheel. */
function listen(plot) {
  const over = plot.over;
  let start = null;
  const at = (event) => plot.posToVal(event.clientX - over.getBoundingClientRect().left, "x");
  over.addEventListener("pointerdown", (event) => {
    if (event.button > 1) return;
    start = { t: at(event), x: event.clientX, view: [...page.view], pan: event.shiftKey || event.button === 1 };
    over.setPointerCapture(event.pointerId);
    if (event.button === 1) event.preventDefault();
  });
  over.addEventListener("pointermove", (event) => {
    if (!start) return;
    if (start.pan) {
      const shift = (start.x - event.clientX) / over.clientWidth * (start.view[1] - start.view[0]);
      setView(start.view[0] + shift, start.view[1] + shift);
    } else if (Math.abs(event.clientX - start.x) > 3) {
      select(Math.min(start.t, at(event)), Math.max(start.t, at(event)));
    }
  });
  const end = (event) => {
    if (start && !start.pan && Math.abs(event.clientX - start.x) <= 3 && event.type === "pointerup") select(null);
    start = null;
  };
  over.addEventListener("pointerup", end);
  over.addEventListener("pointercancel", end);
  over.addEventListener("wheel", (event) => {
    if (event.ctrlKey) return;
    event.preventDefault();
    if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
      pan(Math.sign(event.deltaX || event.deltaY) * 0.1);
    } else {
      zoom(event.deltaY > 0 ? 1.25 : 0.8, at(event));
    }
  }, { passive: false });
  over.addEventListener("dblclick", () => whole());
}

function setView(begin, end, following = false) {
  const limit = Math.max(page.content.end, 1e-3), least = 1e-3;
  const span = Math.min(Math.max(end - begin, least), limit * 1.02);
  begin = Math.min(Math.max(begin, -0.01 * limit), limit * 1.01 - span);
  page.view = [begin, begin + span];
  if (!following) $("follow").checked = false;
  $("range").textContent = `${seconds(page.view[0])} to ${seconds(page.view[1])} s, ${moment(page.view[0])}`;
  for (const { plot } of page.panels) plot.setScale("x", { min: page.view[0], max: page.view[1] });
  clearTimeout(page.timer);
  page.timer = setTimeout(refresh, 60);
}
const whole = () => setView(0, page.content.end);
const pan = (share) => { const shift = share * (page.view[1] - page.view[0]); setView(page.view[0] + shift, page.view[1] + shift); };
function zoom(factor, middle = (page.view[0] + page.view[1]) / 2) {
  setView(middle - (middle - page.view[0]) * factor, middle + (page.view[1] - middle) * factor);
}
function moment(t) {
  const utc = new Date(1000 * (page.content.utc + t));
  return Number.isFinite(utc.getTime()) ? `${utc.toISOString().slice(0, 19).replace("T", " ")} UTC` : "";
}

/** Ask for the data of the view, and draw them. An answer that is late is not drawn. */
async function refresh() {
  const turn = ++page.asked;
  const [from, to] = page.view;
  const signals = page.panels.flatMap((panel) => panel.signals.map((signal) => signal.id));
  const points = Math.min(Math.max(Math.round(widthOfPlots()), 100), 2000);
  try {
    const data = signals.length ? await ask("data", { log: page.log, from, to, points, signal: signals }) : {};
    if (turn !== page.asked) return;
    for (const { plot, signals: own } of page.panels) {
      const tables = own.map((signal) => data[signal.id] ?? { t: [], value: [] }).map(({ t, value }) => [t, value]);
      plot.setData(tables.length > 1 ? uPlot.join(tables) : tables[0], true);
    }
    if (page.content.tracks.length) {
      page.trackNear = await ask("track", { log: page.log, track: $("track").value, from, to, points: 1500 });
      if (turn !== page.asked) return;
    }
    drawMap();
    document.body.dataset.drawn = String(turn);
  } catch (error) { lost(error); }
}

function lost(error) {
  const gone = error instanceof TypeError;
  say(gone ? `The server has ended. To open the log again: seatrial view ${page.content?.path ?? "LOG"}` : error.message);
}

// ---- intervals

function select(begin, end) {
  if (begin === null) { page.selection = null; } else {
    const limit = page.content.end;
    begin = Math.min(Math.max(begin, 0), limit); end = Math.min(Math.max(end, 0), limit);
    page.selection = end > begin ? [begin, end] : null;
  }
  $("from").value = page.selection ? seconds(page.selection[0]) : "";
  $("to").value = page.selection ? seconds(page.selection[1]) : "";
  redraw();
}

function typedSelection() {
  const begin = parseFloat($("from").value), end = parseFloat($("to").value);
  if (Number.isFinite(begin) && Number.isFinite(end) && begin >= 0 && end > begin) { page.selection = [begin, end]; redraw(); return true; }
  $("cut-status").textContent = "Select an interval first: drag on a plot, or type its begin and end.";
  return false;
}

/** Add an interval; intervals that overlap or touch become one. */
function keep() {
  if (!typedSelection()) return;
  const sorted = [...page.intervals, page.selection.map((t) => Math.round(t * 1000) / 1000)].sort((a, b) => a[0] - b[0]);
  const joined = [];
  for (const [begin, end] of sorted) {
    const before = joined.at(-1);
    if (before && begin <= before[1]) before[1] = Math.max(before[1], end); else joined.push([begin, end]);
  }
  setIntervals(joined, "kept");
}

/** Cut the selection out of the intervals; without any, out of the whole log. */
function cutOut() {
  if (!typedSelection()) return;
  const [a, b] = page.selection.map((t) => Math.round(t * 1000) / 1000);
  const before = page.intervals.length ? page.intervals : [[0, Math.floor(page.content.end * 1000) / 1000]];
  const left = before.flatMap(([begin, end]) => (end <= a || begin >= b ? [[begin, end]] : [[begin, a], [b, end]]));
  setIntervals(left.filter(([begin, end]) => end - begin > 0.0005), "cut out");
}

function setIntervals(intervals, done) {
  page.intervals = intervals;
  const total = intervals.reduce((sum, [begin, end]) => sum + end - begin, 0);
  $("cut-status").textContent = `${done}: ${intervals.length} interval${intervals.length === 1 ? "" : "s"}, ${total.toFixed(1)} s`;
  page.selection = null;
  select(null);
  store();
  listIntervals();
}

async function listIntervals() {
  const rows = page.intervals.map(([begin, end], k) => {
    const show = make("button", { type: "button", ariaLabel: `Zoom to interval ${k + 1}` }, "zoom");
    show.addEventListener("click", () => setView(begin - 0.05 * (end - begin), end + 0.05 * (end - begin)));
    const remove = make("button", { type: "button", ariaLabel: `Remove interval ${k + 1}` }, "remove");
    remove.addEventListener("click", () => setIntervals(page.intervals.filter((_, other) => other !== k), "removed"));
    return make("tr", {}, make("td", {}, String(k + 1)), ...[begin, end, end - begin].map((value) => make("td", { className: "num" }, seconds(value))), make("td", {}, show, " ", remove));
  });
  $("intervals").tBodies[0].replaceChildren(...rows);
  $("intervals").hidden = !rows.length;
  $("none").disabled = !rows.length;
  if (!rows.length) {
    $("texts").replaceChildren(make("p", { className: "quiet" }, "Kept intervals become --from and --to of seatrial ident, or [[log]] tables of an import map."));
    return;
  }
  try {
    const interval = page.intervals.map(([begin, end]) => `${seconds(begin)}:${seconds(end)}`);
    const text = await ask("cut", { log: page.log, interval });
    const boxes = [copied("Fit each interval", text.commands), copied("Options of seatrial ident", text.options)];
    boxes.push(text.toml ? copied("Tables for the import map of this log", text.toml)
      : make("p", { className: "quiet" }, "No [[log]] tables: no import map with one clock made this log."));
    $("texts").replaceChildren(...boxes);
  } catch (error) { lost(error); }
}

function copied(title, text) {
  const button = make("button", { type: "button", ariaLabel: `Copy: ${title}` }, "Copy");
  const shown = make("pre", { tabIndex: 0 }, text);
  button.addEventListener("click", async () => {
    try { await navigator.clipboard.writeText(text); button.textContent = "Copied"; } catch {
      getSelection().selectAllChildren(shown);
      button.textContent = "Selected: press Ctrl-C";
    }
    setTimeout(() => { button.textContent = "Copy"; }, 2500);
  });
  return make("div", { className: "text" }, make("h3", {}, title, button), shown);
}

// ---- track

/** Return the colour of a time on the track: cividis, which the colour-blind see as others do. */
function timeColour(share) {
  const stops = matchMedia("(prefers-color-scheme: dark)").matches
    ? [[70, 107, 176], [124, 130, 146], [187, 173, 120], [254, 232, 70]] : [[0, 34, 78], [72, 86, 110], [124, 123, 120], [190, 160, 40]];
  const place = Math.min(Math.max(share, 0), 1) * (stops.length - 1), k = Math.min(Math.floor(place), stops.length - 2);
  return `rgb(${stops[k].map((low, c) => Math.round(low + (place - k) * (stops[k + 1][c] - low))).join(" ")})`;
}

function niceStep(span, count) {
  const raw = span / count, power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= raw);
}

/** Return where a text beside a point begins or ends: on the left of the point if the canvas would cut it on the right. */
function labelPlace(x, size, width) {
  return x + 7 + size <= width ? { align: "left", at: x + 7 } : { align: "right", at: x - 7 };
}

function drawMap() {
  const canvas = $("map"), whole = page.track;
  canvas.hidden = !whole || !whole.t.length;
  if (canvas.hidden) return;
  const ratio = devicePixelRatio, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio)) { canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio); }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  const box = { left: 56, top: 10, right: width - 10, bottom: height - 40 };
  const limits = (values) => values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  const [e0, e1] = limits(whole.east), [n0, n1] = limits(whole.north);
  const scale = Math.min((box.right - box.left) / Math.max(e1 - e0, 1), (box.bottom - box.top) / Math.max(n1 - n0, 1)) * 0.92;
  const x = (east) => (box.left + box.right) / 2 + (east - (e0 + e1) / 2) * scale;
  const y = (north) => (box.top + box.bottom) / 2 - (north - (n0 + n1) / 2) * scale;
  context.font = "12px system-ui, sans-serif";
  context.strokeStyle = colour("--rule"); context.fillStyle = colour("--soft"); context.lineWidth = 1;
  const step = niceStep((box.bottom - box.top) / scale, 5);
  const middle = { e: (e0 + e1) / 2, n: (n0 + n1) / 2 }, half = { e: (box.right - box.left) / 2 / scale, n: (box.bottom - box.top) / 2 / scale };
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  context.textAlign = "center";
  for (let e = Math.ceil((middle.e - half.e) / step) * step, used = -Infinity; e <= middle.e + half.e; e += step) {
    context.beginPath(); context.moveTo(x(e), box.top); context.lineTo(x(e), box.bottom); context.stroke();
    if (x(e) - used > 46) { context.fillText(e.toFixed(digits), x(e), box.bottom + 15); used = x(e); }
  }
  context.textAlign = "right";
  for (let n = Math.ceil((middle.n - half.n) / step) * step; n <= middle.n + half.n; n += step) {
    context.beginPath(); context.moveTo(box.left, y(n)); context.lineTo(box.right, y(n)); context.stroke();
    context.fillText(n.toFixed(digits), box.left - 6, y(n) + 4);
  }
  context.textAlign = "center"; context.fillText("east [m]", (box.left + box.right) / 2, height - 8);
  context.save(); context.translate(12, (box.top + box.bottom) / 2); context.rotate(-Math.PI / 2); context.fillText("north [m]", 0, 0); context.restore();
  const line = (track, from, to, style, thick) => {
    context.lineWidth = thick; context.lineJoin = "round"; context.lineCap = "round";
    let pen = null;
    for (let k = 0; k < track.t.length; k += 1) {
      const t = track.t[k];
      if (t < from || t > to) { pen = null; continue; }
      const place = [x(track.east[k]), y(track.north[k])];
      if (pen) { context.strokeStyle = style(t); context.beginPath(); context.moveTo(...pen); context.lineTo(...place); context.stroke(); }
      pen = place;
    }
  };
  const [begin, end] = page.view;
  line(whole, -Infinity, Infinity, () => colour("--rule"), 2);
  const near = page.trackNear ?? whole;
  const marked = page.selection ? [page.selection] : page.intervals;
  const edge = colour("--ink");
  for (const [from, to] of marked) line(near, from, to, () => edge, 7);
  line(near, begin, end, (t) => timeColour((t - begin) / (end - begin)), 3);
  const mark = (track, k, text) => {
    context.fillStyle = colour("--ink"); context.beginPath(); context.arc(x(track.east[k]), y(track.north[k]), 4, 0, 7); context.fill();
    const place = labelPlace(x(track.east[k]), context.measureText(text).width, width);
    context.textAlign = place.align; context.fillText(text, place.at, Math.max(y(track.north[k]) - 5, 12));
  };
  mark(whole, 0, "start");
  if (page.hover !== null && near.t.length) {
    let k = near.t.findIndex((t) => t >= page.hover);
    k = k < 0 ? near.t.length - 1 : k;
    mark(near, k, `${near.t[k].toFixed(1)} s`);
  }
}

async function loadTrack() {
  const { tracks, end } = page.content;
  if ($("track").length !== tracks.length) {
    $("track").replaceChildren(...tracks.map((name) => make("option", { value: name }, name)));
    $("track-choice").hidden = tracks.length < 2;
  }
  $("track-note").textContent = tracks.length
    ? "Colour: time in view, from dark to light. Thick outline: selection or kept intervals. Grey: the rest of the log."
    : "This log has no position: neither a GNSS receiver with a fix, nor signals x and y.";
  page.track = tracks.length ? await ask("track", { log: page.log, track: $("track").value, from: 0, to: Math.max(end, 1e-3) + 1, points: 1500 }) : null;
}

// ---- events and health

const shownEvents = () => page.content.events.filter((event) => !$("kind").value || event.kind === $("kind").value);

function listEvents(content) {
  const kinds = [...new Set(content.events.map((event) => event.kind))].sort();
  const chosen = $("kind").value;
  $("kind").replaceChildren(make("option", { value: "" }, "all"), ...kinds.map((kind) => make("option", { value: kind }, kind)));
  $("kind").value = kinds.includes(chosen) ? chosen : "";
  const rows = shownEvents().map((event) => {
    const jump = make("button", { type: "button", className: "plain" }, seconds(event.t));
    jump.addEventListener("click", () => {
      const half = Math.min((page.view[1] - page.view[0]) / 2, 30);
      setView(event.t - half, event.t + half);
    });
    const bad = BAD.test(event.kind);
    return make("tr", {}, make("td", { className: "num" }, jump), make("td", { className: bad ? "bad" : "" }, event.kind), make("td", {}, event.text));
  });
  $("events").tBodies[0].replaceChildren(...rows);
  const left = content.n_events - content.events.length;
  $("events-note").textContent = left > 0 ? `${left} events in the middle are left out; seatrial export csv writes all.` : content.n_events ? "" : "This log has no events.";
}

function listHealth(content) {
  const gap = (row) => row.gap !== null && row.rate !== null && row.gap > Math.max(1, 10 / row.rate) && !/command$/.test(row.topic);
  const off = (value, row) => value !== null && row.expected !== null && Math.abs(value - row.expected) > 0.1 * row.expected;
  const silent = (row) => row.expected !== null && row.silent !== null && row.silent > Math.max(1, 5 / row.expected);
  const cell = (text, bad = false) => make("td", { className: bad ? "num bad" : "num" }, bad ? `! ${text}` : text);
  $("rates").tBodies[0].replaceChildren(...content.tables.map((row) => make("tr", {},
    make("td", {}, row.topic), cell(String(row.samples)), cell(number(row.rate, 2), off(row.rate, row)), cell(number(row.recent, 2), off(row.recent, row)),
    cell(number(row.expected, 2)), cell(number(row.gap, 3), gap(row)), cell(number(row.gap_at, 1)), cell(number(row.silent, 2), silent(row)))));
  $("rates").hidden = !content.tables.length;
  $("ports").tBodies[0].replaceChildren(...content.ports.map((row) => make("tr", {}, make("td", {}, row.device), make("td", {}, row.port),
    cell(String(row.bytes_in)), cell(String(row.frames)), ...["checksum_errors", "unparsed_bytes", "dropped", "reconnects"].map((name) => cell(String(row[name]), row[name] > 0)))));
  $("ports").hidden = !content.ports.length;
  $("warnings").replaceChildren(...content.warnings.map((text) => make("li", { className: "warning" }, make("b", {}, "warning "), text)));
}

async function listFindings() {
  const found = await ask("check", { log: page.log });
  const lines = found === null ? [make("li", { className: "quiet" }, "The checks follow when the recording has ended.")]
    : found.map((f) => make("li", { className: f.level }, make("b", {}, f.level), ` ${f.where} ${f.check}: ${f.text} `, make("em", {}, f.advice)));
  $("findings").replaceChildren(...(lines.length ? lines : [make("li", { className: "quiet" }, "These checks are about devices, and the log names none. `seatrial check` also checks signals and motion.")]));
}

// ---- the log as it is now

function showState(content) {
  const words = {
    waiting: "waiting for the recording to begin", live: `● LIVE, ${content.end.toFixed(1)} s`,
    whole: `${content.end.toFixed(1)} s, complete`, "cut off": `${content.end.toFixed(1)} s, without its end (the recording was cut off)`,
  };
  const text = words[content.state] + (content.utc ? `, from ${moment(0)}` : "")
    + (content.shown_from > 0 ? `; samples before ${content.shown_from.toFixed(0)} s are in the file only` : "");
  if ($("state").textContent !== text) $("state").textContent = text;
  $("state").className = content.state === "live" ? "live" : "";
  $("log-name").textContent = content.path;
  document.title = `${content.name} - seatrial view`;
}

async function load(first) {
  const before = page.content;
  const content = await ask("log", { log: page.log });
  page.content = content;
  showState(content);
  const changed = !before || before.end !== content.end || before.state !== content.state || before.n_events !== content.n_events;
  if (first || changed) {
    const fresh = first || !before.tables.length;
    const kept = first ? restore() : null;
    if (fresh && !page.ticked.size && content.tables.length) tickFirst(content);
    listSignals(content);
    listEvents(content);
    listHealth(content);
    await loadTrack();
    if (first) {
      $("follow").checked = content.state === "live" || content.state === "waiting";
      if (kept && !$("follow").checked) page.view = kept.view; else page.view = [0, Math.max(content.end, 1e-3)];
      listIntervals();
    }
    if ($("follow").checked && content.end > 0) {
      const span = content.state === "live" ? LIVE_S : content.end;
      setView(Math.max(content.end - span, 0), Math.max(content.end, Math.min(span, 10)), true);
    } else if (first) { setView(...page.view, true); }
    const panels = panelsOf(content).map((signals) => signals.map((signal) => signal.id).join()).join(";");
    if (fresh || panels !== page.panels.map(({ signals }) => signals.map((signal) => signal.id).join()).join(";")) build(); else await refresh();
    if (first || before.state !== content.state) listFindings().catch(lost);
  }
  if (!$("message").hidden && $("message").textContent.startsWith("The server has ended")) say("");
}

async function poll() {
  try { await load(false); } catch (error) { lost(error); }
  setTimeout(poll, ["live", "waiting"].includes(page.content?.state) ? POLL_MS : IDLE_POLL_MS);
}

async function choose(number) {
  page.log = number;
  Object.assign(page, { content: null, selection: null, track: null, trackNear: null, listed: "" });
  say("");
  try { await load(true); } catch (error) { lost(error); }
}

function wire() {
  $("whole").addEventListener("click", whole);
  $("in").addEventListener("click", () => zoom(0.5));
  $("out").addEventListener("click", () => zoom(2));
  $("back").addEventListener("click", () => pan(-0.5));
  $("forth").addEventListener("click", () => pan(0.5));
  $("to-selection").addEventListener("click", () => { if (typedSelection()) setView(...page.selection); });
  $("follow").addEventListener("change", () => { if ($("follow").checked) load(false).then(() => setView(Math.max(page.content.end - LIVE_S, 0), page.content.end, true)); });
  $("marks").addEventListener("change", redraw);
  $("kind").addEventListener("change", () => { listEvents(page.content); redraw(); });
  $("track").addEventListener("change", () => loadTrack().then(refresh).catch(lost));
  $("search").addEventListener("input", filterSignals);
  $("selection").addEventListener("submit", (event) => { event.preventDefault(); keep(); });
  $("cut").addEventListener("click", cutOut);
  $("clear").addEventListener("click", () => select(null));
  $("none").addEventListener("click", () => setIntervals([], "removed"));
  for (const id of ["from", "to"]) $(id).addEventListener("change", () => { if ($("from").value && $("to").value) typedSelection(); });
  $("log").addEventListener("change", () => choose(Number($("log").value)));
  $("plots").addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = (page.view[1] - page.view[0]) * 0.02, forward = event.key === "ArrowRight";
    if (event.key.startsWith("Arrow") && event.shiftKey && /Left|Right/.test(event.key)) {
      const [begin, end] = page.selection ?? [(page.view[0] + page.view[1]) / 2, (page.view[0] + page.view[1]) / 2];
      const moved = end + (forward ? step : -step);
      select(Math.min(begin, moved), Math.max(begin, moved));
    } else if (event.key === "ArrowLeft") pan(-0.1);
    else if (event.key === "ArrowRight") pan(0.1);
    else if (event.key === "+" || event.key === "=") zoom(0.8);
    else if (event.key === "-") zoom(1.25);
    else if (event.key === "Home" || event.key === "0") whole();
    else if (event.key === "k" || event.key === "K") keep();
    else if (event.key === "x" || event.key === "X") cutOut();
    else if (event.key === "Escape") select(null);
    else return;
    event.preventDefault();
  });
  let width = 0;
  new ResizeObserver(() => {
    if (Math.abs(widthOfPlots() - width) < 2) return;
    width = widthOfPlots();
    for (const { plot } of page.panels) plot.setSize({ width, height: plot.height });
    drawMap();
    refresh();
  }).observe($("plots"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (page.content) build(); });
  if (innerWidth <= 900) $("signals-box").open = false;
}

async function start() {
  wire();
  try {
    const names = await ask("logs");
    $("log").replaceChildren(...names.map((name, k) => make("option", { value: String(k) }, name)));
    $("log-choice").hidden = names.length < 2;
  } catch (error) { lost(error); return; }
  await choose(0);
  setTimeout(poll, POLL_MS);
}

start();
