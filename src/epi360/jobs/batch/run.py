# SPDX-License-Identifier: BSD-3-Clause
"""The whole batch: check, estimate what is missing, merge."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial

from epi360.jobs.batch.inputs import check_names, open_matches
from epi360.jobs.batch.job import BatchJob, merge_parts, missing_parts
from epi360.jobs.batch.local_engine import estimate_parts_locally
from epi360.jobs.batch.parts import count_statuses, output_is_there
from epi360.jobs.engines import Engine, check_engine
from epi360.progress import Progress, no_progress
from epi360.runs import storage
from epi360.runs.lock import only_run


@dataclass(frozen=True)
class BatchSummary:
    """What a batch has done."""

    num_pairs: int  # in the output
    num_estimated: int  # those of them that this run has estimated, and not one before
    seconds: float  # wall time of estimating them
    statuses: Mapping[str, int]  # pairs by status, over the whole output
    files: tuple[str, ...]  # what this run has written; empty where all was there
    left: tuple[str, ...]  # what was asked for too, and was there: it is as it was


def run_batch(
    job: BatchJob,
    *,
    engine: Engine = "local",
    num_threads: int | None = None,
    address: str | None = None,
    database: str | None = None,
    progress: Progress = no_progress,
) -> BatchSummary:
    """Estimate the poses of all pairs that are not estimated yet and write the output.

    The engine is "local" (native threads, by default one per core) or "ray" (on the cluster of that
    address, by default one that is started on this machine). With ``database``, a copy of COLMAP's
    database with the two-view geometries is written there. ``progress`` gets ("checked pairs",
    done, total) for the pairs that are missing, then ("pairs", done, total); what earlier runs have
    done is in the first call.

    Raises
    ------
    ValueError
        If the input cannot be used, the output or its parts belong to another job, or another run
        is writing them.
    OSError
        If a file cannot be written. Finished parts stay.
    """
    check_engine(engine)
    if num_threads is not None and num_threads < 1:
        raise ValueError(f"num_threads must be 1 or more, got {num_threads}")
    for path in filter(None, (job.source.path, job.source.features, job.source.pairs)):
        if storage.is_same(job.output, path):
            raise ValueError(f"{job.output} is read; give the output another name")
    if database is not None and job.source.kind == "colmap" and job.source.camera is not None:
        raise ValueError(
            f"{database}: the copy would keep the cameras of {job.source.path}, but the poses be "
            "estimated with those of --camera; set the cameras in the database instead"
        )
    # Nobody can lock a URL. Files appear whole there too: two runs at once cannot mix poses.
    remote = storage.is_remote(job.output)
    with nullcontext() if remote else only_run(storage.local_path(job.output)):
        return _run(job, engine, num_threads, address, database, progress)


def _run(
    job: BatchJob,
    engine: Engine,
    num_threads: int | None,
    address: str | None,
    database: str | None,
    progress: Progress,
) -> BatchSummary:
    with open_matches(job.source) as matches:
        sizes = matches.part_sizes
        is_merged = output_is_there(job.output, job.identity(matches.fingerprint))
        needs_database = database is not None and _needs_database(job, database, is_merged)
        if not is_merged:
            check_names(job.source.path, matches)
    missing = missing_parts(job) if needs_database or not is_merged else []
    total, todo = sum(sizes), sum(sizes[index] for index in missing)
    start = time.perf_counter()
    if missing:
        estimate = _engine(engine, num_threads, address)
        estimate(job, missing, progress=progress, num_done=total - todo, total=total)
    seconds = time.perf_counter() - start
    if not is_merged:
        merge_parts(job)
    if needs_database and database is not None:
        from epi360.jobs.batch.database_copy import write_database_copy

        write_database_copy(job, database, len(sizes))
    # Only now, so that finished work was on the disk whatever happened before. Parts may also be
    # there of a run that was killed at this line.
    storage.remove_folder(job.parts_folder)
    is_new = {job.output: not is_merged}
    if database is not None:
        is_new[database] = needs_database
    return BatchSummary(
        total,
        todo,
        seconds,
        count_statuses(job.output),
        files=tuple(path for path, new in is_new.items() if new),
        left=tuple(path for path, new in is_new.items() if not new),
    )


def _engine(engine: Engine, num_threads: int | None, address: str | None) -> Callable[..., None]:
    if engine == "local":
        return partial(estimate_parts_locally, num_threads=num_threads)
    from epi360.jobs.batch.ray_engine import estimate_parts_on_ray

    return partial(estimate_parts_on_ray, address=address)


def _needs_database(job: BatchJob, database: str, is_merged: bool) -> bool:
    """Whether the copy of the database is still to be written."""
    if job.source.kind != "colmap":
        raise ValueError("a database can be written only from a COLMAP database")
    if storage.is_remote(database):
        raise ValueError(f"{database} must be on this machine: SQLite writes to disks only")
    path = storage.local_path(database)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"folder {path.parent} of the database does not exist")
    if path.exists() and (not is_merged or storage.is_same(database, job.source.path)):
        raise ValueError(f"{path} is there already; give the name of a new file")
    return not path.exists()
