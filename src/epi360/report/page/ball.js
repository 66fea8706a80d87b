// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// Directions on a ball, or on the ovoid that diag(S, S, K) makes of it; drag to turn.

class Ball {
  constructor(canvas, rays, scales = [1, 1, 1]) {
    Object.assign(this, { canvas, rays, scales, yaw: -0.65, pitch: -0.3 });
    this.wrong = null; // for each ray whether it is that of a wrong match, where that is known
    this.reach = 1.18 * Math.max(...scales);
    onDrag(canvas, (dx, dy) => {
      this.yaw -= 0.01 * dx;
      this.pitch = Math.min(Math.max(this.pitch + 0.01 * dy, -1.55), 1.55);
      this.draw();
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  // A point of the surface: across, down and away from the reader, and whether it is in front.
  _seen(ray) {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const forward = [sy * cp, -sp, cy * cp], right = [cy, 0, -sy], down = cross(forward, right);
    const point = ray.map((value, k) => value * this.scales[k]);
    const normal = ray.map((value, k) => value / this.scales[k]);
    return [dot(right, point), dot(down, point), dot(forward, normal) < 0];
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width) return;
    const context = sharpContext(this.canvas, width, height), scale = Math.min(width, height) / 2 / this.reach;
    const place = (x, y) => [width / 2 + scale * x, height / 2 + scale * y];
    const colours = ["--accent", "--poor"].map(pageColour);
    for (const front of [false, true]) {
      context.globalAlpha = front ? 1 : 0.25;
      context.strokeStyle = pageColour("--line");
      for (const curve of Ball.graticule()) {
        context.beginPath();
        let drawing = false;
        for (const ray of curve) {
          const [x, y, faces] = this._seen(ray);
          if (faces === front) context[drawing ? "lineTo" : "moveTo"](...place(x, y));
          drawing = faces === front;
        }
        context.stroke();
      }
      for (let i = 0; i < this.rays.length; i += 3) {
        const [x, y, faces] = this._seen(Array.from(this.rays.subarray(i, i + 3)));
        context.fillStyle = colours[this.wrong && this.wrong[i / 3] ? 1 : 0];
        if (faces === front) context.fillRect(...place(x, y).map((value) => value - 1.3), 2.6, 2.6);
      }
      this._drawAxes(context, place, front);
    }
    context.globalAlpha = 1;
  }

  _drawAxes(context, place, front) {
    context.font = "italic bold 17px serif";
    for (const [k, name] of ["x", "y", "z"].entries()) {
      const ray = [0, 1, 2].map((j) => (j === k ? 1 : 0)), [x, y, faces] = this._seen(ray);
      if (faces !== front) continue;
      context.fillStyle = pageColour("--text");
      context.beginPath();
      context.arc(...place(x, y), 4, 0, 7);
      context.fill();
      const label = [name, place(x, y)[0] + 8, place(x, y)[1] - 7];
      Object.assign(context, { lineWidth: 4, strokeStyle: pageColour("--panel") });
      context.strokeText(...label);
      context.lineWidth = 1;
      context.fillText(...label);
    }
  }

  static graticule() {
    if (!Ball.curves) {
      Ball.curves = [];
      const ray = (lon, lat) => [Math.cos(lat) * Math.sin(lon), -Math.sin(lat), Math.cos(lat) * Math.cos(lon)];
      const steps = Array.from({ length: 73 }, (_, i) => i / 72 - 0.5);
      for (let i = 0; i < 12; i++) Ball.curves.push(steps.map((s) => ray((i * Math.PI) / 6, s * Math.PI)));
      for (let i = -2; i <= 2; i++) Ball.curves.push(steps.map((s) => ray(2 * Math.PI * s, (i * Math.PI) / 6)));
    }
    return Ball.curves;
  }
}
