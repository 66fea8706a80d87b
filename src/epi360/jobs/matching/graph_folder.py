# SPDX-License-Identifier: BSD-3-Clause
"""The images of a match graph as a folder whose pairs are verified, in memory."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Container, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.resizing import resized_camera, smallest_pixel_deg
from epi360.epipolar.residuals import pose_residuals
from epi360.estimation.image_matches import MAX_NOISE_PX
from epi360.features.images import read_masked_image
from epi360.features.warped_patches import Panorama, remembered
from epi360.interop.match_graph import MatchGraph, TwoViewGeometry
from epi360.jobs.graph.graph_check import DOUBTED_DIRECTION_DEG, DOUBTED_ROTATION_DEG
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching.agreed_cameras import FEWEST_IMAGES, said_of_cameras
from epi360.jobs.matching.verified_folder import are_usable, is_compared
from epi360.jobs.matching.verified_matches import Matched, MatchedViews, verified_matches
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict, VerifiedPair
from epi360.jobs.threads import on_threads
from epi360.progress import Progress
from epi360.runs.inside import inside

_STAGE_READ, _STAGE, _STAGE_AGAIN = "pictures", "verifying pairs", "level pairs"
_ROUNDING_PX = 1  # of the height of a picture that was made smaller or larger
_PAIRS_AT_ONCE = 256  # whose bearings are in memory
_IMAGES_IN_MEMORY = 64  # with the bearings of all their key points
_MOST_NOISE_PX = 3.0 * MAX_NOISE_PX  # of a pose that somebody else has found
_SIGMAS_OF_MEDIAN = 1.4826  # standard deviation of what has a median of 1, without signs


class SharedCameras:
    """The cameras of a graph, of which equal ones of few images are one, by the first one's name.

    COLMAP makes a camera for each image where nobody tells it otherwise.
    """

    def __init__(self, graph: MatchGraph) -> None:
        of_images = [image.camera for image in graph.images.values()]
        num_images = Counter(of_images)
        equal: dict[object, list[str]] = defaultdict(list)  # a camera, or the name of one
        for name, camera in graph.cameras.items():
            equal[camera if num_images[name] < FEWEST_IMAGES else name].append(name)
        self._all = list(graph.cameras)
        self._equal = {names[0]: names for names in equal.values()}
        self._first = {name: first for first, names in self._equal.items() for name in names}
        self.of_images = [None if name is None else self._first[name] for name in of_images]
        self.cameras = {first: graph.cameras[first] for first in self._equal}

    def all_of(self, cameras: Mapping[str, Camera]) -> dict[str, Camera]:
        """The cameras of the graph, in its order, from those that are shared."""
        return {name: cameras[self._first[name]] for name in self._all}

    def said(self, cameras: Mapping[str, Camera]) -> tuple[str, ...]:
        """What the shared cameras are now, and not, by their names in words."""
        named = {first: _names_in_words(names) for first, names in self._equal.items()}
        return said_of_cameras(
            {named[first]: camera for first, camera in self.cameras.items()},
            {named[first]: cameras[first] for first in self.cameras},
        )


def _names_in_words(names: Sequence[str]) -> str:
    """Name of a camera, which is a number in COLMAP's files, and how many are equal to it."""
    first, *others = names
    name = f"camera {first}" if first.isdigit() else first
    return name + (f" and {len(others)} that are equal" if others else "")


class GraphFolder:
    """Images of a match graph, numbered in their order; its pairs go by their names.

    It is a `VerifiedFolder`, in memory.
    """

    def __init__(
        self,
        graph: MatchGraph,
        pictures: Path | None,
        seed: int,
        num_threads: int,
        progress: Progress,
    ) -> None:
        self.progress, self.num_threads = progress, num_threads
        self._graph, self._pictures, self._seed = graph, pictures, seed
        self._names = list(graph.images)
        numbers = {name: number for number, name in enumerate(self._names)}
        self._matches: dict[Pair, NDArray[np.int64]] = {}  # of pairs that are to be verified
        self._kept: dict[Pair, TwoViewGeometry] = {}  # of those that had a pose
        self._alone: dict[Keys, VerifiedPair] = {}
        self._level: dict[Keys, VerifiedPair] = {}
        self.pairs: list[Pair] = []  # those, and the ones that have a say
        for each in graph.pairs:
            pair = numbers[each.image1], numbers[each.image2]
            if each.geometry is None and len(each.matches):
                self._matches[pair] = each.matches
                self.pairs.append(pair)
            elif each.geometry is not None and _has_a_say(each.geometry):
                self._kept[pair] = each.geometry
                self.pairs.append(pair)
        self._cameras = {
            index: self._camera(index) for index in sorted({i for pair in self.pairs for i in pair})
        }
        self._bearings = lru_cache(_IMAGES_IN_MEMORY)(self._find_bearings)
        self.panorama_of = remembered(self._read_panorama)
        given = {pair: self._with_a_say(pair) for pair in self._kept}
        self._given = {pair: each for pair, each in given.items() if self._fits(pair, each)}
        self.pairs = [pair for pair in self.pairs if pair in self._given or pair in self._matches]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the images of all pairs, in the order of the graph."""
        return tuple(self._names[index] for index in self._cameras)

    @property
    def kept(self) -> tuple[tuple[str, str], ...]:
        """Names of the images of pairs that had a pose."""
        return tuple(map(self.keys_of, self._kept))

    @property
    def misfits(self) -> set[tuple[str, str]]:
        """Those of them whose own inliers do not fit the pose."""
        return {self.keys_of(pair) for pair in self._kept.keys() - self._given.keys()}

    @cached_property
    def comparable(self) -> list[Pair]:
        """Pairs whose surroundings can be compared."""
        return [pair for pair in self.pairs if are_usable(self, pair, is_compared)]

    def read_pictures(self) -> None:
        """Read the pictures that are compared; raises what `verify_pairs` says."""
        compared = sorted({index for pair in self.comparable for index in pair})
        for index in compared:
            self._picture(index)
        self.progress(_STAGE_READ, 0, len(compared))
        read = on_threads(self.panorama_of, compared, self.num_threads)
        for count, _ in enumerate(read, start=1):
            self.progress(_STAGE_READ, count, len(compared))

    def verify(self) -> dict[Keys, Verdict]:
        """Verify all pairs by their own matches."""
        self._alone = self._verified(list(self._matches), _STAGE, None)
        self._alone |= {given.keys: given for given in self._given.values()}
        return {keys: pair.verdict for keys, pair in self._alone.items()}

    def verify_again(self, wanted: Mapping[Keys, Pair], level: Level) -> Mapping[Keys, Verdict]:
        """Verdicts with the prior of a level folder on wanted pairs, but for those with a pose."""
        asked = [pair for pair in wanted.values() if pair in self._matches]
        self._level = self._verified(asked, _STAGE_AGAIN, level)
        return {keys: pair.verdict for keys, pair in self._level.items()}

    def settled_pairs(
        self, wanted: Container[Keys], settled: Mapping[Keys, Verdict], level: Level | None
    ) -> Iterator[VerifiedPair]:
        """Wanted pairs with their matches and the verdicts that count."""
        del level  # those of it are told by their verdicts
        return (self.settled(keys, settled[keys]) for keys in self._alone if keys in wanted)

    def settled(self, keys: Keys, verdict: Verdict) -> VerifiedPair:
        """The pair with the verdict that counts: with the prior of a level folder, or without."""
        return self._level[keys] if verdict.prior else self._alone[keys]

    def estimated(
        self, matched: Sequence[tuple[Pair, Matched]], prior: str, level: Level | None
    ) -> dict[Pair, VerifiedPair]:
        """Verify some matches of pairs, with the prior of a level folder, or without.

        ``prior`` says in words how they were chosen.
        """
        views = [self._views(pair, each) for pair, each in matched]
        known = {} if level is None else level.known
        found = verified_matches(
            views, prior, seed=self._seed, num_threads=self.num_threads, **known
        )
        return {pair: each for (pair, _), each in zip(matched, found, strict=True)}

    def name_of(self, index: int) -> str:
        """Name of an image."""
        return self._names[index]

    def is_readable(self, pair: Pair) -> bool:
        """Whether both images could be used; the key points of all are known."""
        return True

    def keys_of(self, pair: Pair) -> Keys:
        """Names of both images."""
        return self._names[pair[0]], self._names[pair[1]]

    def camera_of(self, index: int) -> Camera:
        """Camera of an image."""
        return self._cameras[index]

    def bearings_of(self, index: int) -> NDArray[np.float64]:
        """Where the key points of an image look."""
        return self._bearings(index)

    def _with_a_say(self, pair: Pair) -> VerifiedPair:
        """A pair that had a pose; how sure that is nobody has said, but its inliers how exact.

        Key points that no ray leads to are left out; the noise is NaN if no others are there.
        """
        geometry = self._kept[pair]
        seen = self._matched(pair, geometry.inliers)
        bearings1, bearings2 = seen.bearings1, seen.bearings2
        rows = np.isfinite(bearings1).all(axis=1) & np.isfinite(bearings2).all(axis=1)
        inliers, pose = geometry.inliers[rows], geometry.cam2_from_cam1
        residuals = np.abs(pose_residuals(pose, bearings1[rows], bearings2[rows], "angular"))
        median = np.median(residuals) if len(inliers) else np.nan
        verdict = Verdict(
            status="ok",
            num_matches=len(inliers),
            num_inliers=len(inliers),
            rotation_sigma_deg=DOUBTED_ROTATION_DEG,
            translation_sigma_deg=DOUBTED_DIRECTION_DEG,
            noise_deg=float(np.degrees(_SIGMAS_OF_MEDIAN * median) / 2.0**0.5),
            cam2_from_cam1=pose,
        )
        everyone = np.ones(len(inliers), dtype=bool)
        return VerifiedPair(self.keys_of(pair), verdict, inliers, everyone)

    def _fits(self, pair: Pair, given: VerifiedPair) -> bool:
        """Whether most inliers of a pair that had a pose are near it."""
        cameras = self._cameras[pair[0]], self._cameras[pair[1]]
        return given.verdict.noise_deg <= _MOST_NOISE_PX * smallest_pixel_deg(cameras)

    def _read_panorama(self, index: int) -> Panorama:
        """What an image shows all around; its picture may have another size than its camera."""
        path, camera = self._picture(index), self._cameras[index]
        picture, usable = read_masked_image(path)
        height, width = picture.shape[:2]
        resized = resized_camera(camera, width)
        if abs(resized.height - height) > _ROUNDING_PX:
            raise ValueError(
                f"{path} must have the shape of its camera, {camera.width}x{camera.height}; it is "
                f"{width}x{height}"
            )
        return Panorama.seen_by(resized, picture, usable)

    def _picture(self, index: int) -> Path:
        """Path of a picture that is there."""
        if self._pictures is None:
            raise FileNotFoundError("the pictures are not known")
        path = inside(self._pictures, self._names[index])
        if not path.is_file():
            raise FileNotFoundError(
                f"{self._pictures} must hold the pictures by the names of the images; "
                f"there is no {path}"
            )
        return path

    def _camera(self, index: int) -> Camera:
        name = self._graph.images[self._names[index]].camera
        if name is None:
            raise ValueError(
                f"image {self._names[index]} has no camera, so its pairs cannot be verified"
            )
        return self._graph.cameras[name]

    def _find_bearings(self, index: int) -> NDArray[np.float64]:
        keypoints = self._graph.images[self._names[index]].keypoints
        return np.asarray(self._cameras[index].bearings_from_pixels(keypoints))

    def _views(self, pair: Pair, matched: Matched) -> MatchedViews:
        cameras = self._cameras[pair[0]], self._cameras[pair[1]]
        return MatchedViews(self.keys_of(pair), cameras, matched)

    def _verified(
        self, pairs: Sequence[Pair], stage: str, level: Level | None
    ) -> dict[Keys, VerifiedPair]:
        """Verify pairs from their matches, with the prior of a level folder or without."""
        prior, known = ("", {}) if level is None else (level.prior, level.known)
        found = {}
        for start in range(0, len(pairs), _PAIRS_AT_ONCE):
            self.progress(stage, start, len(pairs))
            some = pairs[start : start + _PAIRS_AT_ONCE]
            views = [self._views(pair, self._matched(pair, self._matches[pair])) for pair in some]
            for each in verified_matches(
                views, prior, seed=self._seed, num_threads=self.num_threads, **known
            ):
                found[each.keys] = each
        self.progress(stage, len(pairs), len(pairs))
        return found

    def _matched(self, pair: Pair, matches: NDArray[np.int64]) -> Matched:
        rows1, rows2 = matches.T
        return Matched(matches, self._bearings(pair[0])[rows1], self._bearings(pair[1])[rows2])


def _has_a_say(geometry: TwoViewGeometry) -> bool:
    """Whether a pair has a pose, and inliers that agree with it."""
    is_known = bool(np.isfinite(geometry.cam2_from_cam1.translation).all())
    return geometry.status == "ok" and is_known and len(geometry.inliers) > 0
