# SPDX-License-Identifier: BSD-3-Clause
"""The work of `match_images` on Ray: an image, or a part of the pairs, is a task of one CPU.

A worker reads the images where the driver does and writes features and parts into the output. What
goes through Ray are the names and cameras of the images, and the verdicts without their matches.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import cv2

from epi360.extras import package_version
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching.match_engines import Found
from epi360.jobs.matching.pair_work import MatchInputs, PairWork, Written
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.ray_tasks import Call, check_is_seen, finished_tasks, on_worker
from epi360.jobs.records.match_store import PAIRS, Keys
from epi360.runs import storage
from epi360.runs.remote_path import AnyPath

Unreadable = dict[str, str]  # reason by name


class RayEngine:
    """A Ray session, which ``connect`` opens when there is something to do."""

    def __init__(self, work: PairWork, connect: Callable[[], Any]) -> None:
        self._work = work
        self._ray = cache(connect)

    def find_features(self, indices: Sequence[int]) -> Iterator[object]:
        """Find the key points of each image in a task."""
        inputs = self._work.inputs
        calls = ((inputs.only([index]), index) for index in indices)
        for (_, index, _), unreadable in self._finished(_find_features, calls):
            self._work.unreadable.update(unreadable)
            if not unreadable:
                check_is_seen(str(inputs.cache.path(inputs.keys[index])))
            yield index

    def verify(self, parts: Sequence[Sequence[Pair]]) -> Iterator[tuple[int, Found]]:
        """Verify each part in a task."""
        calls = ((self._only(part), part) for part in parts)
        for (_, part, _), (written, unreadable) in self._finished(_verify, calls):
            yield len(part), self._seen(written, unreadable, PAIRS)

    def verify_again(
        self, parts: Mapping[str, Mapping[Keys, Pair]], level: Level
    ) -> Iterator[Found]:
        """Verify the pairs of each part in a task."""
        calls = (
            (self._only(wanted.values()), (name, wanted, level)) for name, wanted in parts.items()
        )
        for _, (written, unreadable) in self._finished(_verify_again, calls):
            yield self._seen(written, unreadable, level.store)

    def _only(self, pairs: Iterable[Pair]) -> MatchInputs:
        return self._work.inputs.only(sorted({index for pair in pairs for index in pair}))

    def _seen(self, written: Written, unreadable: Unreadable, store: str) -> Found:
        """What a worker has found, whose files this machine sees."""
        self._work.unreadable.update(unreadable)
        for name in written.files:
            check_is_seen(str(self._work.inputs.output / store / name))
        return written.verdicts

    def _finished(
        self, work: Callable[..., Any], calls: Iterable[Call]
    ) -> Iterator[tuple[Call, Any]]:
        versions = _versions()
        told = ((*call, versions) for call in calls)
        return finished_tasks(self._ray(), work, told, _name)


def _name(call: Call) -> str:
    names = [image.name for image in call[0].images.values()]
    return names[0] if len(names) == 1 else f"pairs of {names[0]} to {names[-1]}"


def _versions() -> dict[str, str]:
    """What must be the same everywhere: a key says which OpenCV has found the key points."""
    return {"epi360_version": package_version(), "opencv_version": cv2.__version__}


def _find_features(inputs: MatchInputs, index: int, versions: Mapping[str, str]) -> Unreadable:
    """Find the key points of an image on a worker."""
    with _worker(inputs, versions) as work:
        # Not an image that cannot be read: the driver has just read it.
        _check_exist([inputs.images[index].path])
        work.find_features(index)
        return work.unreadable


def _verify(
    inputs: MatchInputs, pairs: Sequence[Pair], versions: Mapping[str, str]
) -> tuple[Written, Unreadable]:
    """Verify a part on a worker."""
    with _worker(inputs, versions) as work:
        _check_exist([inputs.cache.path(key) for key in inputs.keys.values()])
        return work.verify_parts([pairs]), work.unreadable


def _verify_again(
    inputs: MatchInputs,
    asked: tuple[str, Mapping[Keys, Pair], Level],
    versions: Mapping[str, str],
) -> tuple[Written, Unreadable]:
    """Verify the pairs of a part again on a worker."""
    with _worker(inputs, versions) as work:
        _check_exist([inputs.output / PAIRS / asked[0]])
        return work.verify_part_again(*asked), work.unreadable


@contextmanager
def _worker(inputs: MatchInputs, versions: Mapping[str, str]) -> Iterator[PairWork]:
    """Work of a worker, on one core: OpenCV would take all in each task."""
    num_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with on_worker(versions, _versions()):
            yield PairWork(inputs, 1)
    finally:
        cv2.setNumThreads(num_threads)


def _check_exist(paths: Iterable[AnyPath]) -> None:
    for path in paths:
        if not storage.exists(str(path)):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
