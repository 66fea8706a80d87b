# SPDX-License-Identifier: BSD-3-Clause
"""Poses of all images that accepted pairs hold together, put together from those of the pairs.

COLMAP's mapper places an image by points that others have triangulated, of which there are few from
room to room. Here the pose of a pair says where the other image is, and what both pairs of an image
know of its surroundings says how far: points, and surfaces that panoramas share (`common_scale`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from epi360.features.warped_patches import Panorama
from epi360.interop.match_graph import MatchedPair, MatchGraph
from epi360.jobs.graph.common_scale import common_scale
from epi360.jobs.graph.graph_check import DOUBTED_DIRECTION_DEG, DOUBTED_ROTATION_DEG, joining
from epi360.jobs.graph.surface_evidence import KnownView, known_views
from epi360.jobs.matching.pair_verdicts import PairVerdict
from epi360.jobs.threads import num_cores, on_threads
from epi360.odometry.pose_graph import (
    PoseGraphEdge,
    diagonal_information,
    optimize_pose_graph,
)
from epi360.odometry.similarity import Similarity
from epi360.places.own_evidence import grow_both
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose
from epi360.progress import Progress, no_progress

Array = NDArray[np.float64]
Names = tuple[str, str]
PanoramaOf = Callable[[str], Panorama | None]

STAGE = "lengths"
MOST_PAIRS = 1000  # that are looked at; the surfaces of one take 0.04 s and 0.4 MB
# Least sigmas, in degrees and as a share of a length: no pair is so sure that it outweighs others.
_LEAST_ROTATION_DEG, _LEAST_OFF = 0.2, 0.02
_SAME_UNIT = 1e-4  # sigma of the logarithm of the scale of an image against another one
_ROUNDS = 4  # of the adjustment; after each, what contradicts the rest counts less
_DEGREES_OF_FREEDOM = 7  # of a step


@dataclass(frozen=True, eq=False)
class ComposedPoses:
    """Poses of images in one world, and the lengths of the pairs that they rest on, by names.

    ``looked_at`` are all pairs whose lengths were asked for.
    """

    cam_from_world: Mapping[str, Pose] = field(default_factory=dict)
    lengths: Mapping[Names, float] = field(default_factory=dict)
    looked_at: frozenset[Names] = frozenset()


def composed_poses(
    graph: MatchGraph,
    verdicts: Sequence[PairVerdict],
    panorama_of: PanoramaOf,
    *,
    progress: Progress = no_progress,
) -> ComposedPoses:
    """Poses of the largest set of images that accepted pairs with sure lengths hold together.

    ``panorama_of`` gives the picture of a full panorama by its name, None for other images. Of more
    than 1000 accepted pairs those are looked at that `hold_together` names. There is nothing of
    fewer than three images, nor of so many that 1000 pairs do not hold them together, nor of a rig,
    which has a unit of its own.

    ``progress`` is told of the stage "lengths".
    """
    told = {(each.image1, each.image2): each for each in verdicts if each.accepted}
    if graph.cam_from_rig or len(told) < 2:
        return ComposedPoses()
    pairs = _chosen_pairs(graph, told.keys())
    names = [(pair.image1, pair.image2) for pair in pairs]
    posed = posed_pairs(graph, pairs, [told[each] for each in names])
    scale = common_scale(posed, _views(posed, names, panorama_of, progress))
    sure = np.flatnonzero(scale.is_sure).tolist()
    lengths = {names[row]: float(np.exp(scale.log_lengths[row])) for row in sure}
    if len({name for pair in lengths for name in pair}) < 3:
        return ComposedPoses()
    return ComposedPoses(
        _placed([_Step.of(posed[row], lengths[names[row]]) for row in sure], list(graph.images)),
        lengths,
        frozenset(names),
    )


def _chosen_pairs(graph: MatchGraph, accepted: Set[Names]) -> list[MatchedPair]:
    """Accepted pairs that are looked at; all others are read one by one and let go."""
    rows, strengths = [], []
    for row, pair in enumerate(graph.pairs):
        if (pair.image1, pair.image2) in accepted:
            rows.append(row)
            strengths.append(((pair.image1, pair.image2), num_inliers(pair)))
    return [graph.pairs[rows[each]] for each in hold_together(strengths, MOST_PAIRS)]


def hold_together(pairs: Sequence[tuple[Names, int]], most: int) -> list[int]:
    """Rows of as many pairs at most, in order: those that hold the images together, and that often.

    Each pair has the names of its images and its number of inliers. First come the pairs with most
    inliers that join all images that can be joined, without a loop; then those that would do so
    without them, and so on. There are none if the first of these would be more than the most: some
    of them would leave the images in parts that nobody chose.
    """
    if len(pairs) <= most:
        return list(range(len(pairs)))
    left = sorted(range(len(pairs)), key=lambda row: -pairs[row][1])
    chosen: set[int] = set()
    while len(chosen) < most:
        tree = [left[row] for row in joining([pairs[row][0] for row in left])]
        if not chosen and len(tree) > most:
            return []
        chosen.update(tree[: most - len(chosen)])
        left = [row for row in left if row not in chosen]
    return sorted(chosen)


def num_inliers(pair: MatchedPair) -> int:
    """How many matches of a pair agree with its pose."""
    return 0 if pair.geometry is None else len(pair.geometry.inliers)


def posed_pairs(
    graph: MatchGraph, pairs: Sequence[MatchedPair], verdicts: Sequence[PairVerdict]
) -> list[PosedPair]:
    """Accepted pairs with the bearings of their inliers, and what the verdicts know of them."""
    number_of = {name: number for number, name in enumerate(graph.images)}
    bearings: dict[str, Array] = {}
    for name in {name for pair in pairs for name in (pair.image1, pair.image2)}:
        image = graph.images[name]
        assert image.camera is not None
        bearings[name] = graph.cameras[image.camera].bearings_from_pixels(image.keypoints)
    found = []
    for pair, verdict in zip(pairs, verdicts, strict=True):
        assert pair.geometry is not None
        names = pair.image1, pair.image2
        rotation_sigma = np.nan_to_num(verdict.rotation_sigma_deg, nan=DOUBTED_ROTATION_DEG)
        direction_sigma = np.nan_to_num(verdict.translation_sigma_deg, nan=DOUBTED_DIRECTION_DEG)
        found.append(
            PosedPair.of(
                (number_of[pair.image1], number_of[pair.image2]),
                pair.geometry.cam2_from_cam1,
                pair.geometry.inliers,
                [bearings[name] for name in names],
                noise_deg=verdict.noise_deg,
                rotation_sigma_deg=float(rotation_sigma),
                translation_sigma_deg=float(direction_sigma),
            )
        )
    return found


def _views(
    posed: Sequence[PosedPair],
    names: Sequence[Names],
    panorama_of: PanoramaOf,
    progress: Progress,
) -> dict[tuple[int, int], KnownView]:
    """Surfaces that the pairs of panoramas know in both views."""
    progress(STAGE, 0, len(posed))

    def grown(row: int) -> tuple[KnownView, KnownView] | None:
        first, second = (panorama_of(name) for name in names[row])
        if first is None or second is None:
            return None
        return known_views(posed[row], grow_both(posed[row], (first, second)))

    found = {}
    for count, (row, views) in enumerate(
        on_threads(grown, range(len(posed)), num_cores()), start=1
    ):
        progress(STAGE, count, len(posed))
        if views is not None:
            found[row, 0], found[row, 1] = views
    return found


@dataclass(frozen=True, eq=False)
class _Step:
    """The way from one image to another, in the common unit, and how sure it is."""

    images: tuple[int, int]
    cam2_from_cam1: Pose
    num_inliers: int
    rotation_sigma_rad: float
    translation_sigma: float

    @classmethod
    def of(cls, pair: PosedPair, length: float) -> _Step:
        """The way that a pair says."""
        pose = pair.cam2_from_cam1
        off = max(np.radians(pair.translation_sigma_deg), _LEAST_OFF)
        return cls(
            pair.images,
            Pose(pose.rotation, length * pose.translation),
            len(pair.keypoints[0]),
            float(np.radians(max(pair.rotation_sigma_deg, _LEAST_ROTATION_DEG))),
            length * float(off),
        )

    def edge(self, rows: Mapping[int, int], weight: float) -> PoseGraphEdge:
        """What the adjustment is told of it."""
        known = diagonal_information(self.rotation_sigma_rad, self.translation_sigma, _SAME_UNIT)
        first, second = (rows[image] for image in self.images)
        return PoseGraphEdge(
            first, second, Similarity.from_pose(self.cam2_from_cam1), weight * known
        )


def _placed(steps: Sequence[_Step], names: Sequence[str]) -> dict[str, Pose]:
    """Poses cam_from_world that agree best with all steps; the first image is the world."""
    start = _chained(steps)
    rows = {image: row for row, image in enumerate(start)}
    nodes = [Similarity.from_pose(pose) for pose in start.values()]
    weights = np.ones(len(steps))
    for _ in range(_ROUNDS):
        edges = [step.edge(rows, weight) for step, weight in zip(steps, weights, strict=True)]
        found = optimize_pose_graph(nodes, edges)
        nodes = found.node_from_world
        weights = 1 / (1 + found.edge_costs / np.maximum(weights, 1e-12) / _DEGREES_OF_FREEDOM)
    return {names[image]: nodes[row].pose() for image, row in rows.items()}


def _chained(steps: Iterable[_Step]) -> dict[int, Pose]:
    """Poses along the surest steps, from the image on that most of them lead to."""
    around: dict[int, list[tuple[tuple[float, int], int, Pose]]] = {}
    for step in steps:
        first, second = step.images
        doubt = step.rotation_sigma_rad, -step.num_inliers
        around.setdefault(first, []).append((doubt, second, step.cam2_from_cam1))
        around.setdefault(second, []).append((doubt, first, step.cam2_from_cam1.inverse()))
    world = max(around, key=lambda image: (len(around[image]), -image))
    found: dict[int, Pose] = {}
    order = itertools.count()  # poses cannot be compared
    ways = [((0.0, 0), next(order), world, Pose(np.eye(3), np.zeros(3)))]
    while ways:
        _, _, image, pose = heappop(ways)
        if image not in found:
            found[image] = pose
            for doubt, other, other_from_image in around[image]:
                if other not in found:
                    heappush(ways, (doubt, next(order), other, other_from_image @ pose))
    return found
