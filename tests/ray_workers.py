# SPDX-License-Identifier: BSD-3-Clause
"""The workers of Ray as processes of this machine, to kill them in the midst of a task."""

import time
from pathlib import Path


def living_processes():
    """Parent of every process; one that has ended and that nobody has asked for is not alive."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
            except OSError:  # it has ended meanwhile
                continue
            if state != "Z":
                parents[int(entry.name)] = int(parent)
    return parents


def descendants(pid):
    parents, found, below = living_processes(), [], {pid}
    while below:
        below = {child for child, parent in parents.items() if parent in below}
        found += below
    return found


def busy_workers(pid, task="_estimate"):
    """Workers below a process that are in the midst of a task whose name begins like this."""

    def title(worker):
        try:
            return Path(f"/proc/{worker}/cmdline").read_bytes()
        except OSError:
            return b""

    begins = f"ray::{task}".encode()
    return [worker for worker in descendants(pid) if title(worker).startswith(begins)]


def wait_until_gone(processes, *, timeout_s=30.0):
    deadline = time.monotonic() + timeout_s
    while living_processes().keys() & processes:
        assert time.monotonic() < deadline, "workers outlive their driver"
        time.sleep(0.05)


def wait_until_idle(pid, task, *, timeout_s=30.0):
    """A driver that has ended leaves tasks that began in its last moment; they end, too."""
    deadline = time.monotonic() + timeout_s
    while busy_workers(pid, task):
        assert time.monotonic() < deadline, "tasks outlive their driver"
        time.sleep(0.05)
