# SPDX-License-Identifier: BSD-3-Clause
"""OpenSfM's own commands on projects that epi360 writes, with what they make of them.

The pictures say where each pixel looks in the world, so that pictures which a program makes can be
compared with the poses that it gives them.
"""

from __future__ import annotations

import subprocess
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from epi360.cameras import Camera, Equirectangular, KannalaBrandt
from epi360.interop import Observations, PosedImage, Reconstruction, read_opensfm
from epi360.interop.opensfm import write_opensfm_folder
from epi360.jobs.trajectories import align
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector

CAMERAS: dict[str, Camera] = {
    "panoramas": Equirectangular(640, 320),
    "fisheye": KannalaBrandt(
        400, 400, 130.0, 130.0, 201.0, 199.0, 0.01, -0.004, 0.001, -2e-4, max_angle_deg=85
    ),
}
TIME_LIMIT_S = 1800
MIDDLE = 127.5  # the color of a direction is this and up to 120 more or less


class Row(NamedTuple):
    """A command, how long it took, and what came of it."""

    command: str
    seconds: str
    result: str


def opensfm_rows(program: Path, scratch: Path) -> list[Row]:
    """Run OpenSfM's commands on a project of panoramas and on one of fisheye images."""
    rows = []
    for kind, camera in CAMERAS.items():
        scene, project = _scene(camera), scratch / kind
        _write_pictures(scene, scratch / f"{kind}_pictures")
        write_opensfm_folder(project, scene, images=scratch / f"{kind}_pictures")
        for command, look in _LOOKS.items():
            took, error = run([program, command, project])
            result = error or look(project, scene)
            rows.append(Row(f"opensfm {command}, {kind}", f"{took:.0f}", result))
    return rows


def run(words: list[str | Path], log: Path | None = None) -> tuple[float, str]:
    """Seconds that a command took, and its error in a line, empty if there was none."""
    start = time.perf_counter()
    try:
        done = subprocess.run(
            [str(word) for word in words], capture_output=True, text=True, timeout=TIME_LIMIT_S,
            check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        return time.perf_counter() - start, f"failed: {error}"[:200]
    took = time.perf_counter() - start
    if log is not None:
        log.write_text(done.stdout)
    if done.returncode == 0:
        return took, ""
    last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
    return took, f"failed ({done.returncode}): {last[:160]}"


def _scene(camera: Camera) -> Reconstruction:
    """Eight cameras in a row that turn and lean, and exact observations of 400 points."""
    rng = np.random.default_rng(2)
    points = rng.normal(size=(400, 3))
    points *= rng.uniform(3, 8, 400)[:, None] / np.linalg.norm(points, axis=1)[:, None]
    images, seen = [], []
    for number in range(8):
        turn = rotation_from_vector([0.1 * (number % 3), 0.5 * number, 0.05])
        pose = Pose(turn, -turn @ [0.3 * number, 0.02 * number, 0.1 * (number % 3)])
        images.append(PosedImage(f"walk/{number}.png", "camera", pose))
        pixels = camera.pixels_from_bearings(points @ pose.rotation.T + pose.translation)
        rows = np.flatnonzero(np.isfinite(pixels).all(axis=1))
        seen.append((rows, np.full(len(rows), number), pixels[rows]))
    observations = Observations(*(np.concatenate(each) for each in zip(*seen, strict=True)))
    counts = np.bincount(observations.points, minlength=len(points))
    kept = counts[observations.points] > 1
    observations = Observations(*(each[kept] for each in vars(observations).values()))
    used, renumbered = np.unique(observations.points, return_inverse=True)
    observations = Observations(renumbered, observations.images, observations.pixels)
    colors = rng.integers(0, 256, (len(used), 3)).astype(np.uint8)
    return Reconstruction({"camera": camera}, tuple(images), points[used], colors, observations)


def _write_pictures(scene: Reconstruction, folder: Path) -> None:
    for image in scene.images:
        path = folder / image.name
        path.parent.mkdir(parents=True, exist_ok=True)
        picture = world_colors(scene.cameras[str(image.camera)], image.cam_from_world)
        Image.fromarray(picture).save(path)


def world_colors(camera: Camera, cam_from_world: Pose) -> np.ndarray:
    """A picture whose colors are the directions of its pixels in the world; black where none."""
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = camera.bearings_from_pixels(np.column_stack([u.ravel(), v.ravel()]))
    colors = np.nan_to_num(MIDDLE + 120 * (rays @ cam_from_world.rotation), nan=0.0)
    return np.round(colors).astype(np.uint8).reshape(camera.height, camera.width, 3)


def _bundle(project: Path, scene: Reconstruction) -> str:
    """How far poses were moved from the exact ones, after the similarity that fits best."""
    found = {image.name: image.cam_from_world for image in read_opensfm(project).images}
    exact = [image.cam_from_world for image in scene.images]
    poses = [found[image.name] for image in scene.images]
    centers = [np.array([pose.inverse().translation for pose in each]) for each in (poses, exact)]
    fit = align(*centers, "sim3")
    off = np.linalg.norm(fit.apply(centers[0]) - centers[1], axis=1)
    turns = [
        rotation_error_deg(one.rotation @ fit.rotation.T, other.rotation)
        for one, other in zip(poses, exact, strict=True)
    ]
    return f"{len(poses)} shots, moved by {max(turns):.0e} deg and {off.max():.0e}"


def _undistort(project: Path, scene: Reconstruction) -> str:
    """By how much the new pictures are turned against what their poses say."""
    with warnings.catch_warnings(action="ignore"):  # its rigs are left out
        new = read_opensfm(project / "undistorted")
    errors = []
    for image in new.images:
        with Image.open(project / "undistorted" / "images" / image.name) as file:
            shown = np.asarray(file.convert("RGB"), dtype=float).reshape(-1, 3)
        wanted = world_colors(new.cameras[str(image.camera)], image.cam_from_world).reshape(-1, 3)
        seen = shown.min(axis=1) > 0
        turn = Rotation.align_vectors(shown[seen] - MIDDLE, wanted[seen] - MIDDLE)[0]
        errors.append(np.degrees(turn.magnitude()))
    return f"{len(new.images)} pictures, turned by {max(errors):.0e} deg"


def _files(*names: str) -> Callable[[Path, Reconstruction], str]:
    def look(project: Path, scene: Reconstruction) -> str:
        missing = [name for name in names if not (project / name).is_file()]
        return f"no {', '.join(missing)}" if missing else ", ".join(names)

    return look


_LOOKS: dict[str, Callable[[Path, Reconstruction], str]] = {
    "bundle": _bundle,
    "export_ply": _files("reconstruction.ply"),
    "detect_features": _files("features/0.png.features.npz"),
    "compute_statistics": _files("stats/stats.json"),
    "export_report": _files("stats/report.pdf"),
    "undistort": _undistort,
    "export_openmvs": _files("undistorted/openmvs/scene.mvs"),
    "export_visualsfm": _files("undistorted/reconstruction.nvm"),
}
