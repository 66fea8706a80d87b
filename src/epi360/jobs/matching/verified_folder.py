# SPDX-License-Identifier: BSD-3-Clause
"""What must be known of images with verified pairs, so that their pairs can be judged together."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.upright import is_full_panorama
from epi360.features.warped_patches import Panorama
from epi360.jobs.graph.graph_check import believed, with_sigmas
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching.verified_matches import Matched
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict, VerifiedPair
from epi360.places.same_place import can_be_compared
from epi360.places.shared_points import PosedPair
from epi360.progress import Progress

Array = NDArray[np.float64]


class VerifiedFolder(Protocol):
    """Images, by their numbers, of which pairs have been verified by their own matches.

    A pair that was verified goes by the keys of both images; equal images may have equal keys.
    ``progress`` is told of the stages "level pairs", "places", "rival poses" and "second poses".
    """

    @property
    def progress(self) -> Progress:
        """Who is told."""

    @property
    def num_threads(self) -> int:
        """Threads that work may take."""

    def name_of(self, index: int) -> str:
        """Name of an image."""

    def is_readable(self, pair: Pair) -> bool:
        """Whether both images could be used so far."""

    def keys_of(self, pair: Pair) -> Keys:
        """Keys of two readable images."""

    def camera_of(self, index: int) -> Camera:
        """Camera of an image."""

    def bearings_of(self, index: int) -> NDArray[np.float64]:
        """Where the key points of an image look."""

    def panorama_of(self, index: int) -> Panorama:
        """What an image shows all around; OSError or ValueError where it cannot be read."""

    def settled_pairs(
        self, wanted: Container[Keys], settled: Mapping[Keys, Verdict], level: Level | None
    ) -> Iterator[VerifiedPair]:
        """Wanted pairs with their matches and the verdicts that count, ``settled``."""

    def verify_again(self, wanted: Mapping[Keys, Pair], level: Level) -> Mapping[Keys, Verdict]:
        """Verdicts with the prior of a level folder on wanted pairs."""

    def estimated(
        self, matched: Sequence[tuple[Pair, Matched]], prior: str, level: Level | None
    ) -> dict[Pair, VerifiedPair]:
        """Verify some matches of pairs, with the prior of a level folder, or without.

        ``prior`` says in words how they were chosen.
        """


@dataclass(frozen=True, eq=False)
class SettledPairs:
    """Pairs whose surroundings can be compared, with their verdicts that count.

    ``images`` has the numbers of two readable ones for each pair of keys; of a level folder some
    verdicts are those with its prior.
    """

    folder: VerifiedFolder
    images: Mapping[Keys, Pair]
    verdicts: Mapping[Keys, Verdict]
    level: Level | None

    @classmethod
    def of(
        cls,
        folder: VerifiedFolder,
        pairs: Sequence[Pair],
        verdicts: Mapping[Keys, Verdict],
        level: Level | None,
    ) -> SettledPairs:
        """Those of the pairs that can be compared, and no two of them of the same images."""
        return cls(folder, readable_pairs(folder, pairs, is_compared), verdicts, level)

    def with_matches(self, wanted: Container[Keys]) -> Iterator[VerifiedPair]:
        """Wanted pairs with their matches."""
        return self.folder.settled_pairs(wanted, self.verdicts, self.level)

    def matched(self, verified: VerifiedPair) -> Matched:
        """The matches of a pair, and where they look in both images."""
        first, second = (
            self.folder.bearings_of(image)[rows]
            for image, rows in zip(self.images[verified.keys], verified.matches.T, strict=True)
        )
        return Matched(verified.matches, first, second)

    def posed(self, verified: VerifiedPair) -> PosedPair:
        """Pose and inliers of a pair that is accepted, or whose doubted pose is."""
        pair, own = self.images[verified.keys], verified.verdict
        verdict = with_sigmas(own) if own.accepted else believed(own)
        return PosedPair.of(
            pair,
            verdict.cam2_from_cam1,
            verified.matches[verified.inlier_mask],
            [self.folder.bearings_of(index) for index in pair],
            noise_deg=verdict.noise_deg,
            rotation_sigma_deg=verdict.rotation_sigma_deg,
            translation_sigma_deg=verdict.translation_sigma_deg,
        )


def is_compared(camera: Camera) -> bool:
    """Whether the surroundings of its images are compared: small panoramas' are in folders."""
    return is_full_panorama(camera) or can_be_compared(camera)


def readable_pairs(
    folder: VerifiedFolder, pairs: Sequence[Pair], is_usable: Callable[[Camera], bool]
) -> dict[Keys, Pair]:
    """Pairs of two readable images with such cameras, one for each pair of keys."""
    return {
        folder.keys_of(pair): pair
        for pair in pairs
        if folder.is_readable(pair) and are_usable(folder, pair, is_usable)
    }


def are_usable(folder: VerifiedFolder, pair: Pair, is_usable: Callable[[Camera], bool]) -> bool:
    """Whether both cameras of a pair are such ones."""
    return all(is_usable(folder.camera_of(index)) for index in pair)
