// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// The report of many pairs: a table of them.

const PAIR_COLUMNS = ["image 1", "image 2", "status", "inliers", "matches", "noise (°)", "parallax (°)",
  "sigma R (°)", "sigma t (°)", "probability"];

{
  const { names, kinds, statuses, numbers } = readJson("data");
  const [text, status, probability] = ["text", "status", "probability"].map((name) => document.querySelector(`[name=${name}]`));
  const written = { 9: (value) => (value > 0.9999 ? "> 0.9999" : value.toFixed(4)) };
  window.batch = new SortedTable(document.querySelector(".table"), {
    titles: PAIR_COLUMNS, noun: "listed pairs", rows: names.map((_, index) => index),
    values: (i) => [...names[i], kinds[statuses[i]], ...numbers.map((column) => column[i])],
    passes: (i, values) => (!status.value || values[2] === status.value) &&
      (!probability.value || (values[9] !== null && values[9] <= Number(probability.value))) &&
      `${values[0]} ${values[1]}`.toLowerCase().includes(text.value.toLowerCase()),
    built: (i, values) => plainRow(values, written, values[2] === "ok" ? "ok" : "not-ok"),
  });
}
