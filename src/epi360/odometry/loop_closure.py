# SPDX-License-Identifier: BSD-3-Clause
"""Whether two parts of the map show the same place, and the similarity between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from epi360.odometry import relocalization
from epi360.odometry.pose_graph import diagonal_information
from epi360.odometry.relocalization import MappedView, PlaceOptions, Relocalization, locate
from epi360.odometry.similarity import Similarity
from epi360.poses import rotation_error_deg

Array = NDArray[np.float64]
Status = Literal[relocalization.Status, "scale_unknown", "drift_too_large"]


@dataclass(frozen=True)
class LoopOptions:
    """What it takes to close a loop: a false one is worse than one that is missed.

    Attributes
    ----------
    place : PlaceOptions
        What both directions, old to new and new to old, must show.
    min_shared_points : int
        Fewest features with a point in both parts of the map, which say the scale.
    max_log_scale_sigma : float
        Largest standard deviation of the logarithm of the scale.
    max_drift_share : float
        Largest error of the new key frame's place in the map, as a share of the path since the
        old one: what asks for more is another place that looks alike.
    max_drift_rad : float
        Largest error of its rotation.
    """

    place: PlaceOptions = PlaceOptions()
    min_shared_points: int = 15
    max_log_scale_sigma: float = 0.05
    max_drift_share: float = 0.15
    max_drift_rad: float = 0.5


@dataclass(frozen=True, eq=False)
class LoopClosure:
    """Similarity between two key frames, and the evidence for it.

    Attributes
    ----------
    old, new : int
        Key frames.
    new_from_old : Similarity or None
        Takes the camera frame of the old key frame, in the units of the map there, to that of the
        new one, in the units of the map here: an edge of the pose graph. None if refused.
    information : ndarray, shape (7, 7) or None
        Inverse covariance of the edge.
    num_inliers : int
        The lower number of both directions.
    num_cells : int
        Cells of 48 of the sphere of view that hold an inlier, the lowest number.
    status : str
        "ok" or why no loop is closed.
    new_in_map : Relocalization or None
        The new key frame as the points of the old one place it. None if refused.
    """

    old: int
    new: int
    new_from_old: Similarity | None
    information: Array | None
    num_inliers: int
    num_cells: int
    status: Status
    new_in_map: Relocalization | None = None

    @property
    def success(self) -> bool:
        """Whether the loop may be closed."""
        return self.status == "ok"


def close_loop(
    new: MappedView,
    old: MappedView,
    *,
    forth: Relocalization | None = None,
    path_length: float | None = None,
    options: LoopOptions = LoopOptions(),  # noqa: B008 - frozen
    seed: int = 0,
) -> LoopClosure:
    """Similarity between two key frames whose points come from different parts of the map.

    The new camera is placed by points of the old key frame and the old one by those of the new;
    both must agree. The scale is the median ratio of distances to the points that both have.
    ``forth`` is the new camera's place by the old points, if that is known. ``path_length`` is the
    way of the camera between them in units of the map, with which the error is compared that the
    loop would take away.
    """
    place = options.place
    forth = forth or locate(new.features, old, options=place, seed=seed)
    refused = LoopClosure(old.key_frame, new.key_frame, None, None, 0, 0, forth.status)
    if not forth.success:
        return refused
    num_inliers = int(forth.pose.inlier_mask.sum())
    refused = replace(refused, num_inliers=num_inliers, num_cells=forth.num_cells)
    rigid = forth.pose.cam_from_world @ old.cam_from_world.inverse()
    ratios = _distance_ratios(new, old, forth)
    if len(ratios) < options.min_shared_points:
        return replace(refused, status="scale_unknown")
    log_scale = float(np.median(ratios))
    scatter = 1.4826 * float(np.median(np.abs(ratios - log_scale)))
    sigma = 1.2533 * scatter / np.sqrt(len(ratios))  # of a median
    if sigma > options.max_log_scale_sigma:
        return replace(refused, status="scale_unknown")
    scale = float(np.exp(log_scale))
    new_from_old = Similarity(scale, rigid.rotation, scale * rigid.translation)
    back = locate(old.features, new, options=place, seed=seed)
    if not back.success:
        return replace(refused, status=back.status)
    num_inliers = min(num_inliers, int(back.pose.inlier_mask.sum()))
    num_cells = min(forth.num_cells, back.num_cells)
    refused = replace(refused, num_inliers=num_inliers, num_cells=num_cells)
    other = (back.pose.cam_from_world @ new.cam_from_world.inverse()).inverse()
    range_ = median_range(new)
    if not similar(new_from_old, Similarity.from_pose(other), range_, place.threshold_rad):
        return replace(refused, status="two_views_disagree")
    if path_length is not None and not _is_plausible(new_from_old, new, old, path_length, options):
        return replace(refused, status="drift_too_large")
    least = place.threshold_rad / 4.0
    information = diagonal_information(least, least * range_, max(sigma, 1e-3))
    return replace(
        refused,
        new_from_old=new_from_old,
        information=information,
        status="ok",
        new_in_map=forth,
    )


def _distance_ratios(new: MappedView, old: MappedView, found: Relocalization) -> Array:
    """Logarithms of new units in one old unit, one a point that both parts of the map have."""
    rows = found.matches[found.pose.inlier_mask]
    points_new, points_old = new.points[rows[:, 1]], old.points[rows[:, 0]]
    both = np.isfinite(points_new[:, 0]) & np.isfinite(points_old[:, 0])
    pose = found.pose.cam_from_world
    far_old = np.linalg.norm(points_old[both] @ pose.rotation.T + pose.translation, axis=1)
    in_new = points_new[both] - new.cam_from_world.inverse().translation
    return np.asarray(np.log(np.linalg.norm(in_new, axis=1) / far_old))


def median_range(view: MappedView) -> float:
    """Median distance of a key frame's points."""
    known = view.points[np.isfinite(view.points[:, 0])]
    center = view.cam_from_world.inverse().translation
    return float(np.median(np.linalg.norm(known - center, axis=1)))


def similar(a: Similarity, b: Similarity, range_: float, threshold_rad: float) -> bool:
    """Whether two similarities that end in the new camera's units differ by noise alone."""
    angle = np.radians(rotation_error_deg(a.rotation, b.rotation))
    # Of the translation: noise of the rays, and five per cent of its length of the scale.
    allowed = 3.0 * threshold_rad * range_ + 0.05 * float(np.linalg.norm(a.translation))
    shift = float(np.linalg.norm(a.translation - b.translation))
    return bool(angle < 3.0 * threshold_rad and shift < allowed)


def _is_plausible(
    new_from_old: Similarity,
    new: MappedView,
    old: MappedView,
    path_length: float,
    options: LoopOptions,
) -> bool:
    """Whether the odometry may have drifted so far on its way."""
    believed = new.cam_from_world @ old.cam_from_world.inverse()
    angle = np.radians(rotation_error_deg(believed.rotation, new_from_old.rotation))
    # Both as places of the new camera in the old one's frame and units.
    place = new_from_old.inverse().translation
    shift = float(np.linalg.norm(place - believed.inverse().translation))
    return bool(angle < options.max_drift_rad and shift < options.max_drift_share * path_length)
