"use strict";
// The page: who is shown, which stretch of time, where the cursor is; and the sections that follow them.

const data = JSON.parse(document.getElementById("data").textContent);
const times = data.entries.flatMap((entry) => [entry.t[0], entry.t[entry.t.length - 1]]);
const span = times.length ? [Math.min(...times), Math.max(...times)] : [0, 1];
const whole = span[1] > span[0] ? span : [span[0] - 1, span[1] + 1];
const state = {
  shown: new Set(data.entries.map((entry) => entry.name)),
  detail: document.body.dataset.detail,
  whole, domain: whole, cursor: null,
};
const timed = [], others = [];
let map = null;

const shown = () => data.entries.filter((entry) => state.shown.has(entry.name))
  .sort((a, b) => (a.name === state.detail) - (b.name === state.detail)); // the one in detail on top
const look = (entry) => ({ name: entry.name, colour: entry.colour, dash: entry.dash, strong: entry.name === state.detail });
const finite = (values) => values.filter((v) => v !== null);
const capital = (text) => text[0].toUpperCase() + text.slice(1);

function drawAll() {
  map?.draw();
  for (const panel of [...timed, ...others]) panel.draw();
  moveCursor(state.cursor);
}

function moveCursor(t, teller = null) {
  state.cursor = t;
  for (const panel of timed) panel.point(t, panel === teller);
  map?.point(t);
}

function zoomTo(domain) {
  const [low, high] = [Math.max(domain[0], state.whole[0]), Math.min(domain[1], state.whole[1])];
  state.domain = high - low > 1e-3 * (state.whole[1] - state.whole[0]) ? [low, high] : state.domain;
  document.getElementById("whole").disabled = state.domain[0] === state.whole[0] && state.domain[1] === state.whole[1];
  drawAll();
}

// Drag along the time axis zooms, a double click or Escape shows the whole dive, arrows move the cursor.
function timeInteraction(panel) {
  let from = null;
  const drop = () => { from = null; panel.selection?.setAttribute("visibility", "hidden"); };
  panel.svg.addEventListener("pointerdown", (event) => { if (event.button === 0) from = panel.at(event); });
  panel.svg.addEventListener("pointermove", (event) => {
    const t = panel.at(event);
    moveCursor(t, panel);
    if (from === null || !event.buttons) return drop();
    const [a, b] = [panel.X(Math.min(from, t)), panel.X(Math.max(from, t))];
    for (const [key, value] of Object.entries({ x: a, width: b - a, visibility: "visible" })) panel.selection.setAttribute(key, value);
  });
  panel.svg.addEventListener("pointerup", (event) => {
    const start = from, t = panel.at(event);
    drop();
    if (start !== null && Math.abs(panel.X(start) - panel.X(t)) > 12) zoomTo([Math.min(start, t), Math.max(start, t)]);
    else moveCursor(t, panel);
  });
  panel.svg.addEventListener("pointercancel", drop);
  panel.svg.addEventListener("pointerleave", (event) => { drop(); if (event.pointerType === "mouse") moveCursor(null); });
  panel.svg.addEventListener("dblclick", () => zoomTo(state.whole));
  panel.svg.addEventListener("keydown", (event) => {
    const step = (state.domain[1] - state.domain[0]) / 100, now = state.cursor ?? state.domain[0];
    if (event.key === "ArrowRight") moveCursor(Math.min(now + step, state.domain[1]), panel);
    else if (event.key === "ArrowLeft") moveCursor(Math.max(now - step, state.domain[0]), panel);
    else if (event.key === "Escape") zoomTo(state.whole);
    else return;
    event.preventDefault();
  });
}

function hoverInteraction(panel) {
  panel.svg.addEventListener("pointermove", (event) => panel.point(panel.at(event), true));
  panel.svg.addEventListener("pointerleave", () => panel.point(null));
}

function addPanel(parent, title, spec, { time = true, height } = {}) {
  const host = html("div", { className: "host" });
  host.dataset.title = title;
  if (height) host.dataset.height = height;
  parent.append(html("figure", { className: "panel" }, html("figcaption", { textContent: title }), host));
  (time ? timed : others).push(new Panel(host, spec, time ? timeInteraction : hoverInteraction));
}

const timeAxis = (label) => ({ domain: state.domain, time: true, label });

// Half the height of a panel: six times what the middle one of those shown needs, at most. Of [name, need, error].
function frame(needs) {
  const known = needs.map(([, need]) => need).filter((need) => need > 0).sort((a, b) => a - b);
  if (!known.length) return { limit: 1, note: "" };
  const limit = 1.1 * Math.min(known[known.length - 1], 6 * known[(known.length - 1) >> 1]);
  const beyond = needs.filter(([, , error]) => error > limit).map(([name, , error]) => `${name} (up to ${figure(error)})`);
  return { limit, note: beyond.length ? `Beyond the frame: ${beyond.join(", ")}` : "" };
}

const inDomain = (xs, ys) => finite(ys.filter((_, i) => xs[i] >= state.domain[0] && xs[i] <= state.domain[1]));
const largest = (values) => values.reduce((most, v) => Math.max(most, Math.abs(v)), 0);
const withLargest = (one) => [one.name, ...Array(2).fill(largest(inDomain(one.x, one.y)))];
const quantile = (values, q) => (values.length ? [...values].sort((a, b) => a - b)[Math.floor(q * (values.length - 1))] : 0);

function errorSpec(column, unit, label) {
  const series = shown().filter((entry) => entry.error || entry.sigma).map((entry) => {
    const y = entry.error ? entry.error[column] : entry.t.map(() => null);
    const band = entry.sigma && entry.sigma[column].map((s) => (s === null ? null : 3 * s));
    return { ...look(entry), x: entry.t, y, band,
      value: (i) => `${figure(y[i])} ${unit}${band && band[i] !== null ? ` ± ${figure(band[i])}` : ""}` };
  });
  const { limit, note } = frame(series.map((one) => {
    const error = largest(inDomain(one.x, one.y));
    const band = one.band ? quantile(inDomain(one.x, one.band), 0.98) : 0;
    return [one.name, Math.max(error, error > 0 ? Math.min(band, 5 * error) : band), error];
  }));
  return { x: timeAxis(label), y: { domain: [-limit, limit] }, rules: [{ y: 0 }], series, note };
}

function sigmaSpec(column, unit, label) {
  const series = shown().filter((entry) => entry.sigma).map((entry) =>
    ({ ...look(entry), x: entry.t, y: entry.sigma[column], value: (i) => `${figure(entry.sigma[column][i])} ${unit}` }));
  // the first sigma of a filter that does not know where it is does not set the frame
  const { limit, note } = frame(series.map((one) => {
    const sigmas = inDomain(one.x, one.y);
    return [one.name, quantile(sigmas, 0.98), largest(sigmas)];
  }));
  return { x: timeAxis(label), y: { domain: [0, limit] }, series, note };
}

function errors(parent) {
  data.quantities.forEach(({ name, unit }, column) => {
    const label = column === data.quantities.length - 1 ? undefined : false;
    const spec = data.judged ? errorSpec : sigmaSpec;
    addPanel(parent, `${capital(name)} ${data.judged ? "error" : "1-sigma"} [${unit}]`, () => spec(column, unit, label),
      { height: column > 3 ? 150 : undefined });
  });
}

const AXIS_SHAPES = ["dot", "square", "triangle"];

function whitenedSpec(kind) {
  // the one in detail, or the next that is shown and has innovations
  const entry = shown().reverse().find((one) => one.sensors[kind]);
  const sensor = entry?.sensors[kind];
  if (!sensor) return { x: timeAxis(), y: { domain: [-4, 4] }, series: [], note: "no estimator shown has any" };
  const used = sensor.whitened.flatMap((column) => finite(column.filter((_, i) => !sensor.refused[i])));
  const limit = Math.max(4, 1.05 * Math.min(largest(used), 1.4 * quantile(used.map(Math.abs), 0.99)));
  const held = (v) => (v === null ? null : Math.min(Math.max(v, -0.97 * limit), 0.97 * limit));
  const series = sensor.whitened.flatMap((column, axis) => {
    const name = sensor.whitened.length > 1 ? `axis ${axis + 1}` : kind;
    const base = { ...look(entry), name, dash: "", x: sensor.t, y: column.map(held), shape: AXIS_SHAPES[axis % 3] };
    return [{ ...base, kind: "dots", keep: (i) => !sensor.refused[i], value: (i) => `${figure(column[i])}${sensor.refused[i] ? " refused" : ""}` },
      { ...base, kind: "crosses", keep: (i) => sensor.refused[i] === 1 }];
  });
  const refusals = sensor.refusals ? `; ${sensor.refusals} refused (crosses, at the edge where they lie beyond it)` : "; none refused";
  return { x: timeAxis(), y: { domain: [-limit, limit] }, series,
    rules: [{ y: 0 }, { y: 3, kind: "bound" }, { y: -3, kind: "bound" }],
    note: `${entry.name}: ${sensor.measurements} measurements${refusals}` };
}

function around(values, low, high) {
  const positive = values.filter((v) => v > 0);
  return [0.9 * Math.min(low, ...positive), 1.1 * Math.max(high, ...positive)];
}

function nisSpec(kind) {
  const running = shown().filter((entry) => entry.sensors[kind]?.running).map((entry) => [entry, entry.sensors[kind].running]);
  const series = running.map(([entry, r]) => ({ ...look(entry), x: r.t, y: r.nis, value: (i) => figure(r.nis[i]) }));
  const [low, high] = running[0]?.[1].bounds || [0.5, 2];
  return { x: timeAxis(), y: { domain: around(series.flatMap((one) => finite(one.y)), Math.max(low, 0.05), high), log: true }, series,
    rules: [{ y: 1 }, { y: low, kind: "bound" }, { y: high, kind: "bound" }],
    note: running.length ? `mean of the last ${running[0][1].window} used; dashed: 95 % interval` : "" };
}

function noiseSpec(kind) {
  const series = shown().filter((entry) => entry.sensors[kind]).flatMap((entry) => {
    const sensor = entry.sensors[kind];
    return sensor.noise.map((column, axis) => ({ ...look(entry), x: sensor.noise_t, y: column,
      name: sensor.noise.length > 1 ? `${entry.name} axis ${axis + 1}` : entry.name, value: (i) => figure(column[i]) }));
  });
  return { x: timeAxis(), y: { domain: around(series.flatMap((one) => finite(one.y)), 0.8, 1.25), log: true }, series, rules: [{ y: 1 }] };
}

function fadingSpec() {
  const faded = shown().filter((entry) => entry.fading);
  const series = faded.map((entry) => ({ ...look(entry), kind: "dots", shape: "disc", foot: 1,
    x: entry.fading.t, y: entry.fading.factor, value: (i) => figure(entry.fading.factor[i]) }));
  const note = faded.map(({ name, colour, dash, fading }) => html("span", { className: "named" }, swatch({ colour, dash }),
    `${name}: at ${fading.times} of ${fading.measurements} measurements, up to ${figure(largest(fading.factor))}`));
  return { x: timeAxis(), y: { domain: around(series.flatMap((one) => one.y), 1, 2), log: true }, series, rules: [{ y: 1 }], note };
}

function innovations(parent) {
  const kinds = [...new Set(data.entries.flatMap((entry) => Object.keys(entry.sensors)))];
  for (const kind of kinds) {
    const row = html("div", { className: "row" });
    parent.append(html("h3", { textContent: kind }), row);
    addPanel(row, "Innovation [stated sigmas]", () => whitenedSpec(kind), { height: 210 });
    addPanel(row, "Running NIS", () => nisSpec(kind), { height: 210 });
    addPanel(row, "Believed over stated sigma", () => noiseSpec(kind), { height: 210 });
  }
  if (!data.entries.some((entry) => entry.fading)) return;
  parent.append(html("h3", { textContent: "Fading factor" }));
  addPanel(parent, "What the predicted covariance was multiplied by", fadingSpec);
}

function directions(parent) {
  for (const found of data.directions)
    addPanel(parent, `${capital(found.name)} residual [deg]`, () => {
      const series = shown().map((entry) => {
        const y = found.residual[data.entries.indexOf(entry)];
        return { ...look(entry), kind: "dots", x: found.t, y, value: (i) => `${figure(y[i])} deg` };
      });
      const { limit, note } = frame(series.map((one) => withLargest(one)));
      const rules = found.sigma ? [{ y: 3 * found.sigma, kind: "bound" }, { y: -3 * found.sigma, kind: "bound" }] : [];
      return { x: timeAxis(), y: { domain: [-limit, limit] }, series, rules: [{ y: 0 }, ...rules], note };
    });
}

function sizes(parent) {
  if (data.entries.some((entry) => entry.distribution))
    addPanel(parent, "Share of the time below a horizontal error [%]", () => {
      const series = shown().filter((entry) => entry.distribution).map((entry) => {
        const { error, percent } = entry.distribution;
        return { ...look(entry), x: error, y: percent, value: (i) => `${figure(percent[i])} %` };
      });
      const all = series.flatMap((one) => one.x).filter((v) => v > 0);
      const high = all.length ? Math.max(...all) : 1;
      const low = Math.min(high / 2, ...series.map((one) => quantile(one.x.filter((v) => v > 0), 0.04)));
      return { x: { domain: [Math.max(low, high / 1e4), high], log: true, label: "horizontal error [m]", unit: "m" }, y: { domain: [0, 100] },
        series: series.map((one) => ({ ...one, x: one.x.map((v) => Math.max(v, high / 1e5)) })) };
    }, { time: false, height: 260 });
  if (!data.entries.some((entry) => entry.rpe.length)) return;
  for (const [key, title] of [["translation_rmse_percent", "Relative position error [% of the way]"], ["heading_rmse_deg", "Relative heading error [deg]"]])
    addPanel(parent, title, () => {
      const series = shown().filter((entry) => entry.rpe.length).map((entry) => {
        const y = entry.rpe.map((row) => row[key] ?? null);
        return { ...look(entry), x: entry.rpe.map((row) => row.distance_m), y, value: (i) => `${figure(y[i])} (${entry.rpe[i].pairs} pairs)` };
      });
      const [low, high] = around(series.flatMap((one) => one.x), Infinity, 0);
      const top = 1.1 * largest(series.flatMap((one) => finite(one.y))) || 1;
      return { x: { domain: isFinite(low) ? [low, high] : [1, 10], log: true, label: "over a distance of [m]", unit: "m" }, y: { domain: [0, top] }, series };
    }, { time: false, height: 260 });
}

function controls() {
  const box = document.getElementById("toggles");
  for (const entry of data.entries) {
    const input = html("input", { type: "checkbox", checked: true, onchange: () => {
      state.shown[input.checked ? "add" : "delete"](entry.name);
      drawAll();
    } });
    input.setAttribute("aria-label", `show ${entry.name}`);
    box.append(html("label", {}, input, swatch(entry), entry.name));
  }
  const select = document.getElementById("detail");
  for (const entry of data.entries) select.append(html("option", { value: entry.name, textContent: entry.name, selected: entry.name === state.detail }));
  select.onchange = () => { state.detail = select.value; drawAll(); };
  document.getElementById("whole").onclick = () => zoomTo(state.whole);
  document.getElementById("bar").open = window.innerWidth > 700;
}

function sortable(table) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  const key = (row, column) => {
    const cell = row.cells[column];
    return column === 0 ? cell.textContent : cell.dataset.value === undefined ? Infinity : +cell.dataset.value;
  };
  heads.forEach((head, column) => {
    head.querySelector("button").onclick = () => {
      const sign = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", sign === 1 ? "ascending" : "descending");
      const order = (a, b) => { // what is not known stays last
        const [x, y] = [key(a, column), key(b, column)];
        return x === y ? 0 : x === Infinity ? 1 : y === Infinity ? -1 : x < y ? -sign : sign;
      };
      body.append(...[...body.rows].sort(order));
    };
  });
}

// Says so where a table is wider than its box, until its end is in sight.
function tellMore(box) {
  const more = () => box.classList.toggle("more", box.scrollLeft + box.clientWidth < box.scrollWidth - 2);
  box.addEventListener("scroll", more);
  new ResizeObserver(more).observe(box);
}

const place = (id) => document.getElementById(id);
if (place("results")) sortable(place("results"));
for (const box of document.querySelectorAll(".scroll")) tellMore(box);
if (data.entries.length) {
  controls();
  map = new TrackMap(place("map"), data, state, (t) => moveCursor(t));
  errors(place("errors"));
  if (place("innovations")) innovations(place("innovations"));
  if (place("directions")) directions(place("directions"));
  if (place("sizes")) sizes(place("sizes"));
  let width = 0;
  new ResizeObserver(() => {
    const now = place("errors").clientWidth;
    if (now !== width) { width = now; drawAll(); }
  }).observe(place("errors"));
  drawAll();
}
document.body.dataset.ready = "yes";
