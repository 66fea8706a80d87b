# SPDX-License-Identifier: BSD-3-Clause
"""Tasks on Ray, on this machine or on a cluster: the session, the tasks, what goes wrong.

The workers read and write files where the driver does; hardly anything but names passes through
Ray. Files appear whole, and a task that is done twice writes the same bytes.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from typing import Any

from epi360.extras import extra_library
from epi360.runs import storage
from epi360.runs.made_from import first_difference

# This is also Ray's default: a machine may vanish three times before the task is suspected.
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
Call = tuple[Any, ...]


def import_ray(purpose: str) -> Any:
    """Ray itself, or an ImportError that says how to install it."""
    for name, value in _QUIET.items():  # read when Ray is imported
        os.environ.setdefault(name, value)
    return extra_library("ray", extra="cluster", purpose=purpose)


@contextmanager
def ray_session(ray: Any, address: str | None) -> Iterator[None]:
    """Connect to the cluster or start Ray here, without its banner, logs and dashboard.

    ``address`` is that of a cluster, as `ray.init` takes it; by default that of the environment's
    RAY_ADDRESS, and without it Ray is started on this machine and stopped at the end. A session
    that the process has open already is used instead and stays open.
    """
    address = address or os.environ.get("RAY_ADDRESS") or "local"
    if "://" in address and not address.startswith("ray://"):
        raise ValueError(f"address must be HOST:PORT, ray://HOST:PORT or auto, got {address}")
    if ray.is_initialized():
        yield
        return
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


def num_cpus(ray: Any) -> int:
    """CPUs that the cluster has now."""
    return max(1, int(ray.cluster_resources().get("CPU", 1)))


def finished_tasks(
    ray: Any, work: Callable[..., Any], calls: Iterable[Call], name_of: Callable[[Call], str]
) -> Iterator[tuple[Call, Any]]:
    """Call the work on one CPU each; yields arguments and result of each call when it has ended.

    ``name_of`` names a call in an error. After an error or an interrupt nothing is cancelled: the
    end of the session stops what is left. `ray.cancel` of a task that ends in the same moment ends
    the whole process (seen in Ray 2.60).
    """
    remote = ray.remote(num_cpus=1, max_retries=_MAX_RETRIES)(work)
    waiting = iter(calls)
    running: dict[Any, Call] = {}
    while True:
        # Each CPU that there is now gets two tasks: none waits for us, and an autoscaler sees that
        # more are wanted. Not more than two, as every task in flight costs the driver memory.
        for call in islice(waiting, max(0, 2 * num_cpus(ray) - len(running))):
            running[remote.remote(*call)] = call
        if not running:
            return
        (finished,), _ = ray.wait(list(running))
        call = running.pop(finished)
        yield call, _result(ray, finished, name_of(call))


def check_is_seen(path: str) -> None:
    """Raise where this machine does not see what a worker has written."""
    if not storage.exists(path):
        raise FileNotFoundError(
            f"{path} was written by a worker but is not there for this machine; the output "
            "must be where all machines of the cluster see it"
        )


@contextmanager
def on_worker(wanted: Mapping[str, str], here: Mapping[str, str]) -> Iterator[None]:
    """Raise where the worker has other versions than the driver, or does not see its files."""
    different = first_difference(here, wanted)
    if different is not None:
        raise ValueError(
            f"all machines must have {different.name.removesuffix('_version')} {different.now}, "
            f"the Ray worker on {socket.gethostname()} has {different.before}"
        )
    try:
        yield
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"{error.filename or error} is not there for the Ray worker on {socket.gethostname()}; "
            "all machines of the cluster must see input and output"
        ) from error


def _result(ray: Any, finished: Any, name: str) -> Any:
    """Result of a task, or what it has raised as if it had been raised here."""
    exceptions = ray.exceptions
    try:
        return ray.get(finished)
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
            f"Ray gave up {name} after {_MAX_RETRIES + 1} tries, its workers died "
            f"({type(error).__name__}); finished parts are kept"
        ) from error
