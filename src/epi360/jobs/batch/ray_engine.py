# SPDX-License-Identifier: BSD-3-Clause
"""The parts of a batch on Ray: one task a part, on this machine or on a cluster.

Plain tasks and not Ray Data: a worker reads its part where the matches are and writes its file
where the output is, so nothing but the number of the part passes through Ray, and a restart finds
the same parts whichever engine made them. Ray Data would choose blocks of its own, hold the matches
in its object store and know nothing of parts that are there.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from typing import Any

from epi360.extras import extra_library
from epi360.jobs.batch import storage
from epi360.jobs.batch.job import BatchJob, estimate_part
from epi360.jobs.batch.sources import open_matches
from epi360.progress import Progress

# Also what Ray takes by default: a machine may vanish thrice before the part itself is suspected.
_MAX_RETRIES = 3
# Nothing of ours goes through the object store; 75 MiB is the least that Ray accepts.
_OBJECT_STORE_BYTES = 80 * 2**20
_SECONDS_TO_ANSWER = 10.0
# What the user has set stays. Ray prints deaths of workers on stdout, in the middle of our results;
# it drops lines that match an expression, and this one matches all.
_QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".",
}


def estimate_parts_on_ray(
    job: BatchJob,
    parts: Sequence[int],
    *,
    address: str | None,
    progress: Progress,
    there: int,
    total: int,
) -> None:
    """Estimate parts in Ray tasks of one CPU; the workers write the files.

    Parameters
    ----------
    job : BatchJob
        The batch. On a cluster all machines must see its input and its output, and have this
        version of epi360.
    parts : sequence of int
        Which are missing.
    address : str, optional
        Of a cluster, as `ray.init` takes it. By default that of the environment's RAY_ADDRESS,
        and without it Ray is started on this machine and stopped at the end. A session that the
        process has open already is used instead and stays open.
    progress : callable
        Gets ("pairs", done, total) after each part.
    there, total : int
        Pairs that are done already, and in all.

    Raises
    ------
    ValueError
        If a row cannot be used, or a worker has another version of epi360.
    OSError
        If a file cannot be read or written, the cluster does not answer, or a worker dies again
        and again. Finished parts stay.
    ImportError
        If Ray is missing here, or epi360 on a worker.
    """
    for name, value in _QUIET.items():  # read when Ray is imported
        os.environ.setdefault(name, value)
    ray = extra_library("ray", extra="cluster", purpose="batches on Ray")
    with open_matches(job.source) as matches:
        sizes = matches.part_sizes
    done = there
    with _session(ray, address):
        for index in _finished_parts(ray, _with_absolute_paths(job), parts):
            done += sizes[index]
            progress("pairs", done, total)


@contextmanager
def _session(ray: Any, address: str | None) -> Iterator[None]:
    """Connect to the cluster or start Ray here, without its banner, logs and dashboard."""
    if ray.is_initialized():
        yield
        return
    address = address or os.environ.get("RAY_ADDRESS") or "local"
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if address == "local":
        options |= {"include_dashboard": False, "object_store_memory": _OBJECT_STORE_BYTES}
    else:
        _check_answers(address)
    ray.init(address=address, **options)
    try:
        yield
    finally:
        ray.shutdown()


def _check_answers(address: str) -> None:
    """Raise at once where nobody listens: Ray tries for minutes and says so on stderr."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not port.isdigit():  # "auto": Ray looks for a cluster on this machine
        return
    try:
        socket.create_connection((host, int(port)), _SECONDS_TO_ANSWER).close()
    except OSError as error:
        raise ConnectionError(
            f"no Ray cluster answers at {address} ({error.strerror or error})"
        ) from error


def _finished_parts(ray: Any, job: BatchJob, parts: Sequence[int]) -> Iterator[int]:
    """Run one task a part; yields its number when its file is there.

    After an error or an interrupt nothing is cancelled: the end of the session stops what is left.
    `ray.cancel` of a task that ends in the same moment ends the whole process (seen in Ray 2.60).
    """
    task = ray.remote(num_cpus=1, max_retries=_MAX_RETRIES)(_estimate)
    waiting, identity = iter(parts), job.identity("")
    running: dict[Any, int] = {}
    while True:
        for index in islice(waiting, max(0, _num_in_flight(ray) - len(running))):
            running[task.remote(job, index, identity)] = index
        if not running:
            return
        (finished,), _ = ray.wait(list(running))
        index = running.pop(finished)
        _raise_failure(ray, finished, index)
        if not storage.exists(job.part_path(index)):
            raise FileNotFoundError(
                f"{job.part_path(index)} was written by a worker but is not there for this "
                "machine; the output must be where all machines of the cluster see it"
            )
        yield index


def _num_in_flight(ray: Any) -> int:
    """Twice the CPUs of the moment: none waits for us, and an autoscaler sees that more is wanted.

    Bounded, as every task in flight costs the driver memory.
    """
    return 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))


def _estimate(job: BatchJob, index: int, identity: Mapping[str, str]) -> None:
    """Estimate one part on a worker, which must be of the driver's version."""
    here = job.identity("")
    if here != identity:
        raise ValueError(
            f"all machines must have epi360 {identity['epi360_version']}, the Ray worker on "
            f"{socket.gethostname()} has {here['epi360_version']}"
        )
    try:
        estimate_part(job, index)
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"{error.filename or error} is not there for the Ray worker on {socket.gethostname()}; "
            "all machines of the cluster must see input and output"
        ) from error


def _raise_failure(ray: Any, finished: Any, index: int) -> None:
    """Raise what a task has raised, as if it had been raised here."""
    exceptions = ray.exceptions
    try:
        ray.get(finished)
    except exceptions.RayTaskError as error:
        if isinstance(error.cause, (ValueError, OSError, ImportError)):
            raise error.cause from None
        if "No module named 'epi360'" in str(error):
            raise ImportError(
                "the Ray workers cannot import epi360; install the same version on all machines"
            ) from None
        raise
    except exceptions.RayError as error:
        raise ChildProcessError(
            f"Ray gave up part {index} after {_MAX_RETRIES + 1} tries, its workers died "
            f"({type(error).__name__}); finished parts are kept"
        ) from error


def _with_absolute_paths(job: BatchJob) -> BatchJob:
    """Job as a worker understands it, whose current folder is another one."""
    source = job.source
    absolute = replace(
        source,
        path=_absolute(source.path),
        camera=_absolute(source.camera) if source.camera else None,
        features=_absolute(source.features) if source.features else None,
        pairs=_absolute(source.pairs) if source.pairs else None,
    )
    return replace(job, source=absolute, output=_absolute(job.output))


def _absolute(path: str) -> str:
    return path if "://" in path else os.path.abspath(path)
