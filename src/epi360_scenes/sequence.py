# SPDX-License-Identifier: BSD-3-Clause
"""A sequence of pictures, ranges and poses in a folder, rendered so that it can be resumed."""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from epi360.cameras import Camera
from epi360.poses import Pose
from epi360.progress import Progress, no_progress
from epi360.runs.made_from import first_difference, read_record
from epi360_scenes.film import Effects, Film
from epi360_scenes.mp3d_layout import (
    POSES_FILE,
    TIMES_FILE,
    frame_files,
    poses_text,
    times_text,
    write_frame,
    write_whole,
)
from epi360_scenes.rendering import RayCaster

OPTIONS_FILE, CAMERA_FILE = "render.json", "camera.json"


def prepare_sequence(
    folder: Path, camera: Camera, world_from_cam: Sequence[Pose], options: Mapping[str, Any]
) -> None:
    """Make the folder of a sequence with its poses, camera and options, or check that they fit."""
    files = {
        OPTIONS_FILE: json.dumps(dict(options), indent=2) + "\n",
        CAMERA_FILE: json.dumps(camera_record(camera), indent=2) + "\n",
        POSES_FILE: poses_text(world_from_cam),
        TIMES_FILE: times_text(len(world_from_cam)),
    }
    check_folder(folder, options)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        path = folder / name
        if not path.exists():
            write_whole(path, text.encode())
        elif path.read_text(encoding="utf-8") != text:
            raise ValueError(
                f"{path} is not what these options give with this version of epi360; "
                "choose another folder"
            )


def render_sequence(
    scene: RayCaster,
    camera: Camera,
    world_from_cam: Sequence[Pose],
    folder: Path,
    options: Mapping[str, Any],
    *,
    supersample: int = 2,
    effects: Effects | None = None,
    step_m: float = 0.04,
    progress: Progress = no_progress,
) -> int:
    """Render the missing frames of a sequence, in the layout of 360-MP3D-VO.

    ``step_m`` is how far moving people go in a frame; their seed, and that of the exposure, is the
    option "seed".
    """
    seed = int(options.get("seed") or 0)
    film = Film(scene, camera, world_from_cam, effects or Effects(), seed=seed, step_m=step_m)
    prepare_sequence(folder, camera, world_from_cam, options)
    missing = [
        index
        for index in range(len(world_from_cam))
        if not all(path.is_file() for path in frame_files(folder, index))
    ]
    total = len(world_from_cam)
    num_kept = total - len(missing)
    progress("frames", num_kept, total)
    for count, index in enumerate(missing, start=1):
        write_frame(folder, index, film.frame(index, supersample=supersample))
        progress("frames", num_kept + count, total)
    return len(missing)


def check_folder(
    folder: Path, options: Mapping[str, Any], *, defaults: Mapping[str, Any] | None = None
) -> None:
    """Raise if a folder cannot take a sequence of these options; nothing is written.

    ``defaults`` are the values of options that may be left out, there or here.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"the sequence must go into a folder, {folder} is a file")
    if not folder.is_dir() or not any(folder.iterdir()):
        return
    path = folder / OPTIONS_FILE
    if not path.is_file():
        raise ValueError(
            f"{folder} is not empty and holds no sequence of epi360 render; choose a new folder"
        )
    options = {**(defaults or {}), **options}
    found = {**(defaults or {}), **(read_record(path, remedy="choose another folder") or {})}
    different = first_difference(found, {**options, **dict.fromkeys(found.keys() - options.keys())})
    if different is not None:
        raise ValueError(
            f"{folder} holds a sequence with {different.name} {different.before}, not "
            f"{different.now}; choose another folder, or the same options to resume it"
        )


def camera_record(camera: Camera) -> dict[str, Any]:
    """Model and parameters of a camera in our own file format."""
    numbers = {
        name: value for name, value in dataclasses.asdict(camera).items() if value is not None
    }
    return {"model": type(camera).__name__, **numbers}
