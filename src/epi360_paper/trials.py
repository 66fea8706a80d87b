# SPDX-License-Identifier: BSD-3-Clause
"""Many random trials on several processes: finished parts are kept, the numbers do not change.

A trial draws from generators seeded by (seed, experiment, cell, trial), so that neither the number
of workers nor an interruption changes a number. A part is a chunk of trials of one cell.
"""

import os
import signal
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np

from epi360.extras import package_version
from epi360.progress import Progress, no_progress
from epi360.runs.interrupts import interrupted_later
from epi360_paper.options import ReproduceOptions
from epi360_paper.parts import Fingerprint, Row, Trials, join_parts, read_part, write_part

# Libraries that NumPy and OpenCV may be built on read these when they load: each worker is one
# thread, so that J workers use J cores.
THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

# In the seed of what all cells share, this stands for the cell; no experiment has as many.
SHARED_CELL = 2**32 - 1


@dataclass(frozen=True)
class Trial:
    """One trial of an experiment and its random numbers."""

    seed: int  # seed of the run
    name: str  # name of the experiment
    cell: int  # index of the cell
    index: int  # index of the trial in its cell

    def rng(self) -> np.random.Generator:
        """Generator of this trial of this cell."""
        return _generator(self.seed, zlib.crc32(self.name.encode()), self.cell, self.index)

    def scene_rng(self) -> np.random.Generator:
        """Generator of this trial that is the same in all cells, so that they share a scene."""
        return _generator(self.seed, zlib.crc32(self.name.encode()), SHARED_CELL, self.index)


TrialFunction = Callable[[Any, Trial], Row | Sequence[Row]]


@dataclass(frozen=True)
class _Chunk:
    path: Path
    fingerprint: Fingerprint
    function: TrialFunction
    value: Any
    cell: int
    first: int
    stop: int

    def compute(self) -> int:
        """Number of trials, which are then in the file."""
        began = time.process_time()
        rows: list[Row] = []
        for index in range(self.first, self.stop):
            trial = Trial(self.fingerprint.seed, self.fingerprint.name, self.cell, index)
            result = self.function(self.value, trial)
            results = [result] if isinstance(result, Mapping) else result
            place: Row = {"cell": self.fingerprint.cell, "trial": index}
            rows.extend({**place, **row} for row in results)
        write_part(self.path, self.fingerprint, rows, seconds=time.process_time() - began)
        return self.stop - self.first


def run_trials(
    name: str,
    cells: Mapping[str, Any],
    trial_function: TrialFunction,
    num_trials: int,
    options: ReproduceOptions,
    progress: Progress = no_progress,
    *,
    chunk_size: int = 100,
    settings: str = "",
) -> Trials:
    """Results of all trials, in the order of cells and trials; finished parts are kept."""
    # trial_function(value, trial) gives one row or several, with the same columns in all cells. It
    # is a function of a module and the values of the cells are picklable: both are sent to other
    # processes. The ``repr`` of a value must say what it is: parts of another are refused.
    # Columns that start with "time_" are measured: only they change from run to run.
    folder = options.folder(name) / "parts"
    chunks = [
        _Chunk(
            path=folder / f"{key}_{first:06d}-{min(first + chunk_size, num_trials):06d}.csv",
            fingerprint=_fingerprint(name, key, value, options, settings),
            function=trial_function,
            value=value,
            cell=cell,
            first=first,
            stop=min(first + chunk_size, num_trials),
        )
        for cell, (key, value) in enumerate(cells.items())
        for first in range(0, num_trials, chunk_size)
    ]
    missing = [chunk for chunk in chunks if read_part(chunk.path, chunk.fingerprint) is None]
    folder.mkdir(parents=True, exist_ok=True)
    total = len(cells) * num_trials
    done = total - sum(chunk.stop - chunk.first for chunk in missing)
    progress(name, done, total)
    for computed in _compute(missing, min(options.num_workers, len(missing))):
        done += computed
        progress(name, done, total)
    return join_parts([(chunk.path, chunk.fingerprint) for chunk in chunks])


def _fingerprint(
    name: str, key: str, value: Any, options: ReproduceOptions, settings: str
) -> Fingerprint:
    return Fingerprint(
        name=name,
        protocol=options.protocol,
        seed=options.seed,
        version=package_version(),
        cell=key,
        value=repr(value),
        settings=settings,
    )


def _compute(chunks: Sequence[_Chunk], num_workers: int) -> Iterator[int]:
    if num_workers <= 1:
        for chunk in chunks:
            yield chunk.compute()
        return
    with _one_thread_each(), _workers(num_workers) as pool:
        with without_interrupts():  # submitting starts the workers
            futures: list[Future[int]] = [pool.submit(chunk.compute) for chunk in chunks]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BrokenProcessPool as error:
            raise ChildProcessError(
                "a worker process was killed, perhaps for its memory; finished trials are kept: "
                "run it again with fewer --jobs"
            ) from error


@contextmanager
def _workers(num_workers: int) -> Iterator[ProcessPoolExecutor]:
    """Pool of processes that ends at once when its user is interrupted or fails."""
    before = set(active_children())
    # Spawned, not forked: the same on all systems, and safe beside the threads of this process.
    pool = ProcessPoolExecutor(num_workers, get_context("spawn"), initializer=_leave_interrupts)
    try:
        yield pool
    except BaseException:
        for process in set(active_children()) - before:
            process.terminate()
        # Without waiting, the end of Python would wake a thread that is closing what wakes it.
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Ctrl-C waits for the end of this; processes started in it never get it, even while loading.

    They inherit what this thread blocks, and can ignore it themselves only when they have loaded.
    Another thread of this process, such as one of a library, may be the one that gets it; so it is
    put off here as well.
    """
    with interrupted_later():
        if sys.platform == "win32":
            yield
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _leave_interrupts() -> None:
    """Ctrl-C reaches the whole group of processes; the first one answers it for all."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Environment in which new processes compute on one thread."""
    before = {name: os.environ.get(name) for name in THREAD_LIMITS}
    os.environ.update(dict.fromkeys(THREAD_LIMITS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _generator(*entropy: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))
