# SPDX-License-Identifier: BSD-3-Clause
"""What a wrong focal length does to the pose of a photograph beside a panorama.

``python benchmarks/lens_beside_panorama.py --help``; README.md beside this file says what is
measured.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from _summary import text_table
from numpy.typing import NDArray

from epi360 import ImagePairResult, relative_pose_of_images
from epi360.cameras import Equirectangular, Pinhole
from epi360.estimation.result import pose_sigmas_deg
from epi360.poses import Pose, rotation_error_deg, translation_error_deg
from epi360.synthetic.landmarks import rotation_from_heading
from epi360_scenes import furnished_room
from epi360_scenes.room import Room

PANORAMA = Equirectangular(2048, 1024)
PHOTOGRAPH = Pinhole(1000, 750, 500.0, 500.0, 500.0, 375.0)  # 90 degrees wide
FACTORS = (1.0, 1.01, 1.02, 1.05, 1.15)
NOISE = 2.0  # grey values
APART_M, CLEAR_M = (0.4, 1.2), 0.4  # of the cameras, and their least distance to things
PAIRS_OF_A_ROOM = 2
WRONG_DEG = 10.0
ASKED = "focal length", "calibration"  # words of the warnings about a lens
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Pair:
    """A panorama and a photograph, and the photograph's pose."""

    panorama: Picture
    photograph: Picture
    photograph_from_panorama: Pose


def main() -> int:
    """Print one row for each factor of the focal length."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seed", type=int, default=40, help="of the first room (40)")
    parser.add_argument("--rooms", type=int, default=14, help="with two pairs each (14)")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.rooms)
    pairs = [pair for seed in seeds for pair in _pairs_of(seed)]
    titles = "focal length", "pairs", "ok", "wrong", "of these warned", "right, warned"
    rows = [[*titles, "error R, t", "over sigma", "below 2 sigma"]]
    for factor in FACTORS:
        camera = replace(PHOTOGRAPH, fx=factor * PHOTOGRAPH.fx, fy=factor * PHOTOGRAPH.fy)
        found = [
            (pair, relative_pose_of_images(
                pair.panorama, pair.photograph, camera1=PANORAMA, camera2=camera
            ))
            for pair in pairs
        ]  # fmt: skip
        rows.append([f"{factor:.2f}", str(len(pairs)), *_counted(found)])
        print(text_table([rows[0], rows[-1]]), flush=True)
    print(text_table(rows))
    return 0


def _counted(found: Sequence[tuple[Pair, ImagePairResult]]) -> list[str]:
    accepted = [(pair, result) for pair, result in found if result.success]
    errors = np.array(
        [_errors(result.cam2_from_cam1, pair.photograph_from_panorama) for pair, result in accepted]
    )
    sigmas = np.array([pose_sigmas_deg(result) for _, result in accepted])
    is_warned = np.array([_is_warned(result) for _, result in accepted])
    is_wrong = errors.max(axis=1) > WRONG_DEG
    over = errors / sigmas
    return [
        str(len(accepted)),
        str(is_wrong.sum()),
        str((is_wrong & is_warned).sum()),
        str((~is_wrong & is_warned).sum()),
        ", ".join(f"{value:.2f}" for value in np.median(errors, axis=0)),
        ", ".join(f"{value:.2f}" for value in np.median(over, axis=0)),
        str((over.max(axis=1) < 2.0).sum()),
    ]


def _errors(found: Pose, truth: Pose) -> tuple[float, float]:
    return rotation_error_deg(found, truth), translation_error_deg(found, truth)


def _is_warned(result: ImagePairResult) -> bool:
    return any(word in warning for warning in result.warnings for word in ASKED)


def _pairs_of(seed: int) -> Iterator[Pair]:
    """Pairs of a furnished room."""
    room, rng = furnished_room(seed), np.random.default_rng(seed)
    for _ in range(PAIRS_OF_A_ROOM):
        first, second = _two_places(room, rng)
        heading, other = rng.uniform(-np.pi, np.pi, 2)
        tilt, roll = rng.uniform(-0.2, 0.2), 0.03 * rng.normal()
        pose1 = Pose(rotation_from_heading(np.array([0.0, heading, 0.0])), first)
        pose2 = Pose(rotation_from_heading(np.array([tilt, other, roll])), second)
        pictures = [
            room.render(camera, pose).image
            for camera, pose in ((PANORAMA, pose1), (PHOTOGRAPH, pose2))
        ]
        noisy = [picture + rng.normal(0.0, NOISE, picture.shape) for picture in pictures]
        panorama, photograph = (np.clip(each, 0, 255).astype(np.uint8) for each in noisy)
        yield Pair(panorama, photograph, pose2.inverse() @ pose1)


def _two_places(
    room: Room, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two free places of a room, not far from each other."""
    low, high = room.bounds
    while True:
        ground = rng.uniform(low[[0, 2]], high[[0, 2]], (2, 2))
        heights = rng.uniform(-1.6, -1.4, 2)
        first, second = np.column_stack([ground[:, 0], heights, ground[:, 1]])
        is_near = APART_M[0] < np.linalg.norm(first - second) < APART_M[1]
        if is_near and room.distances(np.stack([first, second])).min() > CLEAR_M:
            return first, second


if __name__ == "__main__":
    raise SystemExit(main())
