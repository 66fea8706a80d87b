// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// The report of images in a map: a plan, a table, and the picture of the image that is chosen.

const IMAGE_COLUMNS = ["image", "status", "inliers", "matches", "probability", "sigma R (°)", "sigma pos.",
  "looks the same", "x", "y", "z", "near", "remarks"];

class Localized {
  constructor(data) {
    Object.assign(this, { data, chosen: -1 });
    this.shown = document.querySelector(".chosen");
    this.marks = new Map([...document.querySelectorAll(".plan .new")].map((mark) => [Number(mark.dataset.image), mark]));
    for (const [number, mark] of this.marks) mark.addEventListener("click", () => this.select(number));
    this._table();
    const first = data.rows.findIndex((row) => row[1] === "ok");
    this.select(Math.max(first, 0));
  }

  // Choose an image: its mark in the plan, its row, its picture.
  select(number) {
    this.chosen = number;
    const [name, status, inliers] = this.data.rows[number], picture = this.data.pictures[number];
    for (const [k, mark] of this.marks) mark.classList.toggle("selected", k === number);
    this.marks.get(number)?.parentNode.append(this.marks.get(number)); // above the others
    const image = this.shown.querySelector("img");
    this.shown.hidden = false;
    image.hidden = !picture;
    if (picture) image.src = picture;
    const remarks = this.data.remarks[number];
    this.shown.querySelector("figcaption").textContent =
      `${name}: ${status}${status === "ok" ? `, ${inliers} inliers` : ""}${remarks ? `; ${remarks}` : ""}.`;
    for (const row of document.querySelectorAll(".localized tbody tr"))
      row.classList.toggle("selected", Number(row.dataset.image) === number);
  }

  _table() {
    const { rows, remarks } = this.data;
    const [text, status] = ["text", "status"].map((name) => document.querySelector(`[name=${name}]`));
    const share = (value) => `${Math.round(100 * value)} %`;
    this.table = new SortedTable(document.querySelector(".table"), {
      titles: IMAGE_COLUMNS, noun: "images", rows: rows.map((_, number) => number),
      values: (number) => [...rows[number], remarks[number]],
      passes: (number, values) => (!status.value || values[1] === status.value) &&
        values[0].toLowerCase().includes(text.value.toLowerCase()),
      built: (number, values) => this._row(number, plainRow(values, { 4: share, 7: share }, values[1] === "ok" ? "ok" : "not-ok")),
    });
  }

  _row(number, row) {
    row.dataset.image = number;
    row.classList.toggle("selected", number === this.chosen);
    const button = made("button", this.data.rows[number][0], { className: "open" });
    button.addEventListener("click", () => {
      this.select(number);
      document.querySelector(".plan").scrollIntoView({ block: "center" });
    });
    row.firstChild.replaceChildren(button);
    return row;
  }
}

window.localized = new Localized(readJson("data"));
