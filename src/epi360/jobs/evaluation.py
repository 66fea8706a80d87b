# SPDX-License-Identifier: BSD-3-Clause
"""How far an estimated trajectory is from the true one: ATE, RPE, errors of pairs, coverage.

ATE and RPE are those of Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems" (IROS
2012); the errors of pairs are eq. 16 of Robust 360-8PA.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.jobs.trajectories import Alignment, PosedFrames, Similarity, align, matching_frames
from epi360.poses import angles_between

Floats = NDArray[np.float64]

MAX_GAP_S = 0.01
DISTANCE_M = 1.0


@dataclass(frozen=True)
class Statistics:
    """Summary of errors; all NaN where there is none."""

    rmse: float
    mean: float
    median: float
    max: float

    @classmethod
    def of(cls, errors: Floats) -> Statistics:
        """Return the summary of errors that are finite."""
        errors = errors[np.isfinite(errors)]
        if not len(errors):
            return cls(*[float("nan")] * 4)
        rmse = float(np.sqrt(np.mean(errors**2)))
        return cls(rmse, float(errors.mean()), float(np.median(errors)), float(errors.max()))


@dataclass(frozen=True, eq=False)
class PairErrors:
    """Errors of the relative poses of K pairs of frames; row k belongs to one pair.

    ``translation_m`` and ``rotation_deg`` are of the estimate's motion against the true one;
    ``direction_deg`` is the angle between the directions in which camera 2 sees camera 1 move, NaN
    where the true camera stands still.
    """

    pairs: NDArray[np.intp]  # (K, 2): rows of the matched frames
    length_m: Floats  # (K,): true way between the frames
    translation_m: Floats
    rotation_deg: Floats
    direction_deg: Floats


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors of an estimated trajectory; lengths have the unit of the truth."""

    truth: PosedFrames  # the N frames that both have
    estimate: PosedFrames  # the same frames, in the world of the truth
    alignment: Alignment
    similarity: Similarity
    num_truth: int
    num_estimate: int
    position_errors_m: Floats  # (N,)
    rotation_errors_deg: Floats  # (N,) after the alignment of the positions, as evo counts
    # (N,) after the rotation that fits the orientations best: positions near a line leave the
    # rotation about the line open.
    orientation_errors_deg: Floats
    steps: PairErrors  # each matched frame and the next one
    distance_m: float
    stretches: PairErrors  # each frame and the first that is so far ahead on the true way

    @property
    def coverage(self) -> float:
        """Share of the true frames that have a pose in the estimate."""
        return len(self.truth) / self.num_truth

    @property
    def path_m(self) -> float:
        """Length of the true way through the matched frames."""
        return self.truth.path_length()

    @property
    def moves(self) -> bool:
        """Whether the true camera moves, by more than rounding."""
        return _moves(self.truth)


def evaluate(
    estimate: PosedFrames,
    truth: PosedFrames,
    *,
    alignment: Alignment = "sim3",
    max_gap_s: float = MAX_GAP_S,
    distance_m: float | None = None,
) -> Evaluation:
    """Errors of an estimate after laying its positions on the true ones.

    ``distance_m`` is the way over which relative poses are compared: 1 by default, or a tenth of
    the way if that is shorter than 2.

    Raises
    ------
    ValueError
        If fewer than three frames are in both, an option is out of range, or one of the cameras
        stands still where a scale is to be fitted.
    """
    if distance_m is not None and not 0 < distance_m < np.inf:
        raise ValueError(f"distance_m must be positive, got {distance_m}")
    if not max_gap_s >= 0:
        raise ValueError(f"max_gap_s must be 0 or more, got {max_gap_s}")
    rows, truth_rows = matching_frames(estimate, truth, max_gap_s)
    if len(rows) < 3:
        raise ValueError(
            f"{len(rows)} of {len(truth)} true frames are in the estimate, expected 3 or more: "
            + _why_so_few(estimate, truth, max_gap_s)
        )
    true_frames, found = truth.rows(truth_rows), estimate.rows(rows)
    moves = _moves(true_frames)
    if alignment == "sim3" and not moves:
        raise ValueError("the truth stays in one place: it gives no scale; use --align se3")
    similarity = align(found.positions, true_frames.positions, alignment)
    found = similarity.of(found)
    path_m = true_frames.path_length()
    if distance_m is None:
        distance_m = path_m / 10 if moves and path_m < 2 * DISTANCE_M else DISTANCE_M
    following = np.stack([np.arange(len(rows) - 1), np.arange(1, len(rows))], axis=1)
    return Evaluation(
        truth=true_frames,
        estimate=found,
        alignment=alignment,
        similarity=similarity,
        num_truth=len(truth),
        num_estimate=len(estimate),
        position_errors_m=np.linalg.norm(found.positions - true_frames.positions, axis=1),
        rotation_errors_deg=_angles_deg(_transposed(true_frames.rotations) @ found.rotations),
        orientation_errors_deg=_orientation_errors_deg(found, true_frames, alignment),
        steps=_pair_errors(found, true_frames, following),
        distance_m=distance_m,
        stretches=_pair_errors(found, true_frames, _stretches(true_frames, distance_m)),
    )


def _moves(truth: PosedFrames) -> bool:
    away = np.abs(truth.positions - truth.positions[0]).max()
    return bool(away > 1e-9 * max(1.0, np.abs(truth.positions).max()))


def _orientation_errors_deg(
    estimate: PosedFrames, truth: PosedFrames, alignment: Alignment
) -> Floats:
    turn = np.eye(3)
    if alignment != "none":
        u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", truth.rotations, estimate.rotations))
        turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return _angles_deg(_transposed(truth.rotations) @ turn @ estimate.rotations)


def _why_so_few(estimate: PosedFrames, truth: PosedFrames, max_gap_s: float) -> str:
    if estimate.times_s is not None and truth.times_s is not None:
        spans = [f"{times[0]:g} to {times[-1]:g} s" for times in (estimate.times_s, truth.times_s)]
        return (
            f"the estimate has times from {spans[0]}, the truth from {spans[1]}, and {max_gap_s:g} "
            "s apart counts as one (--max-gap-s)"
        )
    return (
        f"the names differ, such as {estimate.names[0]} and {truth.names[0]}; where one side has "
        "times, --frames gives the times of the other's names"
    )


def _stretches(truth: PosedFrames, distance_m: float) -> NDArray[np.intp]:
    """Each frame with the first one that is so far ahead on the way, (K, 2)."""
    way = _way(truth)
    # A camera that moves evenly reaches the distance up to rounding.
    ends = np.searchsorted(way, way + distance_m * (1 - 1e-9))
    starts = np.flatnonzero(ends < len(way))
    return np.stack([starts, ends[starts]], axis=1).astype(np.intp)


def _way(frames: PosedFrames) -> Floats:
    steps = np.linalg.norm(np.diff(frames.positions, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _pair_errors(estimate: PosedFrames, truth: PosedFrames, pairs: NDArray[np.intp]) -> PairErrors:
    first, second = pairs.T
    way = _way(truth)
    rotations, translations = _motions(estimate, first, second)
    true_rotations, true_translations = _motions(truth, first, second)
    # (true motion)^-1 * (estimated motion), as the RPE of Sturm et al.
    difference = _transposed(true_rotations) @ rotations
    return PairErrors(
        pairs,
        way[second] - way[first],
        np.linalg.norm(translations - true_translations, axis=1),
        _angles_deg(difference),
        _direction_errors_deg(estimate, truth, first, second),
    )


def _motions(
    frames: PosedFrames, first: NDArray[np.intp], second: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Rotations (K, 3, 3) and translations (K, 3) of cam1_from_cam2."""
    back = _transposed(frames.rotations[first])
    moves = frames.positions[second] - frames.positions[first]
    return back @ frames.rotations[second], np.einsum("kij,kj->ki", back, moves)


def _direction_errors_deg(
    estimate: PosedFrames, truth: PosedFrames, first: NDArray[np.intp], second: NDArray[np.intp]
) -> Floats:
    """Angle between the translations of cam2_from_cam1, which eq. 16 compares."""
    _, a = _motions(estimate, second, first)
    _, b = _motions(truth, second, first)
    angles = np.degrees(angles_between(a, b))
    lengths = np.minimum(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
    return np.where(lengths > 1e-12, angles, np.nan)


def _transposed(rotations: Floats) -> Floats:
    return rotations.transpose(0, 2, 1)


def _angles_deg(rotations: Floats) -> Floats:
    """Angle of each rotation (K, 3, 3), exact for small and for large ones."""
    skew = rotations - _transposed(rotations)
    sine = 0.5 * np.linalg.norm(skew[:, [2, 0, 1], [1, 2, 0]], axis=1)
    cosine = 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0)
    angles: Floats = np.degrees(np.arctan2(sine, cosine))
    return angles
