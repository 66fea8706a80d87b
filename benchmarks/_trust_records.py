# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts held against known poses: how many are right, and whether stated odds are kept."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from epi360.estimation import RelativePoseResult
from epi360.poses import Pose, rotation_error_deg, translation_error_deg

RIGHT_DEG, WRONG_DEG = 5.0, 10.0
# A pair of which either view shares that much with the other can be asked to be found.
FINDABLE_OVERLAP = 0.3
LISTED = "listed"
ZIND = "zind_tour"  # the photographed tour
PRECISIONS = (1.0, 0.995, 0.99, 0.95, 0.9)


# Sets whose true poses were aligned by hand on a floor plan, and how good they are (their README).
SET_BY_HAND = (ZIND, "learned")
REFERENCE_SIGMAS_DEG = (1.0, 2.0)


@dataclass(frozen=True)
class Judged:
    """One method's verdict on one pair, and how far its pose is from the truth.

    Attributes
    ----------
    set, method, pair : str
    status : str
        The method's own word.
    accepted : bool
    probability : float
        Stated probability that the pose is right; NaN where none is stated.
    num_inliers : int
        Orders the pairs of methods that state no probability.
    rotation_error_deg, translation_error_deg : float
        NaN where there is no pose.
    rotation_sigma_deg, translation_sigma_deg : float
        One sigma over all axes, as stated; NaN where none is.
    overlap : float
        Share that both views see, NaN where it is not known.
    relation : str
        How the rooms of a rendered pair are related; `LISTED` for a pair that its set lists.
    pose : Pose, optional
        What was found, be it with a refusal; it is not part of the record.
    """

    set: str
    method: str
    pair: str
    status: str
    accepted: bool
    probability: float
    num_inliers: int
    rotation_error_deg: float
    translation_error_deg: float
    rotation_sigma_deg: float = math.nan
    translation_sigma_deg: float = math.nan
    overlap: float = math.nan
    relation: str = ""
    pose: Pose | None = None

    @property
    def has_pose(self) -> bool:
        """Whether rotation and direction are given, be it with a refusal."""
        return not math.isnan(self.rotation_error_deg + self.translation_error_deg)

    @property
    def is_right(self) -> bool:
        """Whether both errors are below five degrees."""
        return max(self.rotation_error_deg, self.translation_error_deg) < RIGHT_DEG

    @property
    def is_wrong(self) -> bool:
        """Whether one error is above ten degrees."""
        return max(self.rotation_error_deg, self.translation_error_deg) > WRONG_DEG

    @property
    def is_findable(self) -> bool:
        """Whether it can be asked for: the views share enough, or its set lists it."""
        return self.overlap >= FINDABLE_OVERLAP or self.relation == LISTED

    @property
    def score(self) -> float:
        """What pairs are sorted by, the surest first."""
        return self.num_inliers if math.isnan(self.probability) else self.probability

    def record(self) -> dict[str, Any]:
        """Values for JSON; NaN is None."""
        values = asdict(replace(self, pose=None))
        del values["pose"]
        return for_json(values)

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> Judged:
        """What `record` has made of a verdict; it comes without the pose."""
        return cls(**of_json(record))


def for_json(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values for JSON; NaN is None."""
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in values.items()
    }


def of_json(record: Mapping[str, Any]) -> dict[str, Any]:
    """Values that `for_json` has made a record of."""
    return {key: math.nan if value is None else value for key, value in record.items()}


def errors_of(pose: Pose, truth: Pose) -> tuple[float, float]:
    """Rotation and direction error in degrees; NaN for a pose that has none."""
    return rotation_error_deg(pose, truth), translation_error_deg(pose, truth)


def found_pose(result: RelativePoseResult) -> Pose:
    """The pose, or the one that was refused though it is more probable than not."""
    if result.status in ("too_few_inliers", "another_place") and result.alternatives:
        return result.alternatives[0]
    return result.cam2_from_cam1


def count_rows(judged: Sequence[Judged]) -> list[list[str]]:
    """Table of what each method accepts on each set."""
    header = ["set", "method", "pairs", "accepted", "right", "5-10°", "wrong", "wrong of accepted"]
    header += ["recall", "R, t / sigma", "with the reference's"]
    rows = [header]
    for name, method, runs in _groups(judged):
        accepted = [run for run in runs if run.accepted]
        right, wrong = (sum(map(flag, accepted)) for flag in (_right, _wrong))
        findable = [run for run in runs if run.is_findable]
        found = sum(run.accepted and run.is_right for run in findable)
        recall = f"{found}/{len(findable)} = {found / len(findable):.1%}" if findable else "-"
        share = f"{wrong / len(accepted):.1%}" if accepted else "-"
        between = len(accepted) - right - wrong
        counts = [len(runs), len(accepted), right, between, wrong]
        over_sigma = [_over_sigma(accepted, sigmas) for sigmas in ((0.0, 0.0), _of_reference(name))]
        rows.append([name, method, *map(str, counts), share, recall, *over_sigma])
    return rows


def relation_rows(judged: Sequence[Judged]) -> list[list[str]]:
    """Table of what each method accepts between rooms that are related in one way."""
    rows = [["set", "method", "rooms", "pairs", "accepted", "right", "wrong"]]
    for name, method, runs in _groups(judged):
        relations = dict.fromkeys(run.relation for run in runs)
        for relation in relations if len(relations) > 2 else ():
            related = [run for run in runs if run.relation == relation]
            accepted = [run for run in related if run.accepted]
            counts = len(related), len(accepted), *(sum(map(f, accepted)) for f in (_right, _wrong))
            rows.append([name, method, relation, *map(str, counts)])
    return rows


def precision_rows(judged: Sequence[Judged]) -> list[list[str]]:
    """Table of right poses that are kept where the share that is not wrong is held at a level."""
    header = ["set", "method", "sorted by", "right poses"]
    rows = [header + [f"at {level:.1%}" for level in PRECISIONS]]
    for name, method, runs in _groups(judged):
        posed = sorted((run for run in runs if run.has_pose), key=lambda run: -run.score)
        if not posed:
            continue
        by = "inliers" if all(math.isnan(run.probability) for run in posed) else "probability"
        kept = [str(right_at(posed, level)) for level in PRECISIONS]
        rows.append([name, method, by, str(sum(map(_right, posed))), *kept])
    return rows


def right_at(ranked: Sequence[Judged], level: float) -> int:
    """Right poses among the surest ones, as many as keep 1 - wrong / taken at the level.

    Poses of equal scores are taken together.
    """
    scores = np.array([run.score for run in ranked])
    wrong, right = (np.cumsum([flag(run) for run in ranked]) for flag in (_wrong, _right))
    last_of_score = np.append(scores[1:] != scores[:-1], True)
    precision = 1.0 - wrong / np.arange(1, len(ranked) + 1)
    good = np.flatnonzero(last_of_score & (precision >= level))
    return int(right[good[-1]]) if len(good) else 0


def wrong_lines(judged: Sequence[Judged], method: str) -> list[str]:
    """One line for each pose that a method accepts and that is wrong."""
    return [
        f"{run.set}: {run.pair} {run.relation} R {run.rotation_error_deg:.1f} "
        f"t {run.translation_error_deg:.1f} deg, {run.num_inliers} inliers, "
        f"probability {run.probability:.4f}, overlap {run.overlap:.2f}"
        for run in judged
        if run.method == method and run.accepted and run.is_wrong
    ]


def _right(run: Judged) -> bool:
    return run.is_right


def _wrong(run: Judged) -> bool:
    return run.is_wrong


def _of_reference(set_name: str) -> tuple[float, float]:
    """Sigma of the rotation and the direction of the poses that a set takes to be true."""
    is_set_by_hand = set_name.startswith(SET_BY_HAND)
    return REFERENCE_SIGMAS_DEG if is_set_by_hand else (0.0, 0.0)


def _over_sigma(accepted: Sequence[Judged], of_reference: tuple[float, float]) -> str:
    """Median error over sigma, the stated and the reference's, of accepted poses not wrong."""
    kept = [run for run in accepted if not run.is_wrong]
    rotation, direction = of_reference
    pairs = [
        [run.rotation_error_deg / math.hypot(run.rotation_sigma_deg, rotation) for run in kept],
        [
            run.translation_error_deg / math.hypot(run.translation_sigma_deg, direction)
            for run in kept
        ],
    ]
    known = [[ratio for ratio in ratios if math.isfinite(ratio)] for ratios in pairs]
    return ", ".join(f"{np.median(ratios):.2f}" if ratios else "-" for ratios in known)


def _groups(judged: Sequence[Judged]) -> list[tuple[str, str, list[Judged]]]:
    """Set, method and their runs, in the order in which they came."""
    groups: dict[tuple[str, str], list[Judged]] = {}
    for run in judged:
        groups.setdefault((run.set, run.method), []).append(run)
    return [(*key, runs) for key, runs in groups.items()]
