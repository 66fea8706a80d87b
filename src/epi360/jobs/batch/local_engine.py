# SPDX-License-Identifier: BSD-3-Clause
"""The parts of a batch on this machine: native threads estimate while the next part is read."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate

from epi360.jobs.batch.job import BatchJob, check_parts, write_poses
from epi360.jobs.batch.parts import Identity
from epi360.jobs.batch.sources import PairMatches, open_matches
from epi360.progress import Progress


def estimate_parts_locally(
    job: BatchJob,
    parts: Sequence[int],
    *,
    num_threads: int | None,
    progress: Progress,
    there: int,
    total: int,
) -> None:
    """Check all parts, then estimate one after the other; at most two are in memory.

    Parameters
    ----------
    job : BatchJob
        The batch.
    parts : sequence of int
        Which are missing, in rising order.
    num_threads : int, optional
        Native threads; by default one per core.
    progress : callable
        Gets ("checked pairs", done, all of these parts), then ("pairs", done, total), after each
        part.
    there, total : int
        Pairs that are done already, and in all.

    Raises
    ------
    ValueError
        If a row cannot be used; then nothing is estimated.
    OSError
        If a file cannot be read or written. Finished parts stay.
    """
    for checked in accumulate(check_parts(job, parts), initial=0):
        progress("checked pairs", checked, total - there)
    progress("pairs", there, total)
    coming = _read(job, parts)
    # One thread does all the reading: SQLite allows no other.
    with ThreadPoolExecutor(1) as reader:
        ahead = reader.submit(next, coming, None)
        try:
            while (part := ahead.result()) is not None:
                ahead = reader.submit(next, coming, None)
                index, pairs, identity = part
                write_poses(job, index, pairs, identity, num_threads=num_threads)
                there += len(pairs)
                progress("pairs", there, total)
        finally:
            reader.submit(coming.close)


def _read(
    job: BatchJob, parts: Sequence[int]
) -> Generator[tuple[int, PairMatches, Identity], None, None]:
    with open_matches(job.source) as matches:
        identity = job.part_identity(matches.fingerprint)
        for index, pairs in zip(parts, matches.read(parts), strict=True):
            yield index, pairs, identity
