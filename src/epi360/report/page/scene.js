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
// the middle of the first look, reach: how far it looks, mark: the length of a camera's axes.
function showSceneIn(element, record) {
  if (!element || !record) return;
  showScene(element, record).catch(() => {
    element.textContent = "This browser has no WebGL, which the 3D view needs.";
  });
}

async function showScene(element, record) {
  const { THREE, OrbitControls } = await loadWebGL();
  const scene = new THREE.Scene(), reach = record.reach;
  const camera = new THREE.PerspectiveCamera(50, 2, reach / 1000, reach * 100);
  const renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
  element.replaceChildren(renderer.domElement);
  const world = new THREE.Group();
  world.scale.set(1, -1, -1); // our y points down and z forward, those of WebGL up and backward
  scene.add(world);
  world.add(pointCloud(THREE, record));
  for (const each of record.cameras) world.add(cameraMark(THREE, each, record.mark));
  const middle = new THREE.Vector3(record.middle[0], -record.middle[1], -record.middle[2]);
  camera.position.copy(middle).add(new THREE.Vector3(0.5, 0.9, 1.1).multiplyScalar(reach));
  const controls = new OrbitControls(camera, renderer.domElement);
  controls.target.copy(middle);
  const draw = () => renderer.render(scene, camera);
  controls.addEventListener("change", draw);
  new ResizeObserver(() => {
    const { clientWidth: width, clientHeight: height } = element;
    renderer.setPixelRatio(window.devicePixelRatio || 1);
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    draw();
  }).observe(element);
  controls.update();
  element.dataset.drawn = "yes";
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
  Object.assign(context, { lineWidth: 6, strokeStyle: "#000", fillStyle: "#fff", textAlign: "center" });
  context.strokeText(name, 128, 44, 250);
  context.fillText(name, 128, 44, 250);
  const material = new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas), depthTest: false, sizeAttenuation: false });
  const sprite = new THREE.Sprite(material);
  sprite.scale.set(0.2, 0.05, 1);
  sprite.center.set(0.5, -0.3);
  return sprite;
}
