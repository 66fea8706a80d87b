# SPDX-License-Identifier: BSD-3-Clause
"""The parts of a batch on Ray, on this machine or on a cluster.

Plain tasks and not Ray Data: a worker reads its parts where the matches are and writes its files
where the output is, so nothing but the numbers of parts passes through Ray, and a restart finds
the same parts whichever engine made them. Ray Data would choose blocks of its own, hold the matches
in its object store and know nothing of parts that are there.
"""

from __future__ import annotations

import math
import os
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

from epi360.jobs.batch.inputs import open_matches
from epi360.jobs.batch.job import BatchJob, check_parts, estimate_parts
from epi360.jobs.ray_tasks import (
    check_is_seen,
    finished_tasks,
    import_ray,
    num_cpus,
    on_worker,
    ray_session,
)
from epi360.progress import Progress


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
    epi360; see `ray_session` for the ``address``. ``progress`` gets ("checked pairs", done, all of
    these parts), then ("pairs", done, total), after each task.

    If a row cannot be used, nothing is estimated. Finished parts stay where a file cannot be read
    or written, the cluster does not answer, or a worker dies again and again (OSError).
    """
    ray = import_ray("batches on Ray")
    with open_matches(job.source) as matches:
        sizes, groups = matches.part_sizes, matches.part_groups
    job = _with_absolute_paths(job)
    with ray_session(ray, address):
        tasks = _tasks(parts, groups, num_cpus(ray))
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


def _tasks(parts: Sequence[int], groups: Sequence[int], cpus: int) -> list[list[int]]:
    """Parts of each task, neighbours in one group.

    A task reads over the parts of its group that come before its own. If each of n parts is a task,
    the group is read n / 2 times; if a task has as many parts as the square root of n, it is read
    half that root times. But each CPU should get two tasks.
    """
    tasks, sizes = [], Counter(groups)
    for group, members in groupby(parts, key=lambda part: groups[part]):
        missing, num_parts = list(members), sizes[group]
        size = max(1, min(math.isqrt(num_parts), num_parts // (2 * cpus)))
        tasks += [missing[first : first + size] for first in range(0, len(missing), size)]
    return tasks


def _finished_tasks(
    ray: Any, work: Callable[..., None], job: BatchJob, tasks: Sequence[list[int]]
) -> Iterator[list[int]]:
    """Run the tasks; yields the parts of each when it has ended."""
    identity = job.identity("")
    calls = ((job, parts, identity) for parts in tasks)
    for (_, parts, _), _ in finished_tasks(ray, work, calls, lambda call: f"part {call[1][0]}"):
        yield parts


def _find_files(job: BatchJob, parts: Sequence[int]) -> None:
    for path in map(job.part_path, parts):
        check_is_seen(path)


def _check(job: BatchJob, parts: Sequence[int], identity: Mapping[str, str]) -> None:
    """Check parts on a worker."""
    with on_worker(identity, job.identity("")):
        deque(check_parts(job, parts), maxlen=0)


def _estimate(job: BatchJob, parts: Sequence[int], identity: Mapping[str, str]) -> None:
    """Estimate parts on a worker, but for those that a worker which died has finished."""
    with on_worker(identity, job.identity("")):
        estimate_parts(job, parts)


def _with_absolute_paths(job: BatchJob) -> BatchJob:
    """Job as a worker understands it, whose current folder is another one."""
    names = [name for name in ("path", "camera", "features", "pairs") if getattr(job.source, name)]
    paths: dict[str, Any] = {name: _absolute(getattr(job.source, name)) for name in names}
    return replace(job, source=replace(job.source, **paths), output=_absolute(job.output))


def _absolute(path: str) -> str:
    return path if "://" in path else os.path.abspath(path)
