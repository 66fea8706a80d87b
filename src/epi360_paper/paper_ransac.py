# SPDX-License-Identifier: BSD-3-Clause
"""The eight-point RANSAC of Table 4, as the authors' code does it.

It is not the package's robust estimator: it does not refine, test depths or choose a threshold.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar import observation_matrix

Array = NDArray[np.float64]

SAMPLE_SIZE = 8
CONFIDENCE = 0.99
# Samples that the authors' code allows for the half of the data that it expects to be right:
# log(1 - 0.99) / log(1 - 0.5^8).
MAX_ITERATIONS = 1177
_BATCH = 128  # samples solved at once; the arrays of 400 matches stay below half a megabyte


@dataclass(frozen=True)
class PaperRansac:
    """Matches that RANSAC has kept."""

    inlier_mask: NDArray[np.bool_]  # (N,): matches below the threshold for the best sample
    num_iterations: int  # samples drawn


def paper_ransac(
    bearings1: Array,
    bearings2: Array,
    threshold: float,
    rng: np.random.Generator,
    *,
    residual: Literal["paper", "solarte2021"] = "solarte2021",
    num_iterations: int | None = None,
) -> PaperRansac:
    """Matches that agree with the best sample of eight matches."""
    if len(bearings1) < SAMPLE_SIZE:
        raise ValueError(f"RANSAC needs {SAMPLE_SIZE} matches or more, got {len(bearings1)}")
    # The best sample has the most inliers; among equals, the least sum of squared residuals of all
    # matches. Both, and the stopping rule, are those of the authors' published code.
    best, best_mask = (-1, -np.inf), np.zeros(len(bearings1), dtype=np.bool_)
    done, limit = 0, num_iterations or MAX_ITERATIONS
    for residuals in _residuals_of_samples(bearings1, bearings2, residual, rng, limit):
        inliers = residuals < threshold
        counts, sums = inliers.sum(axis=1), np.square(residuals).sum(axis=1)
        for row, found in enumerate(zip(counts.tolist(), (-sums).tolist(), strict=True)):
            done += 1
            if found > best:
                best, best_mask = found, inliers[row]
                if num_iterations is None:
                    limit = min(limit, _samples_needed(best[0] / len(bearings1)))
            if done >= limit:
                return PaperRansac(best_mask, done)
    return PaperRansac(best_mask, done)


def essential_residuals(
    E: Array, bearings1: Array, bearings2: Array, residual: Literal["paper", "solarte2021"]
) -> Array:
    """Absolute residuals (..., N) of essential matrices (..., 3, 3)."""
    # "paper" is eq. 13 for each match: |b2^T E b1| / |E b1|, the sine of the angle to the epipolar
    # plane. "solarte2021" divides by the norms of the whole arrays instead, as the authors' code
    # does: |b2^T E b1| / (sqrt(N) |E B1|_F), about 1/N of the other.
    products = np.abs(E.reshape(*E.shape[:-2], 9) @ observation_matrix(bearings1, bearings2).T)
    planes = np.linalg.norm(E @ bearings1.T, axis=-2)
    if residual == "paper":
        return np.asarray(products / planes)
    whole = np.sqrt(len(bearings1)) * np.linalg.norm(planes, axis=-1, keepdims=True)
    return np.asarray(products / whole)


def _residuals_of_samples(
    bearings1: Array,
    bearings2: Array,
    residual: Literal["paper", "solarte2021"],
    rng: np.random.Generator,
    num_samples: int,
) -> Iterator[Array]:
    """Residuals (B, N) of all matches for the models of up to B samples at a time."""
    A = observation_matrix(bearings1, bearings2)
    for first in range(0, num_samples, _BATCH):
        numbers = rng.random((min(_BATCH, num_samples - first), len(A)))
        # (B, 8) indices, without repetition in a row
        samples = np.argpartition(numbers, SAMPLE_SIZE - 1, axis=1)[:, :SAMPLE_SIZE]
        yield essential_residuals(_eight_points(A[samples]), bearings1, bearings2, residual)


def _eight_points(A: Array) -> Array:
    """Essential matrices (B, 3, 3) of rank 2 from observation matrices (B, 8, 9) (paper eq. 4)."""
    # The null space of eight rows by QR: A^T A would lose half of the digits.
    null_vectors = np.linalg.qr(A.swapaxes(1, 2), mode="complete").Q[:, :, 8]
    U, s, Vt = np.linalg.svd(null_vectors.reshape(-1, 3, 3))
    s[:, 2] = 0.0
    return np.asarray(U * s[:, None, :] @ Vt)


def _samples_needed(inlier_share: float) -> int:
    """Samples after which one is free of outliers with the confidence above."""
    good = min(inlier_share**SAMPLE_SIZE, 1.0 - 1e-12)
    if good <= 0.0:
        return MAX_ITERATIONS
    return int(np.ceil(np.log(1.0 - CONFIDENCE) / np.log1p(-good)))
