# SPDX-License-Identifier: BSD-3-Clause
"""The parts of a batch on Ray, on this machine or on a cluster.

Plain tasks and not Ray Data: a worker reads its parts where the matches are and writes its files
where the output is, so nothing but the numbers of parts passes through Ray, and a restart finds
the same parts whichever engine made them. Ray Data would choose blocks of its own, hold the matches
in its object store and know nothing of parts that are there.
"""

from __future__ import annotations

import logging
import math
import os
import socket
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import groupby, islice
from typing import Any

from epi360.extras import extra_library
from epi360.jobs.batch.inputs import open_matches
from epi360.jobs.batch.job import BatchJob, check_parts, estimate_parts
from epi360.progress import Progress
from epi360.runs import storage

# This is also Ray's default: a machine may vanish three times before the part is suspected.
_MAX_RETRIES = 3
# Nothing of ours goes through the object store; 75 MiB is the least that Ray accepts.
_OBJECT_STORE_BYTES = 80 * 2**20
_SECONDS_TO_ANSWER = 10.0
# What the user has set stays. Ray prints on stdout, in the middle of our results, that a worker has
# died; it drops lines that match this expression, which are all.
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
    num_done: int,
    total: int,
) -> None:
    """Check all parts, then estimate them, in Ray tasks of one CPU; the workers write the files.

    On a cluster all machines must see the input and the output of the job, and have this version of
    epi360. ``address`` is that of a cluster, as `ray.init` takes it; by default that of the
    environment's RAY_ADDRESS, and without it Ray is started on this machine and stopped at the end.
    A session that the process has open already is used instead and stays open. ``progress`` gets
    ("checked pairs", done, all of these parts), then ("pairs", done, total), after each task.

    If a row cannot be used, nothing is estimated. Finished parts stay where a file cannot be read
    or written, the cluster does not answer, or a worker dies again and again (OSError).
    """
    for name, value in _QUIET.items():  # read when Ray is imported
        os.environ.setdefault(name, value)
    ray = extra_library("ray", extra="cluster", purpose="batches on Ray")
    with open_matches(job.source) as matches:
        sizes, groups = matches.part_sizes, matches.part_groups
    job = _with_absolute_paths(job)
    with _session(ray, address):
        tasks = _tasks(parts, groups, _num_cpus(ray))
        checked, missing = 0, total - num_done
        progress("checked pairs", checked, missing)
        for finished in _finished_tasks(ray, _check, job, tasks):
            checked += sum(sizes[part] for part in finished)
            progress("checked pairs", checked, missing)
        progress("pairs", num_done, total)
        for finished in _finished_tasks(ray, _estimate, job, tasks):
            _find_files(job, finished)
            num_done += sum(sizes[part] for part in finished)
            progress("pairs", num_done, total)


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


def _tasks(parts: Sequence[int], groups: Sequence[int], num_cpus: int) -> list[list[int]]:
    """Parts of each task, neighbours in one group.

    A task reads over the parts of its group that come before its own. If each of n parts is a task,
    the group is read n / 2 times; if a task has as many parts as the square root of n, it is read
    half that root times. But each CPU should get two tasks.
    """
    tasks, sizes = [], Counter(groups)
    for group, members in groupby(parts, key=lambda part: groups[part]):
        missing, num_parts = list(members), sizes[group]
        size = max(1, min(math.isqrt(num_parts), num_parts // (2 * num_cpus)))
        tasks += [missing[first : first + size] for first in range(0, len(missing), size)]
    return tasks


def _finished_tasks(
    ray: Any, work: Callable[..., None], job: BatchJob, tasks: Sequence[list[int]]
) -> Iterator[list[int]]:
    """Run the tasks; yields the parts of each when it has ended.

    After an error or an interrupt nothing is cancelled: the end of the session stops what is left.
    `ray.cancel` of a task that ends in the same moment ends the whole process (seen in Ray 2.60).
    """
    remote = ray.remote(num_cpus=1, max_retries=_MAX_RETRIES)(work)
    waiting, identity = iter(tasks), job.identity("")
    running: dict[Any, list[int]] = {}
    while True:
        # Each CPU that there is now gets two tasks: none waits for us, and an autoscaler sees that
        # more are wanted. Not more than two, as every task in flight costs the driver memory.
        for parts in islice(waiting, max(0, 2 * _num_cpus(ray) - len(running))):
            running[remote.remote(job, parts, identity)] = parts
        if not running:
            return
        (finished,), _ = ray.wait(list(running))
        parts = running.pop(finished)
        _raise_failure(ray, finished, parts)
        yield parts


def _find_files(job: BatchJob, parts: Sequence[int]) -> None:
    """Raise where this machine does not see what a worker has written."""
    for path in map(job.part_path, parts):
        if not storage.exists(path):
            raise FileNotFoundError(
                f"{path} was written by a worker but is not there for this machine; the output "
                "must be where all machines of the cluster see it"
            )


def _num_cpus(ray: Any) -> int:
    return max(1, int(ray.cluster_resources().get("CPU", 1)))


def _check(job: BatchJob, parts: Sequence[int], identity: Mapping[str, str]) -> None:
    """Check parts on a worker."""
    with _same_job(job, identity):
        deque(check_parts(job, parts), maxlen=0)


def _estimate(job: BatchJob, parts: Sequence[int], identity: Mapping[str, str]) -> None:
    """Estimate parts on a worker, but for those that a worker which died has finished."""
    with _same_job(job, identity):
        estimate_parts(job, parts)


@contextmanager
def _same_job(job: BatchJob, identity: Mapping[str, str]) -> Iterator[None]:
    """Raise where the worker has another version than the driver, or does not see its files."""
    here = job.identity("")
    if here != identity:
        raise ValueError(
            f"all machines must have epi360 {identity['epi360_version']}, the Ray worker on "
            f"{socket.gethostname()} has {here['epi360_version']}"
        )
    try:
        yield
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"{error.filename or error} is not there for the Ray worker on {socket.gethostname()}; "
            "all machines of the cluster must see input and output"
        ) from error


def _raise_failure(ray: Any, finished: Any, parts: Sequence[int]) -> None:
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
            f"Ray gave up part {parts[0]} after {_MAX_RETRIES + 1} tries, its workers died "
            f"({type(error).__name__}); finished parts are kept"
        ) from error


def _with_absolute_paths(job: BatchJob) -> BatchJob:
    """Job as a worker understands it, whose current folder is another one."""
    names = [name for name in ("path", "camera", "features", "pairs") if getattr(job.source, name)]
    paths: dict[str, Any] = {name: _absolute(getattr(job.source, name)) for name in names}
    return replace(job, source=replace(job.source, **paths), output=_absolute(job.output))


def _absolute(path: str) -> str:
    return path if "://" in path else os.path.abspath(path)
