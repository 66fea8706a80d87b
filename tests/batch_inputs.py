# SPDX-License-Identifier: BSD-3-Clause
"""Inputs of `epi360 batch`, written by hand, and its outputs as plain values."""

from pathlib import Path

import numpy as np

from epi360.synthetic import two_view_scene

NUM_MATCHES = 100


def scenes(num_pairs, num_matches=NUM_MATCHES):
    """Two views with 30 % of wrong matches; the last pair has too few matches."""
    made = [
        two_view_scene(
            seed, noise_deg=0.1, noise_in_both_views=True, outlier_ratio=0.3,
            num_matches=num_matches,
        )
        for seed in range(num_pairs - 1)
    ]  # fmt: skip
    return [*made, two_view_scene(99, num_matches=3)]


def columns_of(num_pairs, **options):
    """Columns as an input has them, as Python lists."""
    made = scenes(num_pairs, **options)
    return {
        "image1": [f"a/{k}.jpg" for k in range(num_pairs)],
        "image2": [f"b/ä {k}.jpg" for k in range(num_pairs)],
        "bearings1": [scene.bearings1.ravel().tolist() for scene in made],
        "bearings2": [scene.bearings2.ravel().tolist() for scene in made],
    }


def write_matches(path, columns, *, row_group_size=None, schema=None):
    """Parquet file of columns; types are those that pyarrow infers."""
    import pyarrow
    import pyarrow.parquet

    table = pyarrow.table(columns, schema=schema)
    pyarrow.parquet.write_table(table, path, row_group_size=row_group_size)
    return Path(path)


def pose_rows(path):
    """All columns but ``seconds``, as bytes or lists that compare exactly (NaN equals NaN)."""
    import pyarrow.parquet

    with open(path, "rb") as file:
        table = pyarrow.parquet.read_table(file).drop_columns(["seconds"])
    return {
        name: repr(table.column(name).combine_chunks().to_pylist()) for name in table.column_names
    }


def array_of(rows, name, shape):
    """Column of lists as an array, one row a pair."""
    return np.array(rows.column(name).to_pylist(), dtype=float).reshape(-1, *shape)


def version_of(path):
    """What changes when a file is written again, and not when it is read."""
    status = Path(path).stat()
    return status.st_ino, status.st_mtime_ns, status.st_size
