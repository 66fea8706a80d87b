// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// The paper's cost over S and K as a surface to turn. The element keeps what it holds, a map of the
// same cost, where there is no WebGL.

// record: ratios of ln K - ln S, heights (0 to 1) and colours at them (packed), found: the best ratio.
async function showSurfaceIn(element, record) {
  if (!element || !record) return;
  const flat = element.innerHTML;
  try {
    const { THREE, OrbitControls } = await loadWebGL();
    const world = surfaceOf(THREE, record);
    const view = openView(THREE, OrbitControls, element, world, 2);
    view.look(new THREE.Vector3(0, 0.2, 0), new THREE.Vector3(1.75, 1.75, 2.45));
    element.dataset.drawn = "yes";
  } catch {
    element.innerHTML = flat;
  }
}

function surfaceOf(THREE, record) {
  const ratios = floats(record.ratios), heights = floats(record.heights), colours = floats(record.colours);
  const last = ratios.length - 1, reach = ratios[last] / 2, steps = 60;
  const at = (values, ratio, size, k) => {
    const place = Math.min(Math.max((ratio + 2 * reach) / (4 * reach), 0), 1) * last;
    const i = Math.min(Math.floor(place), last - 1), part = place - i;
    return (1 - part) * values[size * i + k] + part * values[size * (i + 1) + k];
  };
  const group = new THREE.Group(), places = [], shades = [], faces = [], lines = [];
  const spot = (s, k) => [s / reach, at(heights, k - s, 1, 0), -k / reach];
  for (let i = 0; i <= steps; i++)
    for (let j = 0; j <= steps; j++) {
      const s = (2 * i / steps - 1) * reach, k = (2 * j / steps - 1) * reach;
      places.push(...spot(s, k));
      shades.push(...[0, 1, 2].map((c) => at(colours, k - s, 3, c)));
      const n = i * (steps + 1) + j;
      if (i < steps && j < steps) faces.push(n, n + 1, n + steps + 1, n + 1, n + steps + 2, n + steps + 1);
      if (i % 6 === 0 && j < steps) lines.push(n, n + 1);
      if (j % 6 === 0 && i < steps) lines.push(n, n + steps + 1);
    }
  const position = new THREE.BufferAttribute(new Float32Array(places), 3);
  const sheet = new THREE.BufferGeometry();
  sheet.setAttribute("position", position);
  sheet.setAttribute("color", new THREE.BufferAttribute(new Float32Array(shades), 3));
  sheet.setIndex(faces);
  const look = { vertexColors: true, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };
  group.add(new THREE.Mesh(sheet, new THREE.MeshBasicMaterial(look)));
  const net = new THREE.BufferGeometry();
  net.setAttribute("position", position);
  net.setIndex(lines);
  group.add(new THREE.LineSegments(net, new THREE.LineBasicMaterial({ color: 0x101418, transparent: true, opacity: 0.45 })));
  group.add(valley(THREE, record.found, reach, spot), ...surfaceAxes(THREE, reach));
  return group;
}

// The line on which K / S is the best: every point of it has the lowest cost.
function valley(THREE, found, reach, spot) {
  const ends = [Math.max(-reach, -reach - found), Math.min(reach, reach - found)];
  const points = Array.from({ length: 61 }, (_, i) => {
    const s = ends[0] + (i / 60) * (ends[1] - ends[0]), [x, y, z] = spot(s, s + found);
    return new THREE.Vector3(x, y + 0.012, z);
  });
  const tube = new THREE.TubeGeometry(new THREE.CatmullRomCurve3(points), 60, 0.014, 6);
  return new THREE.Mesh(tube, new THREE.MeshBasicMaterial({ color: 0xff3b6b }));
}

function surfaceAxes(THREE, reach) {
  const soft = pageColour("--soft"), box = [[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1], [-1, 0, 1], [-1, 1, 1]];
  const label = (text, x, y, z) => {
    const mark = nameMark(THREE, text);
    mark.position.set(x, y, z);
    mark.center.set(0.5, 0.5);
    mark.scale.set(0.3, 0.075, 1);
    return mark;
  };
  return [lineOf(THREE, box, soft), label("ln S", 0, 0, 1.22), label("ln K", 1.22, 0, 0), label("cost", -1, 1.1, 1),
    label(`-${reach}`, -0.95, 0, 1.14), label(`${reach}`, 0.95, 0, 1.14), label(`-${reach}`, 1.14, 0, 0.95), label(`${reach}`, 1.14, 0, -0.95)];
}
