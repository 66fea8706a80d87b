# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from test_key_frames import tracks_of

from epi360 import Equirectangular, Pose
from epi360.features.binary_features import BinaryFeatures
from epi360.odometry import recognition
from epi360.odometry.key_frames import SparseMap
from epi360.odometry.loop_closure import LoopClosure
from epi360.odometry.pose_graph import PoseGraphResult
from epi360.odometry.recognition import Recognition
from epi360.odometry.similarity import Similarity

ROUND = 40  # key frames
MOST_MOVED = 30  # key frames that are moved for each new one, on average


@pytest.fixture
def moved(monkeypatch):
    """How many key frames each correction moves; a loop is closed where a place is the same."""
    numbers = []

    def counted(nodes, edges):
        numbers.append(len(nodes))
        return PoseGraphResult(
            list(nodes), np.zeros((len(edges), 7)), np.zeros(len(edges)), 1, True
        )

    def closed(new, old, **_):
        if (new - old) % ROUND:
            return LoopClosure(old, new, None, None, 0, 0, "too_few_matches")
        return LoopClosure(old, new, Similarity.from_pose(pose_at(0)), np.eye(7), 50, 48, "ok")

    monkeypatch.setattr(recognition, "optimize_pose_graph", counted)
    monkeypatch.setattr(recognition, "close_loop", closed)
    monkeypatch.setattr(Recognition, "_view", lambda self, sparse_map, number: number)
    return numbers


def pose_at(number):
    return Pose(np.eye(3), np.array([0.1 * (number % ROUND), 0.0, 0.0]))


def features_at(number):
    rng = np.random.default_rng(number % ROUND)
    descriptors = rng.integers(0, 256, (40, 32), dtype=np.uint8)
    return BinaryFeatures(np.tile([0.0, 0.0, 1.0], (40, 1)), descriptors)


def walk_rounds(num_key_frames):
    """Numbers of the key frames that closed a loop on rounds through one place."""
    sparse_map = SparseMap()
    seen = Recognition(Equirectangular(64, 32), None, 0.1)
    closed = []
    for number in range(num_key_frames):
        sparse_map.add_key_frame(tracks_of(number, [number]), pose_at(number))
        sparse_map.set_positions(np.array([number]), np.ones((1, 3)))
        seen.add(number, features_at(number))
        loop = seen.close_loop(sparse_map)
        if loop is not None:
            seen.correct(sparse_map, loop)
            closed.append(number)
    return closed


def test_work_for_a_key_frame_is_bounded_however_often_a_place_is_seen(moved):
    closed = walk_rounds(15 * ROUND)
    work = np.zeros(15 * ROUND)
    work[closed] = moved
    for start in range(0, 15 * ROUND, 3 * ROUND):
        part = work[start : start + 3 * ROUND]
        # The last correction of a part is paid for by the key frames after it.
        assert part.sum() <= 3 * ROUND * MOST_MOVED + part.max()
    assert len(closed) > 30  # it still corrects
