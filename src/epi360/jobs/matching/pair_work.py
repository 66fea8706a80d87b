# SPDX-License-Identifier: BSD-3-Clause
"""The work on some images and pairs of a match run, which any machine may do."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from epi360.cameras import Camera
from epi360.cameras.upright import gravity_of
from epi360.features import Features
from epi360.features.detection import CONTRAST_THRESHOLD, SiftKeypoints
from epi360.features.matching import Look, look
from epi360.jobs.folder.feature_cache import FeatureCache, UnreadableImageError
from epi360.jobs.folder.image_set import SourceImage
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching.verified_matches import Matched, MatchedViews, verified_matches
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict, VerifiedPair, read_part, write_part
from epi360.jobs.threads import on_threads
from epi360.runs.file_digests import FileDigests
from epi360.runs.remote_path import AnyPath
from epi360.second_look import has_hope, is_settled, later_is_better

_IMAGES_IN_MEMORY = 32  # with descriptors of 5 MB
_LOOKS_IN_MEMORY = 1000  # at pairs without hope, of 0.1 MB; a level folder asks for them again


@dataclass(frozen=True, eq=False)
class MatchInputs:
    """Images by their number, and what else a run is made of; another machine understands it.

    With ``upright_deg``, all images are panoramas that stand upright to so many degrees (one
    sigma). ``keys`` are those of the key points in the cache, as far as they are known.
    """

    images: Mapping[int, SourceImage]
    cameras: Mapping[int, Camera]
    keys: dict[int, str]
    output: AnyPath  # a folder that `open_output` made
    cache: FeatureCache
    seed: int
    upright_deg: float | None

    def only(self, indices: Collection[int]) -> MatchInputs:
        """What a machine with another current folder needs to know of these images."""
        images = {
            index: replace(
                image, path=image.path.absolute(), mask=image.mask and image.mask.absolute()
            )
            for index in indices
            for image in (self.images[index],)
        }
        cache = replace(self.cache, folder=self.cache.folder.absolute(), digests=FileDigests())
        return replace(
            self,
            images=images,
            cameras={index: self.cameras[index] for index in images},
            keys={index: self.keys[index] for index in images},
            output=self.output.absolute(),
            cache=cache,
        )


class Written(NamedTuple):
    """Parts that were written: their names, and the verdicts in them."""

    files: list[str]
    verdicts: list[tuple[Keys, Verdict]]


class PairWork:
    """Finds key points, matches and verifies pairs; ``unreadable`` says which images cannot be."""

    def __init__(self, inputs: MatchInputs, num_threads: int) -> None:
        self.inputs = inputs
        self.num_threads = num_threads
        self.unreadable: dict[str, str] = {}  # reason by name
        if inputs.upright_deg is not None:
            self._gravity = {
                index: gravity_of(inputs.cameras[index], image.down, image.name)
                for index, image in inputs.images.items()
            }
        self._finding_again = Lock()
        self._first_looks: dict[Pair, Look] = {}  # of the pairs in work
        self._left_looks: dict[Pair, Look] = {}  # of those that were left without hope
        self._features_of = lru_cache(_IMAGES_IN_MEMORY)(self._load_features)

    def find_key(self, index: int) -> None:
        """Find the key of the key points of an image."""
        inputs = self.inputs
        with self._noting_unreadable(index):
            inputs.keys[index] = inputs.cache.key(inputs.images[index], inputs.cameras[index])

    def find_features(self, index: int) -> None:
        """Find the key points of an image, whose key is known."""
        with self._noting_unreadable(index):
            self._extract(index)

    def verify_parts(self, parts: Sequence[Sequence[Pair]]) -> Written:
        """Verify pairs and keep each part in a file; images may turn out to be unreadable."""
        done = {each.keys: each for each in self._verified([p for part in parts for p in part])}
        by_part = [
            [done[k] for pair in part if (k := self.keys_of(pair)) in done] for part in parts
        ]
        files = [write_part(self.inputs.output, found) for found in by_part if found]
        return Written(files, [(keys, each.verdict) for keys, each in done.items()])

    def verify_part_again(self, name: str, wanted: Mapping[Keys, Pair], level: Level) -> Written:
        """Verify some pairs of a part with the prior of a level folder, and keep them in a file.

        They are made from the matches that `verify_parts` has left.
        """
        pairs = read_part(self.inputs.output, name)
        missing = {wanted[pair.keys]: pair for pair in pairs if pair.keys in wanted}
        done = self._verified_with_prior(missing, level)
        files = [write_part(self.inputs.output, done, level.store)] if done else []
        return Written(files, [(each.keys, each.verdict) for each in done])

    def is_readable(self, pair: Pair) -> bool:
        """Whether both images could be used so far."""
        return not any(self.inputs.images[index].name in self.unreadable for index in pair)

    def keys_of(self, pair: Pair) -> Keys:
        """Keys of the key points of two readable images."""
        return self.inputs.keys[pair[0]], self.inputs.keys[pair[1]]

    @contextmanager
    def _noting_unreadable(self, index: int) -> Iterator[None]:
        try:
            yield
        except UnreadableImageError as error:
            self.unreadable[self.inputs.images[index].name] = str(error)

    def _verified(self, pairs: Sequence[Pair]) -> list[VerifiedPair]:
        """Finished pairs; those of images that turned out to be unreadable are missing."""
        found = self._look(pairs, strong=True)
        unsettled = [
            pair
            for pair, each in found.items()
            if not is_settled(each.verdict.status, each.verdict.warnings)
        ]
        hopeful = [pair for pair in unsettled if self._asks_for_more(pair, found[pair].verdict)]
        for pair, each in self._look(hopeful, strong=False).items():
            if later_is_better(found[pair].verdict.status, each.verdict.status):
                found[pair] = each
        self._forget_looks(set(unsettled) - set(hopeful))
        return [found[pair] for pair in pairs if pair in found and self.is_readable(pair)]

    def _asks_for_more(self, pair: Pair, first: Verdict) -> bool:
        """Whether all key points shall be matched where the stronger ones settle nothing."""
        if has_hope(first.status, first.probability) or self.inputs.upright_deg is not None:
            return True
        sides = [self._features_or_none(index) for index in pair]
        return any(side is None or 2 * len(side[1]) < len(side[0]) for side in sides)

    def _forget_looks(self, kept: Collection[Pair]) -> None:
        """Forget the first looks but those that a level folder may ask for, the newest of them."""
        looks = [(pair, seen) for pair, seen in self._first_looks.items() if pair in kept]
        before = [(pair, seen) for pair, seen in self._left_looks.items() if pair not in kept]
        self._left_looks = dict((before + looks)[-_LOOKS_IN_MEMORY:])
        self._first_looks.clear()

    def _look(self, pairs: Sequence[Pair], *, strong: bool) -> dict[Pair, VerifiedPair]:
        """Match and verify pairs, with the stronger key points or with all."""
        work = partial(self._matched, strong=strong)
        # Each of our threads multiplies descriptors. With threads of its own in each of them, BLAS
        # waits in loops for the others: 0.13 s of processor time a pair in place of 0.05.
        with threadpool_limits(1, user_api="blas"):
            found = dict(on_threads(work, pairs, self.num_threads))
        matched = [(pair, each) for pair in pairs if (each := found[pair]) is not None]
        prior = "" if self.inputs.upright_deg is None else "upright"
        return self.estimated(matched, prior, **self.given_of([pair for pair, _ in matched]))

    def _verified_with_prior(
        self, finished: Mapping[Pair, VerifiedPair], level: Level
    ) -> list[VerifiedPair]:
        """Estimate pairs again from the matches that they have, or of all key points."""
        items = list(finished.items())
        with threadpool_limits(1, user_api="blas"):
            found = dict(on_threads(self._placed, items, self.num_threads))
        matched = [(item[0], each) for item in items if (each := found[item]) is not None]
        results = self.estimated(
            matched,
            level.prior,
            **level.known,
        )
        return [pair for images, pair in results.items() if self.is_readable(images)]

    def given_of(self, pairs: Sequence[Pair]) -> dict[str, Any]:
        """What was given about pairs: that their images stand upright, if it was."""
        if self.inputs.upright_deg is None:
            return {}
        return {
            "gravity1": [self._gravity[pair[0]] for pair in pairs],
            "gravity2": [self._gravity[pair[1]] for pair in pairs],
            "gravity_sigma_deg": self.inputs.upright_deg,
        }

    def estimated(
        self, matched: Sequence[tuple[Pair, Matched]], prior: str, **known: Any
    ) -> dict[Pair, VerifiedPair]:
        """Verify matches, with what is known of the poses beforehand, also in words."""
        cameras = self.inputs.cameras
        views = [
            MatchedViews(self.keys_of(pair), (cameras[pair[0]], cameras[pair[1]]), each)
            for pair, each in matched
        ]
        found = verified_matches(
            views, prior, seed=self.inputs.seed, num_threads=self.num_threads, **known
        )
        return {pair: each for (pair, _), each in zip(matched, found, strict=True)}

    def _matched(self, pair: Pair, *, strong: bool) -> Matched | None:
        """Match two images; None where one turns out to be unreadable."""
        sides = [self._features_or_none(index) for index in pair]
        if sides[0] is None or sides[1] is None:
            return None
        features1, features2 = (side[1 if strong else 0] for side in sides if side is not None)
        seen = look(features1, features2, None if strong else self._first_looks.get(pair))
        if strong:
            self._first_looks[pair] = seen
        return self._matched_at(pair, features1, features2, seen.matches())

    def _placed(self, finished: tuple[Pair, VerifiedPair]) -> Matched | None:
        """Matches of a finished pair; None where an image turns out to be unreadable."""
        pair, verified = finished
        sides = [self._features_or_none(index) for index in pair]
        if sides[0] is None or sides[1] is None:
            return None
        features1, features2 = (side[0] for side in sides if side is not None)
        matches, verdict = verified.matches, verified.verdict
        num_strong = [len(side[1]) for side in sides if side is not None]
        only_strong = bool((matches < num_strong).all())
        # With what is known of a level folder, all key points may yet do where some left no hope.
        if only_strong and not has_hope(verdict.status, verdict.probability):
            matches = look(features1, features2, self._left_looks.pop(pair, None)).matches()
        return self._matched_at(pair, features1, features2, matches)

    def _matched_at(
        self,
        pair: Pair,
        features1: Features,
        features2: Features,
        matches: NDArray[np.int64],
    ) -> Matched:
        keypoints1 = features1.keypoints[matches[:, 0]]
        keypoints2 = features2.keypoints[matches[:, 1]]
        return Matched(
            matches,
            self.inputs.cameras[pair[0]].bearings_from_pixels(keypoints1),
            self.inputs.cameras[pair[1]].bearings_from_pixels(keypoints2),
        )

    def _features_or_none(self, index: int) -> tuple[Features, Features] | None:
        name = self.inputs.images[index].name
        if name in self.unreadable:
            return None
        try:
            return self._features_of(index)
        except UnreadableImageError as error:
            self.unreadable[name] = str(error)
            return None

    def bearings_of(self, index: int) -> NDArray[np.float64]:
        """Where the key points of an image look, the strongest first."""
        keypoints = self._features_of(index)[0].keypoints
        return self.inputs.cameras[index].bearings_from_pixels(keypoints)

    def descriptors(self, index: int) -> NDArray[np.float32]:
        """Descriptors (N, 128) of an image, strongest first; none where it cannot be read."""
        features = self._features_or_none(index) if index in self.inputs.keys else None
        return np.zeros((0, 128), np.float32) if features is None else features[0].descriptors

    def _load_features(self, index: int) -> tuple[Features, Features]:
        """All features of an image and the stronger ones; found again if their file is damaged."""
        keypoints = self.inputs.cache.load(self.inputs.keys[index])
        if keypoints is None:
            with self._finding_again:  # one thread for a file
                keypoints = self.inputs.cache.load(self.inputs.keys[index]) or self._extract(index)
        everything = keypoints.features()
        return everything, everything.first(keypoints.num_above(CONTRAST_THRESHOLD))

    def _extract(self, index: int) -> SiftKeypoints:
        inputs = self.inputs
        return inputs.cache.extract(inputs.keys[index], inputs.images[index], inputs.cameras[index])
