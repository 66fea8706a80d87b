# SPDX-License-Identifier: BSD-3-Clause
"""A map that epi360 makes of a rendered walk: a panorama, its cube faces, the path from above."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from PIL import Image

from epi360 import cli
from epi360.interop import read_colmap_model
from epi360.interop.reconstruction import Reconstruction
from epi360.jobs.cubes.cube_faces import face_from_cam
from epi360_paper.datasets import load_mp3d_vo

FACES = ("left", "front", "right", "back", "up")
ALL_FACES = (*FACES, "down")
COLOURS = ("#56B4E9", "#F0E442", "#E69F00", "#CC79A7", "#00C08B")
FRAME = 12  # the panorama that is shown
TAIL = 2  # frames before and after it in which a point is followed
WALK = ("--num-frames", "24", "--step-m", "0.2", "--max-turn-deg", "10", "--width", "1024")


def draw_map(drawn: Path) -> None:
    """Draw a panorama with the points of the map, its cube faces, and the path from above."""
    walk = drawn.parent / "walk"
    cli.main(["render", str(walk), *WALK])
    cli.main(["map", str(walk / "rgb"), "--output", str(walk / "map"),
              "--cubemap", "--faces", *FACES])  # fmt: skip
    model = read_colmap_model(walk / "map" / "sparse" / "0")
    figure = plt.figure(figsize=(12, 7.0), dpi=100)
    rows = figure.add_gridspec(2, 1, height_ratios=(4.2, 2.3), hspace=0.1,
                               left=0.008, right=0.992, bottom=0.008, top=0.955)  # fmt: skip
    above = rows[0].subgridspec(1, 2, width_ratios=(8.0, 3.7), wspace=0.03)
    _draw_panorama(figure.add_subplot(above[0]), model, walk / "rgb")
    _draw_path(figure.add_subplot(above[1]), model, walk)
    below = rows[1].subgridspec(1, len(FACES), wspace=0.03)
    cube = read_colmap_model(walk / "map" / "cubemap" / "sparse" / "0")
    for cell, face, colour in zip(below, FACES, COLOURS, strict=True):
        _draw_face(figure.add_subplot(cell), cube, walk / "map" / "cubemap", face, colour)
    figure.savefig(drawn)


def _draw_panorama(axes: Axes, model: Reconstruction, folder: Path) -> None:
    """Points of the map, coloured by the face they are on, and where neighbours see them."""
    place = {image.name: index for index, image in enumerate(model.images)}
    name = f"{FRAME}.png"
    camera = model.cameras[str(model.images[place[name]].camera)]
    _show(axes, folder / name, f"frame {FRAME} of 24: points of the map and their tracks")
    tracks = np.full((len(model.points), 2 * TAIL + 1, 2), np.nan)
    for column in range(2 * TAIL + 1):
        rows = model.observations.images == place[f"{FRAME + column - TAIL}.png"]
        tracks[model.observations.points[rows], column] = model.observations.pixels[rows]
    tracks = tracks[np.isfinite(tracks[:, TAIL, 0])]
    rays = camera.bearings_from_pixels(tracks[:, TAIL])
    nearest = np.argmax([rays @ face_from_cam(face).rotation[2] for face in ALL_FACES], axis=0)
    tracks, nearest = tracks[nearest < len(FACES)], nearest[nearest < len(FACES)]
    for track, face in zip(tracks, nearest, strict=True):
        seen = track[np.isfinite(track[:, 0])]
        if np.abs(np.diff(seen[:, 0])).max(initial=0) < camera.width / 2:  # not across the seam
            axes.plot(*seen.T, color=COLOURS[face], linewidth=0.8)
    points = tracks[:, TAIL]
    axes.scatter(*points.T, s=9, c=np.array(COLOURS)[nearest], edgecolors="k", linewidths=0.4)


def _draw_face(axes: Axes, cube: Reconstruction, folder: Path, face: str, colour: str) -> None:
    name = f"{FRAME}_{face}.jpg"
    index = [image.name for image in cube.images].index(name)
    _show(axes, folder / "images" / name, face)
    pixels = cube.observations.pixels[cube.observations.images == index]
    axes.scatter(*pixels.T, s=9, c=colour, edgecolors="k", linewidths=0.4)
    for side in axes.spines.values():
        side.set(visible=True, color=colour, linewidth=3)


def _show(axes: Axes, picture: Path, title: str) -> None:
    with Image.open(picture) as image:
        axes.imshow(image, extent=(0, image.width, image.height, 0), interpolation="lanczos")
        axes.set(xlim=(0, image.width), ylim=(image.height, 0), xticks=[], yticks=[])
    axes.set_title(title, fontsize=15, pad=5)


def _draw_path(axes: Axes, model: Reconstruction, walk: Path) -> None:
    """Room from above, true path and cameras of the map; one similarity for all of it."""
    poses = load_mp3d_vo(walk).world_from_cam
    true = np.array([poses[int(Path(image.name).stem) - 1].translation for image in model.images])
    found = np.array([image.cam_from_world.inverse().translation for image in model.images])
    moved, points = _aligned(found, true, found), _aligned(found, true, model.points)
    error_mm = 1000 * np.linalg.norm(moved - true, axis=1)
    below_ceiling = points[:, 1] > np.quantile(points[:, 1], 0.02) + 0.15  # y is down
    points, colours = points[below_ceiling], model.colors[below_ceiling]
    axes.scatter(points[:, 0], points[:, 2], s=2.5, c=colours / 255)
    order = np.argsort([int(Path(image.name).stem) for image in model.images])
    axes.plot(true[order, 0], true[order, 2], "-", color="k", linewidth=1.5, label="true path")
    axes.plot(
        moved[:, 0], moved[:, 2], "o", color="#E00000", markersize=3.5, label="cameras of the map"
    )
    low, high = (np.quantile(points[:, [0, 2]], q, axis=0) for q in (0.005, 0.995))
    axes.set(xlim=(low[0] - 0.3, high[0] + 0.3), ylim=(low[1] - 0.3, high[1] + 0.3))
    axes.set(aspect="equal", anchor="C", xticks=[], yticks=[])
    axes.set_title(f"from above: {np.median(error_mm):.1f} mm off (median)", fontsize=15, pad=5)
    axes.legend(fontsize=12, loc="lower left", framealpha=0.9)


def _aligned(source, target, points):
    """Points after the similarity that takes source to target, all (N, 3) (Umeyama 1991)."""
    from_middle, to_middle = source.mean(axis=0), target.mean(axis=0)
    left, sizes, right = np.linalg.svd((target - to_middle).T @ (source - from_middle))
    signs = np.array([1.0, 1.0, np.linalg.det(left @ right)])
    scale = (sizes * signs).sum() / ((source - from_middle) ** 2).sum()
    return scale * (points - from_middle) @ (left * signs @ right).T + to_middle
