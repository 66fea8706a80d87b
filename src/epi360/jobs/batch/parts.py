# SPDX-License-Identifier: BSD-3-Clause
"""Files of poses: parts that say which job they belong to, and the output made from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import IO, Any

from epi360.extras import extra_library
from epi360.jobs.batch.pose_rows import output_columns, part_schema
from epi360.runs import storage
from epi360.runs.made_from import first_difference

Identity = dict[str, str]
"""What determines the poses: fingerprint of the input, seed, options, version."""

CONVENTION = (
    "rotation (row by row) and translation are cam2_from_cam1: x2 = R x1 + t, |t| = 1; camera axes "
    "x right, y down, z forward; covariance (5 x 5, row by row, radians squared) is of d with "
    "R_true = exp([d0 d1 d2]x) R and t_true = t + B (d3, d4), normalised, "
    "B = epi360.epipolar.tangent_basis(t); NaN: not determined"
)
_PREFIX = "epi360."


def write_part(path: str, rows: Any, identity: Identity) -> None:
    """Write the poses of a part, the table of `estimate_rows`, whole or not at all."""
    with storage.write_whole(path) as file:
        rows = rows.replace_schema_metadata(_metadata(identity))
        _parquet().write_table(rows, file, write_page_checksum=True)


def part_is_there(path: str, identity: Identity, num_pairs: int) -> bool:
    """Whether a part's file is whole; ValueError where it belongs to another job."""
    with storage.open_read(path) as file:
        try:
            # Parts are small: reading all of it finds damage anywhere.
            rows = _read_checked(file)
        except (_arrow().ArrowException, OSError) as error:
            if isinstance(error, OSError) and error.errno is not None:
                raise
            return False
    folder = path.rpartition("/")[0]
    check_identity(rows.schema.metadata, identity, folder, "remove that folder")
    return bool(len(rows) == num_pairs and rows.schema.equals(part_schema()))


def read_part(path: str) -> Any:
    """Poses of a part, as `estimate_rows` has returned them."""
    with storage.open_read(path) as file:
        return _read_checked(file)


def output_is_there(path: str, identity: Identity) -> bool:
    """Whether the output exists; ValueError where it is something else than that of the job."""
    if not storage.exists(path):
        return False
    with _poses(path) as poses:
        check_identity(poses.schema_arrow.metadata, identity, path, "remove that file")
    return True


def check_identity(
    metadata: Mapping[bytes, bytes] | None, identity: Identity, path: str, remedy: str
) -> None:
    """Raise where the metadata of a file do not belong to a job, saying what to do with it."""
    known = {name.decode(errors="replace"): value for name, value in (metadata or {}).items()}
    theirs = {key: known[_PREFIX + key].decode() for key in identity if _PREFIX + key in known}
    different = first_difference(theirs, identity)
    if different is None:
        return
    if different.before is None:
        raise ValueError(
            f"{path} was not written by epi360 batch; give another --output or {remedy}"
        )
    raise ValueError(
        f"{path} holds poses of another job ({different.name.replace('_', ' ')} "
        f"{different.before}, now {different.now}); give another --output or {remedy}"
    )


def merge_part_files(paths: Sequence[str], output: str, identity: Identity) -> None:
    """Join all parts, given in order, to the output; one part is in memory at a time."""
    columns = output_columns()
    schema = _arrow().schema([part_schema().field(name) for name in columns])
    schema = schema.with_metadata(_metadata(identity))
    with storage.write_whole(output) as file, _parquet().ParquetWriter(file, schema) as writer:
        for path in paths:
            rows = read_part(path).select(columns)
            # The input may have changed while it was read.
            check_identity(rows.schema.metadata, identity, path, "remove it")
            writer.write_table(rows.replace_schema_metadata(schema.metadata))


def count_statuses(output: str) -> dict[str, int]:
    """Pairs of the merged file by status, the most frequent first."""
    counts: Counter[str] = Counter()
    with _poses(output) as poses:
        for batch in poses.iter_batches(columns=["status"]):
            counts.update(batch.column("status").to_pylist())
    return dict(counts.most_common())


def _read_checked(file: IO[bytes]) -> Any:
    return _parquet().ParquetFile(file, page_checksum_verification=True).read()


@contextmanager
def _poses(path: str) -> Iterator[Any]:
    with storage.open_read(path) as file:
        try:
            poses = _parquet().ParquetFile(file)
        except _arrow().ArrowException:
            raise ValueError(
                f"{path} is there and is no Parquet file; give another --output or remove it"
            ) from None
        yield poses


def _metadata(identity: Identity) -> dict[str, str]:
    return {
        _PREFIX + "convention": CONVENTION,
        **{_PREFIX + key: value for key, value in identity.items()},
    }


def _arrow() -> Any:
    return extra_library("pyarrow", extra="batch", purpose="Parquet files")


def _parquet() -> Any:
    return extra_library("pyarrow.parquet", extra="batch", purpose="Parquet files")
