"use strict";
// Drawing: an SVG panel with lines, bands and dots. Colours come from the page's style sheet.

const SVG = "http://www.w3.org/2000/svg";

function svg(name, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

function html(name, properties = {}, ...children) {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
}

// A number as people read it, to about four digits.
function figure(value) {
  if (value === null || value === undefined || !isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e6)) return value.toExponential(2);
  return String(+value.toPrecision(size >= 1000 ? 4 : 3)).replace("-", "−");
}

// Round numbers from low to high, about `count` of them, and three at least: one or two do not make a scale.
function ticks(low, high, count, steps = [1, 2, 5, 10]) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const finer = [power / 10, power].flatMap((p) => steps.map((s) => s * p));
  const round = finer.findIndex((step) => step >= rough * 0.999);
  const marks = (step) => {
    const first = Math.ceil(low / step - 1e-9);
    return Array.from({ length: Math.max(0, Math.floor(high / step + 1e-9) - first + 1) }, (_, i) => (first + i) * step);
  };
  return finer.slice(0, round + 1).reverse().map(marks).find((found) => found.length >= 3) || [];
}

// Marks as people write them: to the digit in which they differ.
function tickText(marks) {
  const decimals = Math.max(0, -Math.floor(Math.log10(marks[1] - marks[0]) + 1e-9));
  return (value) => (decimals > 4 ? figure(value) : String(+value.toFixed(decimals)).replace("-", "−"));
}

function logTicks(low, high, count) {
  const all = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++)
    for (const s of [1, 2, 5]) all.push(s * 10 ** power);
  const inside = all.filter((v) => v >= low * 0.999 && v <= high * 1.001);
  if (inside.length < 3) return ticks(low, high, count);
  return inside.length > 7 ? inside.filter((v) => String(v.toExponential())[0] === "1") : inside;
}

// Time ticks in seconds at round minutes, and how to write them.
function timeTicks(low, high, count) {
  const unit = high - low > 180 ? 60 : 1;
  const marks = ticks(low / unit, high / unit, count, unit === 60 ? [1, 2, 3, 5, 10] : [1, 2, 5, 10]);
  const text = tickText(marks);
  return { marks: marks.map((v) => v * unit), text: (t) => text(t / unit), label: unit === 60 ? "time [min]" : "time [s]" };
}

function clock(t) {
  const s = Math.abs(t), minutes = Math.floor(s / 60);
  return `${t < 0 ? "−" : ""}${minutes}:${(s % 60).toFixed(1).padStart(4, "0")} min`;
}

// Index of the value nearest to x in an ascending list, or -1.
function nearest(xs, x) {
  if (!xs.length) return -1;
  let low = 0, high = xs.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (xs[middle] <= x) low = middle; else high = middle;
  }
  return x - xs[low] <= xs[high] - x ? low : high;
}

// First and last index to draw: those inside and one neighbour on either side.
function visible(xs, [low, high]) {
  let from = 0, to = xs.length - 1;
  while (from < to && xs[from + 1] < low) from++;
  while (to > from && xs[to - 1] > high) to--;
  return [from, to];
}

function path(xs, ys, X, Y, [from, to]) {
  let d = "", pen = "M";
  for (let i = from; i <= to; i++) {
    if (xs[i] === null || ys[i] === null) { pen = "M"; continue; }
    d += `${pen}${X(xs[i]).toFixed(1)} ${Y(ys[i]).toFixed(1)}`;
    pen = "L";
  }
  return d;
}

function bandPath(xs, half, X, Y, [from, to]) {
  let d = "", run = [];
  const close = () => {
    if (run.length > 1) {
      const up = run.map((i) => `${X(xs[i]).toFixed(1)} ${Y(half[i]).toFixed(1)}`);
      const down = run.reverse().map((i) => `${X(xs[i]).toFixed(1)} ${Y(-half[i]).toFixed(1)}`);
      d += `M${up.join("L")}L${down.join("L")}Z`;
    }
    run = [];
  };
  for (let i = from; i <= to; i++) half[i] === null ? close() : run.push(i);
  close();
  return d;
}

const SHAPES = {
  dot: (x, y) => `M${x - 1.7} ${y}a1.7 1.7 0 1 0 3.4 0a1.7 1.7 0 1 0 -3.4 0`,
  square: (x, y) => `M${x - 1.6} ${y - 1.6}h3.2v3.2h-3.2z`,
  triangle: (x, y) => `M${x} ${y - 2.2}l2.1 3.8h-4.2z`,
  disc: (x, y) => `M${x - 4} ${y}a4 4 0 1 0 8 0a4 4 0 1 0 -8 0`,
  cross: (x, y) => `M${x - 3} ${y - 3}l6 6m-6 0l6 -6`,
};

function dotsPath(xs, ys, X, Y, [from, to], shape, keep) {
  let d = "";
  for (let i = from; i <= to; i++)
    if (ys[i] !== null && (!keep || keep(i))) d += SHAPES[shape](+X(xs[i]).toFixed(1), +Y(ys[i]).toFixed(1));
  return d;
}

// Lines that stand on y = foot.
function stemsPath(xs, ys, foot, X, Y, [from, to]) {
  let d = "";
  for (let i = from; i <= to; i++) if (ys[i] !== null) d += `M${X(xs[i]).toFixed(1)} ${Y(foot).toFixed(1)}V${Y(ys[i]).toFixed(1)}`;
  return d;
}

// A panel. `spec` says what to draw, anew at every draw():
//   {x: {domain, log, time, label}, y: {domain, log}, rules: [{y, kind}], note (text, or elements),
//    series: [{name, colour, dash, x, y, band, kind: line|dots|crosses, foot, shape, keep, strong, value(i)}]}
class Panel {
  constructor(host, spec, interaction) {
    Object.assign(this, { host, spec });
    this.svg = svg("svg", { role: "img", tabindex: "0", "aria-label": host.dataset.title });
    this.readout = html("div", { className: "readout", hidden: true });
    this.note = html("p", { className: "note" });
    host.append(this.svg, this.readout, this.note);
    interaction?.(this);
  }

  draw() {
    const spec = (this.now = this.spec());
    const width = Math.max(280, Math.round(this.host.clientWidth));
    const height = this.host.dataset.height ? +this.host.dataset.height : width < 500 ? 180 : 190;
    const room = { left: 62, right: 20, top: 8, bottom: spec.x.label === false ? 26 : 46 };
    const inner = (this.inner = { x: room.left, y: room.top, width: width - room.left - room.right,
      height: height - room.top - room.bottom });
    const X = (this.X = scale(spec.x, inner.x, inner.x + inner.width));
    const Y = scale(spec.y, inner.y + inner.height, inner.y);
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.svg.replaceChildren(...this.axes(spec, inner, X, Y));
    // a nested svg clips what leaves the frame
    const plane = svg("svg", { ...inner, viewBox: `${inner.x} ${inner.y} ${inner.width} ${inner.height}` });
    for (const rule of spec.rules || [])
      plane.append(svg("path", { d: `M${inner.x} ${Y(rule.y)}h${inner.width}`, class: `rule ${rule.kind || ""}` }));
    for (const one of spec.series) plane.append(...this.series(one, spec, X, Y));
    this.cursor = svg("path", { class: "cursor", d: `M0 ${inner.y}v${inner.height}`, visibility: "hidden" });
    this.selection = svg("rect", { class: "selection", y: inner.y, height: inner.height, visibility: "hidden" });
    this.svg.append(plane, this.cursor, this.selection);
    this.note.replaceChildren(...[spec.note || []].flat());
  }

  axes(spec, inner, X, Y) {
    const across = spec.x.time ? timeTicks(...spec.x.domain, inner.width / 80)
      : { marks: (spec.x.log ? logTicks : ticks)(...spec.x.domain, inner.width / 80), text: figure, label: spec.x.label };
    const up = (spec.y.log ? logTicks : ticks)(...spec.y.domain, Math.max(3, inner.height / 32));
    const made = [svg("rect", { ...inner, class: "frame" })];
    for (const x of across.marks)
      made.push(svg("path", { class: "grid", d: `M${X(x)} ${inner.y}v${inner.height}` }),
        svg("text", { x: X(x), y: inner.y + inner.height + 18, "text-anchor": "middle" }, across.text(x)));
    for (const y of up)
      made.push(svg("path", { class: "grid", d: `M${inner.x} ${Y(y)}h${inner.width}` }),
        svg("text", { x: inner.x - 6, y: Y(y) + 5, "text-anchor": "end" }, figure(y)));
    if (spec.x.label !== false)
      made.push(svg("text", { x: inner.x + inner.width / 2, y: inner.y + inner.height + 38, "text-anchor": "middle" }, across.label));
    return made;
  }

  series(one, spec, X, Y) {
    const range = spec.x.log ? [0, one.x.length - 1] : visible(one.x, spec.x.domain);
    const css = `c${one.colour}`;
    const made = [];
    if (one.band)
      made.push(svg("path", { class: `band ${css} ${one.strong ? "strong" : ""}`, d: bandPath(one.x, one.band, X, Y, range) }));
    if (one.foot !== undefined)
      made.push(svg("path", { class: `stems ${css}`, d: stemsPath(one.x, one.y, one.foot, X, Y, range) }));
    if (one.kind === "dots")
      made.push(svg("path", { class: `dots ${css}`, d: dotsPath(one.x, one.y, X, Y, range, one.shape || "dot", one.keep) }));
    else if (one.kind === "crosses")
      made.push(svg("path", { class: `crosses ${css}`, d: dotsPath(one.x, one.y, X, Y, range, "cross", one.keep) }));
    else made.push(svg("path", { class: `line ${css} ${one.strong ? "strong" : ""}`, "stroke-dasharray": one.dash || "none",
      d: path(one.x, one.y, X, Y, range) }));
    for (const element of made) element.dataset.series = one.name;
    return made;
  }

  // The vertical line at x; with `tell` also the values there.
  point(x, tell) {
    const [low, high] = this.now.x.domain;
    const inside = x !== null && x >= low && x <= high;
    this.cursor.setAttribute("visibility", inside ? "visible" : "hidden");
    if (inside) this.cursor.setAttribute("transform", `translate(${this.X(x)} 0)`);
    this.readout.hidden = !(inside && tell);
    if (!this.readout.hidden) this.tell(x);
  }

  tell(x) {
    const { domain } = this.now.x;
    const rows = [];
    for (const one of this.now.series) {
      const i = nearest(one.x, x);
      if (i < 0 || !one.value || Math.abs(this.X(one.x[i]) - this.X(x)) > 0.05 * this.inner.width) continue;
      rows.push(html("div", {}, swatch(one), html("b", { textContent: one.name }), ` ${one.value(i)}`));
    }
    const head = this.now.x.time ? clock(x) : `${figure(x)} ${this.now.x.unit || ""}`;
    this.readout.replaceChildren(html("div", { textContent: head }), ...rows);
    const right = this.X(x) < this.X(domain[0]) + this.inner.width / 2;
    this.readout.classList.toggle("right", right);
  }

  // Where a pointer is along x.
  at(event) {
    const box = this.svg.getBoundingClientRect();
    const px = ((event.clientX - box.left) / box.width) * this.svg.viewBox.baseVal.width;
    return this.X.invert(Math.min(Math.max(px, this.inner.x), this.inner.x + this.inner.width));
  }
}

function scale({ domain: [low, high], log }, from, to) {
  const f = log ? Math.log10 : (v) => v;
  const share = (to - from) / (f(high) - f(low));
  const map = (v) => from + (f(v) - f(low)) * share;
  map.invert = (px) => { const v = f(low) + (px - from) / share; return log ? 10 ** v : v; };
  return map;
}

function swatch({ colour, dash }) {
  const line = svg("path", { d: "M1 6h26", class: `line strong c${colour}`, "stroke-dasharray": dash || "none" });
  return svg("svg", { viewBox: "0 0 28 12", class: "swatch", "aria-hidden": "true" }, line);
}
