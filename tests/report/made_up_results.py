# SPDX-License-Identifier: BSD-3-Clause
"""Results made up for the report: every status, exact or noisy matches, any camera."""

from typing import Any, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from epi360.epipolar import sampson_residuals
from epi360.estimation.result import ImagePairResult, Status
from epi360.poses import Pose

STATUSES: tuple[Status, ...] = get_args(Status)
NAN = float("nan")
ROTATION = Rotation.from_rotvec(np.radians([3.0, -25.0, 2.0])).as_matrix()
TRANSLATION = np.array([-0.8, 0.0, -0.6])


def essential(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    return np.cross(translation, rotation.T).T


def matched_pixels(
    camera1: Any, camera2: Any, count: int, noise_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of points around both cameras, those that both see."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(20 * count, 3))
    directions[::2] = directions[::2] / 4.0 + [0.0, 0.0, 1.0]  # enough in front of a pinhole
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points1 = directions * rng.uniform(2.0, 9.0, (len(directions), 1))
    points2 = points1 @ ROTATION.T + TRANSLATION
    bearings2 = points2 / np.linalg.norm(points2, axis=1, keepdims=True)
    bearings2 += rng.normal(scale=np.radians(noise_deg), size=bearings2.shape)
    pixels1 = camera1.pixels_from_bearings(directions)
    pixels2 = camera2.pixels_from_bearings(
        bearings2 / np.linalg.norm(bearings2, axis=1, keepdims=True)
    )
    inside = np.ones(len(pixels1), dtype=bool)
    for pixels, camera in ((pixels1, camera1), (pixels2, camera2)):
        inside &= ((pixels > 0) & (pixels < (camera.width, camera.height))).all(axis=1)
    return pixels1[inside][:count], pixels2[inside][:count]


def fake_result(
    status: Status, camera1: Any, camera2: Any = None, count: int = 60, noise_deg: float = 0.1
) -> ImagePairResult:
    """What an estimator would return with this status."""
    keypoints1, keypoints2 = matched_pixels(camera1, camera2 or camera1, count, noise_deg)
    has_rotation = status in ("ok", "pure_rotation", "planar_ambiguous")
    has_translation = status in ("ok", "planar_ambiguous")
    rotation = ROTATION if has_rotation else np.full((3, 3), NAN)
    translation = TRANSLATION if has_translation else np.full(3, NAN)
    sigmas = np.array([1e-3 if has_rotation else NAN] * 3 + [2e-3 if has_translation else NAN] * 2)
    inlier_mask = np.arange(len(keypoints1)) % 4 > 0 if has_rotation else np.zeros(len(keypoints1))
    cameras = camera1, camera2 or camera1
    bearings = [
        camera.bearings_from_pixels(pixels)
        for camera, pixels in zip(cameras, (keypoints1, keypoints2), strict=True)
    ]
    E = essential(rotation, translation)
    return ImagePairResult(
        cam2_from_cam1=Pose(rotation, translation),
        E=E,
        inlier_mask=inlier_mask.astype(bool),
        residuals_rad=sampson_residuals(E, *bearings)
        if has_translation
        else np.full(len(keypoints1), 1e-3),  # of a refused pose too
        noise_deg=0.1 if has_rotation else NAN,
        inlier_threshold_deg=0.3,
        parallax_deg=8.0 if has_translation else NAN,
        sphere_coverage=0.75 if has_rotation else NAN,
        num_iterations=100,
        status=status,
        covariance=np.diag(sigmas**2),
        translation_basis=np.array([[0.6, 0.0], [0.0, 1.0], [-0.8, 0.0]])
        * (1.0 if has_translation else NAN),
        alternatives=(Pose(ROTATION.T, -TRANSLATION),) if status == "planar_ambiguous" else (),
        warnings=("the scene is nearly flat",) if status == "planar_ambiguous" else (),
        keypoints1=keypoints1,
        keypoints2=keypoints2,
        cameras=cameras,
    )
