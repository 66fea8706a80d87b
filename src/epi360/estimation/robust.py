# SPDX-License-Identifier: BSD-3-Clause
"""The robust estimator: matches with outliers in, a pose with its evidence and verdict out."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import index
from typing import Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from epi360 import _core
from epi360.epipolar.residuals import RESIDUALS
from epi360.estimation.pair_arrays import cut_pairs, listed_pairs, native_pair, values_per_pair
from epi360.estimation.result import RelativePoseResult
from epi360.estimation.verdict import result_of

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
    gravity_sigma_deg: float = 1.0,
    elevation_sigma_deg: float | None = None,
    max_noise_deg: float | None = None,
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
        Direction of gravity (down) in both cameras: three matches make a sample then, all upright
        poses are tried where samples do not suffice, and a pose is less probable the more it tilts
        gravity. Where no upright pose is found, the search is done again without gravity.
    gravity_sigma_deg : float
        Standard deviation of the directions of gravity, per axis and view.
    elevation_sigma_deg : float, optional
        Standard deviation of the translation's angle over the horizon, where the cameras are known
        to have moved at one height, as on a tripod; needs gravity.
    max_noise_deg : float, optional
        Noise of the bearings (one sigma) from which on an "ok" result carries a warning.
    options : RansacOptions
        How the sampling runs.
    seed : int
        Random seed of the sampling; the same input and seed give the same result.

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
    uses_pixels = residual == "tangent_sampson"
    if uses_pixels and (jacobians1 is None or jacobians2 is None):
        raise ValueError("residual tangent_sampson needs jacobians1 and jacobians2")
    sigmas = _prior_sigmas(gravity_sigma_deg, elevation_sigma_deg)
    pair = native_pair(
        bearings1,
        bearings2,
        weights=weights,
        scores=match_scores,
        jacobians=(jacobians1, jacobians2),
        uses_jacobians=uses_pixels,
        gravity=(gravity1, gravity2),
        gravity_sigma=sigmas[0],
        elevation_sigma=sigmas[1],
        seed=index(seed),
        max_noise=_checked_noise(max_noise_deg),
    )
    threshold = inlier_threshold_deg, inlier_threshold_px
    (answer,) = _estimate([pair], *threshold, residual, options, 1)
    return result_of(answer, residual)


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
    gravity1: Sequence[ArrayLike | None] | ArrayLike | None = None,
    gravity2: Sequence[ArrayLike | None] | ArrayLike | None = None,
    gravity_sigma_deg: float = 1.0,
    elevation_sigma_deg: float | None = None,
    max_noise_deg: float | Sequence[float] | None = None,
    options: RansacOptions = RansacOptions(),  # noqa: B008 - frozen
    seed: int | Sequence[int] = 0,
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
    gravity1, gravity2 : array_like, shape (3,) or (P, 3), or sequence of such or None, optional
        One direction for all pairs, or one for each; None where it is not known.
    gravity_sigma_deg : float
        Standard deviation of the directions of gravity, per axis and view.
    elevation_sigma_deg : float, optional
        As in `estimate_relative_pose`.
    max_noise_deg : float or sequence of float, optional
        One for all pairs, or one for each.
    options : RansacOptions
        How the sampling runs.
    seed : int or sequence of int
        Each pair's result is that of `estimate_relative_pose` with this seed; one for all pairs, or
        one for each.

    Returns
    -------
    results : list of RelativePoseResult
        One for each pair, in order.

    Raises
    ------
    ValueError
        If an array has a wrong shape, an infinite or a zero bearing (the message names the pair),
        an option is unknown, or there is not one seed for each pair.
    """
    if residual == "tangent_sampson":
        raise ValueError(
            "residual must be sampson, angular or paper, got 'tangent_sampson'; its Jacobians go "
            "with estimate_relative_pose"
        )
    if offsets is None:
        if bearings2 is not None:
            raise ValueError("bearings2 needs offsets; without them give pairs of arrays")
        pairs = listed_pairs(bearings1)
        scores_of = values_per_pair(match_scores, len(pairs), "match_scores")
        weights_of = values_per_pair(weights, len(pairs), "weights")
    else:
        pairs, scores_of, weights_of = cut_pairs(
            bearings1, bearings2, offsets, match_scores, weights
        )
    seeds = _seeds(seed, len(pairs))
    limits = _noise_limits(max_noise_deg, len(pairs))
    gravity1_of = _directions(gravity1, len(pairs), "gravity1")
    gravity2_of = _directions(gravity2, len(pairs), "gravity2")
    sigmas = _prior_sigmas(gravity_sigma_deg, elevation_sigma_deg)
    native = []
    for k, pair in enumerate(pairs):
        try:
            b1, b2 = pair
            native.append(
                native_pair(
                    b1,
                    b2,
                    weights=weights_of[k],
                    scores=scores_of[k],
                    gravity=(gravity1_of[k], gravity2_of[k]),
                    gravity_sigma=sigmas[0],
                    elevation_sigma=sigmas[1],
                    seed=seeds[k],
                    max_noise=limits[k],
                )
            )
        except (TypeError, ValueError) as error:
            raise ValueError(f"pair {k}: {error}") from None
    threads = _num_threads(num_threads)
    answers = _estimate(native, inlier_threshold_deg, None, residual, options, threads)
    return [result_of(answer, residual) for answer in answers]


def estimate_timed_poses(
    bearings1: Sequence[ArrayLike],
    bearings2: Sequence[ArrayLike],
    *,
    num_threads: int | None,
    options: RansacOptions,
    seeds: Sequence[int],
) -> tuple[list[RelativePoseResult], list[float]]:
    """Relative poses of many pairs, and the time that each of them took.

    Parameters
    ----------
    bearings1, bearings2 : sequence of array_like, shape (M, 3)
        One array for each pair.
    num_threads : int, optional
        By default one per core; the results do not depend on it.
    options : RansacOptions
        How the sampling runs.
    seeds : sequence of int
        One for each pair.

    Returns
    -------
    results : list of RelativePoseResult
        Those of `estimate_relative_poses`.
    seconds : list of float
        Wall time of each estimate on its thread.

    Raises
    ------
    ValueError
        As `estimate_relative_poses`.
    """
    pairs = [
        native_pair(b1, b2, seed=seed)
        for b1, b2, seed in zip(bearings1, bearings2, _seeds(seeds, len(bearings1)), strict=True)
    ]
    answers = _estimate(pairs, "auto", None, "sampson", options, _num_threads(num_threads))
    return [result_of(answer, "sampson") for answer in answers], [
        answer.seconds for answer in answers
    ]


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


def _estimate(
    pairs: list[_core.Pair],
    inlier_threshold_deg: Threshold,
    inlier_threshold_px: float | None,
    residual: str,
    options: RansacOptions,
    num_threads: int,
) -> list[_core.PairResult]:
    if residual not in RESIDUALS or residual == "solarte2021":
        names = ", ".join(name for name in RESIDUALS if name != "solarte2021")
        raise ValueError(f"residual must be one of {names}, got {residual!r}")
    threshold = check_threshold(inlier_threshold_deg)
    if inlier_threshold_px is not None:
        uses_pixels = residual == "tangent_sampson"
        threshold = _checked_pixels(inlier_threshold_px, threshold, uses_pixels)
    answers = _core.estimate_relative_poses(
        pairs,
        residual=residual,
        threshold=threshold,
        threshold_in_pixels=inlier_threshold_px is not None,
        sample_size=8 if options.minimal_solver == "eight_point" else 5,
        min_iterations=options.min_iterations,
        max_iterations=options.max_iterations,
        confidence=options.confidence,
        min_num_inliers=options.min_num_inliers,
        num_threads=num_threads,
    )
    for k, answer in enumerate(answers):
        view, row, is_infinite = answer.bad_row
        if view:
            _raise_bad_row(k, view, row, is_infinite, num_pairs=len(pairs))
    return answers


def _raise_bad_row(pair: int, view: int, row: int, infinite: bool, *, num_pairs: int) -> NoReturn:
    must = "be finite" if infinite else "have non-zero length"
    what = "infinite" if infinite else "zero"
    where = f"pair {pair}: " if num_pairs > 1 else ""
    raise ValueError(
        f"{where}bearings{view} must {must} (NaN marks a missing row), row {row} is {what}"
    )


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


def _seeds(seed: int | Sequence[int], num_pairs: int) -> list[int]:
    if not isinstance(seed, Sequence | np.ndarray):
        return [index(seed)] * num_pairs
    if len(seed) != num_pairs:
        raise ValueError(f"seed must be one for each of {num_pairs} pairs, got {len(seed)}")
    return [index(each) for each in seed]


def _prior_sigmas(
    gravity_sigma_deg: float, elevation_sigma_deg: float | None
) -> tuple[float, float]:
    """Return both in radians, 0 where the elevation may be any."""
    given = {"gravity_sigma_deg": gravity_sigma_deg}
    if elevation_sigma_deg is not None:
        given["elevation_sigma_deg"] = elevation_sigma_deg
    for name, degrees in given.items():
        if not (np.isreal(degrees) and 0.0 < float(degrees) <= 90.0):
            raise ValueError(f"{name} must be in (0, 90], got {degrees!r}")
    elevation_deg = given.get("elevation_sigma_deg", 0.0)
    return float(np.radians(gravity_sigma_deg)), float(np.radians(elevation_deg))


def _directions(
    gravity: Sequence[ArrayLike | None] | ArrayLike | None, num_pairs: int, name: str
) -> Sequence[ArrayLike | None]:
    """Return one direction for each pair, None where it is not known."""
    if gravity is None:
        return [None] * num_pairs
    each: list[ArrayLike | None] = list(gravity)  # type: ignore[arg-type]
    if len(each) == 3 and np.ndim(gravity) == 1:  # type: ignore[arg-type]
        return [gravity] * num_pairs  # type: ignore[list-item]
    if len(each) != num_pairs:
        raise ValueError(
            f"{name} must be one direction, or one for each of {num_pairs} pairs, got {len(each)}"
        )
    return each


def _checked_noise(max_noise_deg: float | None) -> float:
    """Return a limit in radians, 0 for none."""
    if max_noise_deg is None:
        return 0.0
    try:
        degrees = float(max_noise_deg)
    except (TypeError, ValueError):
        degrees = np.nan
    if not (np.isfinite(degrees) and degrees > 0.0):
        raise ValueError(f"max_noise_deg must be a positive number or None, got {max_noise_deg!r}")
    return float(np.radians(degrees))


def _noise_limits(max_noise_deg: float | Sequence[float] | None, num_pairs: int) -> list[float]:
    if not isinstance(max_noise_deg, Sequence | np.ndarray) or isinstance(max_noise_deg, str):
        return [_checked_noise(max_noise_deg)] * num_pairs
    if len(max_noise_deg) != num_pairs:
        raise ValueError(
            f"max_noise_deg must be one for each of {num_pairs} pairs, got {len(max_noise_deg)}"
        )
    return [_checked_noise(each) for each in max_noise_deg]


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
