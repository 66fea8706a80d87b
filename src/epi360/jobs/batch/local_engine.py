# SPDX-License-Identifier: BSD-3-Clause
"""The parts of a batch on this machine: native threads estimate while the next part is read."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate

from epi360.jobs.batch.inputs import open_matches
from epi360.jobs.batch.job import BatchJob, check_parts, write_poses
from epi360.jobs.batch.parts import Identity
from epi360.jobs.batch.sources import PairMatches
from epi360.progress import Progress


def estimate_parts_locally(
    job: BatchJob,
    parts: Sequence[int],
    *,
    num_threads: int | None,
    progress: Progress,
    num_done: int,
    total: int,
) -> None:
    """Check all missing parts, then estimate one after the other; at most two are in memory.

    ``progress`` gets ("checked pairs", done, all of these parts), then ("pairs", done, total),
    after each part; ``num_done`` pairs are done already. If a row cannot be used, nothing is
    estimated.
    """
    for checked in accumulate(check_parts(job, parts), initial=0):
        progress("checked pairs", checked, total - num_done)
    progress("pairs", num_done, total)
    coming = _read(job, parts)
    # One thread does all the reading: SQLite allows no other.
    with ThreadPoolExecutor(1) as reader:
        ahead = reader.submit(next, coming, None)
        try:
            while (part := ahead.result()) is not None:
                ahead = reader.submit(next, coming, None)
                index, pairs, identity = part
                write_poses(job, index, pairs, identity, num_threads=num_threads)
                num_done += len(pairs)
                progress("pairs", num_done, total)
        finally:
            reader.submit(coming.close)


def _read(
    job: BatchJob, parts: Sequence[int]
) -> Generator[tuple[int, PairMatches, Identity], None, None]:
    with open_matches(job.source) as matches:
        identity = job.part_identity(matches.fingerprint)
        for index, pairs in zip(parts, matches.read(parts), strict=True):
            yield index, pairs, identity
