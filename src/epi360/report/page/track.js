// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// The report of a sequence: its way in 3D, what is known of each frame, pictures of key frames.

const FRAME_COLUMNS = ["frame", "image", "time (s)", "status", "points", "speed", "turn (°)", "key frame", "message"];

class Track {
  constructor(data) {
    Object.assign(this, { data, frame: -1, scene: null });
    this.keys = data.pictures.map(({ frame }) => frame);
    this.camera_of = new Map(data.cameras.map((frame, k) => [frame, k]));
    this.says = document.querySelector(".says");
    this.shown = document.querySelector(".chosen");
    const { statuses, keys, loops } = data;
    const curves = data.curves.filter(({ values }) => values.some((value) => value !== null));
    this.timeline = new Timeline(document.querySelector(".timeline"), { statuses, keys, loops, curves },
      (frame) => (this.says.textContent = this.words(frame)), (frame) => this.select(frame));
    this._thumbnails();
    this._table();
    for (const [name, by] of [["earlier", -1], ["later", 1]])
      document.querySelector(`button[name=${name}]`).addEventListener("click", () => this._step(by));
    if (data.scene) this._scene();
    this.shown.hidden = !data.pictures.length;
    const first = data.cameras[0] ?? this.keys[0];
    if (first !== undefined) this.select(first);
  }

  async _scene() {
    const element = document.querySelector(".scene");
    const pick = (number) => this.select(this.data.cameras[number]);
    this.scene = this.data.has_webgl ? await showSceneIn(element, this.data.scene, pick) : null;
    if (!this.scene) this.scene = drawPlan(element, this.data.scene, pick);
    this._mark();
  }

  words(frame) {
    const { names, times, statuses, curves, messages } = this.data;
    const parts = [`Frame ${frame} (${names[frame]}, ${times[frame]} s): ${statuses[frame]}`];
    for (const { title, values } of curves)
      if (values[frame] !== null && statuses[frame] === "tracked") parts.push(`${title}: ${values[frame]}`);
    if (this.data.keys.includes(frame)) parts.push("key frame");
    if (messages[frame]) parts.push(messages[frame]);
    return `${parts.join("; ")}.`;
  }

  // Choose a frame: its place in the plot, and the picture of the nearest key frame that has one.
  select(frame) {
    this.frame = frame;
    this.timeline.select(frame);
    const { pictures } = this.data;
    if (!pictures.length) return;
    const away = this.keys.map((key) => Math.abs(key - frame));
    this.number = away.indexOf(Math.min(...away));
    const { frame: key, picture } = pictures[this.number];
    this.shown.querySelector("img").src = picture;
    this.shown.querySelector("figcaption").textContent = this.words(key);
    for (const [k, button] of document.querySelectorAll(".thumbnails button").entries())
      button.setAttribute("aria-pressed", k === this.number);
    this._mark();
  }

  _mark() {
    const camera = this.number === undefined ? this.camera_of.get(this.frame) : this.camera_of.get(this.keys[this.number]);
    if (this.scene) this.scene.select(camera ?? -1);
  }

  _step(by) {
    const place = this.number + by;
    if (place >= 0 && place < this.keys.length) this.select(this.keys[place]);
  }

  _thumbnails() {
    const all = this.data.pictures.map(({ frame, picture }) => {
      const status = this.data.statuses[frame];
      const button = made("button", undefined, { className: status });
      const note = status === "tracked" ? this.data.names[frame] : `${status}: ${this.data.names[frame]}`;
      button.append(made("img", undefined, { src: picture, alt: "", loading: "lazy" }), made("span", `frame ${frame}`), made("small", note));
      button.addEventListener("click", () => this.select(frame));
      return button;
    });
    document.querySelector(".thumbnails").append(...all);
  }

  _table() {
    const { names, times, statuses, curves, keys, messages } = this.data, is_key = new Set(keys);
    const text = document.querySelector("input[name=text]"), status = document.querySelector("select[name=status]");
    const only_keys = document.querySelector("input[name=keys]");
    this.table = new SortedTable(document.querySelector(".table"), {
      titles: FRAME_COLUMNS, noun: "frames", rows: names.map((_, frame) => frame),
      values: (frame) => [frame, names[frame], times[frame], statuses[frame], ...curves.map(({ values }) => values[frame]),
        is_key.has(frame) ? "yes" : "no", messages[frame] || ""],
      passes: (frame, values) => (!status.value || statuses[frame] === status.value) && (!only_keys.checked || is_key.has(frame)) &&
        `${names[frame]} ${values[8]}`.toLowerCase().includes(text.value.toLowerCase()),
      built: (frame, values) => this._row(frame, values),
    });
  }

  _row(frame, values) {
    const row = plainRow(values, { 7: (value) => (value === "yes" ? "yes" : "") }, this.data.statuses[frame]);
    const button = made("button", frame, { className: "open" });
    button.addEventListener("click", () => {
      this.select(frame);
      document.querySelector(".timeline").scrollIntoView({ block: "center" });
    });
    row.firstChild.replaceChildren(button);
    return row;
  }
}

// The way from above where there is no WebGL: x to the right, z up the page.
function drawPlan(element, record, onPick) {
  const way = floats(record.path), svg = document.createElementNS(SVG_NAMES, "svg");
  const { middle, reach } = record, size = 400, scale = size / 2.4 / reach;
  const place = (x, z) => [size / 2 + scale * (x - middle[0]), size / 2 - scale * (z - middle[2])].map((value) => value.toFixed(1));
  svg.setAttribute("viewBox", `0 0 ${size} ${size}`);
  let d = "";
  for (let i = 0, begins = true; i < way.length; i += 3) {
    const known = Number.isFinite(way[i]);
    if (known) d += `${begins ? "M" : "L"}${place(way[i], way[i + 2]).join(" ")}`;
    begins = !known;
  }
  drawn(svg, "path", { class: "way", d });
  for (const ends of record.loops || [])
    drawn(svg, "path", { class: "loop", d: `M${ends.map(([x, , z]) => place(x, z).join(" ")).join("L")}` });
  const dots = record.cameras.map(({ centre }, k) => {
    const [cx, cy] = place(centre[0], centre[2]);
    const dot = drawn(svg, "circle", { class: "camera", cx, cy, r: 4 });
    dot.addEventListener("click", () => onPick(k));
    return dot;
  });
  element.replaceChildren(svg);
  element.dataset.drawn = "plan";
  return { select: (number) => dots.forEach((dot, k) => dot.classList.toggle("selected", k === number)) };
}

window.track = new Track(readJson("data"));
