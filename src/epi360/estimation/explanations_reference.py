# SPDX-License-Identifier: BSD-3-Clause
"""From the evidence of two views to the five explanations, in plain NumPy: the twin of the core's.

docs/estimator.md has the equations, native/core/robust/verdict.cpp the other half of the twins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from epi360.estimation.result import LEAST_PROBABILITY, Explanations

ACCEPTED = LEAST_PROBABILITY
ACCEPTED_LOG_ODDS = math.log(ACCEPTED / (1.0 - ACCEPTED))
FALSE_ALARMS = -3.0  # log10
LARGEST_CHANCE = 0.6  # of a wrong match inside the gate
ROTATION_MOSTLY = 0.4  # of the inliers
ROTATION_REJECTED, PLANE_REJECTED = 4.0, 3.0  # standard deviations
RIVAL_REJECTED = 6.0  # log-likelihood
MOST_BESIDE_REGIONS = 6.0  # log-odds
RIVAL_OUTNUMBERED = 2.0  # standard deviations
RIVAL_PROBABILITY = 0.5
MIRRORED_SHARE, MIRRORED_TURN_SHARE, FEWEST_MIRRORED = 0.23, 0.07, 10.0  # of the inliers
PLANE_SHARE = 0.9
MOST_NOISE, LOG_ODDS_PER_NOISE = 3.0, -8.0  # over the limit that the user knows
LOG_ODDS, LOG_ODDS_PER_RATIO, LOG_ODDS_PER_SIGMA = -2.7, 0.11, -1.2
LOG_ODDS_PER_MAJORITY = 6.0
CERTAIN = 50.0


@dataclass(frozen=True)
class PairEvidence:
    """What two views say, angles in radians; what is not known speaks for the pose.

    The names are those of the core's ``Evidence``, whose header says what they mean.
    """

    num_usable: int = 0
    sample_size: int = 5
    num_effective: int = 0
    support: int = 0
    log10_false_alarms: float = -math.inf
    chance: float = 0.0
    behind: float = 0.0
    mirrored_turn: float = 0.0
    rotation_support: int = 0
    rotation_log10_false_alarms: float = math.inf
    rotation_rejection: float = math.inf
    rotation_log_ratio: float = math.inf
    log_ratio: float = math.inf
    regional_sigma: float = 0.0
    log_prior: float = 0.0
    has_prior: bool = False
    rival_evidence: float = -math.inf
    rival_probability: float = 1.0
    rival_regions: float = math.nan
    num_contradicting: int = 0
    is_only_crowd: bool = False
    only_pose: float = 0.0
    only_rival: float = 0.0
    plane_share: float = 0.0
    has_twin: bool = False
    noise: float = math.nan
    max_noise: float = 0.0


def explanations_reference(evidence: PairEvidence) -> Explanations:
    """Return the probabilities of the five explanations: a softmax of their log-odds."""
    e = evidence
    if e.num_usable < max(e.sample_size, 5):
        return Explanations(1.0, 0.0, 0.0, 0.0, 0.0)
    pose, rotation = _log_odds_of_pose(e), -math.inf
    if _rotation_explains(e):
        over = _test(e.rotation_rejection)
        if e.rotation_rejection < ROTATION_REJECTED:
            rotation = _log_odds_of_rotation(e)
            pose = min(pose, rotation + over)
        else:
            rotation = pose - over
    rival = pose - _log_odds_over_rival(e)
    surface = 1.0 / (1.0 + math.exp(-_log_odds_of_surface(e)))
    log_odds = np.array([0.0, rotation, pose, rival])
    shares = np.exp(log_odds - log_odds.max())
    nothing, turned, found, other = (shares / shares.sum()).tolist()
    return Explanations(nothing, turned, surface * found, (1.0 - surface) * found, other)


def log_odds_by_regions(evidence: PairEvidence) -> float:
    """Log-odds of the pose over background alone, from what the regions say and its prior."""
    e = evidence
    degrees = math.degrees(1.0) * max(e.regional_sigma, 1e-6)
    return (
        LOG_ODDS
        + LOG_ODDS_PER_RATIO * e.log_ratio
        + LOG_ODDS_PER_SIGMA * math.log(degrees)
        + LOG_ODDS_PER_MAJORITY * _majority(e, e.support)
        + e.log_prior
    )


def _log_odds_of_pose(e: PairEvidence) -> float:
    is_mirrored = e.behind >= max(
        FEWEST_MIRRORED, MIRRORED_SHARE * e.support
    ) or e.mirrored_turn >= max(FEWEST_MIRRORED, MIRRORED_TURN_SHARE * e.support)
    if e.chance > LARGEST_CHANCE or is_mirrored:
        return -CERTAIN
    chance = _by_chance(e.log10_false_alarms)
    crowd = 0.0 if e.is_only_crowd else math.inf
    return _bounded(min(log_odds_by_regions(e), chance, _by_noise(e), crowd))


def _log_odds_of_rotation(e: PairEvidence) -> float:
    by_regions = LOG_ODDS + LOG_ODDS_PER_RATIO * e.rotation_log_ratio
    by_regions += LOG_ODDS_PER_MAJORITY * _majority(e, e.rotation_support)
    return _bounded(min(by_regions, _by_chance(e.rotation_log10_false_alarms)))


def _log_odds_over_rival(e: PairEvidence) -> float:
    if e.num_contradicting > 0:
        return 0.0
    if e.has_twin:
        lack = max(-e.rival_evidence - RIVAL_REJECTED, 0.0)
        deviations = lack / math.sqrt(max(e.support, 1))
        return _bounded(ACCEPTED_LOG_ODDS * (deviations / PLANE_REJECTED) ** 2)
    is_believed = e.rival_probability > RIVAL_PROBABILITY
    if e.has_prior and not is_believed:
        return CERTAIN
    log_odds = -e.rival_evidence * ACCEPTED_LOG_ODDS / RIVAL_REJECTED
    has_heard = math.isfinite(e.rival_regions)
    if has_heard:
        least, most = e.rival_regions - MOST_BESIDE_REGIONS, e.rival_regions + MOST_BESIDE_REGIONS
        log_odds = min(max(log_odds, least), most)
    if is_believed:
        least = min(e.rival_regions, 0.0) if has_heard else -CERTAIN
        log_odds = min(log_odds, max(_by_number(e), least))
    return _bounded(log_odds)


def _by_number(e: PairEvidence) -> float:
    """Log-odds of the pose over another motion, by the matches that each explains alone."""
    if not e.only_rival > 0.0:
        return CERTAIN
    deviations = (e.only_pose - e.only_rival) / math.sqrt(e.only_pose + e.only_rival)
    deviations /= RIVAL_OUTNUMBERED
    return ACCEPTED_LOG_ODDS * deviations * abs(deviations)


def _log_odds_of_surface(e: PairEvidence) -> float:
    n = max(e.support, 1)
    expected = (1.0 - PLANE_SHARE) * n
    excess = ((1.0 - e.plane_share) * n - expected) / math.sqrt(PLANE_SHARE * expected)
    return _bounded(-0.5 * excess * abs(excess))


def _rotation_explains(e: PairEvidence) -> bool:
    is_most = e.rotation_support > 0 and e.rotation_support >= ROTATION_MOSTLY * e.support
    return is_most and e.rotation_log10_false_alarms < FALSE_ALARMS


def _test(deviations: float) -> float:
    """Log-odds from standard deviations, those of what is accepted at the limit of the test."""
    square = deviations * abs(deviations) - ROTATION_REJECTED**2
    return _bounded(0.5 * square + ACCEPTED_LOG_ODDS)


def _by_chance(log10_false_alarms: float) -> float:
    return ACCEPTED_LOG_ODDS - math.log(10.0) * (log10_false_alarms - FALSE_ALARMS)


def _by_noise(e: PairEvidence) -> float:
    if not (e.max_noise > 0.0 and e.noise >= e.max_noise):
        return math.inf
    times = e.noise / (MOST_NOISE * e.max_noise)
    return ACCEPTED_LOG_ODDS + LOG_ODDS_PER_NOISE * math.log(times)


def _majority(e: PairEvidence, support: int) -> float:
    return max(0.0, support / e.num_effective - 0.5) if e.num_effective > 0 else 0.0


def _bounded(log_odds: float) -> float:
    return min(max(log_odds, -CERTAIN), CERTAIN)
