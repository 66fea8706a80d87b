# SPDX-License-Identifier: BSD-3-Clause
"""The faces of a cube around a camera: where they look, which pixels they show, their poses."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Literal, get_args

import numpy as np

from epi360.cameras import Camera, Pinhole
from epi360.cameras.resizing import pixels_per_radian
from epi360.interop.reconstruction import Observations, PosedImage, Reconstruction
from epi360.poses import Pose

FaceName = Literal["front", "right", "back", "left", "up", "down"]
FACES: tuple[FaceName, ...] = get_args(FaceName)
# Rows are the axes of the face, x right, y down, z forward, in the camera's frame. The bottom of
# "up" and the top of "down" touch "front".
_FACE_FROM_CAM: dict[FaceName, tuple[tuple[int, int, int], ...]] = {
    "front": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "right": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "back": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    "left": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "up": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "down": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
}


@dataclass(frozen=True)
class CubemapOptions:
    """How panoramas are cut into faces.

    ``face_size`` is the width and height of a face in pixels. By default a face has as many pixels
    as the panorama has in its angle: a quarter of its width at 90 degrees, and 21 % fewer a degree
    in its middle. "native" loses nothing there: 1 / pi of the width at 90 degrees. If ``fov_deg``
    is more than 90, neighbours overlap. ``flat`` names have neither folders nor dots nor spaces.
    With ``alpha``, which needs PNG, the alpha channel is zero where a face is masked.
    """

    face_size: int | Literal["native"] | None = None
    fov_deg: float = 90.0
    faces: tuple[FaceName, ...] = FACES
    image_format: Literal["jpg", "png"] = "jpg"
    jpeg_quality: int = 95
    flat: bool = False
    alpha: bool = False

    def __post_init__(self) -> None:
        """Check the ranges."""
        size = self.face_size
        if size not in (None, "native") and not (isinstance(size, int) and 8 <= size <= 16384):
            raise ValueError(f'face_size must be 8 to 16384 pixels or "native", got {size}')
        if not 10 <= self.fov_deg <= 150:
            raise ValueError(f"fov_deg must be 10 to 150, got {self.fov_deg}")
        if self.image_format not in ("jpg", "png"):
            raise ValueError(f"image_format must be jpg or png, got {self.image_format!r}")
        if not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"jpeg_quality must be 1 to 100, got {self.jpeg_quality}")
        if self.alpha and self.image_format != "png":
            raise ValueError("image_format must be png for alpha, as JPEG has no transparency")
        if not self.faces or len(set(self.faces)) < len(self.faces) or {*self.faces} - {*FACES}:
            raise ValueError(
                f"faces must be different ones of {', '.join(FACES)}, got {', '.join(self.faces)}"
            )


def face_from_cam(face: FaceName) -> Pose:
    """Pose of a face in the frame of its camera: a rotation."""
    return Pose(np.array(_FACE_FROM_CAM[face], dtype=np.float64), np.zeros(3))


def face_camera(camera: Camera, options: CubemapOptions) -> Pinhole:
    """Square pinhole camera of the faces of a camera, its principal point in the middle."""
    tangent = round(math.tan(math.radians(options.fov_deg / 2)), 14)  # exactly 1 for 45 degrees
    size = options.face_size
    if size is None or size == "native":
        # In its middle a face has its focal length in pixels a radian.
        share = 1.0 if size == "native" else math.pi / 4
        size = max(8, 2 * round(tangent * pixels_per_radian(camera) * share))
    focal = size / 2 / tangent
    return Pinhole(width=size, height=size, fx=focal, fy=focal, cx=size / 2, cy=size / 2)


def face_image_names(names: list[str], options: CubemapOptions) -> dict[tuple[str, FaceName], str]:
    """File names of the faces: ``sub/NAME_front.jpg`` of ``sub/NAME.png``; flat, without ``sub/``.

    The names differ also where case does not count. Where two panoramas differ only in their
    ending, it stays in the names of all; where two flat names are the same, they get numbers.
    """
    if unnamed := [name for name in names if not PurePosixPath(name).name]:
        raise ValueError(f"images must have names, got {unnamed[0]!r}")
    stems = {name: str(PurePosixPath(name).with_suffix("")) for name in names}
    if max(Counter(stem.casefold() for stem in stems.values()).values(), default=1) > 1:
        stems = {name: name for name in names}
    if options.flat:
        stems = _flat_stems(stems)
    return {
        (name, face): f"{stem}_{face}.{options.image_format}"
        for name, stem in stems.items()
        for face in options.faces
    }


def _flat_stems(stems: dict[str, str]) -> dict[str, str]:
    """Stems in which "_" stands for each slash, dot and space, all different."""
    flat = {name: re.sub(r"[/\\.\s]+", "_", stem).strip("_") for name, stem in stems.items()}
    if len({stem.casefold() for stem in flat.values()}) < len(flat):
        digits = len(str(len(flat)))
        numbered = enumerate(flat.items(), start=1)
        flat = {name: f"{number:0{digits}d}_{stem}" for number, (name, stem) in numbered}
    return flat


def cubemap_reconstruction(
    reconstruction: Reconstruction, options: CubemapOptions
) -> Reconstruction:
    """Reconstruction whose images are the faces of another's, as far as its cameras see them.

    The faces of a panorama are a frame of a rig, whose cameras are the faces: a bundle adjustment
    keeps them together. Panoramas of one size share a rig. Cameras that are on a rig already stay
    on it, each with its faces. An observation goes to the face nearest to whose middle it lies.
    Points that no face sees are left out, and those of several observations of which one remains.
    """
    for image in reconstruction.images:
        if image.camera is None:
            raise ValueError(f"image {image.name} has no camera, so it cannot be cut into faces")
    sensors = _FaceCameras(reconstruction, options)
    names = face_image_names([image.name for image in reconstruction.images], options)
    images: list[PosedImage] = []
    place: dict[tuple[int, FaceName], int] = {}
    for index, image in enumerate(reconstruction.images):
        camera = str(image.camera)
        frame = image.frame if camera in reconstruction.cam_from_rig else None
        for face in sensors.faces[camera]:
            place[index, face] = len(images)
            pose = face_from_cam(face) @ image.cam_from_world
            key = sensors.names[camera, face]
            on_rig = (frame or f"image {index + 1}") if key in sensors.cam_from_rig else None
            name = names[image.name, face]
            images.append(PosedImage(name, key, pose, image.timestamp_s, on_rig))
    cube = Reconstruction(sensors.cameras, tuple(images), cam_from_rig=sensors.cam_from_rig)
    return _with_points(reconstruction, cube, place)


class _FaceCameras:
    """A camera for each face of each camera, or of all cameras that give faces of one size."""

    def __init__(self, source: Reconstruction, options: CubemapOptions) -> None:
        self.cameras: dict[str, Pinhole] = {}
        self.cam_from_rig: dict[str, Pose] = {}
        self.names: dict[tuple[str, FaceName], str] = {}
        self.faces = {name: visible_faces(each, options) for name, each in source.cameras.items()}
        groups: dict[object, list[str]] = {}
        for name, camera in source.cameras.items():
            on_rig = name in source.cam_from_rig
            groups.setdefault(name if on_rig else face_camera(camera, options), []).append(name)
        for members in groups.values():
            pinhole = face_camera(source.cameras[members[0]], options)
            cam_from_rig = source.cam_from_rig.get(members[0])
            seen = [face for face in options.faces if any(face in self.faces[m] for m in members)]
            for face in seen:
                key = str(len(self.cameras) + 1)
                self.cameras[key] = pinhole
                self.names |= {(member, face): key for member in members}
                if cam_from_rig is not None:
                    self.cam_from_rig[key] = face_from_cam(face) @ cam_from_rig
                elif len(seen) > 1:
                    self.cam_from_rig[key] = face_from_cam(face)
        # An upright face leads where there is one: the frame of a rig is that of its first camera.
        upright = sorted(
            self.cam_from_rig.items(), key=lambda each: abs(each[1].rotation[1, 1]) < 0.5
        )
        self.cam_from_rig = dict(upright)


def visible_faces(camera: Camera, options: CubemapOptions) -> tuple[FaceName, ...]:
    """Faces of which a camera sees something, in the order of the options."""
    reach = math.tan(math.radians(options.fov_deg / 2)) * np.linspace(-0.98, 0.98, 33)
    x, y = (axis.ravel() for axis in np.meshgrid(reach, reach))
    rays = np.column_stack([x, y, np.ones(len(x))])
    return tuple(
        face
        for face in options.faces
        if np.isfinite(camera.pixels_from_bearings(rays @ face_from_cam(face).rotation)).any()
    )


def _with_points(
    source: Reconstruction, cube: Reconstruction, place: dict[tuple[int, FaceName], int]
) -> Reconstruction:
    """Cube with the points of the panoramas, their observations moved into the faces."""
    seen = source.observations
    if seen is None:
        return replace(cube, points=source.points, colors=source.colors)
    images = np.full(len(seen.images), -1, dtype=np.int64)
    pixels = np.full((len(seen.images), 2), np.nan)
    nearness = np.zeros(len(seen.images))
    rows_of = {index: np.flatnonzero(seen.images == index) for index in {i for i, _ in place}}
    for (index, face), target in place.items():
        rows = rows_of[index]
        camera = source.cameras[str(source.images[index].camera)]
        rays = camera.bearings_from_pixels(seen.pixels[rows]) @ face_from_cam(face).rotation.T
        found = cube.cameras[str(cube.images[target].camera)].pixels_from_bearings(rays)
        better = np.isfinite(found).all(axis=1) & (rays[:, 2] > nearness[rows])
        rows = rows[better]
        nearness[rows], images[rows], pixels[rows] = rays[better, 2], target, found[better]
    kept = images >= 0
    before, now = (
        np.bincount(each, minlength=len(source.points)) for each in (seen.points, seen.points[kept])
    )
    # COLMAP's bundle adjustment stops at a point that only one image sees.
    kept &= ~((now < 2) & (before > now))[seen.points]
    points, renumbered = np.unique(seen.points[kept], return_inverse=True)
    observations = Observations(renumbered.astype(np.int64), images[kept], pixels[kept])
    return replace(
        cube,
        points=source.points[points],
        colors=source.colors[points],
        observations=observations,
    )
