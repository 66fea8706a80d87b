// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// Points and cameras in 3D with three.js, which the page carries as text.

let webglModule = null;

function loadWebGL() {
  const source = readJson("webgl");
  if (!source) return Promise.reject(new Error("no library"));
  if (!webglModule) {
    const address = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
    webglModule = import(address);
  }
  return webglModule;
}

// record: points and colours (packed), cameras [{name, rotation (9, camera from world), centre (3)}],
// the middle of the first look, reach: how far it looks, mark: the length of a camera's axes; where
// there is a way: path (packed, NaN between its parts), loops [[from, to]]. Returns a promise of
// {select}, or of null where nothing can be drawn; onPick gets the number of a camera that is clicked.
function showSceneIn(element, record, onPick) {
  if (!element || !record) return Promise.resolve(null);
  return showScene(element, record, onPick).catch(() => {
    element.textContent = "This browser has no WebGL, which the 3D view needs.";
    return null;
  });
}

async function showScene(element, record, onPick) {
  const { THREE, OrbitControls } = await loadWebGL();
  const reach = record.reach, world = new THREE.Group();
  world.scale.set(1, -1, -1); // our y points down and z forward, those of WebGL up and backward
  world.add(pointCloud(THREE, record));
  const marks = record.cameras.map((each) => cameraMark(THREE, each, record.mark));
  world.add(...marks);
  if (record.path) world.add(pathLine(THREE, floats(record.path)));
  for (const ends of record.loops || []) world.add(lineOf(THREE, ends, pageColour("--poor")));
  const view = openView(THREE, OrbitControls, element, world, reach);
  const middle = new THREE.Vector3(record.middle[0], -record.middle[1], -record.middle[2]);
  view.look(middle, new THREE.Vector3(0.5, 0.9, 1.1).multiplyScalar(reach));
  if (onPick) onCameraClick(THREE, view, marks, onPick);
  element.dataset.drawn = "yes";
  return { select: (number) => selectMark(view, marks, number) };
}

// A canvas with a camera that the pointer turns around a target; look() places it.
function openView(THREE, OrbitControls, element, world, reach) {
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(50, 2, reach / 1000, reach * 100);
  const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
  element.replaceChildren(renderer.domElement);
  scene.add(world);
  const controls = new OrbitControls(camera, renderer.domElement);
  const draw = () => renderer.render(scene, camera);
  controls.addEventListener("change", draw);
  new ResizeObserver(() => {
    const { clientWidth: width, clientHeight: height } = element;
    if (!width || !height) return;
    renderer.setPixelRatio(window.devicePixelRatio || 1);
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    draw();
  }).observe(element);
  const look = (target, from) => {
    camera.position.copy(target).add(from);
    controls.target.copy(target);
    controls.update();
  };
  return { camera, canvas: renderer.domElement, draw, look };
}

// A click is a press without a drag; it picks the nearest camera within a finger's width.
function onCameraClick(THREE, view, marks, onPick) {
  let pressed = null;
  view.canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
  view.canvas.addEventListener("pointerup", (event) => {
    if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 5) return;
    const box = view.canvas.getBoundingClientRect();
    let best = -1, nearest = 18;
    for (const [k, mark] of marks.entries()) {
      const place = mark.getWorldPosition(new THREE.Vector3()).project(view.camera);
      if (place.z > 1) continue;
      const x = box.left + ((place.x + 1) / 2) * box.width, y = box.top + ((1 - place.y) / 2) * box.height;
      const away = Math.hypot(event.clientX - x, event.clientY - y);
      if (away < nearest) [best, nearest] = [k, away];
    }
    if (best >= 0) onPick(best);
  });
}

function selectMark(view, marks, number) {
  for (const [k, mark] of marks.entries()) {
    const chosen = k === number;
    mark.children[0].scale.setScalar(chosen ? 3 : 1);
    mark.children[0].material.color.set(chosen ? 0xff3b6b : 0xffb000);
  }
  view.draw();
}

function pathLine(THREE, places) {
  const group = new THREE.Group();
  let part = [];
  const end = () => {
    if (part.length > 1) group.add(lineOf(THREE, part, pageColour("--soft")));
    part = [];
  };
  for (let i = 0; i < places.length; i += 3) {
    if (Number.isFinite(places[i])) part.push(Array.from(places.subarray(i, i + 3)));
    else end();
  }
  end();
  return group;
}

function lineOf(THREE, places, colour) {
  const geometry = new THREE.BufferGeometry().setFromPoints(places.map((each) => new THREE.Vector3(...each)));
  return new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: colour }));
}

function pointCloud(THREE, record) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(floats(record.points), 3));
  geometry.setAttribute("color", new THREE.BufferAttribute(floats(record.colours), 3));
  const many = geometry.getAttribute("position").count > 1500; // small dots do not hide each other
  const look = { size: (many ? 2 : 3.5) * (window.devicePixelRatio || 1), sizeAttenuation: false, vertexColors: true };
  return new THREE.Points(geometry, new THREE.PointsMaterial(look));
}

// A camera: its axes (x red, y green, z blue), a dot and its name.
function cameraMark(THREE, { name, centre, rotation }, size) {
  const group = new THREE.Group();
  group.position.set(...centre);
  const dotMark = new THREE.Mesh(new THREE.SphereGeometry(0.12 * size, 16, 12), new THREE.MeshBasicMaterial({ color: 0xffb000 }));
  group.add(dotMark);
  const colours = [0xe0402f, 0x1f9d55, 0x3b82f6];
  for (let k = 0; k < 3; k++) {
    const axis = rotation.slice(3 * k, 3 * k + 3); // a row of R is an axis of the camera in the world
    const line = new THREE.BufferGeometry().setFromPoints([
      new THREE.Vector3(), new THREE.Vector3(...axis).multiplyScalar(size)]);
    group.add(new THREE.Line(line, new THREE.LineBasicMaterial({ color: colours[k] })));
  }
  if (name) group.add(nameMark(THREE, name));
  return group;
}

function nameMark(THREE, name) {
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: 256, height: 64 });
  const context = canvas.getContext("2d");
  context.font = "bold 34px sans-serif";
  Object.assign(context, { lineWidth: 6, strokeStyle: pageColour("--panel"), fillStyle: pageColour("--text"), textAlign: "center" });
  context.strokeText(name, 128, 44, 250);
  context.fillText(name, 128, 44, 250);
  const texture = Object.assign(new THREE.CanvasTexture(canvas), { colorSpace: "srgb" });
  const material = new THREE.SpriteMaterial({ map: texture, depthTest: false, sizeAttenuation: false });
  const sprite = new THREE.Sprite(material);
  sprite.scale.set(0.2, 0.05, 1);
  sprite.center.set(0.5, -0.3);
  return sprite;
}
