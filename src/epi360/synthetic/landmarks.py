# SPDX-License-Identifier: BSD-3-Clause
"""Two-view scenes of landmarks with known truth: layouts, noise on the sphere, outliers."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose
from epi360.synthetic.directions import cap_directions, unit
from epi360.synthetic.disturbances import (
    OutlierModel,
    add_metric_noise,
    check_outliers,
    replace_with_outliers,
)
from epi360.synthetic.layouts import Layout, sample_points
from epi360.synthetic.von_mises_fisher import sample_von_mises_fisher

Array = NDArray[np.float64]

Noise = Literal["bearings", "points"]


@dataclass(frozen=True)
class TwoViewScene:
    """Matches of two central cameras and the truth behind them.

    Row i of the unit bearings, both (N, 3), is one match with noise, or an outlier where
    ``inlier_mask`` (N,) is False. ``points`` (N, 3) are the true landmarks in the frame of camera
    1, in metres, those of outliers too. The translation of ``cam2_from_cam1`` is **metric**:
    normalise it to compare it with an estimate.
    """

    bearings1: Array
    bearings2: Array
    points: Array
    cam2_from_cam1: Pose
    inlier_mask: NDArray[np.bool_]


def two_view_scene(
    seed: int = 0,
    *,
    num_matches: int = 200,
    layout: Layout = "room",
    cone_half_angle_deg: float = 30.0,
    cam2_from_cam1: Pose | None = None,
    baseline_m: float | None = None,
    noise_deg: float | None = None,
    kappa: float | None = None,
    noise_in_both_views: bool = False,
    outlier_ratio: float = 0.0,
    outlier_model: OutlierModel = "uniform",
) -> TwoViewScene:
    """Seeded matches of two cameras that see the same landmarks.

    Parameters
    ----------
    seed : int
        Equal arguments and seed give equal scenes.
    num_matches : int
        Number N of matches, outliers included.
    layout : {"room", "sphere", "cone", "plane", "behind"}
        Where the landmarks are: on walls, floor and ceiling of a room around both cameras; in all
        directions; in a cone about the z axis of camera 1; on one plane; at z < 0 in both cameras.
        Ranges are log-uniform from 1 to 10 m where no surface sets them.
    cone_half_angle_deg : float
        Half angle of the layout "cone", in (0, 180].
    cam2_from_cam1 : Pose, optional
        The pose to use, metric; by default `sample_relative_pose` draws it.
    baseline_m : float, optional
        Rescales the translation to this length; 0 is a pure rotation.
    noise_deg : float, optional
        Standard deviation per tangent axis of the von Mises-Fisher noise: kappa = 1 / sigma^2.
    kappa : float, optional
        The concentration itself, instead of `noise_deg`. Without both there is no noise.
    noise_in_both_views : bool
        Disturbs view 1 as well; by default view 2 only, as in the paper.
    outlier_ratio : float
        Share in [0, 1] of the matches whose bearing in view 2 is wrong, as the model states.
    outlier_model : {"uniform", "shuffled", "authors"}
        See `replace_with_outliers`. "uniform" directions of the layout "cone" are those of the
        cone turned with the camera, so that both views see a cone.

    Raises
    ------
    ValueError
        If an option is out of its range, if both `noise_deg` and `kappa` are given, or if the
        layout cannot be seen with the given pose.
    """
    _check_options(num_matches, layout, cone_half_angle_deg, baseline_m)
    check_outliers(outlier_ratio, outlier_model)
    concentration = _concentration(noise_deg, kappa)
    rng = np.random.Generator(np.random.PCG64(seed))
    pose = sample_relative_pose(rng) if cam2_from_cam1 is None else cam2_from_cam1
    pose = pose if baseline_m is None else _with_baseline(pose, baseline_m)
    points = sample_points(rng, num_matches, layout, np.radians(cone_half_angle_deg), pose)
    bearings1 = unit(points)
    bearings2 = unit(points @ pose.rotation.T + pose.translation)
    if concentration is not None:
        bearings2 = sample_von_mises_fisher(rng, bearings2, concentration)
        if noise_in_both_views:
            bearings1 = sample_von_mises_fisher(rng, bearings1, concentration)
    half_angle = np.radians(cone_half_angle_deg) if layout == "cone" else np.pi
    bearings2, inlier_mask = replace_with_outliers(
        rng,
        bearings2,
        outlier_ratio,
        model=outlier_model,
        uniform_directions=lambda rng, num: cap_directions(rng, num, half_angle) @ pose.rotation.T,
    )
    return TwoViewScene(bearings1, bearings2, points, pose, inlier_mask)


def scene_from_points(
    rng: np.random.Generator,
    points: Array,
    cam2_from_cam1: Pose,
    *,
    kappa: float | None = None,
    noise: Noise = "bearings",
    noise_in_both_views: bool = False,
    outlier_ratio: float = 0.0,
    outlier_model: OutlierModel = "uniform",
) -> TwoViewScene:
    """Matches of two cameras that see given landmarks, such as those of `landmarks_from_depth`.

    The options that are not below are those of `two_view_scene`.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the noise and the outliers.
    points : ndarray, shape (N, 3)
        Landmarks in the frame of camera 1, in metres.
    cam2_from_cam1 : Pose
        Metric, such as that of `sample_relative_pose`.
    noise : {"bearings", "points"}
        "bearings": von Mises-Fisher noise on the sphere, as the paper says. "points": noise in
        metres on the points in the frame of the camera, see `add_metric_noise`, as its code does.

    Raises
    ------
    ValueError
        If an option is out of its range or `points` are not (N, 3).
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (N, 3), got {points.shape}")
    if noise not in get_args(Noise):
        raise ValueError(f"noise must be 'bearings' or 'points', got {noise!r}")
    points2 = points @ cam2_from_cam1.rotation.T + cam2_from_cam1.translation
    bearings2 = _seen(rng, points2, kappa, noise)
    bearings1 = _seen(rng, points, kappa if noise_in_both_views else None, noise)
    bearings2, inlier_mask = replace_with_outliers(
        rng, bearings2, outlier_ratio, model=outlier_model
    )
    return TwoViewScene(bearings1, bearings2, points, cam2_from_cam1, inlier_mask)


def _seen(rng: np.random.Generator, points: Array, kappa: float | None, noise: Noise) -> Array:
    if kappa is None:
        return unit(points)
    if noise == "points":
        return unit(add_metric_noise(rng, points, kappa=kappa))
    return sample_von_mises_fisher(rng, unit(points), kappa)


def sample_relative_pose(
    rng: np.random.Generator, *, max_translation_m: float = 1.0, max_angle_deg: float = 45.0
) -> Pose:
    """Random metric ``cam2_from_cam1`` as in section 5.1 of the Robust 360-8PA paper.

    Each coordinate of the translation is uniform in plus or minus ``max_translation_m``, each Euler
    angle in plus or minus ``max_angle_deg`` (45 in the paper, 10 in the authors' code).
    R = Rz Ry Rx: the paper leaves the order open, their code has this one.
    """
    translation = rng.uniform(-max_translation_m, max_translation_m, 3)
    angles = np.radians(rng.uniform(-max_angle_deg, max_angle_deg, 3))
    return Pose(rotation_from_euler(angles), translation)


def rotation_from_euler(angles_rad: Array) -> Array:
    """Rotation matrix Rz Ry Rx of three angles about the fixed axes x, y, z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles_rad), np.sin(angles_rad)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def rotation_from_heading(angles_rad: Array) -> Array:
    """World-from-camera rotation of a camera that is tilted first and then turned to a heading."""
    pitch, heading, roll = angles_rad
    tilt = rotation_from_euler(np.array([pitch, 0.0, roll]))
    return np.asarray(rotation_from_euler(np.array([0.0, heading, 0.0])) @ tilt)


def _check_options(
    num_matches: int, layout: str, half_angle_deg: float, baseline: float | None
) -> None:
    if num_matches < 0:
        raise ValueError(f"num_matches must be 0 or more, got {num_matches}")
    if layout not in get_args(Layout):
        names = ", ".join(get_args(Layout))
        raise ValueError(f"layout must be one of {names}, got {layout!r}")
    if not 0.0 < half_angle_deg <= 180.0:
        raise ValueError(f"cone_half_angle_deg must be in (0, 180], got {half_angle_deg}")
    if baseline is not None and not 0.0 <= baseline < np.inf:
        raise ValueError(f"baseline_m must be 0 or more, got {baseline}")


def _concentration(noise_deg: float | None, kappa: float | None) -> float | None:
    if noise_deg is not None and kappa is not None:
        raise ValueError("give noise_deg or kappa, not both: kappa = 1 / radians(noise_deg)**2")
    if noise_deg is not None and not 0.0 <= noise_deg < np.inf:
        raise ValueError(f"noise_deg must be 0 or more, got {noise_deg}")
    if noise_deg:
        return float(1.0 / np.radians(noise_deg) ** 2)
    return kappa


def _with_baseline(pose: Pose, baseline_m: float) -> Pose:
    length = np.linalg.norm(pose.translation)
    if length == 0.0 and baseline_m > 0.0:
        raise ValueError(
            f"baseline_m is {baseline_m} but cam2_from_cam1 has no translation to rescale"
        )
    scale = baseline_m / length if length > 0.0 else 0.0
    return Pose(pose.rotation, scale * pose.translation)
