// SPDX-License-Identifier: BSD-3-Clause
"use strict";
// The report of one pair.

{
  const data = readJson("data");
  window.pairView = new PairView(document.querySelector(".pair"), data.pair);
  for (const [k, canvas] of document.querySelectorAll("canvas.inliers").entries())
    new Ball(canvas, floats(data.inlier_rays[k])).draw();
  for (const canvas of document.querySelectorAll("canvas.ovoid"))
    new Ball(canvas, floats(data.inlier_rays[0]), canvas.dataset.scales.split(",").map(Number)).draw();
  showSceneIn(document.querySelector(".scene"), data.scene);
  showSurfaceIn(document.querySelector(".surface"), data.surface);
}
