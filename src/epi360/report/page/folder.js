// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// The report of a folder: graph, table, thumbnails, and one pair at a time in a dialog.

const COLUMNS = ["images", "verdict", "probability", "σ rotation (°)", "σ direction (°)", "inliers", "matches",
  "noise (°)", "parallax (°)", "reason"];
const DIGITS = { 3: 2, 4: 2, 7: 3, 8: 1 }; // behind the point, by column
const SVG = "http://www.w3.org/2000/svg";

function shares(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return Float32Array.from(new Uint16Array(bytes.buffer), (value) => value / 65535);
}

class Folder {
  constructor(data) {
    Object.assign(this, { data, opened: -1 });
    this.text = document.querySelector("input[name=text]");
    this.verdict = document.querySelector("select[name=verdict]");
    this.dialog = document.querySelector("dialog");
    this.names = new Set(data.images.map(({ name }) => name.toLowerCase()));
    this.table = new SortedTable(document.querySelector(".table"), {
      titles: COLUMNS, rows: data.pairs, noun: "pairs",
      values: (pair) => this.values(pair),
      passes: (pair, values) => this._passes(pair, values),
      built: (pair, values, index) => this._row(pair, values, index),
    });
    this._graph();
    this._thumbnails();
    this._buttons();
  }

  name(index) {
    return this.data.images[index].name;
  }

  values(pair) {
    return [`${this.name(pair.i)} ${this.name(pair.j)}`, pair.kind, ...pair.numbers, pair.reason];
  }

  _passes(pair, values) {
    const wanted = this.text.value.toLowerCase(), kind = this.verdict.value;
    if (kind && pair.kind !== kind) return false;
    // The whole name of an image means this image: 1.png is not 11.png.
    if (this.names.has(wanted)) return [pair.i, pair.j].some((i) => this.name(i).toLowerCase() === wanted);
    return `${values[0]} ${pair.reason}`.toLowerCase().includes(wanted);
  }

  _row(pair, values, index) {
    const row = made("tr", undefined, { className: pair.kind.replace(" ", "-") });
    const names = made("td", undefined, { className: "c0" });
    const open = made("button", undefined, { className: "open" });
    for (const each of [pair.i, pair.j]) {
      const picture = this.data.pictures[each];
      if (picture) open.append(made("img", undefined, { src: picture, alt: "", loading: "lazy" }));
      open.append(made("span", this.name(each)));
    }
    open.addEventListener("click", () => this.open(index));
    names.append(open);
    row.append(names);
    for (let k = 1; k < values.length; k++)
      row.append(made("td", Folder.written(values[k], k), { className: `c${k}` }));
    return row;
  }

  static written(value, column) {
    if (value === null) return "–";
    if (column === 2) return value > 0.999 ? "> 0.999" : value.toFixed(3);
    return column in DIGITS ? value.toFixed(DIGITS[column]) : value;
  }

  _graph() {
    const graph = document.querySelector(".graph"), count = this.data.images.length;
    const size = 600, radius = 270;
    graph.setAttribute("viewBox", `0 0 ${size} ${size}`);
    const place = (i) => {
      const angle = (2 * Math.PI * i) / count - Math.PI / 2;
      return [size / 2 + radius * Math.cos(angle), size / 2 + radius * Math.sin(angle)];
    };
    const add = (tag, attributes, title, act) => {
      const element = document.createElementNS(SVG, tag);
      for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
      element.append(document.createElementNS(SVG, "title"));
      element.firstChild.textContent = title;
      element.addEventListener("click", act);
      graph.append(element);
    };
    for (const kind of ["no pose", "refused", "accepted"])
      for (const [index, pair] of this.data.pairs.entries()) {
        if (pair.kind !== kind) continue;
        const [[x1, y1], [x2, y2]] = [place(pair.i), place(pair.j)];
        const title = `${this.name(pair.i)} and ${this.name(pair.j)}: ${pair.kind}`;
        add("line", { x1, y1, x2, y2, class: kind.replace(" ", "-") }, title, () => this.open(index));
      }
    const r = Math.min(Math.max((Math.PI * radius) / count / 2, 2.5), 9);
    for (let i = 0; i < count; i++) {
      const [cx, cy] = place(i);
      add("circle", { cx, cy, r }, this.name(i), () => this.filter(this.name(i)));
    }
  }

  _thumbnails() {
    const joined = new Array(this.data.images.length).fill(0);
    for (const pair of this.data.pairs)
      if (pair.kind === "accepted") for (const i of [pair.i, pair.j]) joined[i] += 1;
    const all = this.data.images.map(({ name, unreadable }, i) => {
      const button = made("button"), picture = this.data.pictures[i];
      if (picture) button.append(made("img", undefined, { src: picture, alt: "", loading: "lazy" }));
      const words = joined[i] === 1 ? "1 accepted pair" : `${joined[i]} accepted pairs`;
      button.append(made("span", name), made("small", unreadable ? "could not be read" : words));
      button.addEventListener("click", () => this.filter(name));
      return button;
    });
    document.querySelector(".thumbnails").append(...all);
  }

  filter(name) {
    this.text.value = name;
    this.table.list();
    this.text.scrollIntoView({ block: "center" });
  }

  _buttons() {
    const on = (name, act) => this.dialog.querySelector(`button[name=${name}]`).addEventListener("click", act);
    on("close", () => this.dialog.close());
    on("earlier", () => this._step(-1));
    on("later", () => this._step(1));
    this.dialog.addEventListener("close", () => {
      this.view = null;
      this.dialog.querySelector(".room").replaceChildren();
    });
  }

  _step(by) {
    const { listed } = this.table, place = listed.indexOf(this.opened) + by;
    if (place >= 0 && place < listed.length) this.open(listed[place]);
  }

  open(index) {
    const pair = this.data.pairs[index];
    this.opened = index;
    this.dialog.querySelector(".pair-title").textContent = `${this.name(pair.i)} and ${this.name(pair.j)}`;
    this.dialog.querySelector(".words").replaceChildren(...pair.words.map((text) => made("p", text)));
    const room = this.dialog.querySelector(".room");
    room.replaceChildren();
    if (!this.dialog.open) this.dialog.showModal();
    if (!pair.pixels || !this.data.pictures[pair.i] || !this.data.pictures[pair.j]) return;
    room.append(document.querySelector("template").content.cloneNode(true));
    for (const [k, caption] of room.querySelectorAll("figcaption").entries())
      caption.textContent = `View ${k + 1}: ${this.name(k ? pair.j : pair.i)}`;
    this.view = new PairView(room.querySelector(".pair"), this._record(pair));
  }

  _record(pair) {
    const views = [pair.i, pair.j].map((i) => ({
      picture: this.data.pictures[i], camera: this.data.cameras[this.data.images[i].camera] }));
    const pixels = pair.pixels.map((text, k) => {
      const places = shares(text), { width, height } = views[k].camera;
      return places.map((value, i) => value * (i % 2 ? height : width));
    });
    const count = pixels[0].length / 2;
    const residuals = pair.residuals
      ? shares(pair.residuals).map((share) => (share < 1 ? 3 * pair.gate * share : NaN))
      : new Float32Array(count).fill(NaN);
    const inliers = "1".repeat(pair.agreeing) + "0".repeat(count - pair.agreeing);
    return { views, pixels, residuals, inliers, E: pair.E || null, gate: pair.gate || null };
  }
}

{
  const data = readJson("data");
  window.folder = new Folder(data);
  showSceneIn(document.querySelector(".scene"), data.scene);
}
