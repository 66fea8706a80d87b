# SPDX-License-Identifier: BSD-3-Clause
"""Two-view scenes of landmarks with known truth: layouts, noise on the sphere, outliers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose

Layout = Literal["room", "sphere", "cone", "plane", "behind"]

# No landmark is closer than this to either camera, so that every bearing is well defined.
MIN_RANGE_M = 0.3
# Ranges of the layouts without walls: log-uniform between these, an indoor scene's spread.
NEAREST_M, FARTHEST_M = 1.0, 10.0
# Half extents of the room of the layout "room"; it grows where camera 2 stands outside.
ROOM_HALF_M = (3.5, 1.6, 2.5)
WALL_CLEARANCE_M = 0.5

Sampler = Callable[[np.random.Generator, int], NDArray[np.float64]]


@dataclass(frozen=True)
class TwoViewScene:
    """Matches of two central cameras and the truth behind them.

    Attributes
    ----------
    bearings1, bearings2 : ndarray, shape (N, 3)
        Unit bearing vectors with noise and outliers; row i of both is one match.
    points : ndarray, shape (N, 3)
        True landmarks in the frame of camera 1, in metres (also of the rows that are outliers).
    cam2_from_cam1 : Pose
        True pose with its **metric** translation (normalise it to compare with an estimate).
    inlier_mask : ndarray, shape (N,), bool
        False where the match was made an outlier.
    """

    bearings1: NDArray[np.float64]
    bearings2: NDArray[np.float64]
    points: NDArray[np.float64]
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
        Share in [0, 1] of the matches, exactly ``round(outlier_ratio * N)`` of them, whose
        bearing in view 2 becomes a uniform random direction (for "cone": uniform over the cone
        turned with the camera, so that both views see a cone).

    Returns
    -------
    scene : TwoViewScene

    Raises
    ------
    ValueError
        If an option is out of its range, if both `noise_deg` and `kappa` are given, or if the
        layout cannot be seen with the given pose.
    """
    _check_options(num_matches, layout, cone_half_angle_deg, baseline_m, outlier_ratio)
    concentration = _concentration(noise_deg, kappa)
    rng = np.random.Generator(np.random.PCG64(seed))
    pose = sample_relative_pose(rng) if cam2_from_cam1 is None else cam2_from_cam1
    pose = pose if baseline_m is None else _with_baseline(pose, baseline_m)
    points = _sample_points(rng, num_matches, layout, np.radians(cone_half_angle_deg), pose)
    bearings1 = _unit(points)
    bearings2 = _unit(points @ pose.rotation.T + pose.translation)
    if concentration is not None:
        bearings2 = sample_von_mises_fisher(rng, bearings2, concentration)
        if noise_in_both_views:
            bearings1 = sample_von_mises_fisher(rng, bearings1, concentration)
    outliers = rng.choice(num_matches, round(outlier_ratio * num_matches), replace=False)
    half_angle = np.radians(cone_half_angle_deg) if layout == "cone" else np.pi
    bearings2[outliers] = _cap_directions(rng, len(outliers), half_angle) @ pose.rotation.T
    inlier_mask = np.ones(num_matches, dtype=np.bool_)
    inlier_mask[outliers] = False
    return TwoViewScene(bearings1, bearings2, points, pose, inlier_mask)


def sample_relative_pose(
    rng: np.random.Generator, *, max_translation_m: float = 1.0, max_angle_deg: float = 45.0
) -> Pose:
    """Random ``cam2_from_cam1`` as in section 5.1 of the Robust 360-8PA paper.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the random numbers.
    max_translation_m : float
        Each coordinate of the translation is uniform in plus or minus this, in metres.
    max_angle_deg : float
        Each Euler angle is uniform in plus or minus this; R = Rz Ry Rx (the paper leaves the
        order open).

    Returns
    -------
    cam2_from_cam1 : Pose
        With a metric translation.
    """
    translation = rng.uniform(-max_translation_m, max_translation_m, 3)
    angles = np.radians(rng.uniform(-max_angle_deg, max_angle_deg, 3))
    return Pose(rotation_from_euler(angles), translation)


def rotation_from_euler(angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrix Rz Ry Rx of three angles about the fixed axes x, y, z.

    Parameters
    ----------
    angles_rad : ndarray, shape (3,)
        Angles about x, y and z in radians; x is applied first.

    Returns
    -------
    rotation : ndarray, shape (3, 3)
    """
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles_rad), np.sin(angles_rad)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    rotation: NDArray[np.float64] = about_z @ about_y @ about_x
    return rotation


def sample_von_mises_fisher(
    rng: np.random.Generator, mean_directions: NDArray[np.float64], kappa: float
) -> NDArray[np.float64]:
    """Sample unit vectors from von Mises-Fisher distributions about given directions.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the random numbers.
    mean_directions : ndarray, shape (N, 3)
        Unit vectors.
    kappa : float
        Concentration, > 0; 1 / kappa is the variance in rad^2 per tangent axis when it is large.

    Returns
    -------
    directions : ndarray, shape (N, 3)
        One unit vector about each mean direction.

    Raises
    ------
    ValueError
        If `kappa` is not a positive number or the directions are not (N, 3).

    Notes
    -----
    Exact inversion on the sphere (Wood 1994; Jakob 2012): with u uniform in (0, 1] the cosine of
    the angle is ``1 + log(u + (1 - u) exp(-2 kappa)) / kappa``. The mean angle is about
    ``sqrt(pi / (2 kappa))``: 3.21 deg for kappa = 500.
    """
    if mean_directions.ndim != 2 or mean_directions.shape[1] != 3:
        raise ValueError(f"mean_directions must have shape (N, 3), got {mean_directions.shape}")
    if not kappa > 0:
        raise ValueError(f"kappa must be positive, got {kappa}; 1 / sigma_rad**2 for small noise")
    num = len(mean_directions)
    u = 1.0 - rng.random(num)
    # 1 - cos directly: cos itself would lose the angle's digits for a large kappa.
    versine = -np.log(u + (1.0 - u) * np.exp(-2.0 * kappa)) / kappa
    azimuth = rng.uniform(0.0, 2.0 * np.pi, num)
    tangent1, tangent2 = _tangents(mean_directions)
    across = np.cos(azimuth)[:, None] * tangent1 + np.sin(azimuth)[:, None] * tangent2
    sine = np.sqrt(versine * (2.0 - versine))
    return _unit((1.0 - versine)[:, None] * mean_directions + sine[:, None] * across)


def _check_options(
    num_matches: int, layout: str, half_angle_deg: float, baseline: float | None, ratio: float
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
    if not 0.0 <= ratio <= 1.0:
        raise ValueError(f"outlier_ratio must be in [0, 1], got {ratio}; 0.2 is 20 %")


def _concentration(noise_deg: float | None, kappa: float | None) -> float | None:
    """Kappa of the noise, None for exact bearings."""
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


def _sample_points(
    rng: np.random.Generator, num: int, layout: Layout, half_angle: float, pose: Pose
) -> NDArray[np.float64]:
    """Landmarks of a layout that keep their distance from both cameras, by rejection."""
    center2 = pose.inverse().translation
    samplers: dict[str, Sampler] = {
        "room": lambda rng, num: _room_points(rng, num, center2),
        "sphere": lambda rng, num: _ranged(rng, _cap_directions(rng, num, np.pi)),
        "cone": lambda rng, num: _ranged(rng, _cap_directions(rng, num, half_angle)),
        "behind": lambda rng, num: _ranged(rng, -_cap_directions(rng, num, np.pi / 2)),
    }
    sample = _plane_sampler(rng, center2) if layout == "plane" else samplers[layout]
    kept: list[NDArray[np.float64]] = [np.empty((0, 3))]
    for _ in range(1000):
        missing = num - sum(len(points) for points in kept)
        if missing == 0:
            return np.concatenate(kept)
        points = sample(rng, max(missing, 16))
        points2 = points @ pose.rotation.T + pose.translation
        ranges = np.minimum(np.linalg.norm(points, axis=1), np.linalg.norm(points2, axis=1))
        good = ranges >= MIN_RANGE_M
        if layout == "behind":
            good &= (points[:, 2] < 0.0) & (points2[:, 2] < 0.0)
        kept.append(points[good][:missing])
    raise ValueError(f"cam2_from_cam1 sees no landmarks of the layout {layout!r}; turn it less")


def _room_points(
    rng: np.random.Generator, num: int, center2: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points uniform over the six inner faces of a box that holds both cameras."""
    low = np.minimum(-np.array(ROOM_HALF_M), center2 - WALL_CLEARANCE_M)
    high = np.maximum(ROOM_HALF_M, center2 + WALL_CLEARANCE_M)
    size = high - low
    areas = np.prod(size) / size
    axis = rng.choice(3, num, p=areas / areas.sum())
    points = rng.uniform(low, high, (num, 3))
    points[np.arange(num), axis] = np.where(rng.random(num) < 0.5, low[axis], high[axis])
    return points


def _plane_sampler(rng: np.random.Generator, center2: NDArray[np.float64]) -> Sampler:
    """One random plane in front of both cameras, and a sampler of an 8 m square on it."""
    normal = _cap_directions(rng, 1, np.pi)
    distance = rng.uniform(1.5, 3.0) + max(0.0, float(normal[0] @ center2))
    tangents = np.concatenate(_tangents(normal))

    def sample(rng: np.random.Generator, num: int) -> NDArray[np.float64]:
        points: NDArray[np.float64] = distance * normal + rng.uniform(-4, 4, (num, 2)) @ tangents
        return points

    return sample


def _cap_directions(rng: np.random.Generator, num: int, half_angle: float) -> NDArray[np.float64]:
    """Sample unit vectors uniformly over the spherical cap of a half angle about +z."""
    z = 1.0 - rng.random(num) * (1.0 - np.cos(half_angle))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, num)
    radius = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


def _ranged(rng: np.random.Generator, directions: NDArray[np.float64]) -> NDArray[np.float64]:
    ranges = np.exp(rng.uniform(np.log(NEAREST_M), np.log(FARTHEST_M), (len(directions), 1)))
    points: NDArray[np.float64] = ranges * directions
    return points


def _tangents(directions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors that make an orthonormal frame with each direction."""
    # The cross product with the axis of the smallest coordinate is never near zero.
    axis = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    tangent1 = _unit(np.cross(directions, axis))
    return tangent1, np.cross(directions, tangent1)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    units: NDArray[np.float64] = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return units
