# SPDX-License-Identifier: BSD-3-Clause
"""Matches of pairs of images to verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.resizing import smallest_pixel_deg
from epi360.estimation import (
    RelativePoseResult,
    estimate_relative_pose,
    estimate_relative_poses,
)
from epi360.estimation.angle_search import are_panoramas
from epi360.estimation.image_matches import IMAGE_OPTIONS, noise_of_keypoints
from epi360.estimation.result import pose_sigmas_deg
from epi360.jobs.records.match_store import Keys, Verdict, VerifiedPair
from epi360.places.shared_points import floor_share
from epi360.poses import Pose
from epi360.two_view import asked_again

_DOUBTED = ("concentrated_inliers", "too_few_inliers")  # their poses other pairs may confirm


@dataclass(frozen=True, eq=False)
class Matched:
    """Matches of two images and where both look."""

    matches: NDArray[np.int64]
    bearings1: NDArray[np.float64]
    bearings2: NDArray[np.float64]

    @property
    def bearings(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where both images look, (M, 3) each."""
        return self.bearings1, self.bearings2

    def some(self, mask: NDArray[np.bool_]) -> Matched:
        """Some of the matches."""
        return Matched(self.matches[mask], self.bearings1[mask], self.bearings2[mask])

    def floor_share(self, inlier_mask: NDArray[np.bool_]) -> float:
        """Share of the inliers that both images see well below the horizon; NaN without any."""
        return floor_share(self.bearings1[inlier_mask], self.bearings2[inlier_mask])


@dataclass(frozen=True, eq=False)
class MatchedViews:
    """A pair that can be verified: the keys and cameras of both images, and their matches."""

    keys: Keys
    cameras: tuple[Camera, Camera]
    matched: Matched

    @property
    def pixel_deg(self) -> float:
        """Size of the smaller pixel."""
        return smallest_pixel_deg(self.cameras)


def verified_matches(
    pairs: Sequence[MatchedViews], prior: str, *, seed: int, num_threads: int | None, **known: Any
) -> list[VerifiedPair]:
    """Verify pairs, with what is ``known`` of their poses beforehand, in words ``prior``."""
    noises = [noise_of_keypoints(pair.pixel_deg) for pair in pairs]
    results = estimate_relative_poses(
        [(pair.matched.bearings1, pair.matched.bearings2) for pair in pairs],
        min_noise_deg=[noise["min_noise_deg"] for noise in noises],
        max_noise_deg=[noise["max_noise_deg"] for noise in noises],
        options=IMAGE_OPTIONS,
        num_threads=num_threads,
        seed=seed,
        **known,
    )
    return [
        _verified(pair, result, prior, seed=seed, **_known_of(row, known))
        for row, (pair, result) in enumerate(zip(pairs, results, strict=True))
    ]


def _known_of(row: int, known: Mapping[str, Any]) -> dict[str, Any]:
    """What is known of one pair: values are of all pairs, or lists of one for each."""
    return {name: each[row] if isinstance(each, list) else each for name, each in known.items()}


def with_pose_of_some(
    verified: VerifiedPair, some: NDArray[np.bool_], result: VerifiedPair, pose: Pose, why: str
) -> VerifiedPair:
    """The pair with a pose that ``some`` (M,) of its matches say, and their inliers.

    ``result`` is what was found from them; ``why`` the pose is believed becomes a warning.
    """
    inlier_mask = np.zeros(len(verified.matches), dtype=bool)
    inlier_mask[some] = result.inlier_mask
    told = replace(
        result.verdict,
        status="ok",
        num_matches=len(verified.matches),
        cam2_from_cam1=pose,
        warnings=(*result.verdict.warnings, why),
    )
    return VerifiedPair(verified.keys, told, verified.matches, inlier_mask)


def _verified(
    pair: MatchedViews, result: RelativePoseResult, prior: str, **known: Any
) -> VerifiedPair:
    estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS, **known)
    result = asked_again(result, pair.matched.bearings, pair.cameras, estimate).result
    rotation_sigma_deg, translation_sigma_deg = pose_sigmas_deg(result)
    floor = pair.matched.floor_share(result.inlier_mask) if are_panoramas(pair.cameras) else np.nan
    verdict = Verdict(
        status=result.status,
        warnings=result.warnings,
        num_matches=result.num_matches,
        num_inliers=result.num_inliers,
        noise_deg=result.noise_deg,
        parallax_deg=result.parallax_deg,
        rotation_sigma_deg=rotation_sigma_deg,
        translation_sigma_deg=translation_sigma_deg,
        probability=result.probability,
        explanations=result.explanations,
        floor_share=floor,
        prior=prior,
        cam2_from_cam1=result.cam2_from_cam1,
        doubted=_doubted_pose(result),
    )
    return VerifiedPair(pair.keys, verdict, pair.matched.matches, result.inlier_mask)


def _doubted_pose(result: RelativePoseResult) -> Pose:
    if result.status not in _DOUBTED or not result.alternatives:
        return Pose.nan()
    return result.alternatives[0]
