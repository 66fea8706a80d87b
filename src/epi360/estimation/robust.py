# SPDX-License-Identifier: BSD-3-Clause
"""The robust estimator: matches with outliers in, a pose with its evidence and verdict out."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import index
from typing import Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360 import _core
from epi360.epipolar.arguments import direction_array, jacobians_array, weights_array
from epi360.epipolar.residuals import RESIDUALS
from epi360.estimation.result import RelativePoseResult
from epi360.estimation.verdict import Found, result_of

Array = NDArray[np.float64]
Threshold = float | Literal["auto"]


@dataclass(frozen=True)
class RansacOptions:
    """How the sampling runs.

    Parameters
    ----------
    minimal_solver : str
        "five_point" (Nistér 2004) or "eight_point".
    min_iterations, max_iterations : int
        Limits on the minimal samples of all rounds together.
    confidence : float
        Probability that at least one sample without outliers was drawn when sampling stops. Local
        optimisation makes use of samples with an outlier too, so that more succeed.
    min_num_inliers : int
        Support under which a pose is not believed, whatever its odds.
    """

    minimal_solver: Literal["five_point", "eight_point"] = "five_point"
    min_iterations: int = 20
    max_iterations: int = 10000
    confidence: float = 0.99
    min_num_inliers: int = 6

    def __post_init__(self) -> None:
        """Check all options.

        Raises
        ------
        ValueError
            If one is out of its range.
        """
        if self.minimal_solver not in ("five_point", "eight_point"):
            raise ValueError(
                f"minimal_solver must be five_point or eight_point, got {self.minimal_solver!r}"
            )
        for name in ("min_iterations", "max_iterations", "min_num_inliers"):
            if not isinstance(getattr(self, name), (int, np.integer)):
                raise ValueError(f"{name} must be an integer, got {getattr(self, name)!r}")
        if not 1 <= self.min_iterations <= self.max_iterations:
            raise ValueError(
                "1 <= min_iterations <= max_iterations must hold, got "
                f"{self.min_iterations} and {self.max_iterations}"
            )
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"confidence must be between 0 and 1, got {self.confidence}")
        if self.min_num_inliers < 5:
            raise ValueError(f"min_num_inliers must be at least 5, got {self.min_num_inliers}")


def estimate_relative_pose(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    *,
    inlier_threshold_deg: Threshold = "auto",
    inlier_threshold_px: float | None = None,
    residual: str = "sampson",
    jacobians1: ArrayLike | None = None,
    jacobians2: ArrayLike | None = None,
    match_scores: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    gravity1: ArrayLike | None = None,
    gravity2: ArrayLike | None = None,
    options: RansacOptions = RansacOptions(),  # noqa: B008 - frozen
    seed: int = 0,
) -> RelativePoseResult:
    """Relative pose from matches of which many may be wrong.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (M, 3)
        Bearings of any length in both cameras, row i of both is one match; a row with NaN in either
        is missing data.
    inlier_threshold_deg : float or "auto"
        Gate on the residual's angle in degrees; "auto" estimates the noise and gates at the angle
        where a match is as likely right as wrong.
    inlier_threshold_px : float, optional
        The gate in pixels instead; needs residual "tangent_sampson".
    residual : str
        "sampson", "angular", "paper", or "tangent_sampson" with the Jacobians.
    jacobians1, jacobians2 : array_like, shape (M, 3, 2), optional
        Derivative of each bearing by its pixel: respects the pixel noise of any camera.
    match_scores : array_like, shape (M,), optional
        How good each match looks, higher is better (a ratio test's: minus the ratio): the best are
        sampled first. Scores order the search; they do not weigh the answer.
    weights : array_like, shape (M,), optional
        Of the matches, relative to one another.
    gravity1, gravity2 : array_like, shape (3,), optional
        Direction of gravity (down) in both cameras, good to a few degrees: three matches make a
        sample then. The answer is refined freely; where it contradicts gravity by more than
        15 degrees, the search is done again without.
    options : RansacOptions
        How the sampling runs.
    seed : int
        Of the sampling; the same input and seed give the same result.

    Returns
    -------
    result : RelativePoseResult
        With ``status`` other than "ok" where the matches do not support one pose.

    Raises
    ------
    ValueError
        If an array has a wrong shape, an infinite or a zero bearing, or an option is unknown.

    Notes
    -----
    Five-point samples (Nistér 2004), or upright three-point samples (Fraundorfer et al. 2010),
    drawn in the order of the scores (PROSAC, Chum & Matas 2005), whose points lie in front of both
    cameras are scored by a truncated cost that counts depths (MSAC, Torr & Zisserman 2000), over
    four scales while the noise is unknown. Good hypotheses are refined over SO(3) x S^2 to the most
    likely pose under Gaussian inliers, near misses and uniform outliers, whose scale and shares are
    estimated along; the most likely wins. The verdict asks whether a rotation explains the matches
    as well, whether chance would, whether another pose does, and whether the inliers are one patch
    among matches from everywhere.
    """
    arrays = _Arrays()
    arrays.append(
        bearings1, bearings2, weights, match_scores, jacobians1, jacobians2, gravity1, gravity2
    )
    return _estimate(arrays, inlier_threshold_deg, inlier_threshold_px, residual, options, seed, 1)[
        0
    ]


def estimate_relative_poses(
    bearings1: ArrayLike | Iterable[tuple[ArrayLike, ArrayLike]],
    bearings2: ArrayLike | None = None,
    *,
    offsets: ArrayLike | None = None,
    num_threads: int | None = None,
    inlier_threshold_deg: Threshold = "auto",
    residual: str = "sampson",
    match_scores: Sequence[ArrayLike] | ArrayLike | None = None,
    weights: Sequence[ArrayLike] | ArrayLike | None = None,
    options: RansacOptions = RansacOptions(),  # noqa: B008 - frozen
    seed: int = 0,
) -> list[RelativePoseResult]:
    """Relative poses of many pairs of views, on native threads.

    Parameters
    ----------
    bearings1 : iterable of (bearings1, bearings2), or array_like, shape (N, 3)
        One pair of arrays (M, 3) for each pair of views; or the bearings of view 1 of all pairs,
        one pair after the other, with `bearings2` and `offsets`.
    bearings2 : array_like, shape (N, 3), optional
        The bearings of view 2 of all pairs.
    offsets : array_like, shape (P + 1,), int, optional
        Pair k has the rows offsets[k] to offsets[k + 1]; the first is 0, the last N.
    num_threads : int, optional
        By default one per core; the results do not depend on it.
    inlier_threshold_deg : float or "auto"
        As in `estimate_relative_pose`, as are the other options.
    residual : str
        "sampson", "angular" or "paper".
    match_scores, weights : sequence of array_like, or array_like, shape (N,), optional
        One array for each pair; with `offsets` one array for all.
    options : RansacOptions
        How the sampling runs.
    seed : int
        Each pair's result is that of `estimate_relative_pose` with this seed.

    Returns
    -------
    results : list of RelativePoseResult
        One for each pair, in order.

    Raises
    ------
    ValueError
        If an array has a wrong shape, an infinite or a zero bearing (the message names the pair),
        or an option is unknown.
    """
    if residual == "tangent_sampson":
        raise ValueError(
            "residual must be sampson, angular or paper, got 'tangent_sampson'; its Jacobians go "
            "with estimate_relative_pose"
        )
    arrays = _Arrays()
    if offsets is None:
        if bearings2 is not None:
            raise ValueError("bearings2 needs offsets; without them give pairs of arrays")
        pairs = _listed(bearings1)
        scores_of = _per_pair(match_scores, len(pairs), "match_scores")
        weights_of = _per_pair(weights, len(pairs), "weights")
    else:
        pairs, scores_of, weights_of = _cut(bearings1, bearings2, offsets, match_scores, weights)
    for k, pair in enumerate(pairs):
        try:
            b1, b2 = pair
            arrays.append(b1, b2, weights_of[k], scores_of[k])
        except (TypeError, ValueError) as error:
            raise ValueError(f"pair {k}: {error}") from None
    threads = _num_threads(num_threads)
    return _estimate(arrays, inlier_threshold_deg, None, residual, options, seed, threads)


def check_threshold(inlier_threshold_deg: float | str) -> float:
    """Return a threshold in radians, 0 for "auto".

    Parameters
    ----------
    inlier_threshold_deg : float or "auto"
        Degrees in (0, 45].

    Raises
    ------
    ValueError
        If it is neither.
    """
    if inlier_threshold_deg == "auto":
        return 0.0
    try:
        degrees = float(inlier_threshold_deg)
    except (TypeError, ValueError):
        degrees = np.nan
    if not 0.0 < degrees <= 45.0:
        raise ValueError(
            f'inlier_threshold_deg must be "auto" or in (0, 45], got {inlier_threshold_deg!r}'
        )
    return float(np.radians(degrees))


class _Arrays:
    """Arrays of all pairs as the native core takes them; what nobody gave stays empty."""

    def __init__(self) -> None:
        self.bearings1: list[Array] = []
        self.bearings2: list[Array] = []
        self.weights: list[Array] = []
        self.scores: list[Array] = []
        self.jacobians1: list[Array] = []
        self.jacobians2: list[Array] = []
        self.gravity1: list[Array] = []
        self.gravity2: list[Array] = []

    def append(
        self,
        bearings1: ArrayLike,
        bearings2: ArrayLike,
        weights: ArrayLike | None = None,
        scores: ArrayLike | None = None,
        jacobians1: ArrayLike | None = None,
        jacobians2: ArrayLike | None = None,
        gravity1: ArrayLike | None = None,
        gravity2: ArrayLike | None = None,
    ) -> None:
        b1 = _rows(bearings1, "bearings1")
        b2 = _rows(bearings2, "bearings2")
        if len(b1) != len(b2):
            raise ValueError(
                f"bearings1 and bearings2 must have the same length, got {len(b1)} and {len(b2)}"
            )
        if (gravity1 is None) != (gravity2 is None):
            raise ValueError("gravity1 and gravity2 must be given together, got only one")
        self.bearings1.append(b1)
        self.bearings2.append(b2)
        for kept, given in (
            (self.weights, weights_array(weights, len(b1))),
            (self.scores, _scores(scores, len(b1))),
            (self.jacobians1, jacobians_array(jacobians1, len(b1), "jacobians1")),
            (self.jacobians2, jacobians_array(jacobians2, len(b1), "jacobians2")),
            (self.gravity1, None if gravity1 is None else direction_array(gravity1, "gravity1")),
            (self.gravity2, None if gravity2 is None else direction_array(gravity2, "gravity2")),
        ):
            if given is not None:
                kept.append(given)


def _estimate(
    arrays: _Arrays,
    inlier_threshold_deg: Threshold,
    inlier_threshold_px: float | None,
    residual: str,
    options: RansacOptions,
    seed: int,
    num_threads: int,
) -> list[RelativePoseResult]:
    if residual not in RESIDUALS or residual == "solarte2021":
        names = ", ".join(name for name in RESIDUALS if name != "solarte2021")
        raise ValueError(f"residual must be one of {names}, got {residual!r}")
    uses_pixels = residual == "tangent_sampson"
    if uses_pixels and not (arrays.jacobians1 and arrays.jacobians2):
        raise ValueError("residual tangent_sampson needs jacobians1 and jacobians2")
    threshold = check_threshold(inlier_threshold_deg)
    if inlier_threshold_px is not None:
        threshold = _checked_pixels(inlier_threshold_px, threshold, uses_pixels)
    answers = _core.estimate_relative_poses(
        arrays.bearings1,
        arrays.bearings2,
        residual=residual,
        threshold=threshold,
        threshold_in_pixels=inlier_threshold_px is not None,
        sample_size=8 if options.minimal_solver == "eight_point" else 5,
        min_iterations=options.min_iterations,
        max_iterations=options.max_iterations,
        confidence=options.confidence,
        seed=index(seed) % 2**64,
        num_threads=num_threads,
        weights=arrays.weights,
        scores=arrays.scores,
        jacobians1=arrays.jacobians1 if uses_pixels else [],
        jacobians2=arrays.jacobians2 if uses_pixels else [],
        gravity1=arrays.gravity1,
        gravity2=arrays.gravity2,
    )
    if isinstance(answers, tuple):
        _raise_bad_row(*answers, num_pairs=len(arrays.bearings1))
    return [result_of(Found(*answer), residual, options.min_num_inliers) for answer in answers]


def _raise_bad_row(pair: int, view: int, row: int, infinite: bool, *, num_pairs: int) -> NoReturn:
    must = "be finite" if infinite else "have non-zero length"
    what = "infinite" if infinite else "zero"
    where = f"pair {pair}: " if num_pairs > 1 else ""
    raise ValueError(
        f"{where}bearings{view} must {must} (NaN marks a missing row), row {row} is {what}"
    )


def _rows(bearings: ArrayLike, name: str) -> Array:
    array = np.ascontiguousarray(bearings, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (N, 3), got {array.shape}")
    return array


def _scores(scores: ArrayLike | None, num_matches: int) -> Array | None:
    if scores is None:
        return None
    array = np.asarray(scores, dtype=np.float64, order="C")
    if array.shape != (num_matches,):
        raise ValueError(f"match_scores must have shape ({num_matches},), got {array.shape}")
    return array


def _checked_pixels(pixels: float, threshold_rad: float, uses_pixels: bool) -> float:
    if not uses_pixels:
        raise ValueError(
            'inlier_threshold_px needs residual="tangent_sampson" with jacobians1 and jacobians2'
        )
    if threshold_rad:
        raise ValueError("give inlier_threshold_deg or inlier_threshold_px, not both")
    try:
        threshold = float(pixels)
    except (TypeError, ValueError):
        threshold = np.nan
    if not (np.isfinite(threshold) and threshold > 0.0):
        raise ValueError(f"inlier_threshold_px must be a positive number, got {pixels!r}")
    return threshold


def _num_threads(num_threads: int | None) -> int:
    if num_threads is None:
        return (
            len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else (os.cpu_count() or 1)
        )
    if not isinstance(num_threads, (int, np.integer)) or num_threads < 1:
        raise ValueError(f"num_threads must be a positive integer, got {num_threads!r}")
    return int(num_threads)


def _listed(pairs: object) -> list[tuple[ArrayLike, ArrayLike]]:
    if not isinstance(pairs, Iterable):
        raise ValueError(f"pairs must be a sequence of (bearings1, bearings2), got {pairs!r}")
    return list(pairs)


def _per_pair(
    values: Sequence[ArrayLike] | ArrayLike | None, num_pairs: int, name: str
) -> list[ArrayLike | None]:
    if values is None:
        return [None] * num_pairs
    listed: list[ArrayLike | None] = list(values)  # type: ignore[arg-type]
    if len(listed) != num_pairs:
        raise ValueError(
            f"{name} must have one array for each of {num_pairs} pairs, got {len(listed)}"
        )
    for k, array in enumerate(listed):
        if array is None:
            raise ValueError(f"{name} must have an array for every pair or none, pair {k} has none")
    return listed


def _cut(
    bearings1: object,
    bearings2: ArrayLike | None,
    offsets: ArrayLike,
    scores: object,
    weights: object,
) -> tuple[list[tuple[ArrayLike, ArrayLike]], list[ArrayLike | None], list[ArrayLike | None]]:
    """Pairs, scores and weights out of concatenated arrays."""
    if bearings2 is None:
        raise ValueError("offsets need bearings1 and bearings2 as two arrays of shape (N, 3)")
    b1, b2 = _rows(bearings1, "bearings1"), _rows(bearings2, "bearings2")  # type: ignore[arg-type]
    cuts = np.asarray(offsets)
    if cuts.ndim != 1 or not len(cuts) or not np.issubdtype(cuts.dtype, np.integer):
        raise ValueError(
            f"offsets must be integers of shape (P + 1,), got {cuts.dtype} {cuts.shape}"
        )
    if cuts[0] != 0 or cuts[-1] != len(b1) or (np.diff(cuts) < 0).any() or len(b2) != len(b1):
        raise ValueError(
            "offsets must rise from 0 to the length of bearings1 and bearings2, got "
            f"{cuts[0]} to {cuts[-1]} for {len(b1)} and {len(b2)} rows"
        )
    all_scores = _scores(scores, len(b1))  # type: ignore[arg-type]
    all_weights = weights_array(weights, len(b1))  # type: ignore[arg-type]
    parts = [slice(int(a), int(b)) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
    return (
        [(b1[part], b2[part]) for part in parts],
        [None if all_scores is None else all_scores[part] for part in parts],
        [None if all_weights is None else all_weights[part] for part in parts],
    )
