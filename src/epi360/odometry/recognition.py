# SPDX-License-Identifier: BSD-3-Clause
"""Places that are seen again: the way back to a lost map, and loops that take drift away."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.features.binary_features import BinaryFeatures, extract_binary_features
from epi360.odometry.frame_result import FrameTracks
from epi360.odometry.key_frames import Ids, KeyFrame, SparseMap
from epi360.odometry.loop_closure import LoopClosure, LoopOptions, close_loop
from epi360.odometry.map_parts import Connection, PartOfMap
from epi360.odometry.mapping import Noise
from epi360.odometry.places import PlaceIndex
from epi360.odometry.pose_graph import (
    PoseGraphEdge,
    diagonal_information,
    move_points,
    optimize_pose_graph,
)
from epi360.odometry.relocalization import (
    MappedView,
    PlaceOptions,
    Relocalization,
    locate,
    map_view,
    relocalize,
)
from epi360.odometry.similarity import Similarity
from epi360.odometry.surroundings import SharedView, Surroundings
from epi360.poses import Pose, angles_of_units

Array = NDArray[np.float64]

_NUM_FEATURES = 800  # of a key frame, 45 kB
_CANDIDATES = 4  # key frames that are tried when the map is lost
_CANDIDATES_ELSEWHERE = 3  # of another map, which is asked again at a later key frame
_NUM_NEIGHBOURS, _FARTHEST = 4, 4  # key frames whose rays place the features of one
_THRESHOLD_PX = 2.0  # of a feature; small pictures need more than the angle that is the default
_LOOP_GAP = 20  # key frames, before which a place that looks alike is no loop
_SIMILAR = 0.5  # of the similarity to the key frame before, which a loop's must reach
_FEWEST_COMMON = 30  # landmarks that two key frames share if nothing has drifted between them
_JOINED_AROUND = 3  # key frames before and after one, whose landmarks tracks may be joined to
_REST = 5  # key frames after a loop, or a try that failed, before the next is tried
# A correction moves the whole map, in 0.3 ms for each key frame. After one, more key frames rest in
# proportion: no key frame pays for moving more than so many, however often a place is seen again.
_MOVED_PER_KEY_FRAME = 30


class Recognition:
    """What the key frames of one map look like."""

    def __init__(self, camera: Camera, mask: NDArray[np.bool_] | None, pixel_rad: float) -> None:
        self._camera, self._mask = camera, mask
        place = PlaceOptions()
        threshold_rad = max(place.threshold_rad, _THRESHOLD_PX * pixel_rad)
        self._place = replace(place, threshold_rad=threshold_rad)
        self._index = PlaceIndex()
        self._features: dict[int, BinaryFeatures] = {}
        self._surroundings = Surroundings(camera, mask)
        self._loops: list[PoseGraphEdge] = []
        self._rest_until = 0  # key frame before which no loop is looked for
        self._views: dict[int, MappedView] = {}  # of key frames while the map does not grow

    def features(self, gray: NDArray[np.uint8]) -> BinaryFeatures:
        """Features of a picture."""
        return extract_binary_features(gray, self._camera, self._mask, max_features=_NUM_FEATURES)

    def add(
        self, number: int, features: BinaryFeatures, gray: NDArray[np.uint8] | None = None
    ) -> None:
        """Remember what a key frame looks like: its features, and the picture around them."""
        self._features[number] = features
        self._index.add(number, features.descriptors)
        self._views.clear()
        if gray is not None:
            self._surroundings.add(number, gray)

    def find(
        self, sparse_map: SparseMap, gray: NDArray[np.uint8], *, in_doubt: bool = False
    ) -> tuple[Pose, int] | None:
        """Pose of a picture in the map and the key frame that shows the same place, or None.

        ``in_doubt`` its surroundings must make the place sure.
        """
        features = self.features(gray)
        found = relocalize(features, self._candidates(sparse_map, features), options=self._place)
        if not found.success:
            return None
        if self._is_elsewhere(sparse_map, found, features, gray, in_doubt=in_doubt):
            return None
        return found.pose.cam_from_world, found.key_frame

    def shows_another_place(
        self,
        sparse_map: SparseMap,
        tracks: FrameTracks,
        pose: Pose,
        gray: NDArray[np.uint8],
        noise: Noise,
    ) -> bool:
        """Whether what surrounds the landmarks of a frame says that it is not where they say."""
        view = self._surroundings.best_view(sparse_map, tracks, pose, noise)
        return self._surroundings.deny(gray, view)

    def _is_elsewhere(
        self,
        sparse_map: SparseMap,
        found: Relocalization,
        features: BinaryFeatures,
        gray: NDArray[np.uint8],
        *,
        in_doubt: bool = False,
    ) -> bool:
        """The same of a frame that was found by its features."""
        view = self._shared_view(sparse_map, found, features)
        return self._surroundings.deny(gray, view, in_doubt=in_doubt)

    def _shared_view(
        self, sparse_map: SparseMap, found: Relocalization, features: BinaryFeatures
    ) -> SharedView:
        """What a frame that was found by its features shares with the key frame that found it."""
        old = found.key_frame
        pose = sparse_map.key_frames[old].cam_from_world
        return SharedView.of_relocalization(found, pose, self._features[old], features)

    def close_loop(self, sparse_map: SparseMap) -> LoopClosure | None:
        """Loop between the newest key frame and an old one that shows the same place."""
        number = len(sparse_map.key_frames) - 1
        if number < self._rest_until or number not in self._features:
            return None
        before, similarities = self._index.similar_before(number)
        num_old = int(np.searchsorted(before, number - _LOOP_GAP, side="right"))
        if num_old == 0:
            return None
        best = int(similarities[:num_old].argmax())
        if not similarities[best] > _SIMILAR * np.sort(similarities)[-3:][0]:
            return None
        old = int(before[best])
        new_frame, old_frame = sparse_map.key_frames[number], sparse_map.key_frames[old]
        if len(np.intersect1d(new_frame.ids, old_frame.ids)) >= _FEWEST_COMMON:
            return None
        self._rest_until = number + _REST
        centers = np.array([each.center for each in sparse_map.key_frames[old:]])
        way = float(np.linalg.norm(np.diff(centers, axis=0), axis=1).sum())
        loop = close_loop(
            self._view(sparse_map, number),
            self._view(sparse_map, old),
            path_length=way,
            options=LoopOptions(place=self._place),
        )
        gray = self._surroundings.picture(number)
        if loop.new_in_map is not None and gray is not None:
            features = self._features[number]
            if self._is_elsewhere(sparse_map, loop.new_in_map, features, gray):
                return None
        return loop if loop.success else None

    def connect(
        self, sparse_map: SparseMap, other: Recognition, other_map: SparseMap
    ) -> Connection | None:
        """Key frame of another map that shows the same place as the newest one of this map.

        Nothing says where the maps are, so what surrounds it must make the place sure.
        """
        number = len(sparse_map.key_frames) - 1
        if number not in self._features or not self._surroundings.has_picture(number):
            return None
        features, new = self._features[number], None
        for old in other._that_look_alike(features):
            view = other._view_at_rest(other_map, old)
            forth = locate(features, view, options=self._place, seed=0)
            if not forth.success:
                continue
            new = new or self._view(sparse_map, number)
            loop = close_loop(new, view, forth=forth, options=LoopOptions(place=self._place))
            if loop.new_in_map is None:
                continue
            shared = other._shared_view(other_map, loop.new_in_map, features)
            if not shared.has_parallax:  # another key frame says more
                continue
            gray = self._surroundings.picture(number)
            assert gray is not None
            is_sure = not other._surroundings.deny(gray, shared, in_doubt=True)
            return Connection.of(loop, new, view, self._place.threshold_rad, is_sure=is_sure)
        return None

    def _that_look_alike(self, features: BinaryFeatures) -> list[int]:
        """Key frames that look nearly as much like a picture as like their own neighbours."""
        found = self._index.most_similar(features.descriptors, _CANDIDATES_ELSEWHERE)
        if not found:
            return []
        own = self._index.most_similar(self._features[found[0][0]].descriptors, 3)
        return [number for number, similarity in found if similarity > _SIMILAR * own[-1][1]]

    def take_in(
        self,
        other: Recognition,
        connections: Sequence[Connection],
        sparse_map: SparseMap,
        own_part: PartOfMap,
        other_part: PartOfMap,
    ) -> None:
        """Take in what another map's key frames look like, after the map has taken them in."""
        own, others = own_part.renumbered(self._features), other_part.renumbered(other._features)
        self._index = _joint_index((self._index, own_part, own), (other._index, other_part, others))
        self._features = dict(sorted((own | others).items()))
        self._surroundings.take_in(other._surroundings, own_part, other_part)
        nodes = [Similarity.from_pose(each.cam_from_world) for each in sparse_map.key_frames]
        ends = [
            *(own_part.ends_of(each) for each in self._loops),
            *(other_part.ends_of(each) for each in other._loops),
            *(each.ends(own_part, other_part) for each in connections),
        ]
        self._loops = [
            PoseGraphEdge(i, j, nodes_relative(nodes, i, j), information)
            for i, j, information in ends
        ]
        self._rest_until = len(nodes) + _REST
        self._views.clear()

    def correct(self, sparse_map: SparseMap, loop: LoopClosure) -> None:
        """Spread what a loop says over the key frames."""
        assert loop.new_from_old is not None
        self._loops.append(PoseGraphEdge(loop.old, loop.new, loop.new_from_old, loop.information))
        nodes = [Similarity.from_pose(each.cam_from_world) for each in sparse_map.key_frames]
        rest = -(-len(nodes) // _MOVED_PER_KEY_FRAME)
        self._rest_until = max(self._rest_until, loop.new + rest)
        graph = optimize_pose_graph(nodes, [*_odometry_edges(sparse_map), *self._loops])
        ids = sparse_map.ids
        points = move_points(
            sparse_map.positions_of(ids), _last_seen(sparse_map, ids), nodes, graph.node_from_world
        )
        sparse_map.set_positions(ids, points)
        for key_frame, node in zip(sparse_map.key_frames, graph.node_from_world, strict=True):
            key_frame.move(node)
        # What the loop said about scale holds between key frames that have one unit from now on.
        self._loops = [
            PoseGraphEdge(
                edge.i,
                edge.j,
                nodes_relative(graph.node_from_world, edge.i, edge.j),
                edge.information,
            )
            for edge in self._loops
        ]

    def join_tracks(
        self,
        sparse_map: SparseMap,
        tracks: FrameTracks | KeyFrame,
        pose: Pose,
        number: int,
        limit_rad: float,
    ) -> int:
        """Join tracks to the landmarks around a key frame that they must show; returns how many."""
        near = [sparse_map.key_frames[each] for each in sparse_map.near(number, _JOINED_AROUND)]
        ids = np.unique(np.concatenate([each.ids[each.is_used] for each in near]))
        positions = sparse_map.positions_of(ids)
        seen = np.isfinite(positions[:, 0]) & ~np.isin(ids, sparse_map.landmarks_of(tracks.ids))
        ids, positions = ids[seen], positions[seen]
        if len(ids) == 0 or len(tracks.ids) == 0:
            return 0
        rays = positions @ pose.rotation.T + pose.translation
        rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
        cosines = tracks.bearings @ rays.T
        nearest = cosines.argmax(axis=1)
        mutual = cosines.argmax(axis=0)[nearest] == np.arange(len(nearest))
        close = angles_of_units(tracks.bearings, rays[nearest]) < limit_rad
        rows = np.flatnonzero(mutual & close)
        sparse_map.join(tracks.ids[rows], ids[nearest[rows]])
        return len(rows)

    def _candidates(self, sparse_map: SparseMap, features: BinaryFeatures) -> Iterator[MappedView]:
        similar = self._index.most_similar(features.descriptors, _CANDIDATES)
        numbers = [number for number, _ in similar]
        last = max(self._features, default=-1)
        if last >= 0:
            numbers = [last, *(number for number in numbers if number != last)]
        for number in numbers:
            yield self._view(sparse_map, number)

    def _view_at_rest(self, sparse_map: SparseMap, number: int) -> MappedView:
        """The same, which is kept as long as the key frame stays where it is."""
        pose, kept = sparse_map.key_frames[number].cam_from_world, self._views.get(number)
        if kept is None or not np.array_equal(kept.cam_from_world.matrix(), pose.matrix()):
            kept = self._views[number] = self._view(sparse_map, number)
        return kept

    def _view(self, sparse_map: SparseMap, number: int) -> MappedView:
        """Key frame with the places of its features, from the rays of its neighbours."""
        around = sorted(sparse_map.near(number, _FARTHEST), key=lambda each: -abs(each - number))
        known = [other for other in around if other in self._features and other != number]
        chosen = known[:_NUM_NEIGHBOURS]
        neighbours = [
            (sparse_map.key_frames[other].cam_from_world, self._features[other])
            for other in reversed(chosen)
        ]
        pose = sparse_map.key_frames[number].cam_from_world
        return map_view(number, pose, self._features[number], neighbours, self._place)


_Indexed = tuple[PlaceIndex, PartOfMap, Mapping[int, BinaryFeatures]]


def _joint_index(first: _Indexed, second: _Indexed) -> PlaceIndex:
    """Index of the key frames of both maps, of which only those of the smaller are described."""
    smaller, larger = sorted((first, second), key=lambda each: len(each[0]))
    index, part, _ = larger
    others = {number: features.descriptors for number, features in smaller[2].items()}
    if index.has_learned:
        index.take_in(part.numbers, others)
        return index
    joint = PlaceIndex()
    own = {number: features.descriptors for number, features in larger[2].items()}
    for number, descriptors in sorted((own | others).items()):
        joint.add(number, descriptors)
    return joint


def nodes_relative(nodes: list[Similarity], i: int, j: int) -> Similarity:
    """Similarity between two nodes in the one unit that the world has after a correction."""
    relative = nodes[j].pose() @ nodes[i].pose().inverse()
    return Similarity.from_pose(relative)


def _odometry_edges(sparse_map: SparseMap) -> list[PoseGraphEdge]:
    """Edges along each chain of key frames; a step may be wrong by a percent of its length."""
    chains: dict[int, list[int]] = {}
    for number, key_frame in enumerate(sparse_map.key_frames):
        chains.setdefault(key_frame.chain, []).append(number)
    steps = [pair for numbers in chains.values() for pair in pairwise(numbers)]
    befores, afters = np.array(steps, np.intp).reshape(-1, 2).T
    rotations = np.array([each.rotation for each in sparse_map.key_frames])
    translations = np.array([each.translation for each in sparse_map.key_frames])
    turns = rotations[afters] @ np.swapaxes(rotations[befores], 1, 2)
    ways = translations[afters] - (turns @ translations[befores, :, None])[:, :, 0]
    lengths = np.maximum(np.linalg.norm(ways, axis=1), 1e-6)
    return [
        PoseGraphEdge(
            before,
            after,
            Similarity(1.0, turn, way),
            diagonal_information(2e-3, 0.01 * length, 0.01),
        )
        for (before, after), turn, way, length in zip(steps, turns, ways, lengths, strict=True)
    ]


def _last_seen(sparse_map: SparseMap, ids: Ids) -> NDArray[np.intp]:
    """Number of the newest key frame that sees each landmark (sorted identities), or -1."""
    numbers = np.full(len(ids), -1, np.intp)
    for number, key_frame in enumerate(sparse_map.key_frames):
        rows = np.searchsorted(ids, key_frame.ids)
        rows = np.minimum(rows, len(ids) - 1)
        known = key_frame.is_used & (ids[rows] == key_frame.ids)
        numbers[rows[known]] = number
    return numbers
