// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// A picture on the sphere of its rays, seen from the camera's centre; drag to turn, wheel to zoom.

const VERTEX = `
attribute vec3 ray; attribute vec2 place; varying vec2 at;
uniform mat3 turn; uniform vec2 focal;
void main() { vec3 p = turn * ray; at = place; gl_Position = vec4(p.x * focal.x, -p.y * focal.y, 0.0, p.z); }`;
const FRAGMENT = `
precision mediump float; varying vec2 at; uniform sampler2D picture; uniform float faded;
void main() {
  vec3 colour = texture2D(picture, at).rgb;
  float grey = dot(colour, vec3(0.299, 0.587, 0.114));
  gl_FragColor = vec4(mix(colour, 0.7 * mix(vec3(grey), colour, 0.45), faded), 1.0);
}`;

class Sphere {
  constructor(canvas, camera, image) {
    Object.assign(this, { canvas, camera, yaw: 0, pitch: 0, fov: 1.75 });
    const middle = camera.ray(camera.width / 2, camera.height / 2);
    if (Number.isFinite(middle[0])) this.yaw = Math.atan2(middle[0], middle[2]);
    const gl = canvas.getContext("webgl", { preserveDrawingBuffer: true });
    this.gl = gl;
    if (gl) this._prepare(gl, image);
  }

  _prepare(gl, image) {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
    const { columns, rows, rays } = this.camera.grid();
    const places = [], triangles = [];
    const has = (i) => Number.isFinite(rays[3 * i]);
    for (let r = 0; r <= rows; r++)
      for (let c = 0; c <= columns; c++) {
        places.push(c / columns, r / rows);
        const i = r * (columns + 1) + c, below = i + columns + 1;
        if (r < rows && c < columns && has(i) && has(i + 1) && has(below) && has(below + 1))
          triangles.push(i, i + 1, below, below, i + 1, below + 1);
      }
    this._attribute(program, "ray", 3, rays.map((value) => (Number.isFinite(value) ? value : 0)));
    this._attribute(program, "place", 2, new Float32Array(places));
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(triangles), gl.STATIC_DRAW);
    this.count = triangles.length;
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T])
      gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
    this.program = program;
  }

  _attribute(program, name, size, values) {
    const gl = this.gl, place = gl.getAttribLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
  }

  turn(dx, dy, width) {
    const step = this.fov / width;
    this.yaw -= dx * step;
    this.pitch = Math.min(Math.max(this.pitch + dy * step, -1.55), 1.55);
  }

  zoom(amount) {
    this.fov = Math.min(Math.max(this.fov * Math.exp(amount), 0.3), 2.4);
  }

  // Rows: right, down and forward of the viewer, in the camera's frame.
  axes() {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const forward = [sy * cp, -sp, cy * cp], right = [cy, 0, -sy];
    return [right, cross(forward, right), forward];
  }

  focal(width) {
    return width / 2 / Math.tan(this.fov / 2);
  }

  project(ray, width, height) {
    const [x, y, z] = this.axes().map((axis) => dot(axis, ray));
    if (z < 0.05) return null;
    const focal = this.focal(width);
    return [width / 2 + (focal * x) / z, height / 2 + (focal * y) / z];
  }

  rayAt(x, y, width, height) {
    const focal = this.focal(width), [right, down, forward] = this.axes();
    return unit([0, 1, 2].map((k) => (x - width / 2) * right[k] + (y - height / 2) * down[k] + focal * forward[k]));
  }

  draw(width, height, faded) {
    const gl = this.gl;
    if (!gl) return;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(0.2, 0.2, 0.2, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const axes = this.axes(), focal = this.focal(width);
    const columns = [0, 1, 2].flatMap((k) => axes.map((axis) => axis[k]));
    gl.uniformMatrix3fv(gl.getUniformLocation(this.program, "turn"), false, columns);
    gl.uniform2f(gl.getUniformLocation(this.program, "focal"), (2 * focal) / width, (2 * focal) / height);
    gl.uniform1f(gl.getUniformLocation(this.program, "faded"), faded ? 1 : 0);
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_SHORT, 0);
  }
}
