// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// What the sliders of the paper's tab change: errors, sigma 8, the ovoid, the cost over S and K.

const paper = {
  balls: null,
  drawnAt: 0, // for tests and measurements
  numDrawn: 0,

  show(record) {
    this.record = record;
    for (const [i, row] of record.errors.entries())
      for (const [k, value] of row.entries()) this.bar(i, k, value);
    for (const [i, { value, share }] of record.sigma8.entries()) {
      const cells = document.querySelectorAll(".sigma8 tbody tr")[i].children;
      cells[1].textContent = value === null ? "none" : value.toPrecision(3);
      cells[2].textContent = share === null ? "none" : share.toPrecision(3);
    }
    this.drawBalls();
    this.drawSurface();
    this.drawnAt = performance.now();
    this.numDrawn += 1;
    document.querySelector(".paper").dataset.drawn = this.numDrawn;
  },

  // Errors from 0.01 to 180 degrees, by their logarithm.
  share(value) {
    const [low, high] = [Math.log(0.01), Math.log(180)];
    return Math.min(Math.max((Math.log(Math.max(value, 1e-9)) - low) / (high - low), 0.004), 1);
  },

  cell(i, k) {
    return document.querySelectorAll(".errors .method")[i].querySelectorAll(".bar")[k];
  },

  bar(i, k, value) {
    const cell = this.cell(i, k);
    cell.querySelector("i").style.width = value === null ? "0" : `${100 * this.share(value)}%`;
    cell.querySelector("b").textContent = value === null ? "no pose" : this.degrees(value);
    cell.querySelector("s").classList.add("old");
  },

  showMedians(rows, count) {
    for (const [i, row] of rows.entries())
      for (const [k, value] of row.entries()) {
        const mark = this.cell(i, k).querySelector("s");
        mark.style.left = `${100 * this.share(value)}%`;
        mark.title = `median of ${count} sets of points: ${this.degrees(value)}`;
        mark.classList.remove("old");
      }
  },

  degrees(value) {
    return value >= 10 ? `${value.toFixed(1)}°` : value >= 1 ? `${value.toFixed(2)}°` : `${value.toFixed(3)}°`;
  },

  drawBalls() {
    const { rays, S, K, outliers } = this.record;
    if (!this.balls) this.balls = [...document.querySelectorAll(".paper .ball")].map((canvas) => new Ball(canvas, new Float32Array()));
    const largest = Math.max(S, K);
    for (const [k, ball] of this.balls.entries()) {
      ball.rays = floats(rays);
      ball.wrong = [...outliers].map((letter) => letter === "1");
      ball.scales = k ? [S / largest, S / largest, K / largest] : [1, 1, 1];
      ball.reach = 1.18;
      ball.draw();
    }
  },

  // The cost at ln(K / S), between the values that were computed.
  costRank(u) {
    const { ratios, ranks } = this.record, last = ratios.length - 1;
    const place = Math.min(Math.max(((u - ratios[0]) / (ratios[last] - ratios[0])) * last, 0), last);
    const k = Math.min(Math.floor(place), last - 1);
    return ranks[k] + (place - k) * (ranks[k + 1] - ranks[k]);
  },

  // One pixel for each of steps x steps values: a small picture is drawn faster than its squares.
  surfaceImage(steps, reach) {
    this.small = this.small || document.createElement("canvas");
    Object.assign(this.small, { width: steps, height: steps });
    const context = this.small.getContext("2d"), image = context.createImageData(steps, steps);
    const colours = Array.from({ length: 2 * steps - 1 }, (_, n) => heat(this.costRank(((n + 1) / steps - 1) * 2 * reach)));
    for (let row = 0; row < steps; row++)
      for (let column = 0; column < steps; column++)
        image.data.set([...colours[2 * steps - 2 - row - column], 255], 4 * (row * steps + column));
    context.putImageData(image, 0, 0);
    return this.small;
  },

  drawSurface() {
    const canvas = document.querySelector(".paper .surface"), record = this.record;
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width) return;
    // Colours go by rank: next to the highest costs, all others would look the same.
    const order = record.costs.map((_, k) => k).sort((a, b) => record.costs[a] - record.costs[b]);
    record.ranks = [];
    for (const [rank, k] of order.entries()) record.ranks[k] = rank / (order.length - 1);
    const context = sharpContext(canvas, width, height), steps = 40, reach = Math.log(4);
    const [left, top, right, bottom] = [40, 6, width - 8, height - 36];
    const x = (value) => left + ((Math.log(value) + reach) / (2 * reach)) * (right - left);
    const y = (value) => bottom - ((Math.log(value) + reach) / (2 * reach)) * (bottom - top);
    Object.assign(context, { imageSmoothingEnabled: false });
    context.drawImage(this.surfaceImage(steps, reach), left, top, right - left, bottom - top);
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
    Object.assign(context, { strokeStyle: "#fff", lineWidth: 2 });
    context.setLineDash([6, 5]);
    context.beginPath();
    context.moveTo(x(1 / 64), y(Math.exp(record.found) / 64));
    context.lineTo(x(64), y(Math.exp(record.found) * 64));
    context.stroke();
    context.restore();
    context.beginPath();
    context.arc(x(record.S), y(record.K), 7, 0, 7);
    Object.assign(context, { fillStyle: "#fff", strokeStyle: "#000", lineWidth: 2 });
    context.fill();
    context.stroke();
    this.drawTicks(context, { x, y, left, bottom, middle: [(left + right) / 2, (top + bottom) / 2] });
  },

  drawTicks(context, { x, y, left, bottom, middle }) {
    Object.assign(context, { fillStyle: pageColour("--text"), font: "13px system-ui, sans-serif", textAlign: "center" });
    const values = { "¼": 0.25, "½": 0.5, 1: 1, 2: 2, 4: 4 };
    const inside = (place, low, high) => Math.min(Math.max(place, low), high);
    for (const [text, value] of Object.entries(values)) {
      context.fillText(text, inside(x(value), left + 5, x(4) - 5), bottom + 16);
      context.fillText(text, left - 14, inside(y(value) + 5, y(4) + 11, bottom));
    }
    context.font = "italic 15px serif";
    context.fillText("S", middle[0] + 40, bottom + 31);
    context.fillText("K", 9, middle[1] + 30);
  },
};

// From dark blue (low) to pale yellow (high), as in the report.
function heat(height) {
  const stops = [[38, 34, 98], [30, 110, 140], [90, 180, 120], [250, 240, 170]];
  const place = Math.min(Math.max(height, 0), 1) * 3, k = Math.min(Math.floor(place), 2);
  return stops[k].map((value, c) => Math.round(value + (place - k) * (stops[k + 1][c] - value)));
}

// A tab that was hidden has no size to draw at.
window.addEventListener("resize", () => paper.record && paper.drawSurface());
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => paper.record && paper.drawSurface());
