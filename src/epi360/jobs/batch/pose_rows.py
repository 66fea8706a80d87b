# SPDX-License-Identifier: BSD-3-Clause
"""Rows of the output: schema, and the poses of pairs as a table."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from typing import Any

import numpy as np

from epi360.cameras.upright import DOWN
from epi360.estimation import Explanations, RelativePoseResult, estimate_relative_pose
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.robust import estimate_timed_poses
from epi360.extras import extra_library
from epi360.jobs.batch.sources import Array, PairMatches, pair_seed

# A database needs the inliers. Packed bits are small, so that every part has them.
INLIERS = "inlier_bits"


def output_columns() -> list[str]:
    """Names of the columns of the output, in order."""
    return [name for name in part_schema().names if name != INLIERS]


def part_schema() -> Any:
    """Arrow schema of a part: the columns of the output and the inliers as packed bits.

    The lists are plain ones and not of fixed size, which Parquet does not know: all readers see the
    same.
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
            ("probability", number),
            *((f"probability_{field.name}", number) for field in fields(Explanations)),
            (INLIERS, arrow.binary()),
        ]
    )


def estimate_rows(
    pairs: PairMatches, *, seed: int, num_threads: int | None, upright_deg: float | None = None
) -> Any:
    """Poses of at least one pair as a pyarrow table, one row a pair, with `part_schema`.

    What the matches do not determine is NaN. ``seconds`` is the wall time of the pair's estimate on
    its thread, without reading and writing.
    """
    names = zip(pairs.image1, pairs.image2, strict=True)
    seeds = [pair_seed(seed, *pair) for pair in names]
    if upright_deg is None:
        results, seconds = estimate_timed_poses(
            pairs.bearings1,
            pairs.bearings2,
            num_threads=num_threads,
            options=IMAGE_OPTIONS,
            seeds=seeds,
        )
    else:
        results, seconds = _estimate_upright(pairs, seeds, num_threads, upright_deg)
    poses = [result.cam2_from_cam1 for result in results]
    columns: dict[str, Any] = {
        "image1": [name.encode() for name in pairs.image1],
        "image2": [name.encode() for name in pairs.image2],
        "status": [result.status.encode() for result in results],
        "rotation": [pose.rotation.ravel() for pose in poses],
        "translation": [pose.translation for pose in poses],
        "covariance": [result.covariance.ravel() for result in results],
        "num_matches": [result.num_matches for result in results],
        "num_inliers": [result.num_inliers for result in results],
        "noise_deg": [result.noise_deg for result in results],
        "parallax_deg": [result.parallax_deg for result in results],
        "seconds": seconds,
        "probability": [result.probability for result in results],
        **{
            f"probability_{field.name}": [
                getattr(each.explanations, field.name) for each in results
            ]
            for field in fields(Explanations)
        },
        INLIERS: [np.packbits(result.inlier_mask).tobytes() for result in results],
    }
    return _table(columns)


def _estimate_upright(
    pairs: PairMatches, seeds: Sequence[int], num_threads: int | None, upright_deg: float
) -> tuple[list[RelativePoseResult], list[float]]:
    """Poses of upright cameras, and the time that each of them took."""

    def estimate(bearings1: Array, bearings2: Array, seed: int) -> tuple[RelativePoseResult, float]:
        start = time.perf_counter()
        result = estimate_relative_pose(
            bearings1,
            bearings2,
            gravity1=DOWN,
            gravity2=DOWN,
            gravity_sigma_deg=upright_deg,
            options=IMAGE_OPTIONS,
            seed=seed,
        )
        return result, time.perf_counter() - start

    with ThreadPoolExecutor(num_threads) as pool:  # the core works without the interpreter's lock
        answers = list(pool.map(estimate, pairs.bearings1, pairs.bearings2, seeds))
    return [result for result, _ in answers], [seconds for _, seconds in answers]


def _table(columns: Mapping[str, Any]) -> Any:
    """Table of bytes, numbers and arrays of numbers, with `part_schema`.

    It is made from buffers: to look at a list or a NumPy array, pyarrow imports pandas if there is
    one, and that takes as long as all else that the command imports.
    """
    arrow = extra_library("pyarrow", extra="batch", purpose="Parquet files")
    types = extra_library("pyarrow.types", extra="batch", purpose="Parquet files")

    def array(kind: Any, values: Any) -> Any:
        if types.is_list(kind):
            ends = np.cumsum([0, *map(len, values)], dtype=np.int32)
            inner = array(kind.value_type, np.concatenate(values))
            return arrow.ListArray.from_arrays(array(arrow.int32(), ends), inner)
        if isinstance(values[0], bytes):
            ends = np.cumsum([0, *map(len, values)], dtype=np.int32)
            buffers = [ends, b"".join(values)]
        else:
            # Not kind.to_pandas_dtype(), for which pyarrow up to 21 needs pandas.
            letter = (
                "f" if types.is_floating(kind) else "u" if types.is_unsigned_integer(kind) else "i"
            )
            buffers = [np.asarray(values, f"{letter}{kind.bit_width // 8}")]
        pieces = [None, *map(arrow.py_buffer, buffers)]  # no nulls
        return arrow.Array.from_buffers(kind, len(values), pieces)

    schema = part_schema()
    arrays = [array(field.type, columns[field.name]) for field in schema]
    return arrow.Table.from_arrays(arrays, schema=schema)
