# SPDX-License-Identifier: BSD-3-Clause
"""Poses that rest on a few things which stand apart, and nothing else is matched.

A poster, a chair: two of them that stand elsewhere in another room nearly always agree on some
pose, for either gives three of its five numbers. Where others with many of the matches disagree,
things stand elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair
from epi360.estimation.result import RelativePoseResult, with_pose_refused

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Matches so near to each other in both views are of one thing, which is no wider than that around
# its middle; so many at least of some hundreds that are looked at.
_BESIDE_DEG, _WIDEST_DEG, _FEWEST, _MOST_MATCHES = 5.0, 25.0, 6, 480
_LARGEST_COVERAGE = 0.35  # of the sphere by inliers; few things cover less
_NARROW_DEG = 50.0  # around the middle of all matches: a narrow view, which may be one thing itself
# Shares of all matches and of the inliers that lie on such things. Of the right poses of ALIKED and
# SIFT in a real home none has more than 0.85 of the inliers there.
_LEAST_OF_ALL, _LEAST_OF_INLIERS = 0.8, 0.9
_AGREES, _DISAGREES = 0.5, 0.2  # of the matches of a thing
# As many matches, of the inliers, as those that disagree must have: a car that drove on has fewer.
_LEAST_AGAINST = 0.4
_MOST_PROBABLE = 0.5


class Things(NamedTuple):
    """How many things agree with a pose, of how many hardly any match does, and how much that is.

    ``against`` is the number of matches on the latter, of the number of inliers.
    """

    agreeing: int
    disagreeing: int
    against: float


def with_doubt_of_things(
    result: RelativePoseResult, bearings1: ArrayLike, bearings2: ArrayLike
) -> RelativePoseResult:
    """The result, refused or with a warning where a few things are all that it rests on.

    ``bearings1`` and ``bearings2`` (N, 3) are those that it was estimated from.
    """
    if not result.success or result.sphere_coverage > _LARGEST_COVERAGE:
        return result
    used = np.isfinite(result.residuals_rad)
    b1, b2 = bearing_pair(bearings1, bearings2)
    things = things_apart(b1[used], b2[used], result.inlier_mask[used])
    if things is None or things.agreeing < 2:
        return result
    if things.against >= _LEAST_AGAINST:
        return _refused(result, things)
    if things.agreeing == 2 and not things.disagreeing:
        sentence = "nearly all matches lie on two things: if either stands elsewhere, no pose shows"
        return replace(result, warnings=(*result.warnings, sentence))
    return result


def things_apart(b1: Array, b2: Array, inlier_mask: Mask) -> Things | None:
    """Things that unit bearings (N, 3) show; None if more matches lie elsewhere, or all in a cone.

    What moves through a narrow view is no reason to doubt what all the others say.
    """
    rows = slice(None, None, 1 + len(b1) // _MOST_MATCHES)
    views, agrees = [b1[rows], b2[rows]], inlier_mask[rows]
    if len(agrees) < _FEWEST or min(map(_radius_deg, views)) < _NARROW_DEG:
        return None
    beside = np.logical_and(*(view @ view.T > np.cos(np.radians(_BESIDE_DEG)) for view in views))
    if np.mean(beside.sum(axis=1) > 2) < _LEAST_OF_ALL:  # a match is beside itself
        return None
    on_things = np.zeros(len(agrees), dtype=bool)
    shares, counts = [], []
    for thing in _connected(beside):
        if np.count_nonzero(thing) < _FEWEST:
            continue
        if max(_radius_deg(view[thing]) for view in views) > _WIDEST_DEG:
            return None
        on_things |= thing
        shares.append(agrees[thing].mean())
        counts.append(np.count_nonzero(thing))
    inliers_on_things = np.count_nonzero(on_things & agrees)
    if on_things.mean() < _LEAST_OF_ALL or inliers_on_things < _LEAST_OF_INLIERS * agrees.sum():
        return None
    told = np.array(shares)
    is_against = told < _DISAGREES
    against = float(np.sum(np.array(counts)[is_against]) / max(agrees.sum(), 1))
    return Things(int(np.sum(told > _AGREES)), int(np.sum(is_against)), against)


def _connected(beside: Mask) -> Iterator[Mask]:
    """Rows (N,) that are connected with each other, by which (N, N) lie side by side."""
    left = np.ones(len(beside), dtype=bool)
    while left.any():
        some = np.zeros(len(beside), dtype=bool)
        newest = np.array([np.argmax(left)])
        while len(newest):
            some[newest] = True
            newest = np.flatnonzero(beside[newest].any(axis=0) & ~some)
        left &= ~some
        yield some


def _radius_deg(bearings: Array) -> float:
    """Largest angle from the middle of some directions."""
    middle = bearings.mean(axis=0)
    cosines = bearings @ (middle / np.linalg.norm(middle))
    return float(np.degrees(np.arccos(np.clip(cosines.min(), -1.0, 1.0))))


def _refused(result: RelativePoseResult, things: Things) -> RelativePoseResult:
    """The result without its pose, which is the first of the alternatives."""
    others = f"{things.disagreeing} others do" if things.disagreeing > 1 else "one does"
    sentence = (
        f"nearly all matches lie on a few things; {things.agreeing} of them agree on the pose and "
        f"{others} not: they may stand elsewhere, or be others of their kind"
    )
    return replace(
        with_pose_refused(result, "concentrated_inliers"),
        probability=min(result.probability, _MOST_PROBABLE),
        warnings=(*result.warnings, sentence),
    )
