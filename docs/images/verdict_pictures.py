# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of pictures that show each verdict, from rooms that the package renders."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import epi360
from epi360.cameras import Camera, Equirectangular, KannalaBrandt, Pinhole
from epi360.features import nadir_mask
from epi360.poses import Pose, rotation_from_vector
from epi360.report.figure import draw_pair
from epi360_scenes import Room, scene
from epi360_scenes.home import Home, HomeView, twin_home
from epi360_scenes.rendering import RayCaster, Rays

Image = NDArray[np.uint8]
PANORAMA = Equirectangular(768, 384)


@dataclass(frozen=True)
class Pair:
    """Two pictures, what is known of them, and the truth.

    Attributes
    ----------
    image1, image2 : ndarray, shape (H, W, 3), uint8
    cam2_from_cam1 : Pose
        True pose, in metres.
    camera : Camera
        What the estimate takes for the camera of both, right or not.
    mask : ndarray, shape (H, W), bool, optional
        What the estimate may use.
    """

    image1: Image
    image2: Image
    cam2_from_cam1: Pose
    camera: Camera = PANORAMA
    mask: NDArray[np.bool_] | None = None

    def estimate(self) -> epi360.ImagePairResult:
        """Return what epi360 says of the pair."""
        return epi360.relative_pose_of_images(
            self.image1,
            self.image2,
            camera1=self.camera,
            camera2=self.camera,
            mask1=self.mask,
            mask2=self.mask,
        )

    def draw(self, path: Path) -> None:
        """Draw the pair as `epi360 pair --figure` does."""
        draw_pair(self.image1, self.image2, self.camera, self.camera, self.estimate(), path)


def standing(x: float, z: float, turn_deg: float = 0.0, height_m: float = 1.5) -> Pose:
    """Pose ``world_from_cam`` of an upright camera."""
    turn = rotation_from_vector(np.array([0.0, np.radians(turn_deg), 0.0]))
    return Pose(turn, np.array([x, -height_m, z]))


def looking_down(
    x: float, z: float, *, height_m: float, turn_deg: float = 0.0, tilt_deg: float = 0.0
) -> Pose:
    """Pose ``world_from_cam`` of a camera that looks at the floor, but for a tilt."""
    down = rotation_from_vector(np.array([np.radians(tilt_deg - 90.0), 0.0, 0.0]))
    above = standing(x, z, turn_deg, height_m)
    return Pose(above.rotation @ down, above.translation)


def seen(
    room: Room,
    first: Pose,
    second: Pose,
    camera: Camera = PANORAMA,
    taken_for: Camera | None = None,
) -> Pair:
    """Pair of pictures of one room."""
    images = [room.render(camera, pose).image for pose in (first, second)]
    return Pair(*images, second.inverse() @ first, taken_for or camera)


def pure_rotation() -> Pair:
    """The camera was turned on its tripod."""
    return seen(scene("living_room"), standing(0.2, 0.3), standing(0.2, 0.3, 70.0))


def planar_ambiguous() -> Pair:
    """A camera looks down at floor boards and at nothing else."""
    lens = Pinhole(480, 360, 1000.0, 1000.0, 240.0, 180.0)
    first = looking_down(-0.44, -1.15, height_m=1.6)
    second = looking_down(-0.18, -1.5, height_m=1.76, turn_deg=18.5, tilt_deg=5.0)
    return seen(scene("living_room"), first, second, lens)


def concentrated_inliers() -> Pair:
    """Two rooms with the same carpet."""
    first, second = standing(0.2, 0.3), standing(0.5, 0.3, 20.0)
    return Pair(
        scene("living_room").render(PANORAMA, first).image,
        scene("studio").render(PANORAMA, second).image,
        second.inverse() @ first,
    )


def too_few_inliers() -> Pair:
    """Two rooms that do not see each other."""
    return in_home(standing(-5.15, 1.6, -60.0), standing(2.9, 2.1, 130.0))


def low_probability() -> Pair:
    """One wall through a long lens: many matches agree, and so would they with other poses."""
    lens = Pinhole(640, 480, 1400.0, 1400.0, 320.0, 240.0)
    return seen(scene("studio"), standing(0.0, 0.3, 90.0), standing(0.2, 0.45, 87.0), lens)


def too_few_matches() -> Pair:
    """The mask is the wrong way round: it leaves the tripod and hides the room."""
    pair = seen(scene("living_room"), standing(0.2, 0.3), standing(0.6, 0.7, 25.0))
    return replace(pair, mask=~nadir_mask(PANORAMA, 8.0))


@cache
def fixed_to_the_camera() -> Pair:
    """The lowest 30 degrees show what the camera stands on: part of a picture of a carpet."""
    pair = seen(scene("studio"), standing(-2.0, 0.0), standing(-2.6, 1.2, 30.0))
    below = ~nadir_mask(PANORAMA, 30.0)
    carpet = scene("living_room").render(PANORAMA, standing(1.2, 0.3)).image
    images = [np.where(below[:, :, None], carpet, image) for image in (pair.image1, pair.image2)]
    return Pair(*images, pair.cam2_from_cam1)


def fixed_to_the_camera_masked() -> Pair:
    """The same two pictures with a mask over it."""
    return replace(fixed_to_the_camera(), mask=nadir_mask(PANORAMA, 30.0))


def little_parallax() -> Pair:
    """The camera moved by 4 mm."""
    return seen(scene("living_room"), standing(0.2, 0.3), standing(0.204, 0.3, 10.0))


def part_of_the_scene() -> Pair:
    """A living room and a corridor, through the door between them."""
    return in_home(standing(1.71, -2.57, -40.0), standing(0.49, -1.08, 20.0))


def same_floor() -> Pair:
    """Two rooms with equal doors and floors."""
    return in_home(standing(-5.15, 1.6, -72.0), standing(0.58, -1.52, 148.0))


def wrong_calibration() -> Pair:
    """A fisheye pair with the focal length of another lens."""
    lens = KannalaBrandt(480, 480, 150.0, 150.0, 240.0, 240.0)
    other = KannalaBrandt(480, 480, 95.0, 95.0, 240.0, 240.0)
    return seen(
        scene("living_room"), standing(0.2, 0.3), standing(0.6, 0.7, 25.0), lens, taken_for=other
    )


def twin_rooms() -> Pair:
    """Two rooms of a hotel that are furnished alike."""
    return in_home(standing(-5.5, 2.2, -72.0), standing(5.32, -1.65, 190.0))


def in_home(first: Pose, second: Pose) -> Pair:
    """Pair of pictures of a home with twin rooms."""
    views = [_InHome(_home().seen_from(pose.translation)) for pose in (first, second)]
    images = [
        view.render(PANORAMA, pose).image for view, pose in zip(views, (first, second), strict=True)
    ]
    return Pair(*images, second.inverse() @ first)


@dataclass(frozen=True)
class _InHome(RayCaster):
    view: HomeView

    def cast(self, rays: Rays) -> tuple[Any, Any, NDArray[np.intp]]:
        return self.view.cast(rays)


@cache
def _home() -> Home:
    return twin_home(0)


PAIRS: dict[str, Callable[[], Pair]] = {
    one.__name__: one
    for one in (
        pure_rotation, planar_ambiguous, concentrated_inliers, too_few_inliers, low_probability,
        too_few_matches, fixed_to_the_camera, little_parallax, part_of_the_scene,
        wrong_calibration, twin_rooms, same_floor,
    )
}  # fmt: skip
