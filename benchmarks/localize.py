# SPDX-License-Identifier: BSD-3-Clause
"""New images in a map: errors, sigmas and seconds, with pycolmap's estimator beside ours.

Each image of a set is left out of the map once: its observations are removed, the points are
triangulated again from the other images, whose poses stay, and the image is localized. The rendered
set has new images with exact truth instead, panoramas and a fisheye of 200 degrees. "focal" has
photographs of 90 degrees in the same map, whose focal length is given right, and too large.

pycolmap gets the same matches (our features, matched with the same images of the map), its
EQUIRECTANGULAR or PINHOLE camera, and estimates and refines the pose, of photographs with and
without the focal length; it has no model for a fisheye beyond 180 degrees.

    python benchmarks/localize.py room theta_flat --data /path/to/data --work scratch
"""

from __future__ import annotations

import argparse
import csv
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from _left_out import model_without, poses_in_world
from numpy.typing import NDArray

import epi360
from epi360.cameras import Camera, Equirectangular, KannalaBrandt, Pinhole
from epi360.estimation.calibration_doubt import CALIBRATION_QUESTION
from epi360.jobs.localization.map_matches import joined, matches_with
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.poses import Pose, pose_from_quaternion, rotation_from_vector

FISHEYE = KannalaBrandt(720, 720, 206.0, 206.0, 360.0, 360.0, 0.0, 0.0, 0.0, 0.0, max_angle_deg=100)
PANORAMA = Equirectangular(1024, 512)
PHOTOGRAPH = Pinhole(1000, 750, 500.0, 500.0, 500.0, 375.0)
FACTORS = (1.0, 1.01, 1.02, 1.05, 1.15)  # of its focal length
REAL = ("theta_flat", "Tram", "Walking_Girl")
MATCHED_VIEWS = 4  # for pycolmap, as in our first look
COLMAP_GATE_PX = 12.0  # its default; 4 and 2 px are tried too


@dataclass
class Query:
    """A new image, its truth in the world of its map, and the map."""

    name: str
    picture: Path | NDArray[np.uint8]
    camera: Camera | None
    truth: Pose
    world: LocalizationMap
    unit: float  # of the map in that of the truth


@dataclass
class Row:
    """Results of one method on a set."""

    method: str
    total: int = 0
    rotation_deg: list[float] = field(default_factory=list)
    position: list[float] = field(default_factory=list)
    sigmas: list[tuple[float, float]] = field(default_factory=list)
    num_told: int = 0  # by a warning about the camera
    cpu_s: list[float] = field(default_factory=list)


def run(words: list[str]) -> None:
    """Run a command of epi360."""
    subprocess.run([sys.executable, "-m", "epi360", *words], check=True, capture_output=True)


def map_of(images: Path, output: Path) -> LocalizationMap:
    """Map of a folder, made where it is not there."""
    if not (output / "sparse" / "0").is_dir():
        run(["map", str(images), "--output", str(output), "--no-track"])
    return epi360.load_map(output)


def true_poses(file: Path, names: list[str]) -> dict[str, Pose]:
    """``cam_from_world`` of the rows of a poses.csv, whose last seven numbers are q and c."""
    poses = {}
    with file.open(encoding="utf-8") as lines:
        rows = list(csv.reader(lines))[1:]
    for name, row in zip(names, rows, strict=True):
        numbers = np.array([float(cell) for cell in row[-7:]])
        poses[name] = pose_from_quaternion(numbers[4:], numbers[:4]).inverse()
    return poses


def real_queries(name: str, data: Path, work: Path, every: int) -> Iterator[Query]:
    """Images of a real set, each left out of its map."""
    folder = data / name if name == "theta_flat" else data / "video_clips" / name
    source = folder / ("images" if name == "theta_flat" else "frames")
    images = work / f"{name}-images"
    if not images.is_dir():
        shutil.copytree(source, images)
    world = map_of(images, work / f"{name}-map")
    names = sorted(path.name for path in images.iterdir())
    truth = true_poses(folder / "poses.csv", names)
    for image in world.model.images[::every]:
        model = model_without(world.model, {image.name})
        moved, unit = poses_in_world(truth, model, {image.name})
        left = LocalizationMap(model, world.source, name)
        yield Query(image.name, images / image.name, None, moved[image.name], left, unit)


def room_queries(work: Path, seed: int, camera: Camera, kind: str) -> Iterator[Query]:
    """New images of a rendered room."""
    from epi360_scenes import furnished_room

    room, rng = furnished_room(seed), np.random.default_rng(seed)
    images = work / f"room{seed}-images"
    poses = {}
    for number in range(10):
        place = np.array([-0.9 + 0.2 * number, -1.5, 0.25 * np.sin(number) - 0.3])
        pose = Pose(rotation_from_vector([0.02, 0.5 * number, 0.03]), place)
        poses[f"{number}.png"] = pose.inverse()
        path = images / f"{number}.png"
        if not path.is_file():
            images.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), room.render(PANORAMA, pose).image[..., ::-1])
    world = map_of(images, work / f"room{seed}-map")
    for number in range(8):
        place = np.array([rng.uniform(-0.9, 0.9), rng.uniform(-1.65, -1.3), rng.uniform(-0.6, 0)])
        pose = Pose(rotation_from_vector(rng.normal(size=3) * [0.1, 2.0, 0.1]), place)
        moved, unit = poses_in_world({**poses, "new": pose.inverse()}, world.model, {"new"})
        picture = room.render(camera, pose).image
        yield Query(f"{kind} {number}", picture, camera, moved["new"], world, unit)


def photograph_queries(work: Path, seed: int, factor: float) -> Iterator[Query]:
    """Photographs of the room, by a focal length that is too large."""
    wrong = replace(PHOTOGRAPH, fx=factor * PHOTOGRAPH.fx, fy=factor * PHOTOGRAPH.fy)
    for query in room_queries(work, seed, PHOTOGRAPH, "photograph"):
        yield replace(query, camera=wrong)


def add(row: Row, query: Query, pose: Pose | None, cpu_s: float) -> None:
    """Note the errors of a pose."""
    row.total += 1
    row.cpu_s.append(cpu_s)
    if pose is None:
        return
    away = pose.inverse().translation - query.truth.inverse().translation
    row.rotation_deg.append(epi360.rotation_error_deg(pose, query.truth))
    row.position.append(float(np.linalg.norm(away)) * query.unit)


def ours(query: Query, row: Row) -> None:
    """Localize an image with epi360."""
    begun = time.process_time()
    result = epi360.localize_image(query.picture, query.world, camera=query.camera)
    cpu_s = time.process_time() - begun
    add(row, query, result.cam_from_world if result.success else None, cpu_s)
    row.num_told += any(CALIBRATION_QUESTION in each for each in result.warnings)
    if result.success:
        row.sigmas.append((result.rotation_sigma_deg, result.position_sigma * query.unit))


def colmap(query: Query, row: Row, gate_px: float, *, refine_focal: bool = False) -> None:
    """Estimate and refine with pycolmap from the same kind of matches."""
    import pycolmap

    world = query.world
    picture = epi360.read_image(query.picture)
    camera = query.camera or Equirectangular(picture.shape[1], picture.shape[0])
    begun = time.process_time()
    features = world.source.of_new(query.picture, camera, None, 0.0)
    views = world.similar_views(features)[:MATCHED_VIEWS]
    matches = joined([matches_with(world.view(k), k, features) for k in views])
    size = {"width": camera.width, "height": camera.height}
    if isinstance(camera, Pinhole):
        numbers = [camera.fx, camera.fy, camera.cx, camera.cy]
        model = pycolmap.Camera(model="PINHOLE", params=numbers, **size)
    else:
        model = pycolmap.Camera(model="EQUIRECTANGULAR", params=[*size.values()], **size)
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = gate_px
    refinement = pycolmap.AbsolutePoseRefinementOptions()
    refinement.refine_focal_length = refine_focal
    found = pycolmap.estimate_and_refine_absolute_pose(
        features.keypoints[matches.rows], matches.points, model, options, refinement
    )
    pose = None
    if found is not None:
        matrix = found["cam_from_world"].matrix()
        pose = Pose(matrix[:, :3], matrix[:, 3])
    add(row, query, pose, time.process_time() - begun)


def table(name: str, rows: list[Row]) -> None:
    """Print the lines of a set."""
    for row in rows:
        if not row.total:
            continue
        rotation, position = row.rotation_deg or [np.nan], row.position or [np.nan]
        line = (
            f"| {name} | {row.method} | {len(row.position)} of {row.total} "
            f"| {np.median(rotation):.3f} / {np.max(rotation):.3f} "
            f"| {np.median(position):.2g} / {np.max(position):.2g} "
        )
        sigmas = np.array(row.sigmas)
        line += (
            f"| {np.median(sigmas[:, 0]):.3f} / {np.median(sigmas[:, 1]):.2g} "
            if len(sigmas)
            else "| none "
        )
        told = row.num_told if len(sigmas) else "–"
        print(f"{line}| {told} | {np.median(row.cpu_s):.2f} |", flush=True)


def main() -> None:
    """Run the sets and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="+", choices=["room", "focal", *REAL])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--every", type=int, default=1, help="leave out every so many images only")
    parser.add_argument("--room", type=int, default=0, help="seed of the rendered room (0)")
    given = parser.parse_args()
    given.work.mkdir(exist_ok=True)
    print(
        "| set | method | poses | rotation error, deg: median / worst | position error: median / "
        "worst | sigma: rotation, deg / position | camera doubted | CPU s |"
    )
    print("| --- " * 8 + "|")
    for name in given.sets:
        if name == "room":
            kinds = {"panoramas": PANORAMA, "fisheye 200°": FISHEYE}
            groups = {
                f"room, {k}": room_queries(given.work, given.room, c, k) for k, c in kinds.items()
            }
        elif name == "focal":
            groups = {
                f"room, focal length times {factor}": photograph_queries(
                    given.work, given.room, factor
                )
                for factor in FACTORS
            }
        else:
            groups = {name: real_queries(name, given.data, given.work, given.every)}
        for title, queries in groups.items():
            gates = (COLMAP_GATE_PX, 4.0)
            mine, peers = Row("epi360"), [Row(f"pycolmap, {gate:.0f} px") for gate in gates]
            refined = Row(f"pycolmap, {COLMAP_GATE_PX:.0f} px, with focal length")
            for query in queries:
                ours(query, mine)
                if query.camera is not FISHEYE:
                    for row, gate in zip(peers, gates, strict=True):
                        colmap(query, row, gate)
                if isinstance(query.camera, Pinhole):
                    colmap(query, refined, COLMAP_GATE_PX, refine_focal=True)
            table(title, [mine, *peers, refined])


if __name__ == "__main__":
    main()
