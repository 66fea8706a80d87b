# SPDX-License-Identifier: BSD-3-Clause
"""A batch: what it reads, what it writes, and the work on one part of it.

A part is a row group of a Parquet file, or `pairs_per_part` pairs where a row group has more and
in the other inputs. Each part is written for itself, so a run that is stopped, killed or started on
many machines loses at most the parts in work; the end joins them in the order of the input.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

from epi360.cameras.upright import check_upright
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.extras import package_version
from epi360.jobs.batch.inputs import open_matches
from epi360.jobs.batch.parts import Identity, merge_part_files, part_is_there, write_part
from epi360.jobs.batch.pose_rows import estimate_rows
from epi360.jobs.batch.sources import MatchSource, PairMatches
from epi360.runs import storage

_OTHER_FORMATS = (".csv", ".json", ".txt", ".h5", ".db")  # of which the output is none


@dataclass(frozen=True)
class BatchJob:
    """What is read, what is written and the seed; plain values that another machine understands."""

    source: MatchSource
    output: str  # Parquet file of the poses: path, or URL that fsspec understands
    seed: int = 0  # a pair's seed is a hash of this one and the names of its images
    upright_deg: float | None = None  # all cameras stand upright to so many degrees, one sigma

    def __post_init__(self) -> None:
        """Check the options."""
        check_upright(self.upright_deg)
        if self.output.lower().endswith(_OTHER_FORMATS):
            raise ValueError(
                f"{self.output}: poses are written as a Parquet table, name it *.parquet"
            )

    @property
    def parts_folder(self) -> str:
        """Folder of the finished parts."""
        return f"{self.output}.parts"

    def part_path(self, index: int) -> str:
        """Path of a part's file."""
        return f"{self.parts_folder}/part-{index:06d}.parquet"

    def identity(self, input_fingerprint: str) -> Identity:
        """What determines the poses, as it is written into the files."""
        options = {**asdict(IMAGE_OPTIONS), "upright_deg": self.upright_deg}
        return {
            "input": input_fingerprint,
            "seed": str(self.seed),
            "options": " ".join(f"{name}={value}" for name, value in options.items()),
            "epi360_version": package_version(),
        }

    def part_identity(self, input_fingerprint: str) -> Identity:
        """What determines the poses in a part and which pairs are in it."""
        pairs_per_part = str(self.source.pairs_per_part)
        return {**self.identity(input_fingerprint), "pairs_per_part": pairs_per_part}


def check_parts(job: BatchJob, parts: Sequence[int]) -> Iterator[int]:
    """Read parts, given in rising order, and check their matches; yields the pairs of each.

    Reading takes a fiftieth of the time of the estimates. If a wrong row came to light in the midst
    of them, all would be lost: with the row corrected, the finished parts are of another input.
    """
    with open_matches(job.source) as matches:
        for pairs in matches.read(parts):
            yield len(pairs)


def estimate_parts(job: BatchJob, parts: Sequence[int], *, num_threads: int = 1) -> None:
    """Estimate the parts that have no file yet, given in rising order, and write their files."""
    with open_matches(job.source) as matches:
        identity, sizes = job.part_identity(matches.fingerprint), matches.part_sizes
        missing = [
            index
            for index in parts
            if not storage.exists(path := job.part_path(index))
            or not part_is_there(path, identity, sizes[index])
        ]
        for index, pairs in zip(missing, matches.read(missing), strict=True):
            write_poses(job, index, pairs, identity, num_threads=num_threads)


def write_poses(
    job: BatchJob,
    index: int,
    pairs: PairMatches,
    identity: Identity,
    *,
    num_threads: int | None,
) -> None:
    """Estimate the poses of a part whose pairs are read already, and write its file."""
    rows = estimate_rows(pairs, seed=job.seed, num_threads=num_threads, upright_deg=job.upright_deg)
    write_part(job.part_path(index), rows, identity)


def missing_parts(job: BatchJob) -> list[int]:
    """Parts that are not there yet, or damaged, in order.

    Raises
    ------
    ValueError
        If the folder holds parts of another input, seed or version.
    """
    with open_matches(job.source) as matches:
        identity = job.part_identity(matches.fingerprint)
        sizes = matches.part_sizes
    names = set(storage.names_in(job.parts_folder))
    missing = []
    for index, size in enumerate(sizes):
        path = job.part_path(index)
        is_listed = path.rpartition("/")[2] in names
        if not (is_listed and part_is_there(path, identity, size)):
            missing.append(index)
    return missing


def merge_parts(job: BatchJob) -> None:
    """Join the parts, which must all be there and stay, into the output, in the input's order."""
    with open_matches(job.source) as matches:
        identity = job.identity(matches.fingerprint)
        paths = [job.part_path(index) for index in range(len(matches.part_sizes))]
    merge_part_files(paths, job.output, identity)
