# SPDX-License-Identifier: BSD-3-Clause
"""When a pair of images is looked at again with more key points, and which answer is kept."""

from __future__ import annotations

from collections.abc import Sequence

from epi360.estimation import RelativePoseResult
from epi360.estimation.result import pose_sigmas_deg

# One sigma, over all components, shared errors included, which more key points do not lessen.
_PRECISE_ROTATION_DEG, _PRECISE_DIRECTION_DEG = 0.25, 0.75
# Probability after a look with the stronger key points. Of 200 pairs of different places, 189 have
# less; all accepted pairs of five tours and a sequence (178) have at least 0.5, but for six that
# only the prior of a level folder finds.
_LEAST_HOPE = 0.05


def is_settled(status: str, warnings: Sequence[str] = ()) -> bool:
    """Whether more key points of the same images would hardly change this verdict."""
    # Of 55 real pairs, one or two that are ok but have a warning are 3 degrees off, and right when
    # all key points are matched.
    return status in ("ok", "pure_rotation") and not warnings


def has_hope(status: str, probability: float) -> bool:
    """Whether more key points of the same images may find the pose that a look did not."""
    return status != "too_few_inliers" or not probability < _LEAST_HOPE


def is_precise(result: RelativePoseResult) -> bool:
    """Whether larger images would hardly change the pose: it has small sigmas and no warning."""
    rotation_deg, direction_deg = pose_sigmas_deg(result)
    if result.status == "pure_rotation":
        return rotation_deg < _PRECISE_ROTATION_DEG
    precise = rotation_deg < _PRECISE_ROTATION_DEG and direction_deg < _PRECISE_DIRECTION_DEG
    return bool(result.success and not result.warnings and precise)


def later_is_better(status: str, later_status: str) -> bool:
    """Whether the answer of a closer look is kept in place of the earlier one.

    A pose is given up only for another, or for a verdict that contradicts it.
    """
    return later_status in ("ok", "pure_rotation", "planar_ambiguous") or status != "ok"


def prior_is_better(later_status: str, contradicts_prior: bool) -> bool:
    """Whether the answer with a prior is kept in place of the one without.

    A pose that contradicts the prior is given up for whatever the look with it finds.
    """
    return later_status == "ok" or contradicts_prior
