# SPDX-License-Identifier: BSD-3-Clause
"""Where a camera is in the map, from key frames that may show the same place."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epi360.estimation import RansacOptions, estimate_relative_pose
from epi360.estimation.absolute_evidence import num_cells
from epi360.estimation.absolute_pose_fit import AbsolutePoseFit, fit_absolute_pose
from epi360.features.binary_features import BinaryFeatures, match_binary_descriptors
from epi360.odometry.points import triangulate_tracks
from epi360.poses import Pose, rotation_error_deg

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Status = Literal[
    "ok",
    "too_few_matches",
    "two_views_disagree",
    "too_few_inliers",
    "concentrated_inliers",
    "unexplained_points",
]

# A point is looked for where the camera found anything within this angle: lens and mask have ends.
_SIGHT_RAD = 0.25
# Two views and points that agree turn the camera by the same angle, but for noise.
_LARGEST_TURN_DEG = 5.0
# Features near a point's direction that are compared with it, by at most so many of 256 bits.
_NUM_NEAR, _EXPLAINED_BITS = 8, 70
_BITS = np.array([number.bit_count() for number in range(256)], dtype=np.uint8)


@dataclass(frozen=True)
class PlaceOptions:
    """What it takes to believe that two key frames show the same place.

    Attributes
    ----------
    threshold_rad : float
        Largest angle between a feature and where its point should be seen.
    min_inliers : int
        Fewest features whose points support the pose.
    min_inlier_share : float
        Least share of the matches with a point that support it: twin rooms share some furniture.
    min_cells : int
        Fewest of 48 equal cells of the sphere of view with an inlier, in both views.
    min_explained_share : float
        Least share of the key frame's points in sight that the camera sees as well, matched or
        not. In rendered homes 0.59 to 0.82 (90 % of the cases) within half a metre of the key
        frame, and at most 0.47 in a twin room, whose furniture gives 100 inliers all around.
    min_parallax_rad : float
        Least angle between the rays of a point that is used.
    """

    threshold_rad: float = 0.012
    min_inliers: int = 30
    min_inlier_share: float = 0.5
    min_cells: int = 8
    min_explained_share: float = 0.55
    min_parallax_rad: float = 0.02


@dataclass(frozen=True, eq=False)
class MappedView:
    """Features of a key frame and where they are in the map.

    Attributes
    ----------
    key_frame : int
    cam_from_world : Pose
    features : BinaryFeatures
    points : ndarray, shape (N, 3)
        Point of each feature in the world, NaN where it is not known.
    """

    key_frame: int
    cam_from_world: Pose
    features: BinaryFeatures
    points: Array


@dataclass(frozen=True, eq=False)
class Relocalization:
    """Pose of a camera in the map and the evidence for it.

    Attributes
    ----------
    key_frame : int
        Key frame that shows the same place; the most convincing of those refused otherwise, -1
        where there was none.
    pose : AbsolutePoseFit
        Of the matches below.
    matches : ndarray, shape (M, 2)
        Rows of features of the key frame and of the camera.
    num_cells : int
        Cells of 48 of the sphere of view that hold an inlier, the lower number of both views.
    explained_share : float
        Share of the key frame's points in sight that the camera sees from the pose.
    status : str
        "ok" or why the pose must not be used.
    """

    key_frame: int
    pose: AbsolutePoseFit
    matches: NDArray[np.int64]
    num_cells: int
    explained_share: float
    status: Status

    @property
    def success(self) -> bool:
        """Whether the pose may be used."""
        return self.status == "ok"


def map_view(
    key_frame: int,
    cam_from_world: Pose,
    features: BinaryFeatures,
    neighbours: Sequence[tuple[Pose, BinaryFeatures]],
    options: PlaceOptions = PlaceOptions(),  # noqa: B008 - frozen
) -> MappedView:
    """Features of a key frame with the points where rays of a few neighbours meet theirs.

    Neighbours, (cam_from_world, features) each, should be as far away as they still show the
    same: parallax is what gives points.
    """
    poses, chosen = [cam_from_world], [np.arange(len(features))]
    rays = [features.bearings @ cam_from_world.rotation]
    for pose, others in neighbours:
        matches = match_binary_descriptors(features.descriptors, others.descriptors)
        b1, b2 = features.bearings[matches[:, 0]], others.bearings[matches[:, 1]]
        relative = pose @ cam_from_world.inverse()
        fits = _off_plane(relative, b1, b2) < options.threshold_rad
        poses.append(pose)
        chosen.append(matches[fits, 0])
        rays.append(b2[fits] @ pose.rotation)
    centers = [
        np.tile(pose.inverse().translation, (len(rows), 1))
        for pose, rows in zip(poses, chosen, strict=True)
    ]
    found = triangulate_tracks(
        np.concatenate(centers), np.concatenate(rays), np.concatenate(chosen), len(features)
    )
    good = found.in_front & (found.residual_rad < options.threshold_rad)
    good &= found.parallax_rad > options.min_parallax_rad
    return MappedView(
        key_frame, cam_from_world, features, np.where(good[:, None], found.points, np.nan)
    )


def relocalize(
    features: BinaryFeatures,
    candidates: Iterable[MappedView],
    *,
    options: PlaceOptions = PlaceOptions(),  # noqa: B008 - frozen
    seed: int = 0,
) -> Relocalization:
    """Pose of a camera in the world of the first candidate that convinces.

    Candidates come best first, from `PlaceIndex.most_similar` and `map_view`, and are made only
    as far as they are needed if they come from a generator.
    """
    best = nowhere()
    for candidate in candidates:
        found = locate(features, candidate, options=options, seed=seed)
        if found.success:
            return found
        if best.key_frame < 0 or found.pose.inlier_mask.sum() > best.pose.inlier_mask.sum():
            best = found
    return best


def nowhere() -> Relocalization:
    """Return the answer where there is no candidate."""
    none = fit_absolute_pose(np.zeros((0, 3)), np.zeros((0, 3)))
    return Relocalization(-1, none, np.zeros((0, 2), np.int64), 0, 0.0, "too_few_matches")


def locate(
    features: BinaryFeatures, view: MappedView, *, options: PlaceOptions, seed: int
) -> Relocalization:
    """Pose of a camera from the points of one key frame, asked of two views and of points."""
    matches = match_binary_descriptors(view.features.descriptors, features.descriptors)
    b1, b2 = view.features.bearings[matches[:, 0]], features.bearings[matches[:, 1]]
    points = view.points[matches[:, 0]]
    has_point = np.isfinite(points[:, 0])
    none = nowhere().pose
    if has_point.sum() < options.min_inliers:
        return Relocalization(view.key_frame, none, matches, 0, 0.0, "too_few_matches")
    two_view = estimate_relative_pose(
        b1, b2,
        max_noise_deg=float(np.degrees(options.threshold_rad)) / 2.0,
        options=RansacOptions(min_num_inliers=options.min_inliers),
        seed=seed,
    )  # fmt: skip
    if two_view.status not in ("ok", "pure_rotation"):
        return Relocalization(view.key_frame, none, matches, 0, 0.0, "two_views_disagree")
    in_view = points @ view.cam_from_world.rotation.T + view.cam_from_world.translation
    guess = _scaled(two_view.cam2_from_cam1, in_view, b2, two_view.inlier_mask & has_point)
    pose = fit_absolute_pose(
        b2, points, threshold_rad=options.threshold_rad, guess=guess @ view.cam_from_world,
        min_inliers=options.min_inliers, seed=seed,
    )  # fmt: skip
    inliers = pose.inlier_mask
    cells = min(num_cells(b1[inliers]), num_cells(b2[inliers]))
    explained = explained_share(view, features, pose.cam_from_world, options.threshold_rad)
    turn_deg = rotation_error_deg(pose.cam_from_world, guess @ view.cam_from_world)
    status: Status = "ok"
    if not pose.success or inliers.sum() < options.min_inlier_share * has_point.sum():
        status = "too_few_inliers"
    elif turn_deg > _LARGEST_TURN_DEG:
        status = "two_views_disagree"
    elif cells < options.min_cells:
        status = "concentrated_inliers"
    elif explained < options.min_explained_share:
        status = "unexplained_points"
    return Relocalization(view.key_frame, pose, matches, cells, explained, status)


def explained_share(
    view: MappedView, features: BinaryFeatures, cam_from_world: Pose, threshold_rad: float
) -> float:
    """Share of a key frame's points in sight of which a camera has a similar feature in place.

    Matches alone do not say what is missing: the walls of a twin room.
    """
    known = np.flatnonzero(np.isfinite(view.points[:, 0]))
    if len(known) == 0 or len(features) == 0 or np.isnan(cam_from_world.translation).any():
        return 0.0
    expected = view.points[known] @ cam_from_world.rotation.T + cam_from_world.translation
    expected /= np.maximum(np.linalg.norm(expected, axis=1, keepdims=True), 1e-12)
    num_near = min(_NUM_NEAR, len(features))
    chords, near = cKDTree(features.bearings).query(expected, k=np.arange(1, num_near + 1))
    differing = view.features.descriptors[known, None] ^ features.descriptors[near]
    similar = _BITS[differing].sum(axis=2) <= _EXPLAINED_BITS
    seen = (similar & (chords < threshold_rad)).any(axis=1)
    in_sight = chords[:, 0] < _SIGHT_RAD
    return float(seen[in_sight].mean()) if in_sight.any() else 0.0


def _scaled(cam2_from_cam1: Pose, points1: Array, b2: Array, inliers: Mask) -> Pose:
    """Relative pose with the translation's length by which points of view 1 are seen in view 2."""
    R, t = cam2_from_cam1.rotation, cam2_from_cam1.translation
    if not np.isfinite(t).all() or not inliers.any():
        return Pose(R, np.zeros(3))
    turned, rays = points1[inliers] @ R.T, b2[inliers]
    # b2 x (R X + s t) = 0: one equation for s in the direction of b2 x t, weighed by its sine.
    normals = np.cross(rays, t)
    across = np.cross(rays, turned)
    lengths = -np.einsum("ni,ni->n", normals, across)
    squares = np.einsum("ni,ni->n", normals, normals)
    order = np.argsort(lengths / np.maximum(squares, 1e-12))
    weights = np.cumsum(np.sqrt(squares[order]))
    middle = order[int(np.searchsorted(weights, 0.5 * weights[-1]))]
    return Pose(R, max(0.0, float(lengths[middle] / max(squares[middle], 1e-12))) * t)


def _off_plane(cam2_from_cam1: Pose, b1: Array, b2: Array) -> Array:
    """Angle between each bearing of view 2 and the half plane in which its match must lie."""
    along = b1 @ cam2_from_cam1.rotation.T
    normals = np.cross(np.broadcast_to(cam2_from_cam1.translation, along.shape), along)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.arcsin(np.clip(np.abs(np.einsum("ni,ni->n", normals, b2)), 0.0, 1.0)))
