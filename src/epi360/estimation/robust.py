# SPDX-License-Identifier: BSD-3-Clause
"""The robust estimator: matches with outliers in, a pose with its evidence and verdict out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NoReturn

from numpy.typing import ArrayLike

from epi360 import _core
from epi360.epipolar.residuals import RESIDUALS
from epi360.estimation.options import (
    RansacOptions,
    Threshold,
    check_threshold,
    checked_integer,
    checked_noises,
    checked_pixels,
    direction_of_each,
    noise_limits,
    prior_sigmas,
    seed_of_each,
    thread_count,
)
from epi360.estimation.pair_arrays import cut_pairs, listed_pairs, native_pair, values_per_pair
from epi360.estimation.result import RelativePoseResult
from epi360.estimation.separate_things import with_doubt_of_things
from epi360.estimation.verdict import result_of


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
    min_noise_deg: float | None = None,
    max_noise_deg: float | None = None,
    options: RansacOptions = RansacOptions(),  # noqa: B008 - frozen
    seed: int = 0,
) -> RelativePoseResult:
    """Relative pose from matches of which many may be wrong.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (M, 3)
        Bearings of any length in both cameras, row i of both is one match; a row with NaN in either
        is missing data. Where more than a quarter of the rows repeat others, these count once.
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
        How much each match counts beside the others; only their ratios matter. Two matches say more
        than one of weight 2. One that weighs less than a millionth of the heaviest is left out.
    gravity1, gravity2 : array_like, shape (3,), optional
        Direction of gravity (down) in both cameras: three matches make a sample then, all upright
        poses are tried where samples do not suffice, and a pose is less probable the more it tilts
        gravity. Where no upright pose is found, the search is done again without gravity.
    gravity_sigma_deg : float
        Standard deviation of the directions of gravity, per axis and view.
    elevation_sigma_deg : float, optional
        Standard deviation of the translation's angle over the horizon, where the cameras are known
        to have moved at one height, as on a tripod; needs gravity.
    min_noise_deg : float, optional
        What the noise of the bearings (one sigma) is at least. Key points of pictures are no better
        than a twentieth of a pixel; the few that agree much better with a pose do so by chance.
    max_noise_deg : float, optional
        Noise of the bearings (one sigma) from which on an "ok" result carries a warning; its
        probability falls, and from three times as much on it is refused (``too_few_inliers``). The
        search does not end with such a pose: a right one may be hidden that fewer matches agree
        with.
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
    sigmas = prior_sigmas(gravity_sigma_deg, elevation_sigma_deg, has_gravity=gravity1 is not None)
    noises = checked_noises(min_noise_deg, max_noise_deg)
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
        seed=checked_integer(seed, "seed"),
        min_noise=noises[0],
        max_noise=noises[1],
    )
    threshold = inlier_threshold_deg, inlier_threshold_px
    answers = _estimate([pair], *threshold, residual, options, 1)
    (result,) = _results([(bearings1, bearings2)], answers)
    return result


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
    min_noise_deg: float | Sequence[float] | None = None,
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
    min_noise_deg, max_noise_deg : float or sequence of float, optional
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
            raise ValueError(
                "bearings2 must come with offsets; without them give a list of pairs, "
                "[(bearings1, bearings2), ...]"
            )
        pairs = listed_pairs(bearings1)
        scores_of = values_per_pair(match_scores, len(pairs), "match_scores")
        weights_of = values_per_pair(weights, len(pairs), "weights")
    else:
        pairs, scores_of, weights_of = cut_pairs(
            bearings1, bearings2, offsets, match_scores, weights
        )
    seeds = seed_of_each(seed, len(pairs))
    limits = noise_limits(min_noise_deg, max_noise_deg, len(pairs))
    gravity1_of = direction_of_each(gravity1, len(pairs), "gravity1")
    gravity2_of = direction_of_each(gravity2, len(pairs), "gravity2")
    sigmas = prior_sigmas(gravity_sigma_deg, elevation_sigma_deg, has_gravity=gravity1 is not None)
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
                    min_noise=limits[k][0],
                    max_noise=limits[k][1],
                )
            )
        except (TypeError, ValueError) as error:
            raise ValueError(f"pair {k}: {error}") from None
    threads = thread_count(num_threads)
    answers = _estimate(native, inlier_threshold_deg, None, residual, options, threads)
    return _results(pairs, answers)


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
    checked = seed_of_each(seeds, len(bearings1))
    views = list(zip(bearings1, bearings2, strict=True))
    pairs = [native_pair(*pair, seed=seed) for pair, seed in zip(views, checked, strict=True)]
    answers = _estimate(pairs, "auto", None, "sampson", options, thread_count(num_threads))
    return _results(views, answers), [answer.seconds for answer in answers]


def _results(
    pairs: Sequence[tuple[ArrayLike, ArrayLike]], answers: Sequence[_core.PairResult]
) -> list[RelativePoseResult]:
    """What the answers of the core on these bearings say in the end."""
    return [
        with_doubt_of_things(result_of(answer), *pair)
        for answer, pair in zip(answers, pairs, strict=True)
    ]


def _estimate(
    pairs: list[_core.Pair],
    inlier_threshold_deg: Threshold,
    inlier_threshold_px: float | None,
    residual: str,
    options: RansacOptions,
    num_threads: int,
) -> list[_core.PairResult]:
    if not isinstance(options, RansacOptions):
        raise TypeError(f"options must be RansacOptions(...), got {type(options).__name__}")
    if residual not in RESIDUALS or residual == "solarte2021":
        names = ", ".join(name for name in RESIDUALS if name != "solarte2021")
        raise ValueError(f"residual must be one of {names}, got {residual!r}")
    threshold = check_threshold(inlier_threshold_deg)
    if inlier_threshold_px is not None:
        uses_pixels = residual == "tangent_sampson"
        threshold = checked_pixels(inlier_threshold_px, threshold, uses_pixels)
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
        shared_error=options.shared_error,
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
