# SPDX-License-Identifier: BSD-3-Clause
"""Two rendered panoramas with key points tracked between them: the data of Figs. 1 and 2."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Equirectangular
from epi360.epipolar import EightPointSolution, eight_point
from epi360.features import track_features
from epi360.poses import Pose, rotation_from_vector
from epi360_paper.options import ReproduceOptions
from epi360_scenes import Room

Array = NDArray[np.float64]

NUM_KEYPOINTS = 200  # paper, section 5.2
# More corners than wanted, because at 1024 px one in ten is lost on the way.
NUM_CORNERS = 240
NUM_FRAMES = 7
MIN_BASELINE_M = 0.5  # paper, section 5.2


@dataclass(frozen=True)
class TrackedPair:
    """Two rendered panoramas and the key points that were followed from one to the other."""

    image1: NDArray[np.uint8]
    image2: NDArray[np.uint8]
    points1: Array  # (H, W, 3): scene point of each pixel of image 1 in camera 1, in metres
    camera: Equirectangular
    cam2_from_cam1: Pose  # true pose, metric
    # (N, 2): continuous pixels; row i of both is one match.
    keypoints1: Array
    keypoints2: Array

    @property
    def bearings1(self) -> Array:
        """Bearings of the key points of image 1, shape (N, 3)."""
        return self.camera.bearings_from_pixels(self.keypoints1)

    @property
    def bearings2(self) -> Array:
        """Bearings of the key points of image 2, shape (N, 3)."""
        return self.camera.bearings_from_pixels(self.keypoints2)

    @property
    def landmarks(self) -> Array:
        """Scene points at the key points of image 1, shape (N, 3), metres in camera 1."""
        columns, rows = np.floor(self.keypoints1).astype(int).T
        return np.asarray(self.points1[rows, columns])


def track_pair(
    room: Room, options: ReproduceOptions, progress: Callable[[int, int], None]
) -> TrackedPair:
    """Two panoramas of a room, 0.5 m apart or more, with at most 200 key points tracked."""
    camera = Equirectangular(options.image_width, options.image_width // 2)
    path = _path(room, np.random.Generator(np.random.PCG64([options.seed, 1])))
    views = []
    for index, world_from_cam in enumerate(path):
        progress(index, len(path))
        views.append(room.render(camera, world_from_cam))
    images = [view.image for view in views]
    tracks = track_features(images, camera, max_features=NUM_CORNERS)
    kept = np.flatnonzero(tracks.visible[-1])[:NUM_KEYPOINTS]  # the strongest corners come first
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = camera.bearings_from_pixels(np.stack([u.ravel(), v.ravel()], axis=1))
    return TrackedPair(
        images[0],
        images[-1],
        (views[0].depth.reshape(-1, 1) * rays).reshape(*views[0].depth.shape, 3),
        camera,
        path[-1].inverse() @ path[0],
        tracks.keypoints[0, kept],
        tracks.keypoints[-1, kept],
    )


def solutions(pair: TrackedPair) -> tuple[EightPointSolution, EightPointSolution]:
    """Eight-point solutions on the unit sphere and on the ovoid that the search finds."""
    unit = eight_point(pair.bearings1, pair.bearings2)
    return unit, eight_point(pair.bearings1, pair.bearings2, normalization="sk")


def ratio_of(solution: EightPointSolution) -> float:
    """K/S of a solution's ovoid."""
    return float(solution.normalizer1[2, 2] / solution.normalizer1[0, 0])


def pair_line(options: ReproduceOptions) -> str:
    """Sentence on the pictures behind a figure."""
    width = options.image_width
    return f"One pair of panoramas, rendered at {width} x {width // 2}, seed {options.seed}."


def _path(room: Room, rng: np.random.Generator) -> list[Pose]:
    shares = np.linspace(0.0, 1.0, NUM_FRAMES)[:, None]
    while True:
        first = room.sample_pose(rng)
        step = rng.uniform((-0.8, -0.15, -0.8), (0.8, 0.15, 0.8))
        turn = rng.uniform((-0.1, -0.6, -0.1), (0.1, 0.6, 0.1))
        positions = first.translation + shares * step
        if np.linalg.norm(step) < 1.2 * MIN_BASELINE_M:
            continue
        if (room.solids.distances(positions) > 0.4).all():
            return [
                Pose(first.rotation @ rotation_from_vector(share * turn), position)
                for share, position in zip(shares[:, 0], positions, strict=True)
            ]
