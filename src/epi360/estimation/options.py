# SPDX-License-Identifier: BSD-3-Clause
"""Options of the robust estimator, checked and in radians."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from operator import index
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

Threshold = float | Literal["auto"]

MOST_ITERATIONS = 10_000_000  # half a minute of samples
_MOST_THREADS = 1024


@dataclass(frozen=True)
class RansacOptions:
    """How the sampling runs.

    Parameters
    ----------
    minimal_solver : str
        "five_point" (Nistér 2004) or "eight_point".
    min_iterations, max_iterations : int
        Limits on the minimal samples of all rounds together; at most ten million. A second pose
        is looked for with up to a quarter more.
    confidence : float
        Probability that at least one sample without outliers was drawn when sampling stops. Local
        optimisation makes use of samples with an outlier too, so that more succeed.
    min_num_inliers : int
        Support under which a pose is not believed, whatever its odds.
    shared_error : float
        Standard deviation of the error that neighbouring bearings have in common (stitching,
        calibration, rolling shutter), in units of the noise of one bearing. The covariance allows
        for at least so much, and for more where the residuals show it. Image pairs use 1.
    """

    minimal_solver: Literal["five_point", "eight_point"] = "five_point"
    min_iterations: int = 20
    max_iterations: int = 10000
    confidence: float = 0.99
    min_num_inliers: int = 6
    shared_error: float = 0.0

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
            object.__setattr__(self, name, checked_integer(getattr(self, name), name))
        if not 1 <= self.min_iterations <= self.max_iterations:
            raise ValueError(
                "1 <= min_iterations <= max_iterations must hold, got "
                f"{self.min_iterations} and {self.max_iterations}"
            )
        if self.max_iterations > MOST_ITERATIONS:
            raise ValueError(
                f"max_iterations must be at most {MOST_ITERATIONS}, got {self.max_iterations}"
            )
        confidence = number_or_nan(self.confidence)
        if not 0.0 < confidence < 1.0:
            raise ValueError(f"confidence must be between 0 and 1, got {self.confidence}")
        object.__setattr__(self, "confidence", confidence)
        if not 5 <= self.min_num_inliers < 2**31:
            raise ValueError(f"min_num_inliers must be at least 5, got {self.min_num_inliers}")
        shared = number_or_nan(self.shared_error)
        if not 0.0 <= shared <= 100.0:
            raise ValueError(f"shared_error must be in [0, 100], got {self.shared_error!r}")
        object.__setattr__(self, "shared_error", shared)


def checked_integer(value: object, name: str) -> int:
    """Return an integer, or an array of one integer as such."""
    try:
        return index(value)  # type: ignore[arg-type]
    except TypeError:
        raise ValueError(f"{name} must be an integer, got {value!r}") from None


def number_or_nan(value: object) -> float:
    """Return a number as float, NaN if it is none."""
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def _is_one_for_each(values: object) -> bool:
    """Whether these are several values: an array without a dimension is one."""
    is_array = isinstance(values, np.ndarray) and values.ndim > 0
    return is_array or (isinstance(values, Sequence) and not isinstance(values, str))


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
    degrees = number_or_nan(inlier_threshold_deg)
    if not 0.0 < degrees <= 45.0:
        raise ValueError(
            f'inlier_threshold_deg must be "auto" or in (0, 45], got {inlier_threshold_deg!r}'
        )
    return float(np.radians(degrees))


def checked_pixels(pixels: float, threshold_rad: float, uses_pixels: bool) -> float:
    """Return a threshold in pixels that goes with the other options."""
    if not uses_pixels:
        raise ValueError(
            'inlier_threshold_px needs residual="tangent_sampson" with jacobians1 and jacobians2'
        )
    if threshold_rad:
        raise ValueError("give inlier_threshold_deg or inlier_threshold_px, not both")
    threshold = number_or_nan(pixels)
    if not (np.isfinite(threshold) and threshold > 0.0):
        raise ValueError(f"inlier_threshold_px must be a positive number, got {pixels!r}")
    return threshold


def seed_of_each(seed: int | Sequence[int], num_pairs: int) -> list[int]:
    """Return the seed of each pair."""
    if not _is_one_for_each(seed):
        return [checked_integer(seed, "seed")] * num_pairs
    assert not isinstance(seed, int)
    if len(seed) != num_pairs:
        raise ValueError(f"seed must be one for each of {num_pairs} pairs, got {len(seed)}")
    return [checked_integer(each, "seed") for each in seed]


def prior_sigmas(
    gravity_sigma_deg: float, elevation_sigma_deg: float | None, *, has_gravity: bool
) -> tuple[float, float]:
    """Return both in radians, 0 where the elevation may be any."""
    given = {"gravity_sigma_deg": gravity_sigma_deg}
    if elevation_sigma_deg is not None:
        given["elevation_sigma_deg"] = elevation_sigma_deg
    for name, degrees in given.items():
        if not 1e-6 <= number_or_nan(degrees) <= 90.0:
            raise ValueError(f"{name} must be a number from 1e-6 to 90, got {degrees!r}")
    if elevation_sigma_deg is not None and not has_gravity:
        raise ValueError("elevation_sigma_deg needs gravity1 and gravity2")
    elevation_deg = given.get("elevation_sigma_deg", 0.0)
    return float(np.radians(gravity_sigma_deg)), float(np.radians(elevation_deg))


def direction_of_each(
    gravity: Sequence[ArrayLike | None] | ArrayLike | None, num_pairs: int, name: str
) -> Sequence[ArrayLike | None]:
    """Return one direction for each pair, None where it is not known."""
    if gravity is None:
        return [None] * num_pairs
    if not isinstance(gravity, Sequence | np.ndarray) or getattr(gravity, "ndim", 1) == 0:
        raise ValueError(f"{name} must be a direction, or one for each pair, got {gravity!r}")
    each: list[ArrayLike | None] = list(gravity)
    if len(each) == 3 and all(value is not None and np.ndim(value) == 0 for value in each):
        return [gravity] * num_pairs  # type: ignore[list-item]
    if len(each) != num_pairs:
        raise ValueError(
            f"{name} must be one direction, or one for each of {num_pairs} pairs, got {len(each)}"
        )
    return each


def checked_noise(noise_deg: float | None, name: str = "max_noise_deg") -> float:
    """Return a limit in radians, 0 for none; ``name`` is that of the argument."""
    if noise_deg is None:
        return 0.0
    degrees = number_or_nan(noise_deg)
    if not (np.isfinite(degrees) and degrees > 0.0):
        raise ValueError(f"{name} must be a positive number or None, got {noise_deg!r}")
    return float(np.radians(degrees))


def checked_noises(min_noise_deg: float | None, max_noise_deg: float | None) -> tuple[float, float]:
    """Return both limits in radians, 0 for none."""
    least = checked_noise(min_noise_deg, "min_noise_deg")
    most = checked_noise(max_noise_deg, "max_noise_deg")
    if 0.0 < most <= least:
        raise ValueError(
            f"min_noise_deg must be smaller than max_noise_deg, got {min_noise_deg} and "
            f"{max_noise_deg}"
        )
    return least, most


def noise_limits(
    min_noise_deg: float | Sequence[float] | None,
    max_noise_deg: float | Sequence[float] | None,
    num_pairs: int,
) -> list[tuple[float, float]]:
    """Return both limits of each pair in radians, 0 for none."""
    least = _noise_of_each(min_noise_deg, num_pairs, "min_noise_deg")
    most = _noise_of_each(max_noise_deg, num_pairs, "max_noise_deg")
    return list(map(checked_noises, least, most))


def _noise_of_each(
    noise_deg: float | Sequence[float] | None, num_pairs: int, name: str
) -> list[float | None]:
    if noise_deg is None or not _is_one_for_each(noise_deg):
        return [noise_deg] * num_pairs  # type: ignore[list-item]
    assert not isinstance(noise_deg, float)
    if len(noise_deg) != num_pairs:
        raise ValueError(f"{name} must be one for each of {num_pairs} pairs, got {len(noise_deg)}")
    return list(noise_deg)


def thread_count(num_threads: int | None) -> int:
    """Return the number of threads, by default one per core."""
    if num_threads is None:
        return (
            len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else (os.cpu_count() or 1)
        )
    try:
        threads = index(num_threads)
    except TypeError:
        threads = 0
    if threads < 1:
        raise ValueError(f"num_threads must be a positive integer, got {num_threads!r}")
    return min(threads, _MOST_THREADS)
