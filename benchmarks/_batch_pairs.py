# SPDX-License-Identifier: BSD-3-Clause
"""The same pairs as a Parquet file for `epi360 batch` and as a database for pycolmap."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from _two_view_problems import Problem
from numpy.typing import NDArray

PAIRS_PER_ROW_GROUP = 500


def write_parquet(path: Path, problems: Sequence[Problem], num_pairs: int) -> None:
    """Write matches, one pair a row; the problems come again and again under other names."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    flat = [(problem.bearings1.ravel(), problem.bearings2.ravel()) for problem in problems]
    names = [(name, pa.string()) for name in ("image1", "image2")]
    lists = [(name, pa.list_(pa.float64())) for name in ("bearings1", "bearings2")]
    schema = pa.schema(names + lists)
    with pq.ParquetWriter(path, schema) as writer:
        for start in range(0, num_pairs, PAIRS_PER_ROW_GROUP):
            pairs = range(start, min(start + PAIRS_PER_ROW_GROUP, num_pairs))
            columns = {
                "image1": [f"a{pair}.jpg" for pair in pairs],
                "image2": [f"b{pair}.jpg" for pair in pairs],
                "bearings1": [flat[pair % len(flat)][0] for pair in pairs],
                "bearings2": [flat[pair % len(flat)][1] for pair in pairs],
            }
            writer.write_table(pa.table(columns, schema=schema))


def write_database(
    path: Path, problems: Sequence[Problem], num_pairs: int, cameras: tuple[Any, Any]
) -> None:
    """Write the same matches into a new COLMAP database, two images a pair."""
    import pycolmap

    ours, theirs = cameras
    path.unlink(missing_ok=True)
    with pycolmap.Database.open(path) as database:
        camera = database.write_camera(theirs)
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(sensor)
        rig_id = database.write_rig(rig)
        for pair in range(num_pairs):
            problem = problems[pair % len(problems)]
            images = []
            for letter, bearings in (("a", problem.bearings1), ("b", problem.bearings2)):
                image = pycolmap.Image(name=f"{letter}{pair}.jpg", camera_id=camera)
                images.append(database.write_image(image))
                frame = pycolmap.Frame()
                frame.rig_id = rig_id
                frame.add_data_id(pycolmap.data_t(sensor, images[-1]))
                database.write_frame(frame)
                keypoints = ours.pixels_from_bearings(bearings)
                database.write_keypoints(images[-1], keypoints.astype(np.float32))
            database.write_matches(*images, _same_rows(len(problem.bearings1)))


def _same_rows(count: int) -> NDArray[np.uint32]:
    rows = np.arange(count, dtype=np.uint32)
    return np.column_stack([rows, rows])
