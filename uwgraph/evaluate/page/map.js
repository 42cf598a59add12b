"use strict";
// The tracks from above: north up, one metre as long east as north.

class TrackMap {
  constructor(host, data, state, onTime) {
    Object.assign(this, { host, data, state, onTime, zoom: 1, middle: null });
    this.svg = svg("svg", { role: "img", tabindex: "0", "aria-label": "map of the tracks, north up" });
    host.append(this.svg);
    const button = (text, label, act) => html("button", { type: "button", textContent: text, ariaLabel: label, onclick: act });
    host.append(html("div", { className: "tools controls" },
      button("+", "zoom in", () => this.magnify(1.6)), button("−", "zoom out", () => this.magnify(1 / 1.6)),
      button("⌂", "whole map", () => this.whole())));
    this.listen();
  }

  tracks() {
    return this.data.entries.filter((entry) => this.state.shown.has(entry.name));
  }

  // East and north of all that is shown.
  extent() {
    const tracks = [...this.tracks(), this.data.reference, this.data.fixes].filter(Boolean);
    const range = (key) => {
      let low = Infinity, high = -Infinity;
      for (const track of tracks) for (const v of track[key]) if (v !== null) { low = Math.min(low, v); high = Math.max(high, v); }
      return low <= high ? [low, high] : [-1, 1];
    };
    return { east: range("east"), north: range("north") };
  }

  draw() {
    const width = Math.max(280, Math.round(this.host.clientWidth));
    const height = width < 500 ? 380 : Math.round(Math.min(620, Math.max(420, width * 0.5)));
    const inner = (this.inner = { x: 62, y: 8, width: width - 82, height: height - 54 });
    const { east, north } = this.extent();
    const fit = Math.max((east[1] - east[0]) / inner.width, (north[1] - north[0]) / inner.height, 1e-3) * 1.08;
    const perPixel = (this.perPixel = fit / this.zoom);
    const [e0, n0] = (this.now = this.middle || [(east[0] + east[1]) / 2, (north[0] + north[1]) / 2]);
    const X = (this.X = scale({ domain: [e0 - (inner.width / 2) * perPixel, e0 + (inner.width / 2) * perPixel] }, inner.x, inner.x + inner.width));
    const Y = (this.Y = scale({ domain: [n0 - (inner.height / 2) * perPixel, n0 + (inner.height / 2) * perPixel] }, inner.y + inner.height, inner.y));
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.svg.style.touchAction = this.zoom > 1 ? "none" : "pan-y pinch-zoom";
    const plane = svg("svg", { ...inner, viewBox: `${inner.x} ${inner.y} ${inner.width} ${inner.height}` });
    plane.append(...this.layers(X, Y), ...this.marks(X, Y));
    this.cursors = svg("g");
    plane.append(this.cursors);
    this.svg.replaceChildren(...this.grid(inner, X, Y), plane, this.ruler(inner), this.compass(inner));
  }

  grid(inner, X, Y) {
    const east = [X.invert(inner.x), X.invert(inner.x + inner.width)];
    const north = [Y.invert(inner.y + inner.height), Y.invert(inner.y)];
    const step = 90 * this.perPixel;
    const made = [svg("rect", { ...inner, class: "frame" })];
    const [across, up] = [ticks(...east, (east[1] - east[0]) / step), ticks(...north, (north[1] - north[0]) / step)];
    const [acrossText, upText] = [tickText(across), tickText(up)];
    for (const e of across)
      made.push(svg("path", { class: "grid", d: `M${X(e)} ${inner.y}v${inner.height}` }),
        svg("text", { x: X(e), y: inner.y + inner.height + 18, "text-anchor": "middle" }, acrossText(e)));
    for (const n of up)
      made.push(svg("path", { class: "grid", d: `M${inner.x} ${Y(n)}h${inner.width}` }),
        svg("text", { x: inner.x - 6, y: Y(n) + 5, "text-anchor": "end" }, upText(n)));
    made.push(svg("text", { x: inner.x, y: inner.y + inner.height + 40 }, "east [m]"),
      svg("text", { x: 14, y: inner.y + inner.height / 2, "text-anchor": "middle",
        transform: `rotate(-90 14 ${inner.y + inner.height / 2})` }, "north [m]"));
    return made;
  }

  layers(X, Y) {
    const made = [];
    const line = (track, css, dash, range) => svg("path", { class: css, "stroke-dasharray": dash || "none",
      d: path(track.east, track.north, X, Y, range || [0, track.east.length - 1]) });
    if (this.data.reference) made.push(line(this.data.reference, "reference"));
    const detail = this.data.entries.find((entry) => entry.name === this.state.detail && this.state.shown.has(entry.name));
    for (const entry of this.tracks()) {
      const zoomed = this.state.domain[0] > this.state.whole[0] || this.state.domain[1] < this.state.whole[1];
      const css = `line c${entry.colour} ${entry === detail ? "strong" : ""}`;
      const whole = line(entry, zoomed ? `${css} faint` : css, entry.dash);
      whole.dataset.series = entry.name;
      made.push(whole);
      if (zoomed) made.push(line(entry, css, entry.dash, visible(entry.t, this.state.domain)));
    }
    for (const [e1, n1, e2, n2] of this.tracks().flatMap((entry) => entry.closures))
      made.push(svg("path", { class: "closure", d: `M${X(e1)} ${Y(n1)}L${X(e2)} ${Y(n2)}` }));
    if (!detail) return made;
    for (const [e, n, a, b, angle] of detail.ellipses)
      made.push(svg("ellipse", { class: `ellipse c${detail.colour}`, rx: a / this.perPixel, ry: b / this.perPixel,
        transform: `translate(${X(e)} ${Y(n)}) rotate(${-angle})` }));
    return made;
  }

  marks(X, Y) {
    const made = [];
    const fixes = this.data.fixes;
    if (fixes) made.push(svg("path", { class: "fixes", d: fixes.east.map((e, i) => SHAPES.cross(X(e), Y(fixes.north[i]))).join("") }));
    const track = this.data.entries.find((entry) => entry.name === this.state.detail) || this.data.reference;
    if (!track) return made;
    let [x, y] = [-Infinity, -Infinity];
    for (const i of this.data.sun.map((t) => nearest(track.t, t)).filter((i) => track.east[i] !== null)) {
      const [cx, cy] = [X(track.east[i]), Y(track.north[i])];
      if (Math.hypot(cx - x, cy - y) < 18) continue; // a chain of rings would hide the track
      made.push(svg("circle", { class: "sun", r: 3, cx, cy }));
      [x, y] = [cx, cy];
    }
    const last = track.east.length - 1;
    made.push(svg("circle", { class: "end", r: 6, cx: X(track.east[0]), cy: Y(track.north[0]) }),
      svg("rect", { class: "end", x: X(track.east[last]) - 5, y: Y(track.north[last]) - 5, width: 10, height: 10 }));
    return made;
  }

  ruler(inner) {
    const longest = 140 * this.perPixel, power = 10 ** Math.floor(Math.log10(longest));
    const length = power * [5, 2, 1].find((s) => s * power <= longest);
    const px = length / this.perPixel, x = inner.x + inner.width - px - 2, y = inner.y + inner.height + 42;
    return svg("g", { class: "ruler" }, svg("path", { d: `M${x} ${y - 5}v5h${px}v-5` }),
      svg("text", { x: x - 6, y: y + 1, "text-anchor": "end" }, length >= 1000 ? `${figure(length / 1000)} km` : `${figure(length)} m`));
  }

  compass(inner) {
    const x = inner.x + 18, y = inner.y + 12;
    return svg("g", { class: "ruler" }, svg("path", { d: `M${x} ${y + 26}v-24l-5 9m5 -9l5 9` }),
      svg("text", { x: x + 9, y: y + 14 }, "N"));
  }

  point(t) {
    const at = (track, css, r) => {
      const i = nearest(track.t, t);
      return i < 0 || track.east[i] === null ? "" : svg("circle", { class: css, r, cx: this.X(track.east[i]), cy: this.Y(track.north[i]) });
    };
    const made = t === null ? [] : this.tracks().map((entry) => at(entry, `here c${entry.colour}`, 5));
    if (t !== null && this.data.reference) made.unshift(at(this.data.reference, "here reference", 7));
    this.cursors.replaceChildren(...made.filter(Boolean));
  }

  whole() { this.zoom = 1; this.middle = null; this.draw(); }

  // Zoom about a place of the map; its middle unless told.
  magnify(by, about = this.now) {
    this.zoom = Math.min(500, Math.max(1, this.zoom * by));
    if (this.zoom === 1) return this.whole();
    const share = 1 - 1 / by;
    this.middle = [this.now[0] + (about[0] - this.now[0]) * share, this.now[1] + (about[1] - this.now[1]) * share];
    return this.draw();
  }

  place(event) {
    const box = this.svg.getBoundingClientRect();
    const unit = this.svg.viewBox.baseVal.width / box.width;
    return [(event.clientX - box.left) * unit, (event.clientY - box.top) * unit];
  }

  listen() {
    let held = null;
    this.svg.addEventListener("pointerdown", (event) => { held = this.place(event); this.seek(...held); });
    this.svg.addEventListener("pointermove", (event) => {
      const [x, y] = this.place(event);
      if (held && event.buttons && (this.zoom > 1 || event.pointerType === "mouse")) {
        this.middle = [this.now[0] - (x - held[0]) * this.perPixel, this.now[1] + (y - held[1]) * this.perPixel];
        held = [x, y];
        this.draw();
      } else this.seek(x, y);
    });
    for (const end of ["pointerup", "pointercancel", "pointerleave"]) this.svg.addEventListener(end, () => { held = null; });
    this.svg.addEventListener("dblclick", () => this.whole());
    this.svg.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return; // the wheel alone scrolls the page
      event.preventDefault();
      const [x, y] = this.place(event);
      this.magnify(event.deltaY < 0 ? 1.25 : 0.8, [this.X.invert(x), this.Y.invert(y)]);
    }, { passive: false });
    this.svg.addEventListener("keydown", (event) => {
      if (event.key === "+") this.magnify(1.6);
      if (event.key === "-") this.magnify(1 / 1.6);
      if (event.key === "Escape") this.whole();
    });
  }

  // The moment at which a track passes nearest to a place.
  seek(x, y) {
    let best = 30 ** 2, when = null;
    for (const track of [...this.tracks(), this.data.reference].filter(Boolean))
      for (let i = 0; i < track.t.length; i++) {
        if (track.east[i] === null) continue;
        const d = (this.X(track.east[i]) - x) ** 2 + (this.Y(track.north[i]) - y) ** 2;
        if (d < best) { best = d; when = track.t[i]; }
      }
    if (when !== null) this.onTime(when);
  }
}
