// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// A table that sorts by a click on a column's name and shows more rows on demand.

const ROWS = 100; // at first, and with each click on "Show more"

function made(tag, text, properties = {}) {
  const element = Object.assign(document.createElement(tag), properties);
  if (text !== undefined) element.textContent = text;
  return element;
}

class SortedTable {
  // In root: table, .count, button[name=more], and fields that filter. rows: any values. values(row)
  // gives a row's cells, null for what is not known. passes(row, values) says whether the fields let
  // it through, and built(row, values, index) makes its element.
  constructor(root, { titles, rows, values, passes, built, noun, order = 0, rising = true }) {
    Object.assign(this, { rows, values, passes, built, noun, order, rising, listed: [], shown: ROWS });
    this.table = root.querySelector("table");
    this.count = root.querySelector(".count");
    this.more = root.querySelector("button[name=more]");
    this.more.addEventListener("click", () => this.list(this.shown + ROWS));
    for (const field of root.querySelectorAll("input, select"))
      field.addEventListener("input", () => this.list());
    this._head(titles);
    this.list();
  }

  _head(titles) {
    const row = made("tr");
    for (const [k, title] of titles.entries()) {
      const cell = made("th", undefined, { className: `c${k}` }), button = made("button", title);
      button.addEventListener("click", () => {
        this.rising = this.order === k ? !this.rising : true;
        this.order = k;
        this.list();
      });
      cell.append(button);
      row.append(cell);
    }
    this.table.querySelector("thead").append(row);
  }

  // Show the rows that pass the filters, in the order of the chosen column.
  list(shown = ROWS) {
    this.shown = shown;
    const k = this.order, sign = this.rising ? 1 : -1;
    const rows = this.rows.map((row, index) => ({ index, row, values: this.values(row) }))
      .filter(({ row, values }) => this.passes(row, values));
    rows.sort((a, b) => SortedTable.compared(a.values[k], b.values[k], sign) || a.index - b.index);
    this.listed = rows.map(({ index }) => index);
    const body = rows.slice(0, shown).map(({ row, values, index }) => this.built(row, values, index));
    this.table.querySelector("tbody").replaceChildren(...body);
    for (const [i, cell] of this.table.querySelectorAll("th").entries())
      cell.setAttribute("aria-sort", i !== k ? "none" : this.rising ? "ascending" : "descending");
    this.more.hidden = rows.length <= shown;
    const part = this.more.hidden ? "" : ` The first ${shown} are shown.`;
    this.count.textContent = `${rows.length} of ${this.rows.length} ${this.noun}.${part}`;
  }

  // Numbers by size, others by name; what is not known comes last in either direction.
  static compared(a, b, sign) {
    if (a === null || b === null) return (a === null) - (b === null);
    if (typeof a === "number") return sign * (a - b);
    return sign * a.localeCompare(b, undefined, { numeric: true });
  }
}

// A row whose cells are written as they are, or by the function of their column.
function plainRow(values, written, className) {
  const row = made("tr", undefined, { className });
  for (const [k, value] of values.entries()) {
    const text = value === null ? "–" : written[k] ? written[k](value) : value;
    row.append(made("td", text, { className: `c${k}` }));
  }
  return row;
}
