// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// What is known of each frame of a sequence, over the number of the frame; drawn as wide as the page.

const SVG_NAMES = "http://www.w3.org/2000/svg";
const PLOT = { left: 56, right: 12, gap: 30, band: 22, ticks: 10, arcs: 44, panel: 104 };

function drawn(parent, tag, attributes, text) {
  const element = document.createElementNS(SVG_NAMES, tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

// Up to four round numbers from 0 to the largest value.
function roundTicks(top) {
  const power = 10 ** Math.floor(Math.log10(top / 3));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => top / each <= 4);
  return Array.from({ length: Math.floor(top / step) + 1 }, (_, i) => Number((i * step).toPrecision(6)));
}

class Timeline {
  // record: statuses (a name for each frame), keys (numbers of key frames), loops [[frame, old]],
  // curves [{title, values}]. onPoint gets the frame under the pointer, onPick the one clicked.
  constructor(element, record, onPoint, onPick) {
    Object.assign(this, { element, record, chosen: -1 });
    this.count = record.statuses.length;
    new ResizeObserver(() => this.draw()).observe(element);
    const frameAt = (event) => {
      const box = element.getBoundingClientRect();
      const share = (event.clientX - box.left - PLOT.left) / (box.width - PLOT.left - PLOT.right);
      return Math.min(Math.max(Math.round(share * (this.count - 1)), 0), this.count - 1);
    };
    element.addEventListener("pointermove", (event) => {
      this._place(this.pointer, frameAt(event));
      onPoint(frameAt(event));
    });
    element.addEventListener("click", (event) => onPick(frameAt(event)));
    this.draw();
  }

  x(frame) {
    return PLOT.left + (frame / Math.max(this.count - 1, 1)) * (this.width - PLOT.left - PLOT.right);
  }

  select(frame) {
    this.chosen = frame;
    if (this.cursor) this._place(this.cursor, frame);
  }

  _place(line, frame) {
    line.setAttribute("x1", this.x(frame));
    line.setAttribute("x2", this.x(frame));
    line.setAttribute("visibility", frame < 0 ? "hidden" : "visible");
  }

  draw() {
    if (this.element.clientWidth === this.width) return;
    this.width = this.element.clientWidth;
    const { curves, loops } = this.record;
    const top = 4 + (loops.length ? PLOT.arcs : 0), panels = top + PLOT.band + PLOT.ticks;
    const floor = panels + curves.length * (PLOT.panel + PLOT.gap), height = floor + 40;
    const svg = document.createElementNS(SVG_NAMES, "svg");
    for (const [key, value] of Object.entries({ width: this.width, height, role: "img" })) svg.setAttribute(key, value);
    svg.setAttribute("aria-label", "Status and measurements of each frame");
    if (loops.length) this._loops(svg, top);
    this._band(svg, top);
    for (const [k, curve] of curves.entries()) this._curve(svg, curve, panels + k * (PLOT.panel + PLOT.gap) + PLOT.gap);
    for (const frame of roundTicks(Math.max(this.count - 1, 1)))
      drawn(svg, "text", { x: this.x(frame), y: floor + 16, "text-anchor": "middle" }, frame);
    drawn(svg, "text", { x: this.width / 2, y: floor + 34, "text-anchor": "middle" }, "frame");
    this.pointer = drawn(svg, "line", { class: "pointer", y1: top, y2: floor, visibility: "hidden" });
    this.cursor = drawn(svg, "line", { class: "cursor", y1: top, y2: floor, visibility: "hidden" });
    this.element.replaceChildren(svg);
    this._place(this.cursor, this.chosen);
  }

  // One bar for each run of frames with the same status, and a tick below each key frame.
  _band(svg, top) {
    const { statuses, keys } = this.record, wide = Math.max(this.x(1) - this.x(0), 1);
    for (let first = 0, i = 1; i <= this.count; i++) {
      if (i < this.count && statuses[i] === statuses[first]) continue;
      const x = Math.max(this.x(first) - wide / 2, PLOT.left), end = Math.min(this.x(i - 1) + wide / 2, this.width - PLOT.right);
      drawn(svg, "rect", { class: statuses[first], x, y: top, width: Math.max(end - x, 1.5), height: PLOT.band });
      first = i;
    }
    drawn(svg, "text", { x: PLOT.left - 6, y: top + 15, "text-anchor": "end" }, "status");
    const d = keys.map((frame) => `M${this.x(frame).toFixed(1)} ${top + PLOT.band + 2}v${PLOT.ticks - 3}`).join("");
    drawn(svg, "path", { class: "key", d });
  }

  _loops(svg, top) {
    const longest = Math.max(...this.record.loops.map(([frame, old]) => frame - old));
    const d = this.record.loops.map(([frame, old]) => {
      const [a, b] = [this.x(old), this.x(frame)], high = PLOT.arcs * (0.4 + (1.6 * (frame - old)) / longest);
      return `M${a.toFixed(1)} ${top - 2}Q${((a + b) / 2).toFixed(1)} ${top - 2 - high + 6} ${b.toFixed(1)} ${top - 2}`;
    });
    drawn(svg, "path", { class: "loop", d: d.join("") });
    drawn(svg, "text", { x: PLOT.left - 6, y: top - 12, "text-anchor": "end" }, "loops");
  }

  _curve(svg, { title, values }, top) {
    const known = values.filter((value) => value !== null), highest = Math.max(...known, 1e-9);
    const floor = top + PLOT.panel, y = (value) => floor - (value / (1.05 * highest)) * PLOT.panel;
    drawn(svg, "text", { x: PLOT.left, y: top - 8, class: "title" }, title);
    for (const value of known.length ? roundTicks(highest) : []) {
      drawn(svg, "path", { class: "grid", d: `M${PLOT.left} ${y(value).toFixed(1)}H${this.width - PLOT.right}` });
      drawn(svg, "text", { x: PLOT.left - 6, y: y(value) + 4, "text-anchor": "end" }, value);
    }
    let d = "", begins = true;
    for (const [frame, value] of values.entries()) {
      if (value !== null) {
        const alone = begins && (values[frame + 1] ?? null) === null ? "h.01" : "";
        d += `${begins ? "M" : "L"}${this.x(frame).toFixed(1)} ${y(value).toFixed(1)}${alone}`;
      }
      begins = value === null;
    }
    drawn(svg, "path", { class: "curve", d });
  }
}
