# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 render``: a sequence of pictures, ranges and poses of a scene."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cyclopts import Group, Parameter

from epi360.cli.command import (
    SUCCESS,
    TO_TRY,
    Flag,
    app,
    show_bars,
    show_progress,
)

if TYPE_CHECKING:
    from epi360.cameras import Camera
    from epi360_scenes.meshes import MeshScene
    from epi360_scenes.room import Room


@Parameter(name="*", group=Group("Scene", sort_key=1))
@dataclass(frozen=True)
class SceneChoice:
    """What is rendered."""

    scene: Literal["living_room", "studio"] | None = None
    """Built-in scene: living_room (default) is rich in key points on all sides, studio on one."""
    seed: int = 0
    """Random seed of the furnishing and of the path."""
    mesh: Path | None = None
    """Textured mesh instead of a built-in scene: OBJ, PLY or GLB, in metres."""
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = "+y"
    """With --mesh: axis of its world that points up; glTF says +y, many scans +z."""


@Parameter(name="*", group=Group("Path", sort_key=2))
@dataclass(frozen=True)
class PathChoice:
    """How the camera moves."""

    num_frames: int = 300
    """Number of frames."""
    step_m: float = 0.04
    """Largest way between two frames; frames 0.5 m apart are then about 13 frames apart."""
    max_turn_deg: float = 2.0
    """Largest turn between two frames."""
    height_m: float = 1.5
    """Mean height of the camera over the floor."""
    clearance_m: float = 0.35
    """Least distance from every surface."""
    loop: Flag = False
    """The last pose is the first one again."""


@Parameter(name="*", group=Group("Camera", sort_key=3))
@dataclass(frozen=True)
class CameraChoice:
    """What the pictures are like."""

    width: int | None = None
    """Width of the panoramas, twice their height; 1024 by default."""
    camera: Path | None = None
    """Calibration file of another camera, a fisheye for example, instead of a panorama; FILE:NAME
    where it holds several."""
    supersample: int = 2
    """Rays per axis in pixels at edges."""


LARGEST_SUPERSAMPLE = 32  # a thousand rays a pixel


@Parameter(name="*", group=Group("Effects", sort_key=4))
@dataclass(frozen=True)
class EffectChoice:
    """What a real camera adds, at 30 frames a second."""

    moving_people: int = 0
    """So many people walk through a built-in scene."""
    exposure_change: float = 0.0
    """Stops between the brightest and the darkest exposure at most; it changes slowly, so that less
    than a hundred frames have less."""
    motion_blur: int = 1
    """Odd number of moments that are mixed in a picture, over half of the time of a frame."""
    rolling_shutter_ms: float = 0.0
    """Time from the first row to the last; the pose is that of the middle row."""


ANY_SCENE, ANY_PATH, ANY_CAMERA = SceneChoice(), PathChoice(), CameraChoice()
NO_EFFECTS = EffectChoice()


@app.command(group=TO_TRY, sort_key=2)
def render(
    out: Path,
    /,
    *,
    what: SceneChoice = ANY_SCENE,
    path: PathChoice = ANY_PATH,
    picture: CameraChoice = ANY_CAMERA,
    effect: EffectChoice = NO_EFFECTS,
) -> int:
    """Render pictures, depth and poses along a hand-held path, in the layout of 360-MP3D-VO.

    Writes rgb/1.png, ..., depth/tiff/1.tiff, ... (float32, metres along the ray, 0 = none),
    frm_ref.txt (rows t tx ty tz qx qy qz qw of world_from_cam; row k from 0 belongs to files
    k + 1), rgb/frames.csv (that t of each picture), camera.json and render.json. The same command
    resumes an interrupted run.

    Parameters
    ----------
    out
        Folder of the sequence: new, or begun with the same options.
    """
    from epi360_scenes.film import Effects
    from epi360_scenes.paths import handheld_path
    from epi360_scenes.sequence import check_folder, render_sequence

    _check_words(what, path, picture)
    if effect.moving_people and what.mesh is not None:
        raise ValueError("--moving-people walk through the built-in scenes only, not a --mesh")
    effects = Effects(**asdict(effect))
    camera, options = _camera(picture), _options(what, path, picture, effect)
    check_folder(out, options, defaults=asdict(NO_EFFECTS))
    out.mkdir(parents=True, exist_ok=True)  # where that fails, it fails before the work
    with show_progress() as say:
        say("building the scene")
        scene = _scene(what)
        say("planning the path")
        poses = handheld_path(scene, seed=what.seed, **asdict(path))
    with show_bars() as progress:
        render_sequence(
            scene, camera, poses, out, options, supersample=picture.supersample, effects=effects,
            step_m=path.step_m, progress=progress,
        )  # fmt: skip
    print(f"{len(poses)} frames of {camera.width}x{camera.height} pixels in {out}", flush=True)
    return SUCCESS


def _check_words(what: SceneChoice, path: PathChoice, picture: CameraChoice) -> None:
    if what.mesh is not None and what.scene is not None:
        raise ValueError("give --mesh or --scene, not both: each is a scene of its own")
    if picture.camera is not None and picture.width is not None:
        raise ValueError("--width is that of a panorama; a --camera file has its own size")
    for name, value in (("num_frames", path.num_frames), ("supersample", picture.supersample)):
        if value < 1:
            raise ValueError(f"{name} must be 1 or more, got {value}")
    if picture.supersample > LARGEST_SUPERSAMPLE:
        raise ValueError(
            f"supersample must be {LARGEST_SUPERSAMPLE} or less, got {picture.supersample}"
        )


def _camera(picture: CameraChoice) -> Camera:
    from epi360.cameras import Equirectangular, load_camera
    from epi360.features.image_files import MAX_PIXELS

    if picture.camera is not None:
        camera = load_camera(picture.camera)
        if camera.width * camera.height > MAX_PIXELS:
            raise ValueError(
                f"--camera may have {MAX_PIXELS} pixels at most, got "
                f"{camera.width}x{camera.height} in {picture.camera}"
            )
        return camera
    width = 1024 if picture.width is None else picture.width
    if width < 2 or width % 2:
        raise ValueError(f"--width must be a positive even number, got {width}")
    if width * (width // 2) > MAX_PIXELS:  # no command would read such pictures
        raise ValueError(f"--width may give {MAX_PIXELS} pixels at most, got {width}x{width // 2}")
    return Equirectangular(width, width // 2)


def _options(
    what: SceneChoice, path: PathChoice, picture: CameraChoice, effect: EffectChoice
) -> dict[str, Any]:
    """What the pictures depend on, to recognise a sequence that can be resumed."""
    from epi360.extras import package_version
    from epi360.runs.input_files import read_file

    if what.mesh is None:
        scene: dict[str, Any] = {"scene": what.scene or "living_room"}
    else:
        digest = hashlib.sha256(read_file(what.mesh)).hexdigest()
        scene = {"mesh": what.mesh.name, "mesh_sha256": digest, "up": what.up}
    calibration = None if picture.camera is None else picture.camera.name
    # What is left out is not written: a folder of an earlier version can be gone on with.
    asked = {name: value for name, value in asdict(effect).items() if effect != NO_EFFECTS}
    way = {name: value for name, value in asdict(path).items() if name != "loop" or value}
    options = {**scene, "seed": what.seed, **way, **asked}
    options |= {"width": picture.width, "camera": calibration, "supersample": picture.supersample}
    return {**options, "epi360": package_version()}


def _scene(what: SceneChoice) -> Room | MeshScene:
    if what.mesh is None:
        from epi360_scenes.room import scene

        return scene(what.scene or "living_room", what.seed)
    from epi360_scenes.meshes import load_mesh_scene

    return load_mesh_scene(what.mesh, up=what.up)
