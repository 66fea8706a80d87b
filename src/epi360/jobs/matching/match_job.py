# SPDX-License-Identifier: BSD-3-Clause
"""The state of `match_images`: key points of images, then pairs, part by part."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.features.warped_patches import Panorama
from epi360.jobs.folder.panoramas import read_panorama
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching.kept_estimates import Asked, KeptEstimates, Told
from epi360.jobs.matching.match_engines import MatchEngine
from epi360.jobs.matching.pair_work import PairWork
from epi360.jobs.matching.verified_matches import Matched
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import (
    PAIRS,
    Keys,
    Verdict,
    VerifiedPair,
    keys_by_part,
    read_parts,
)
from epi360.jobs.threads import on_threads
from epi360.progress import Progress

# A few seconds of work of one core, what a kill may cost it. Also a task of a cluster: the parts,
# and with them the bytes of the output, must not depend on the number of threads.
PAIRS_PER_PART = 32


class MatchJob:
    """What is known and done so far; an engine does the work.

    ``progress`` is told of the stages "images", "features", "pairs", "level pairs", "places",
    "rival poses" and "second poses".
    """

    def __init__(self, work: PairWork, engine: MatchEngine, progress: Progress) -> None:
        self.work = work
        self.output = work.inputs.output
        self.images = work.inputs.images
        self.keys = work.inputs.keys
        self.unreadable = work.unreadable
        self.engine = engine
        self.progress = progress
        self.gone: dict[str, str] = {}  # images that could be read before, and why not any more
        self._estimates = KeptEstimates(self.output, self.keys_of)

    def find_features(self, wanted: Sequence[int]) -> None:
        """Find the key points of images, where they are not known."""
        work, cache = self.work, self.work.inputs.cache
        self._told(on_threads(work.find_key, wanted, work.num_threads), "images", 0, len(wanted))
        cache.digests.save()
        contents = {key: index for index, key in self.keys.items()}  # equal images: once
        there = dict(on_threads(cache.has, list(contents), work.num_threads))
        missing = [index for key, index in contents.items() if not there[key]]
        num_there = len(contents) - len(missing)
        found = self.engine.find_features(missing)
        self._told(found, "features", num_there, len(contents))

    def verify(self, pairs: Sequence[Pair]) -> tuple[dict[Keys, Verdict], int]:
        """Verdicts of the pairs by their keys, and how many of them were there."""
        wanted = {self.keys_of(pair) for pair in pairs if self.is_readable(pair)}
        finished = {
            pair.keys: pair.verdict for pair in read_parts(self.output) if pair.keys in wanted
        }
        num_found = len(finished)
        self.progress("pairs", num_found, len(wanted))
        # Equal images have equal keys: if one of them turns out to be unreadable, another is taken.
        while missing := self._missing(pairs, finished):
            self._verify_missing(missing, finished, len(wanted))
        return finished, num_found

    def _missing(self, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict]) -> list[Pair]:
        """One readable pair for each pair of keys that is not finished."""
        readable = {self.keys_of(pair): pair for pair in pairs if self.is_readable(pair)}
        return [pair for keys, pair in readable.items() if keys not in finished]

    def _verify_missing(
        self, missing: Sequence[Pair], finished: dict[Keys, Verdict], total: int
    ) -> None:
        # In the order of the pairs, in which neighbours share an image. Parts may be finished in
        # any order: what a stopped run has left to do is cut at the same places.
        starts = range(0, len(missing), PAIRS_PER_PART)
        parts = [missing[start : start + PAIRS_PER_PART] for start in starts]
        num_done = len(finished)
        for tried, found in self.engine.verify(parts):
            finished.update(found)
            num_done += tried
            self.progress("pairs", num_done, total)

    def verify_again(self, wanted: Mapping[Keys, Pair], level: Level) -> dict[Keys, Verdict]:
        """Verdicts with the prior of a level folder on wanted pairs.

        They are made from the matches that `verify` has left.
        """
        again = {
            pair.keys: pair.verdict
            for pair in read_parts(self.output, level.store)
            if pair.keys in wanted
        }
        self.progress("level pairs", len(again), len(wanted))
        if len(again) < len(wanted):
            parts = self._asked_again(wanted, again)
            for found in self.engine.verify_again(parts, level):
                again.update(found)
                self.progress("level pairs", len(again), len(wanted))
        return again

    def _asked_again(
        self, wanted: Mapping[Keys, Pair], again: Collection[Keys]
    ) -> dict[str, dict[Keys, Pair]]:
        """Names of parts with those of their pairs that are still to be verified again."""
        left = {keys: pair for keys, pair in wanted.items() if keys not in again}
        parts = {}
        for name, keys in keys_by_part(self.output):
            if here := {each: left.pop(each) for each in keys if each in left}:
                parts[name] = here
        return parts

    def settled_pairs(
        self, wanted: Container[Keys], settled: Mapping[Keys, Verdict], level: Level | None
    ) -> Iterator[VerifiedPair]:
        """Wanted pairs with their matches, from the parts that hold the verdicts that count."""
        stores = {PAIRS: ""} if level is None else {PAIRS: "", level.store: level.prior}
        for store, prior in stores.items():
            for verified in read_parts(self.output, store):
                if verified.keys not in wanted:
                    continue
                has_prior = level is not None and settled[verified.keys].prior == level.prior
                if has_prior == bool(prior):
                    yield verified

    def estimated(
        self, matched: Sequence[tuple[Pair, Matched]], prior: str, level: Level | None
    ) -> dict[Pair, VerifiedPair]:
        """Verify some matches of pairs, with the prior of a level folder, or what was given.

        ``prior`` says in words how they were chosen. What is found is kept.
        """

        def estimate(asked: Asked) -> Told:
            given = self.work.given_of([pair for pair, _ in asked])
            return self.work.estimated(asked, prior, **(given if level is None else level.known))

        return self._estimates.estimated(matched, prior, level, estimate)

    @property
    def num_threads(self) -> int:
        """Threads of this machine that may work."""
        return self.work.num_threads

    def name_of(self, index: int) -> str:
        """Name of an image."""
        return self.images[index].name

    def panorama_of(self, index: int) -> Panorama:
        """What an image shows all around; OSError or ValueError where it cannot be read now."""
        nadir_deg = self.work.inputs.cache.options.mask_nadir_deg
        try:
            return read_panorama(self.images[index], self.camera_of(index), nadir_deg)
        except (OSError, ValueError) as error:
            self.gone[self.name_of(index)] = str(error)
            raise

    def camera_of(self, index: int) -> Camera:
        """Camera of an image."""
        return self.work.inputs.cameras[index]

    def is_readable(self, pair: Pair) -> bool:
        """Whether both images could be used so far."""
        return self.work.is_readable(pair)

    def keys_of(self, pair: Pair) -> Keys:
        """Keys of the key points of two readable images."""
        return self.work.keys_of(pair)

    def bearings_of(self, index: int) -> NDArray[np.float64]:
        """Where the key points of an image look, the strongest first."""
        return self.work.bearings_of(index)

    def readable_keys(self) -> dict[str, str]:
        """Key of the key points of each image that has some, by its name."""
        named = {self.images[index].name: key for index, key in self.keys.items()}
        return {name: key for name, key in named.items() if name not in self.unreadable}

    def descriptors(self, index: int) -> NDArray[np.float32]:
        """Descriptors (N, 128) of an image, strongest first; none where it cannot be read."""
        return self.work.descriptors(index)

    def _told(self, done: Iterable[object], stage: str, before: int, total: int) -> None:
        """Tell the progress of each image that is done."""
        self.progress(stage, before, total)
        for count, _ in enumerate(done, start=1):
            self.progress(stage, before + count, total)
