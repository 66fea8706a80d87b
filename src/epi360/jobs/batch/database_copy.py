# SPDX-License-Identifier: BSD-3-Clause
"""A copy of a COLMAP database with the two-view geometries of a batch."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from epi360.interop.colmap_database import (
    open_colmap_database,
    two_view_geometry_to_colmap,
    whole_database,
)
from epi360.interop.colmap_pairs import ColmapPairs
from epi360.interop.match_graph import TwoViewGeometry
from epi360.jobs.batch.job import BatchJob
from epi360.jobs.batch.parts import read_part
from epi360.jobs.batch.pose_rows import INLIERS
from epi360.poses import Pose
from epi360.runs import storage


def write_database_copy(job: BatchJob, path: str, num_parts: int) -> None:
    """Copy the database of a batch to a new file and write the geometries of its pairs into it.

    All parts must be there. The copy appears whole or not at all; geometries that the database has
    of these pairs are replaced.
    """
    try:
        with (
            whole_database(storage.local_path(path)) as temporary,
            ColmapPairs(job.source.path) as pairs,
        ):
            _copy(pairs.path, temporary)
            try:
                _write_geometries(job, pairs, temporary, num_parts)
            except ValueError as error:
                raise ValueError(str(error).replace(str(temporary), path)) from None
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OSError(f"COLMAP database {path} cannot be written: {reason}") from None


def _copy(source: Path, target: Path) -> None:
    """Copy the file with what a writer, or a crash, has left beside it: SQLite puts that in."""
    for end in ("", "-wal", "-journal"):
        if Path(f"{source}{end}").exists():
            shutil.copyfile(f"{source}{end}", f"{target}{end}")


def _write_geometries(job: BatchJob, pairs: ColmapPairs, path: Path, num_parts: int) -> None:
    with open_colmap_database(path) as database:
        id_of_name = {image.name: image.image_id for image in database.read_all_images()}
        # Without pycolmap.DatabaseTransaction, see write_colmap_database.
        for index, geometry in enumerate(_geometries(job, pairs, num_parts)):
            ids = tuple(id_of_name[name] for name in pairs.names[index])
            if database.exists_two_view_geometry(*ids):
                database.delete_two_view_geometry(*ids)
            database.write_two_view_geometry(*ids, two_view_geometry_to_colmap(geometry))


def _geometries(job: BatchJob, pairs: ColmapPairs, num_parts: int) -> Iterator[TwoViewGeometry]:
    """Geometry of each pair, in the order of the database; one part is in memory."""
    row = 0
    for part in range(num_parts):
        table = read_part(job.part_path(part))
        columns = ("status", "rotation", "translation", INLIERS)
        for values in zip(*(table.column(name).to_pylist() for name in columns), strict=True):
            status, rotation, translation, bits = values
            matches = pairs.matches(row)
            mask = np.unpackbits(np.frombuffer(bits, np.uint8), count=len(matches)).astype(bool)
            pose = Pose(np.reshape(rotation, (3, 3)), np.array(translation))
            yield TwoViewGeometry(status, pose, matches[mask])
            row += 1
