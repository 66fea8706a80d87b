# SPDX-License-Identifier: BSD-3-Clause
"""The work of `match_images`: key points of images, then pairs, part by part, on all threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from epi360.cameras import Camera
from epi360.cameras.upright import DOWN, gravity_of, is_full_panorama
from epi360.estimation import RelativePoseResult, estimate_relative_poses
from epi360.estimation.verdict import noise_in_pixels
from epi360.features import Features
from epi360.features.detection import CONTRAST_THRESHOLD, SiftKeypoints
from epi360.features.matching import Look, look
from epi360.jobs.feature_cache import FeatureCache, UnreadableImageError
from epi360.jobs.image_set import ImageSet, SourceImage
from epi360.jobs.level_folder import Level
from epi360.jobs.match_store import (
    Keys,
    Verdict,
    VerifiedPair,
    pairs_by_part,
    read_parts,
    write_part,
)
from epi360.jobs.pair_selection import Pair
from epi360.poses import Pose
from epi360.progress import Progress
from epi360.second_look import is_settled, later_is_better
from epi360.two_view import IMAGE_OPTIONS, MAX_NOISE_PX, smallest_pixel_deg

_PAIRS_PER_THREAD = 16  # in a part: a few seconds of work, what a kill may cost
_IMAGES_IN_MEMORY = 32  # with descriptors of 5 MB
_BELOW_HORIZON = np.sin(np.radians(5.0))  # y of what a level camera sees five degrees below it
Item = TypeVar("Item", bound=Hashable)
Result = TypeVar("Result")


class MatchJob:
    """State of a run: keys of the images, and which images turned out to be unreadable.

    ``output`` is a folder that `open_output` made. With ``upright_deg``, all images are panoramas
    that stand upright to so many degrees (one sigma). ``progress`` is told of the stages "images",
    "features", "pairs", "level pairs" and "places".
    """

    def __init__(
        self,
        images: ImageSet,
        output: Path,
        cache: FeatureCache,
        *,
        seed: int,
        num_threads: int | None,
        progress: Progress,
        upright_deg: float | None = None,
    ) -> None:
        self.images: Sequence[SourceImage] = images.images
        self.cameras: list[Camera] = [images.cameras[image.camera] for image in images.images]
        self.output = output
        self.cache = cache
        self.seed = seed
        self.upright_deg = upright_deg
        if upright_deg is not None:
            self._gravity = [
                gravity_of(camera, image.down, image.name)
                for image, camera in zip(self.images, self.cameras, strict=True)
            ]
        self.num_threads = num_threads or _num_cores()
        self.progress = progress
        self.keys: dict[int, str] = {}
        self.unreadable: dict[str, str] = {}
        self._finding_again = Lock()
        self._first_looks: dict[Pair, Look] = {}  # of the pairs in work
        self._features_of = lru_cache(_IMAGES_IN_MEMORY)(self._load_features)

    def find_features(self, wanted: Sequence[int]) -> None:
        """Find the key points of images, where they are not known."""

        def find_key(index: int) -> None:
            self.keys[index] = self.cache.key(self.images[index], self.cameras[index])

        self._for_each_image(wanted, find_key, "images", 0)
        self.cache.digests.save()
        contents = {key: index for index, key in self.keys.items()}  # equal images: once
        missing = [index for key, index in contents.items() if not self.cache.has(key)]
        self._for_each_image(missing, self._extract, "features", len(contents) - len(missing))

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
        num_before = len(finished)
        step = _PAIRS_PER_THREAD * self.num_threads
        for start in range(0, len(missing), step):
            done = self._verified(missing[start : start + step])
            if done:
                write_part(self.output, done)
            finished.update((pair.keys, pair.verdict) for pair in done)
            self.progress("pairs", num_before + min(start + step, len(missing)), total)

    def verify_again(
        self, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict], level: Level
    ) -> dict[Keys, Verdict]:
        """Verdicts with the prior of a level folder on the pairs that ask for it.

        They are made from the matches that `verify` has left.
        """
        usable = [pair for pair in pairs if self.is_readable(pair) and self.sees_all_around(pair)]
        by_keys = {self.keys_of(pair): pair for pair in usable}
        wanted = {keys: pair for keys, pair in by_keys.items() if level.asks_again(finished[keys])}
        again = {
            pair.keys: pair.verdict
            for pair in read_parts(self.output, level.store)
            if pair.keys in wanted
        }
        self.progress("level pairs", len(again), len(wanted))
        for part in pairs_by_part(self.output) if len(again) < len(wanted) else ():
            missing = {
                wanted[pair.keys]: pair
                for pair in part
                if pair.keys in wanted and pair.keys not in again
            }
            done = self._verified_with_prior(missing, level) if missing else []
            if done:
                write_part(self.output, done, level.store)
            again.update((pair.keys, pair.verdict) for pair in done)
            self.progress("level pairs", len(again), len(wanted))
        return again

    def sees_all_around(self, pair: Pair) -> bool:
        """Whether both images are full panoramas."""
        return all(is_full_panorama(self.cameras[index]) for index in pair)

    def bearings_of(self, index: int) -> NDArray[np.float64]:
        """Where the key points of an image look, the strongest first."""
        return self.cameras[index].bearings_from_pixels(self._features_of(index)[0].keypoints)

    def readable_keys(self) -> dict[str, str]:
        """Key of the key points of each image that has some, by its name."""
        named = {self.images[index].name: key for index, key in self.keys.items()}
        return {name: key for name, key in named.items() if name not in self.unreadable}

    def _verified(self, pairs: Sequence[Pair]) -> list[VerifiedPair]:
        """Finished pairs; those of images that turned out to be unreadable are missing."""
        found = self._look(pairs, strong=True)
        unsettled = [
            pair
            for pair, each in found.items()
            if not is_settled(each.verdict.status, each.verdict.warnings)
        ]
        for pair, each in self._look(unsettled, strong=False).items():
            if later_is_better(found[pair].verdict.status, each.verdict.status):
                found[pair] = each
        self._first_looks.clear()
        return [found[pair] for pair in pairs if pair in found and self.is_readable(pair)]

    def _look(self, pairs: Sequence[Pair], *, strong: bool) -> dict[Pair, VerifiedPair]:
        """Match and verify pairs, with the stronger key points or with all."""
        work = partial(self._matched, strong=strong)
        # Each of our threads multiplies descriptors. With threads of its own in each of them, BLAS
        # waits in loops for the others: 0.13 s of processor time a pair in place of 0.05.
        with threadpool_limits(1, user_api="blas"):
            found = dict(on_threads(work, pairs, self.num_threads))
        matched = [(pair, each) for pair in pairs if (each := found[pair]) is not None]
        gravity: dict[str, Any] = {}
        if self.upright_deg is not None:
            gravity = {
                "gravity1": [self._gravity[pair[0]] for pair, _ in matched],
                "gravity2": [self._gravity[pair[1]] for pair, _ in matched],
                "gravity_sigma_deg": self.upright_deg,
            }
        prior = "" if self.upright_deg is None else "upright"
        return self._estimated(matched, prior, **gravity)

    def _verified_with_prior(
        self, finished: Mapping[Pair, VerifiedPair], level: Level
    ) -> list[VerifiedPair]:
        """Estimate pairs again from the matches that they have."""
        items = list(finished.items())
        found = dict(on_threads(self._placed, items, self.num_threads))
        matched = [(item[0], each) for item in items if (each := found[item]) is not None]
        results = self._estimated(
            matched,
            level.prior,
            gravity1=DOWN,
            gravity2=DOWN,
            gravity_sigma_deg=level.gravity_sigma_deg,
            elevation_sigma_deg=level.elevation_sigma_deg,
        )
        return [pair for images, pair in results.items() if self.is_readable(images)]

    def _estimated(
        self, matched: Sequence[tuple[Pair, _Matched]], prior: str, **known: Any
    ) -> dict[Pair, VerifiedPair]:
        """Verify matches, with what is known of the poses beforehand."""
        results = estimate_relative_poses(
            [(each.bearings1, each.bearings2) for _, each in matched],
            max_noise_deg=[MAX_NOISE_PX * self._pixel_deg(pair) for pair, _ in matched],
            options=IMAGE_OPTIONS,
            num_threads=self.num_threads,
            seed=self.seed,
            **known,
        )
        return {
            pair: self._verified_pair(pair, each, result, prior)
            for (pair, each), result in zip(matched, results, strict=True)
        }

    def _matched(self, pair: Pair, *, strong: bool) -> _Matched | None:
        """Match two images; None where one turns out to be unreadable."""
        sides = [self._features_or_none(index) for index in pair]
        if sides[0] is None or sides[1] is None:
            return None
        features1, features2 = (side[1 if strong else 0] for side in sides if side is not None)
        seen = look(features1, features2, None if strong else self._first_looks.get(pair))
        if strong:
            self._first_looks[pair] = seen
        return self._matched_at(pair, features1, features2, seen.matches())

    def _placed(self, finished: tuple[Pair, VerifiedPair]) -> _Matched | None:
        """Matches of a finished pair; None where an image turns out to be unreadable."""
        pair, verified = finished
        sides = [self._features_or_none(index) for index in pair]
        if sides[0] is None or sides[1] is None:
            return None
        return self._matched_at(pair, sides[0][0], sides[1][0], verified.matches)

    def _matched_at(
        self,
        pair: Pair,
        features1: Features,
        features2: Features,
        matches: NDArray[np.int64],
    ) -> _Matched:
        keypoints1 = features1.keypoints[matches[:, 0]]
        keypoints2 = features2.keypoints[matches[:, 1]]
        return _Matched(
            matches,
            self.cameras[pair[0]].bearings_from_pixels(keypoints1),
            self.cameras[pair[1]].bearings_from_pixels(keypoints2),
        )

    def _pixel_deg(self, pair: Pair) -> float:
        return smallest_pixel_deg((self.cameras[pair[0]], self.cameras[pair[1]]))

    def _verified_pair(
        self, pair: Pair, matched: _Matched, result: RelativePoseResult, prior: str
    ) -> VerifiedPair:
        result = noise_in_pixels(result, self._pixel_deg(pair))
        variances = np.diag(result.covariance)
        is_placed = self.sees_all_around(pair)
        verdict = Verdict(
            status=result.status,
            warnings=result.warnings,
            num_matches=result.num_matches,
            num_inliers=result.num_inliers,
            noise_deg=result.noise_deg,
            parallax_deg=result.parallax_deg,
            rotation_sigma_deg=float(np.degrees(np.sqrt(variances[:3].sum()))),
            translation_sigma_deg=float(np.degrees(np.sqrt(variances[3:].sum()))),
            probability=result.probability,
            explanations=result.explanations,
            floor_share=matched.floor_share(result.inlier_mask) if is_placed else np.nan,
            prior=prior,
            cam2_from_cam1=result.cam2_from_cam1,
            doubted=_doubted_pose(result),
        )
        return VerifiedPair(self.keys_of(pair), verdict, matched.matches, result.inlier_mask)

    def _features_or_none(self, index: int) -> tuple[Features, Features] | None:
        name = self.images[index].name
        if name in self.unreadable:
            return None
        try:
            return self._features_of(index)
        except UnreadableImageError as error:
            self.unreadable[name] = str(error)
            return None

    def descriptors(self, index: int) -> NDArray[np.float32]:
        """Descriptors (N, 128) of an image, strongest first; none where it cannot be read."""
        features = self._features_or_none(index) if index in self.keys else None
        return np.zeros((0, 128), np.float32) if features is None else features[0].descriptors

    def _load_features(self, index: int) -> tuple[Features, Features]:
        """All features of an image and the stronger ones; found again if their file is damaged."""
        keypoints = self.cache.load(self.keys[index])
        if keypoints is None:
            with self._finding_again:  # one thread for a file
                keypoints = self.cache.load(self.keys[index]) or self._extract(index)
        everything = keypoints.features()
        return everything, everything.first(keypoints.num_above(CONTRAST_THRESHOLD))

    def _extract(self, index: int) -> SiftKeypoints:
        return self.cache.extract(self.keys[index], self.images[index], self.cameras[index])

    def is_readable(self, pair: Pair) -> bool:
        """Whether both images could be used so far."""
        return not any(self.images[index].name in self.unreadable for index in pair)

    def keys_of(self, pair: Pair) -> Keys:
        """Keys of the key points of two readable images."""
        return self.keys[pair[0]], self.keys[pair[1]]

    def _for_each_image(
        self, wanted: Sequence[int], work: Callable[[int], object], stage: str, done: int
    ) -> None:
        """Work on images on all threads, and note those that cannot be read."""

        def attempt(index: int) -> None:
            try:
                work(index)
            except UnreadableImageError as error:
                self.unreadable[self.images[index].name] = str(error)

        total = done + len(wanted)
        self.progress(stage, done, total)
        for count, _ in enumerate(on_threads(attempt, wanted, self.num_threads), start=1):
            self.progress(stage, done + count, total)


DOUBTED = ("concentrated_inliers", "too_few_inliers")  # their poses other pairs may confirm


def _doubted_pose(result: RelativePoseResult) -> Pose:
    if result.status not in DOUBTED or not result.alternatives:
        return Pose.nan()
    return result.alternatives[0]


@dataclass(frozen=True, eq=False)
class _Matched:
    """Matches of two images and where both look."""

    matches: NDArray[np.int64]
    bearings1: NDArray[np.float64]
    bearings2: NDArray[np.float64]

    def floor_share(self, inlier_mask: NDArray[np.bool_]) -> float:
        """Share of the inliers that both images see well below the horizon; NaN without any."""
        if not inlier_mask.any():
            return np.nan
        heights = np.minimum(self.bearings1[inlier_mask, 1], self.bearings2[inlier_mask, 1])
        return float(np.mean(heights > _BELOW_HORIZON))


def on_threads(
    work: Callable[[Item], Result], items: Sequence[Item], num_threads: int
) -> Iterator[tuple[Item, Result]]:
    """Items with their results, as they come; an interrupt waits only for those in work."""
    pool = ThreadPoolExecutor(num_threads)
    try:
        futures = {pool.submit(work, item): item for item in items}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _num_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
