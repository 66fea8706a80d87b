# SPDX-License-Identifier: BSD-3-Clause
"""The faces of a cube around a camera: where they look, which pixels they show, their poses."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

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
_PADDING_PX = 4  # more than bicubic interpolation reads beyond a pixel
_MapPair = tuple[NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True)
class CubemapOptions:
    """How panoramas are cut into faces.

    Attributes
    ----------
    face_size : int, optional
        Width and height of a face in pixels; by default what keeps the size of a panorama's
        pixels: a quarter of its width at 90 degrees.
    fov_deg : float
        Field of view of a face; more than 90 makes neighbours overlap.
    faces : tuple of str
        Of front, right, back, left, up, down.
    image_format : "jpg" or "png"
    jpeg_quality : int
        1 to 100.

    Raises
    ------
    ValueError
        If a number is out of its range, or a face is unknown, there twice, or there is none.
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
    """Pose of a face in the frame of its camera: a rotation.

    Parameters
    ----------
    face : str

    Returns
    -------
    Pose
    """
    return Pose(np.array(_FACE_FROM_CAM[face], dtype=np.float64), np.zeros(3))


def face_camera(camera: Camera, options: CubemapOptions) -> Pinhole:
    """Pinhole camera of the faces of a camera.

    Parameters
    ----------
    camera : Camera
    options : CubemapOptions

    Returns
    -------
    Pinhole
        Square, its principal point in the middle.
    """
    tangent = round(math.tan(math.radians(options.fov_deg / 2)), 14)  # of 45 degrees: 1
    size = options.face_size
    if size is None:
        size = max(8, 2 * round(tangent * _pixels_per_radian(camera) * math.pi / 4))
    focal = size / 2 / tangent
    return Pinhole(width=size, height=size, fx=focal, fy=focal, cx=size / 2, cy=size / 2)


def _pixels_per_radian(camera: Camera) -> float:
    """Resolution in the middle of the image, the mean of both directions."""
    middle = np.array([[camera.width / 2, camera.height / 2]])
    if isinstance(camera, Equirectangular):  # whose middle may be far from the horizon
        return camera.width / math.radians(camera.horizontal_fov_deg)
    return math.sqrt(2) / float(np.linalg.norm(camera.bearing_jacobians(middle)[0]))


class FaceSampler:
    """Cuts one face out of the pictures of one camera.

    Parameters
    ----------
    camera : Camera
        Of the pictures.
    pinhole : Pinhole
        Of the face.
    face : str

    Attributes
    ----------
    visible : ndarray, shape (size, size), bool
        Pixels whose direction the camera sees.
    """

    def __init__(self, camera: Camera, pinhole: Pinhole, face: FaceName) -> None:
        self._wraps = isinstance(camera, Equirectangular) and camera.horizontal_fov_deg >= 360
        self._size = pinhole.width
        # A face pixel that covers several of the picture is the mean of as many samples a side.
        self._samples = max(1, round(_pixels_per_radian(camera) / pinhole.fx))
        self._map = self._build_map(camera, pinhole, face)
        seen = np.where(np.isfinite(self._map[0]), np.uint8(255), np.uint8(0))
        for part in self._map:
            part[~np.isfinite(part)] = -2.0 * _PADDING_PX  # samples nothing
        self.visible: NDArray[np.bool_] = self._reduced(seen) == 255

    def picture(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Face of a picture; black where the camera sees nothing.

        Parameters
        ----------
        image : ndarray, shape (H, W) or (H, W, C), uint8

        Returns
        -------
        face : ndarray, shape (size, size) or (size, size, C), uint8
        """
        reduced = self._reduced(self._sampled(image, cv2.INTER_CUBIC))
        reduced[~self.visible] = 0
        return reduced

    def mask(self, mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
        """Pixels of the face to use: seen by the camera, and usable in the picture's mask.

        Parameters
        ----------
        mask : ndarray, shape (H, W), bool, optional
            True = use.

        Returns
        -------
        mask : ndarray, shape (size, size), bool
        """
        if mask is None:
            return self.visible
        white = np.where(mask, np.uint8(255), np.uint8(0))
        return self.visible & (self._reduced(self._sampled(white, cv2.INTER_LINEAR)) > 127)

    def _build_map(self, camera: Camera, pinhole: Pinhole, face: FaceName) -> _MapPair:
        """Where each sample lies in the padded picture, for cv2.remap; NaN where nowhere."""
        count = self._size * self._samples
        axis = (np.arange(count) + 0.5) / self._samples
        u, v = np.empty((count, count), np.float32), np.empty((count, count), np.float32)
        cam_from_face = face_from_cam(face).rotation.T
        rows_per_block = max(1, 2**19 // count)
        for top in range(0, count, rows_per_block):
            rows = axis[top : top + rows_per_block]
            pixels = np.stack(np.meshgrid(axis, rows), axis=-1).reshape(-1, 2)
            bearings = pinhole.bearings_from_pixels(pixels) @ cam_from_face.T
            # OpenCV counts from the centre of the first pixel: half a pixel less.
            found = camera.pixels_from_bearings(bearings) + (_PADDING_PX - 0.5)
            u[top : top + len(rows)] = found[:, 0].reshape(len(rows), count)
            v[top : top + len(rows)] = found[:, 1].reshape(len(rows), count)
        return u, v

    def _sampled(self, image: NDArray[np.uint8], interpolation: int) -> NDArray[np.uint8]:
        return np.asarray(cv2.remap(self._padded(image), *self._map, interpolation), dtype=np.uint8)

    def _padded(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Picture continued beyond its borders, across the seam of a panorama."""
        pad = _PADDING_PX
        tall = cv2.copyMakeBorder(image, pad, pad, 0, 0, cv2.BORDER_REPLICATE)
        border = cv2.BORDER_WRAP if self._wraps else cv2.BORDER_REPLICATE
        return np.asarray(cv2.copyMakeBorder(tall, 0, 0, pad, pad, border), dtype=np.uint8)

    def _reduced(self, sampled: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Mean of the samples of each pixel."""
        if self._samples == 1:
            return sampled
        size = (self._size, self._size)
        reduced = cv2.resize(sampled, size, interpolation=cv2.INTER_AREA)
        return np.asarray(reduced, dtype=np.uint8)


def face_image_names(names: list[str], options: CubemapOptions) -> dict[tuple[str, FaceName], str]:
    """File names of the faces: ``sub/NAME_front.jpg`` of ``sub/NAME.png``.

    Parameters
    ----------
    names : list of str
        Of the panoramas, each once.
    options : CubemapOptions

    Returns
    -------
    names : dict of (panorama, face) to str
        Different also where case does not count. Where two panoramas differ only in their ending,
        it stays in the names of all.
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
    """Reconstruction whose images are the faces of another's.

    Parameters
    ----------
    reconstruction : Reconstruction
        Each image with its camera.
    options : CubemapOptions

    Returns
    -------
    Reconstruction
        One `Pinhole` camera for each size of a face. Of an image come the faces that its camera
        sees something of. An observation goes to the face nearest to whose middle it lies; points
        that no face sees are left out.

    Raises
    ------
    ValueError
        If an image has no camera.
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
    """Faces of which a camera sees something.

    Parameters
    ----------
    camera : Camera
    options : CubemapOptions

    Returns
    -------
    faces : tuple of str
        In the order of the options.
    """
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
