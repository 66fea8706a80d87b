# SPDX-License-Identifier: BSD-3-Clause
"""Sequences for the benchmark of odometry: rendered with exact truth, and real clips."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _data import read_poses

from epi360.cameras import Camera, Equirectangular, KannalaBrandt, load_camera
from epi360.features import read_image
from epi360.image_folders import natural_order
from epi360.jobs.trajectories import PosedFrames, posed_frames, read_trajectory
from epi360_scenes import SCENES, handheld_path, scene
from epi360_scenes.film import Effects
from epi360_scenes.mp3d_layout import POSES_FILE
from epi360_scenes.sequence import CAMERA_FILE, render_sequence

CAMERAS = {
    "360": Equirectangular(1024, 512),
    # Equidistant, 200 degrees in a circle of 790 pixels.
    "fisheye200": KannalaBrandt(800, 800, 226, 226, 400, 400, 0, 0, 0, 0, max_angle_deg=100),
}
EFFECTS = {
    "people": Effects(moving_people=3),
    "exposure": Effects(exposure_change=2.0),
    "blur": Effects(motion_blur=5),
    "shutter": Effects(rolling_shutter_ms=20.0),
    "all": Effects(3, 2.0, 5, 20.0),
}
CLIPS = ("Tram", "Walking_Girl", "Farm", "Elephant")
RENDERED = tuple(f"{name}_{camera}" for name in SCENES for camera in CAMERAS)
KNOWN = (*RENDERED, *CLIPS, "theta_flat")


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames in order, their camera, masks by the frame's name, and the truth if there is one."""

    name: str
    frames: tuple[Path, ...]
    camera: Camera
    truth: PosedFrames | None  # its names are those of the frames
    masks: dict[str, Path]


def rendered_clip(folder: Path, name: str, num_frames: int) -> Clip:
    """Rendered sequence; ``NAME+EFFECT`` and ``NAME-loop`` are those of a room and camera too.

    A folder that has as many frames is used as it is; otherwise the frames are rendered into it.
    """
    base, _, effect = name.partition("+")
    loop = base.endswith("-loop")
    place, _, lens = base.removesuffix("-loop").rpartition("_")
    if place not in SCENES or lens not in CAMERAS or (effect and effect not in EFFECTS):
        raise ValueError(f"unknown sequence {name}")
    target = folder / (f"{name}{num_frames}" if loop else name)
    if not _has_frames(target, num_frames):
        room = scene(place)
        poses = handheld_path(room, num_frames, loop=loop)
        options = {"scene": place, "seed": 0, "num_frames": num_frames, "effect": effect or None}
        render_sequence(
            room, CAMERAS[lens], poses, target, options, effects=EFFECTS.get(effect, Effects())
        )
    files = [target / "rgb" / f"{number}.png" for number in range(1, num_frames + 1)]
    rows = read_trajectory(target / POSES_FILE).rows(np.arange(num_frames))
    truth = PosedFrames(tuple(f.name for f in files), rows.times_s, rows.rotations, rows.positions)
    return Clip(name, tuple(files), load_camera(target / CAMERA_FILE), truth, {})


def _has_frames(folder: Path, num_frames: int) -> bool:
    return (folder / POSES_FILE).is_file() and all(
        (folder / "rgb" / f"{number}.png").is_file() for number in range(1, num_frames + 1)
    )


def real_clip(data: Path, name: str) -> Clip:
    """A clip of ``video_clips``, with its masks, or ``theta_flat``."""
    if name == "theta_flat":
        folder = data / name
        images, masks = folder / "images", {}
    else:
        folder = data / "video_clips" / name
        images = folder / "frames"
        masks = {f"{path.stem}.jpg": path for path in (folder / "masks").glob("*.png")}
    files = sorted(images.glob("*.jpg"), key=natural_order)
    height, width = read_image(files[0]).shape[:2]
    table = folder / "poses.csv"
    poses = read_poses(table) if table.is_file() else None
    truth = posed_frames(list(poses), None, list(poses.values())) if poses else None
    return Clip(name, tuple(files), Equirectangular(width, height), truth, masks)
