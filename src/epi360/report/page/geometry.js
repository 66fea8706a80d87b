// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// Rays of cameras and great circles. Frame: x right, y down, z forward.

function readJson(id) {
  return JSON.parse(document.getElementById(id).textContent);
}

function floats(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function unit(a) {
  const length = Math.hypot(a[0], a[1], a[2]);
  return [a[0] / length, a[1] / length, a[2] / length];
}

function times(matrix, a) {
  return [0, 3, 6].map((row) => dot(matrix.slice(row, row + 3), a));
}

function transposed(m) {
  return [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
}

// A camera turns pixels of the original picture into unit rays, NaN where it has none.
class Camera {
  constructor(record) {
    Object.assign(this, { width: record.width, height: record.height });
    this.panorama = record.panorama || null;
    if (!this.panorama) {
      this.cells = record.cells;
      this.rays = floats(record.rays);
    }
  }

  ray(u, v) {
    return this.panorama ? this._panoramaRay(u, v) : this._sampledRay(u, v);
  }

  _panoramaRay(u, v) {
    const [width, height, longitude, latitude] = this.panorama;
    const lon = longitude + (u / this.width - 0.5) * width;
    const lat = latitude - (v / this.height - 0.5) * height;
    return [Math.cos(lat) * Math.sin(lon), -Math.sin(lat), Math.cos(lat) * Math.cos(lon)];
  }

  _sampledRay(u, v) {
    const x = Math.min(Math.max((u / this.width) * this.cells, 0), this.cells - 1e-6);
    const y = Math.min(Math.max((v / this.height) * this.cells, 0), this.cells - 1e-6);
    const column = Math.floor(x), row = Math.floor(y), right = x - column, down = y - row;
    const sum = [0, 0, 0];
    for (const [c, r, weight] of [
      [column, row, (1 - right) * (1 - down)], [column + 1, row, right * (1 - down)],
      [column, row + 1, (1 - right) * down], [column + 1, row + 1, right * down],
    ]) {
      const start = 3 * (r * (this.cells + 1) + c);
      for (let k = 0; k < 3; k++) sum[k] += weight * this.rays[start + k];
    }
    return unit(sum);
  }

  // Rays at the corners of a grid over the picture, made once.
  grid() {
    if (!this._grid) {
      const columns = 128, rows = this.panorama ? 64 : 128;
      const rays = new Float32Array(3 * (columns + 1) * (rows + 1));
      for (let r = 0, k = 0; r <= rows; r++)
        for (let c = 0; c <= columns; c++, k += 3)
          rays.set(this.ray((c / columns) * this.width, (r / rows) * this.height), k);
      this._grid = { columns, rows, rays };
    }
    return this._grid;
  }

  // Segments [u1, v1, u2, v2] where the great circle with this normal runs through the picture:
  // the zero line of the rays' component along the normal, cell by cell. Every camera is the same to
  // it, and neither the seam nor a pole needs a case of its own.
  circle(normal) {
    const { columns, rows, rays } = this.grid();
    const side = new Float32Array((columns + 1) * (rows + 1));
    for (let i = 0; i < side.length; i++)
      side[i] = normal[0] * rays[3 * i] + normal[1] * rays[3 * i + 1] + normal[2] * rays[3 * i + 2];
    const segments = [], width = this.width / columns, height = this.height / rows;
    for (let r = 0; r < rows; r++)
      for (let c = 0; c < columns; c++) {
        const i = r * (columns + 1) + c;
        const corners = [[c, r, side[i]], [c + 1, r, side[i + 1]],
          [c + 1, r + 1, side[i + columns + 2]], [c, r + 1, side[i + columns + 1]]];
        const ends = [];
        for (let k = 0; k < 4; k++) {
          const [x1, y1, s1] = corners[k], [x2, y2, s2] = corners[(k + 1) % 4];
          if (s1 < 0 !== s2 < 0 && Number.isFinite(s1 + s2)) {
            const part = s1 / (s1 - s2);
            ends.push((x1 + part * (x2 - x1)) * width, (y1 + part * (y2 - y1)) * height);
          }
        }
        for (let k = 0; k + 3 < ends.length; k += 4) segments.push(ends.slice(k, k + 4));
      }
    return segments;
  }
}

// Rays once around the great circle with this normal.
function greatCircle(normal, count = 180) {
  const smallest = [0, 1, 2].reduce((a, b) => (Math.abs(normal[b]) < Math.abs(normal[a]) ? b : a));
  const first = unit(cross(normal, [0, 1, 2].map((k) => (k === smallest ? 1 : 0))));
  const second = unit(cross(normal, first));
  return Array.from({ length: count + 1 }, (_, i) => {
    const angle = (2 * Math.PI * i) / count;
    return first.map((value, k) => Math.cos(angle) * value + Math.sin(angle) * second[k]);
  });
}

// From cyan (0) to magenta (1), bright over a darkened picture; light blue where there is no pose.
function residualColour(share) {
  if (!Number.isFinite(share)) return "#33b5ff";
  const t = Math.min(Math.max(share, 0), 1);
  return `rgb(${Math.round(255 * t)},${Math.round(255 * (1 - t))},255)`;
}

function onDrag(element, move) {
  let last = null;
  element.addEventListener("pointerdown", (event) => {
    last = [event.clientX, event.clientY];
    element.setPointerCapture(event.pointerId);
  });
  element.addEventListener("pointermove", (event) => {
    if (!last) return;
    move(event.clientX - last[0], event.clientY - last[1]);
    last = [event.clientX, event.clientY];
  });
  for (const name of ["pointerup", "pointercancel"]) element.addEventListener(name, () => (last = null));
}

// A canvas as sharp as the screen; returns its context, with units of CSS pixels.
function sharpContext(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

function pageColour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
