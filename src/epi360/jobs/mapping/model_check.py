# SPDX-License-Identifier: BSD-3-Clause
"""Which images of a mapped model have a place that points and pairs confirm."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.jobs.graph.graph_check import DOUBTED_DIRECTION_DEG, DOUBTED_ROTATION_DEG
from epi360.jobs.matching.match_folder import PairVerdict
from epi360.poses import Pose, angles_between, rotation_error_deg, translation_error_deg

Array = NDArray[np.float64]

# Of 13 panoramas that COLMAP's global mapper places of a real tour, the nine right ones see 29
# points or more of which the others know the depth, and agree with two pairs or more. The four
# that are metres off see 3 points at most: one pair says where they are, not how far.
_MIN_POINTS = 15
_MIN_PAIRS = 2
_FEWEST_MOMENTS = 3  # two have no third that could agree
# Least angle between two rays to a point of known depth: ten times the noise of a small panorama.
_MIN_PARALLAX_RAD = np.radians(0.5)
# A pair agrees with a model up to so much and four sigmas of its pose. In the same tour pairs of
# right places differ by up to 3.5 degrees, those of wrong ones by 7 to 50.
_ROTATION_DEG, _DIRECTION_DEG, _SIGMAS = 3.0, 5.0, 4.0
# Logarithms of lengths in the model over those by what pairs share are so near to their middle.
_LENGTHS_AGREE = 0.15


@dataclass(frozen=True, eq=False)
class PlacedImages:
    """A model as it is checked: where its images are, and which of them sees which point.

    ``frames`` are the moments of the images: those of a rig that share one move together. Row i of
    ``image_index`` (K,), in the order of the poses, and ``point_index`` (K,) is one observation of
    ``points`` (P, 3).
    """

    cam_from_world: Mapping[str, Pose]
    frames: Mapping[str, str | int]
    points: Array
    point_index: NDArray[np.int64]
    image_index: NDArray[np.int64]


def confirmed_images(
    model: PlacedImages,
    pairs: Sequence[PairVerdict],
    lengths: Mapping[tuple[str, str], float] | None = None,
) -> set[str]:
    """Names of the images of the largest of the `confirmed_groups`; there may be none."""
    return next(iter(confirmed_groups(model, pairs, lengths)), set())


def confirmed_groups(
    model: PlacedImages,
    pairs: Sequence[PairVerdict],
    lengths: Mapping[tuple[str, str], float] | None = None,
) -> list[set[str]]:
    """Names of the images that confirm each other's places, group by group, the largest first.

    From two images that a pair connects, the rest is confirmed one after the other: an image needs
    15 points of which confirmed ones know the depth, because two of them see it under half a degree
    or more, and two accepted pairs with confirmed ones that agree with the model. So a right
    direction at a wrong distance is not enough, and wrong images do not confirm each other unless
    three of them agree in all that. Where it is known how long the translations of pairs are, in
    one unit for all ``lengths``, by the names of both images, one such pair that agrees with the
    model in that too is enough, with 15 points that anyone else sees. Each pair that no group holds
    begins another one.
    """
    graph = _Graph(model, pairs, lengths or {})
    found: list[NDArray[np.bool_]] = []
    for is_sound, starts in ((True, graph.sound_starts()), (False, graph.connected())):
        for start in starts:
            if graph.may_grow_from(start, is_sound=is_sound) and not _holds(found, start):
                found.append(graph.grown_from(start, is_sound=is_sound))
    sizes = [np.count_nonzero(group) for group in found]
    order = sorted(range(len(found)), key=lambda k: -sizes[k])
    return [
        {name for name, moment in graph.moment_of.items() if found[k][moment]}
        for k in order
        if sizes[k] >= _FEWEST_MOMENTS
    ]


def judged_images(
    names: Iterable[str],
    pairs: Sequence[PairVerdict],
    lengths: Mapping[tuple[str, str], float],
    looked_at: Set[tuple[str, str]],
) -> set[str]:
    """Names of the images of a model that lengths can judge: not to be confirmed tells of them.

    They are the ends of pairs with a known length, and those whose accepted pairs in the model were
    all looked at and lead to such ends: if one of these had a sure length, they would have it too.
    """
    placed = set(names)
    reached = {name for ends in lengths for name in ends}
    beside: dict[str, list[bool]] = {}
    for pair in pairs:
        ends = pair.image1, pair.image2
        if pair.accepted and placed.issuperset(ends):
            for name, other in (ends, ends[::-1]):
                beside.setdefault(name, []).append(ends in looked_at and other in reached)
    return placed & (reached | {name for name, told in beside.items() if all(told)})


def _holds(groups: Sequence[NDArray[np.bool_]], start: NDArray[np.int64]) -> bool:
    """Whether a group has both moments of a pair: nothing that begins there is larger."""
    return any(group[start].all() for group in groups)


class _Graph:
    """Moments of a model, the rays on which they see points, and the pairs that agree with it."""

    def __init__(
        self,
        model: PlacedImages,
        pairs: Sequence[PairVerdict],
        lengths: Mapping[tuple[str, str], float],
    ) -> None:
        moments = list(dict.fromkeys(model.frames[name] for name in model.cam_from_world))
        row_of = {moment: row for row, moment in enumerate(moments)}
        self.moment_of = {name: row_of[model.frames[name]] for name in model.cam_from_world}
        self.num_moments, self.num_points = len(moments), len(model.points)
        moment_index = np.array(list(self.moment_of.values()), dtype=np.int64)[model.image_index]
        # A point that a moment of a rig sees twice counts once.
        seen = moment_index * (self.num_points + 1) + model.point_index
        once = np.unique(seen, return_index=True)[1]
        self.moments, self.points = moment_index[once], model.point_index[once]
        centers = np.array([p.inverse().translation for p in model.cam_from_world.values()])
        self.rays = model.points[self.points] - centers.reshape(-1, 3)[model.image_index[once]]
        agreeing = [
            (pair.image1, pair.image2)
            for pair in pairs
            if pair.image1 in self.moment_of
            and pair.image2 in self.moment_of
            and _agrees(pair, model.cam_from_world)
        ]
        known = [names for names in agreeing if names in lengths]
        as_far = _as_far(known, lengths, model.cam_from_world)
        wrong = set(known) - set(as_far) if as_far else set()
        self.pairs = self._moments_of([names for names in agreeing if names not in wrong])
        self.far_pairs = self._moments_of(as_far)
        self.num_seen = np.bincount(self.moments, minlength=self.num_moments)
        self.beside: dict[int, set[int]] = {}  # moments with an agreeing pair with each
        for one, other in self.pairs.tolist():
            self.beside.setdefault(one, set()).add(other)
            self.beside.setdefault(other, set()).add(one)

    def _moments_of(self, pairs: Sequence[tuple[str, str]]) -> NDArray[np.int64]:
        """Moments (N, 2) of pairs of images, the earlier one first."""
        ends = [sorted((self.moment_of[name1], self.moment_of[name2])) for name1, name2 in pairs]
        return np.array(ends, dtype=np.int64).reshape(-1, 2)

    def connected(self) -> list[NDArray[np.int64]]:
        """Moments with an agreeing pair, those farthest apart in the order of the images first.

        In a sequence, the nearest ones see points under too small an angle to begin with.
        """
        return _farthest_first(self.pairs)

    def sound_starts(self) -> list[NDArray[np.int64]]:
        """Those of them whose lengths confirm images, as theirs would confirm each other."""
        return _farthest_first(
            self.far_pairs[(self.num_seen[self.far_pairs] >= _MIN_POINTS).all(axis=1)]
        )

    def may_grow_from(self, start: NDArray[np.int64], *, is_sound: bool) -> bool:
        """Whether a third moment could be confirmed: it has pairs with both, or a length counts."""
        one, other = start.tolist()
        return is_sound or bool(self.beside[one] & self.beside[other])

    def grown_from(self, start: NDArray[np.int64], *, is_sound: bool) -> NDArray[np.bool_]:
        """Moments that those of a pair confirm, step by step, shape (F,).

        If that pair itself is not one whose length confirms an image, no other length counts: what
        hangs on it alone would be confirmed with the rest.
        """
        far_pairs = self.far_pairs if is_sound else self.far_pairs[:0]
        inside: NDArray[np.bool_] = np.zeros(self.num_moments, dtype=bool)
        new = inside.copy()
        new[start] = True
        first_rays = np.full((self.num_points, 3), np.nan)
        parallax = np.zeros(self.num_points)
        while new.any():
            inside |= new
            rows = np.flatnonzero(new[self.moments])
            points, rays = self.points[rows], self.rays[rows]
            unseen = np.isnan(first_rays[points, 0])
            first_rays[points[unseen][::-1]] = rays[unseen][::-1]
            np.maximum.at(parallax, points, angles_between(first_rays[points], rays))
            is_known = parallax >= _MIN_PARALLAX_RAD
            num_points = np.bincount(
                self.moments[is_known[self.points]], minlength=self.num_moments
            )
            new = (num_points >= _MIN_POINTS) & (self._num_of(self.pairs, inside) >= _MIN_PAIRS)
            hanging = (self.num_seen >= _MIN_POINTS) & (self._num_of(far_pairs, inside) > 0)
            new = (new | hanging) & ~inside
        return inside

    def _num_of(self, pairs: NDArray[np.int64], inside: NDArray[np.bool_]) -> NDArray[np.int64]:
        """How many pairs each moment has with those inside, shape (F,)."""
        one, other = pairs.T
        return np.bincount(one[inside[other]], minlength=self.num_moments) + np.bincount(
            other[inside[one]], minlength=self.num_moments
        )


def _farthest_first(pairs: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Pairs (N, 2) of two moments, each once."""
    pairs = np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0)
    return list(pairs[np.argsort(pairs[:, 0] - pairs[:, 1], kind="stable")])


def _agrees(pair: PairVerdict, cam_from_world: Mapping[str, Pose]) -> bool:
    """Whether the pose of an accepted pair is that of the model."""
    if not pair.accepted and pair.status != "pure_rotation":
        return False
    placed = cam_from_world[pair.image2] @ cam_from_world[pair.image1].inverse()
    rotation_sigma = np.nan_to_num(pair.rotation_sigma_deg, nan=DOUBTED_ROTATION_DEG)
    limit = _ROTATION_DEG + _SIGMAS * rotation_sigma
    if rotation_error_deg(placed, pair.cam2_from_cam1) > limit:
        return False
    if not np.isfinite(pair.cam2_from_cam1.translation).all():
        return True  # a pure rotation
    sigma = np.nan_to_num(pair.translation_sigma_deg, nan=DOUBTED_DIRECTION_DEG)
    error: float = translation_error_deg(placed, pair.cam2_from_cam1)
    return bool(error <= _DIRECTION_DEG + _SIGMAS * sigma)


def _as_far(
    pairs: Sequence[tuple[str, str]],
    lengths: Mapping[tuple[str, str], float],
    cam_from_world: Mapping[str, Pose],
) -> list[tuple[str, str]]:
    """Pairs whose images are as far from each other in the model as they must be, in its unit.

    There are none if less than two, or not most, agree in a unit: then lengths tell nothing.
    """
    if len(pairs) < 2:
        return []
    centers = {name: pose.inverse().translation for name, pose in cam_from_world.items()}
    placed = [np.linalg.norm(centers[name1] - centers[name2]) for name1, name2 in pairs]
    logs = np.log(np.maximum(placed, 1e-12) / [lengths[names] for names in pairs])
    # The unit of the model is the one with which most agree.
    order = np.sort(logs)
    ends = np.searchsorted(order, order + 2 * _LENGTHS_AGREE)
    first = int(np.argmax(ends - np.arange(len(order))))
    if ends[first] - first < max(2, len(pairs) // 2 + 1):
        return []
    low, high = order[first], order[ends[first] - 1]
    return [names for names, log in zip(pairs, logs, strict=True) if low <= log <= high]
