# SPDX-License-Identifier: BSD-3-Clause
"""Rows of the output: schema, and the poses of pairs as a table."""

from __future__ import annotations

from typing import Any

import numpy as np

from epi360.estimation.result import RelativePoseResult
from epi360.estimation.robust import estimate_timed_poses
from epi360.extras import extra_library
from epi360.jobs.batch.sources import PairMatches, pair_seed
from epi360.two_view import IMAGE_OPTIONS

# Inliers are needed to write a database; packed bits are small, so every part has them.
INLIERS = "inlier_bits"


def output_columns() -> list[str]:
    """Names of the columns of the output, in order."""
    return [name for name in part_schema().names if name != INLIERS]


def part_schema() -> Any:
    """Arrow schema of a part: the columns of the output and the inliers as packed bits.

    Plain lists, not lists of fixed size: Parquet knows no other, so all readers see the same.
    """
    arrow = extra_library("pyarrow", extra="batch", purpose="Parquet files")
    number, numbers = arrow.float64(), arrow.list_(arrow.float64())
    return arrow.schema(
        [
            ("image1", arrow.string()),
            ("image2", arrow.string()),
            ("status", arrow.string()),
            ("rotation", numbers),
            ("translation", numbers),
            ("covariance", numbers),
            ("num_matches", arrow.int64()),
            ("num_inliers", arrow.int64()),
            ("noise_deg", number),
            ("parallax_deg", number),
            ("seconds", number),
            (INLIERS, arrow.binary()),
        ]
    )


def estimate_rows(pairs: PairMatches, *, seed: int, num_threads: int | None) -> Any:
    """Table of the poses of pairs, one row a pair.

    Parameters
    ----------
    pairs : PairMatches
        At least one pair.
    seed : int
        Of the job.
    num_threads : int, optional
        Native threads; by default one per core. The poses do not depend on it.

    Returns
    -------
    rows : pyarrow.Table
        With `part_schema`; what the matches do not determine is NaN. ``seconds`` is the wall time
        of the pair's estimate on its thread, without reading and writing.
    """
    arrow = extra_library("pyarrow", extra="batch", purpose="Parquet files")
    names = list(zip(pairs.image1, pairs.image2, strict=True))
    results, seconds = estimate_timed_poses(
        pairs.bearings1,
        pairs.bearings2,
        num_threads=num_threads,
        options=IMAGE_OPTIONS,
        seeds=[pair_seed(seed, *pair) for pair in names],
    )
    columns = {
        "image1": pairs.image1,
        "image2": pairs.image2,
        "status": [result.status for result in results],
        "rotation": [result.cam2_from_cam1.rotation.ravel() for result in results],
        "translation": [result.cam2_from_cam1.translation for result in results],
        "covariance": [result.covariance.ravel() for result in results],
        "num_matches": [result.num_matches for result in results],
        "num_inliers": [result.num_inliers for result in results],
        "noise_deg": [result.noise_deg for result in results],
        "parallax_deg": [result.parallax_deg for result in results],
        "seconds": seconds,
        INLIERS: [_packed_bits(result) for result in results],
    }
    return arrow.table(columns, schema=part_schema())


def _packed_bits(result: RelativePoseResult) -> bytes:
    return np.packbits(result.inlier_mask).tobytes()
