# SPDX-License-Identifier: BSD-3-Clause
"""Every rule that makes a status or a warning of a pose in a map: evidence in, verdict out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from epi360.estimation.absolute_evidence import Evidence
from epi360.estimation.copies import copies_sentence
from epi360.estimation.result import LEAST_PROBABILITY

AbsoluteStatus = Literal[
    "ok", "too_few_matches", "too_few_inliers", "concentrated_inliers", "ambiguous"
]

FEWEST_MATCHES = 4  # three have up to four poses
_FALSE_ALARMS = -3.0  # log10; accepted below
# Standard deviation in the worst direction, in radians and in median distances of the points.
_LARGEST_ROTATION, _LARGEST_TRANSLATION = np.radians(5.0), 0.1
_PATCH_CELLS, _PATCH_SHARE = 6, 0.35  # as with pairs of views
_PARTIAL_COVERAGE = 0.5
# Logistic curve through log10 of the false alarms and the share of the regions that agree. Of 239
# poses from the matches of one map image (theta_flat, Tram; all, a seventh or a twentieth of the
# matches), those that were 2 to 5 degrees off had 10^-15 to 10^-21 false alarms, and all but 6 of
# the others fewer than 10^-28. Images of one set found no pose in the map of the other.
_LOG_ODDS, _PER_DECADE, _PER_SHARE = -4.5, 0.25, 3.0
_RIVAL_SHARE = 0.5  # of the regions of the best pose, from which another one makes it ambiguous


@dataclass(frozen=True)
class Spread:
    """How well the inliers determine the pose: worst standard deviations, radians and distances."""

    rotation: float
    translation: float


def probability_of(evidence: Evidence) -> float:
    """Probability that a pose with this evidence is right."""
    if not np.isfinite(evidence.log10_false_alarms):
        return 0.0
    log_odds = _LOG_ODDS - _PER_DECADE * evidence.log10_false_alarms
    log_odds += _PER_SHARE * evidence.inlier_share
    return float(1.0 / (1.0 + np.exp(-np.clip(log_odds, -50.0, 50.0))))


def judge(
    evidence: Evidence, spread: Spread, min_num_inliers: int, rival_regions: float
) -> AbsoluteStatus:
    """Status of a pose; ``rival_regions`` agree with the best one that is truly different."""
    if evidence.num_usable < FEWEST_MATCHES:
        return "too_few_matches"
    is_chance = evidence.log10_false_alarms > _FALSE_ALARMS
    if evidence.num_inliers < min_num_inliers or is_chance:
        return "too_few_inliers"
    is_open = spread.rotation > _LARGEST_ROTATION or spread.translation > _LARGEST_TRANSLATION
    if is_open or _is_patch(evidence):
        return "concentrated_inliers"
    if rival_regions > _RIVAL_SHARE * evidence.num_regions:
        return "ambiguous"
    return "ok" if probability_of(evidence) >= LEAST_PROBABILITY else "too_few_inliers"


def warnings_of_rows(num_given: int, num_missing: int, num_copies: int) -> tuple[str, ...]:
    """Sentences for a person about rows that do not count."""
    found = []
    if num_missing:
        found.append(
            f"{num_missing} of {num_given} matches are missing (NaN, as of pixels outside the "
            "image)"
        )
    if num_copies:
        found.append(copies_sentence(num_copies, num_given))
    return tuple(found)


def warnings_of(
    evidence: Evidence, noise_deg: float, max_noise_deg: float | None
) -> tuple[str, ...]:
    """Sentences for a person about a pose that is used."""
    found = []
    if evidence.cells < _PARTIAL_COVERAGE * evidence.cells_of_matches:
        found.append(
            f"inliers cover {evidence.cells} of 48 cells of the sphere, all matches "
            f"{evidence.cells_of_matches}: part of the scene may have changed or repeat itself"
        )
    if max_noise_deg is not None and noise_deg >= max_noise_deg:
        found.append(
            f"the matches agree only to {noise_deg:.3g} degrees (one sigma): does the camera "
            "belong to this image, and the map to this place?"
        )
    return tuple(found)


def _is_patch(evidence: Evidence) -> bool:
    few = evidence.cells <= _PATCH_CELLS
    return few and evidence.cells < _PATCH_SHARE * evidence.cells_of_matches
