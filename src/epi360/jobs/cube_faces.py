# SPDX-License-Identifier: BSD-3-Clause
"""The faces of a cube around a camera: where they look, which pixels they show, their poses."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Literal, get_args

import numpy as np

from epi360.cameras import Camera, Equirectangular, Pinhole
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

    ``face_size`` is the width and height of a face in pixels; by default it keeps the size of a
    panorama's pixels: a quarter of its width at 90 degrees. If ``fov_deg`` is more than 90,
    neighbours overlap.
    """

    face_size: int | None = None
    fov_deg: float = 90.0
    faces: tuple[FaceName, ...] = FACES
    image_format: Literal["jpg", "png"] = "jpg"
    jpeg_quality: int = 95

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.face_size is not None and not 8 <= self.face_size <= 16384:
            raise ValueError(f"face_size must be 8 to 16384 pixels, got {self.face_size}")
        if not 10 <= self.fov_deg <= 150:
            raise ValueError(f"fov_deg must be 10 to 150, got {self.fov_deg}")
        if self.image_format not in ("jpg", "png"):
            raise ValueError(f"image_format must be jpg or png, got {self.image_format!r}")
        if not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"jpeg_quality must be 1 to 100, got {self.jpeg_quality}")
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
    if size is None:
        size = max(8, 2 * round(tangent * pixels_per_radian(camera) * math.pi / 4))
    focal = size / 2 / tangent
    return Pinhole(width=size, height=size, fx=focal, fy=focal, cx=size / 2, cy=size / 2)


def pixels_per_radian(camera: Camera) -> float:
    """Resolution in the middle of the image, the mean of both directions; of a panorama, across."""
    middle = np.array([[camera.width / 2, camera.height / 2]])
    if isinstance(camera, Equirectangular):  # whose middle may be far from the horizon
        return camera.width / math.radians(camera.horizontal_fov_deg)
    return math.sqrt(2) / float(np.linalg.norm(camera.bearing_jacobians(middle)[0]))


def face_image_names(names: list[str], options: CubemapOptions) -> dict[tuple[str, FaceName], str]:
    """File names of the faces: ``sub/NAME_front.jpg`` of ``sub/NAME.png``.

    The names differ also where case does not count. Where two panoramas differ only in their
    ending, it stays in the names of all.
    """
    stems = {name: str(PurePosixPath(name).with_suffix("")) for name in names}
    if max(Counter(stem.casefold() for stem in stems.values()).values(), default=1) > 1:
        stems = {name: name for name in names}
    return {
        (name, face): f"{stem}_{face}.{options.image_format}"
        for name, stem in stems.items()
        for face in options.faces
    }


def cubemap_reconstruction(
    reconstruction: Reconstruction, options: CubemapOptions
) -> Reconstruction:
    """Reconstruction whose images are the faces of another's, as far as its cameras see them.

    There is one `Pinhole` camera for each size of a face. An observation goes to the face nearest
    to whose middle it lies; points that no face sees are left out.
    """
    sources = reconstruction.cameras
    pinholes = {name: face_camera(camera, options) for name, camera in sources.items()}
    cameras = {
        str(number): pinhole for number, pinhole in enumerate(dict.fromkeys(pinholes.values()), 1)
    }
    keys = {pinhole: key for key, pinhole in cameras.items()}
    faces_of = {name: visible_faces(camera, options) for name, camera in sources.items()}
    names = face_image_names([image.name for image in reconstruction.images], options)
    images: list[PosedImage] = []
    place: dict[tuple[int, FaceName], int] = {}
    for index, image in enumerate(reconstruction.images):
        if image.camera is None:
            raise ValueError(f"image {image.name} has no camera, so it cannot be cut into faces")
        for face in faces_of[image.camera]:
            place[index, face] = len(images)
            pose = face_from_cam(face) @ image.cam_from_world
            key = keys[pinholes[image.camera]]
            images.append(PosedImage(names[image.name, face], key, pose, image.timestamp_s))
    return _with_points(reconstruction, Reconstruction(cameras, tuple(images)), place)


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
        return Reconstruction(cube.cameras, cube.images, source.points, source.colors)
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
    points, renumbered = np.unique(seen.points[kept], return_inverse=True)
    observations = Observations(renumbered.astype(np.int64), images[kept], pixels[kept])
    return Reconstruction(
        cube.cameras, cube.images, source.points[points], source.colors[points], observations
    )
