// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// Both pictures of a pair with its matches; the point under the pointer has its curve in the other.

const NEAR_PX = 14;

class PictureView {
  constructor(element, pair, index) {
    Object.assign(this, { element, pair, index, sphere: null, curve: null, marked: -1 });
    const { picture, camera } = pair.views[index];
    this.camera = camera;
    this.image = element.querySelector("img");
    this.image.src = picture;
    [this.globe, this.overlay] = element.querySelectorAll("canvas");
    element.style.aspectRatio = `${camera.width} / ${camera.height}`;
    this.overlay.addEventListener("pointermove", (event) => this._pointed(event));
    this.overlay.addEventListener("pointerdown", (event) => this._pointed(event));
    this.overlay.addEventListener("pointerleave", () => pair.leave());
    this.overlay.addEventListener("wheel", (event) => this._zoomed(event), { passive: false });
    onDrag(this.overlay, (dx, dy) => this._turned(dx, dy));
    new ResizeObserver(() => pair.redraw()).observe(element);
  }

  async showSphere(shown) {
    if (shown && !this.sphere) {
      await this.image.decode();
      this.sphere = new Sphere(this.globe, this.camera, this.image);
    }
    this.onSphere = shown && Boolean(this.sphere.gl);
    this.element.classList.toggle("on-sphere", this.onSphere);
    return this.onSphere === shown;
  }

  _turned(dx, dy) {
    if (!this.onSphere) return;
    this.sphere.turn(dx, dy, this.element.clientWidth);
    this.pair.redraw();
  }

  _zoomed(event) {
    if (!this.onSphere) return;
    event.preventDefault();
    this.sphere.zoom(0.001 * event.deltaY);
    this.pair.redraw();
  }

  _pointed(event) {
    const box = this.overlay.getBoundingClientRect();
    const x = event.clientX - box.left, y = event.clientY - box.top;
    const near = this._nearest(x, y);
    const { width, height } = this.camera;
    let ray;
    if (near >= 0) ray = Array.from(this.pair.rays[this.index].subarray(3 * near, 3 * near + 3));
    else if (this.onSphere) ray = this.sphere.rayAt(x, y, box.width, box.height);
    else ray = this.camera.ray((x / box.width) * width, (y / box.height) * height);
    this.pair.point(this.index, ray, near);
  }

  _nearest(x, y) {
    let best = -1, least = NEAR_PX;
    for (let i = 0; i < this.pair.count; i++) {
      const place = this.place(i);
      const distance = place ? Math.hypot(place[0] - x, place[1] - y) : Infinity;
      if (distance < least) [best, least] = [i, distance];
    }
    return best;
  }

  // Where a match lies on the screen, null where it is out of sight.
  place(i) {
    const { clientWidth: width, clientHeight: height } = this.overlay;
    if (this.onSphere)
      return this.sphere.project(this.pair.rays[this.index].subarray(3 * i, 3 * i + 3), width, height);
    const pixels = this.pair.pixels[this.index];
    return [(pixels[2 * i] / this.camera.width) * width, (pixels[2 * i + 1] / this.camera.height) * height];
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.overlay;
    if (!width) return;
    if (this.onSphere) this.sphere.draw(width, height, this.pair.shown);
    const context = sharpContext(this.overlay, width, height);
    if (this.pair.shown) for (const inlier of [false, true]) this._drawMatches(context, inlier);
    if (this.curve) this._drawCurve(context, width, height);
    if (this.marked >= 0) this._drawMark(context);
  }

  _drawMatches(context, inlier) {
    const wide = this.overlay.clientWidth > 500;
    const radius = this.pair.count > 1500 || !wide ? 1.5 : 2.4;
    context.strokeStyle = "#ff9980";
    for (let i = 0; i < this.pair.count; i++) {
      if (this.pair.agrees(i) !== inlier) continue;
      const place = this.place(i);
      if (!place) continue;
      const [x, y] = place;
      context.beginPath();
      if (inlier) {
        context.fillStyle = residualColour(this.pair.residuals[i] / this.pair.gate);
        context.arc(x, y, radius, 0, 7);
        context.fill();
      } else if (this.pair.outliersShown) {
        context.moveTo(x - 2, y - 2);
        context.lineTo(x + 2, y + 2);
        context.moveTo(x - 2, y + 2);
        context.lineTo(x + 2, y - 2);
        context.stroke();
      }
    }
  }

  _drawCurve(context, width, height) {
    const path = new Path2D();
    if (this.onSphere) {
      const places = greatCircle(this.curve).map((ray) => this.sphere.project(ray, width, height));
      for (let i = 1; i < places.length; i++)
        if (places[i] && places[i - 1]) {
          path.moveTo(...places[i - 1]);
          path.lineTo(...places[i]);
        }
    } else {
      const [right, down] = [width / this.camera.width, height / this.camera.height];
      for (const [u1, v1, u2, v2] of this.camera.circle(this.curve)) {
        path.moveTo(u1 * right, v1 * down);
        path.lineTo(u2 * right, v2 * down);
      }
    }
    for (const [colour, thick] of [["rgba(0,0,0,.6)", 4], ["#ffd21f", 2]]) {
      Object.assign(context, { strokeStyle: colour, lineWidth: thick });
      context.stroke(path);
    }
    context.lineWidth = 1;
  }

  _drawMark(context) {
    const place = this.place(this.marked);
    if (!place) return;
    for (const [colour, thick] of [["black", 5], ["#ffd21f", 2.5]]) {
      Object.assign(context, { strokeStyle: colour, lineWidth: thick });
      context.beginPath();
      context.arc(...place, 8, 0, 7);
      context.stroke();
    }
    context.lineWidth = 1;
  }
}

class PairView {
  constructor(element, record) {
    this.element = element;
    this.views = record.views.map((view) => ({ ...view, camera: new Camera(view.camera) }));
    const numbers = (value) => (typeof value === "string" ? floats(value) : value);
    this.pixels = record.pixels.map(numbers);
    this.residuals = numbers(record.residuals);
    this.inliers = record.inliers;
    this.count = this.inliers.length;
    this.rays = this.views.map(({ camera }, k) => {
      const rays = new Float32Array(3 * this.count);
      for (let i = 0; i < this.count; i++)
        rays.set(camera.ray(this.pixels[k][2 * i], this.pixels[k][2 * i + 1]), 3 * i);
      return rays;
    });
    Object.assign(this, { E: record.E, gate: record.gate || 1, shown: true, outliersShown: true });
    this.says = element.querySelector(".says");
    this.hint = this.says.textContent;
    this.panels = [...element.querySelectorAll(".picture")].map((each, k) => new PictureView(each, this, k));
    this._bind("matches", (on) => (this.shown = on));
    this._bind("outliers", (on) => (this.outliersShown = on));
    this._bind("sphere", (on) => this._showSpheres(on));
    this.redraw();
  }

  _bind(name, act) {
    const box = this.element.querySelector(`input[name=${name}]`);
    box.addEventListener("change", async () => {
      await act(box.checked);
      this.element.classList.toggle("plain", !this.shown);
      this.redraw();
    });
  }

  async _showSpheres(on) {
    const worked = await Promise.all(this.panels.map((panel) => panel.showSphere(on)));
    if (worked.includes(false)) this.says.textContent = "This browser has no WebGL, which the sphere needs.";
  }

  agrees(i) {
    return this.inliers[i] === "1";
  }

  // A ray of one view, and the match it belongs to (or -1): its plane cuts the other view.
  point(index, ray, near) {
    const other = this.panels[1 - index];
    this.leave();
    if (this.E && Number.isFinite(ray[0])) other.curve = times(index ? transposed(this.E) : this.E, ray);
    for (const panel of this.panels) panel.marked = near;
    this.says.textContent = near >= 0 ? this._matchWords(near) : this._pointWords(index);
    this.redraw();
  }

  _matchWords(i) {
    const agrees = this.agrees(i) ? "agrees with the pose" : "does not agree with the pose";
    const residual = this.residuals[i];
    const size = Number.isFinite(residual) ? `, its residual is ${residual.toFixed(3)}°` : "";
    return `Match ${i + 1} ${agrees}${size}.`;
  }

  _pointWords(index) {
    if (!this.E) return this.hint;
    return `What view ${index + 1} shows here lies on the yellow curve of view ${2 - index}.`;
  }

  leave() {
    for (const panel of this.panels) Object.assign(panel, { curve: null, marked: -1 });
    this.says.textContent = this.hint;
    this.redraw();
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      for (const panel of this.panels) panel.draw();
    });
  }
}
