# SPDX-License-Identifier: BSD-3-Clause
import numpy as np

from epi360 import Pose
from epi360.odometry.frame_result import FrameTracks, shared_rows
from epi360.odometry.key_frames import SparseMap

HERE = Pose(np.eye(3), np.zeros(3))


def tracks_of(index, ids):
    ids = np.array(ids)
    bearings = np.tile([0.0, 0.0, 1.0], (len(ids), 1))
    return FrameTracks(index, ids, bearings, np.zeros((len(ids), 2)))


def map_with(*seen):
    sparse_map = SparseMap()
    for index, ids in enumerate(seen):
        sparse_map.add_key_frame(tracks_of(index, ids), HERE)
    return sparse_map


def place(sparse_map, ids):
    sparse_map.set_positions(np.array(ids), np.arange(3.0 * len(ids)).reshape(-1, 3))


def test_identities_may_come_in_any_order():
    sparse_map = map_with([9000, 9001])
    place(sparse_map, [9000, 9001])
    place(sparse_map, [3, 100_000])
    assert sparse_map.ids.tolist() == [3, 9000, 9001, 100_000]
    np.testing.assert_array_equal(sparse_map.positions_of(np.array([9001])), [[3.0, 4.0, 5.0]])
    assert np.isnan(sparse_map.positions_of(np.array([50]))).all()


def test_only_landmarks_with_a_place_are_observed():
    sparse_map = map_with([1, 2, 3], [2, 3, 4])
    place(sparse_map, [2, 4])
    places, ids, _ = sparse_map.observations([0, 1])
    assert (places.tolist(), ids.tolist()) == ([0, 1, 1], [2, 2, 4])
    assert sparse_map.is_free(np.array([1, 2])).tolist() == [True, False]


def test_joined_tracks_are_one_landmark_which_a_key_frame_sees_once():
    sparse_map = map_with([1, 2], [1, 7], [8, 9])
    place(sparse_map, [1, 2, 7])
    sparse_map.join(np.array([7]), np.array([1]))
    sparse_map.join(np.array([8]), np.array([7]))
    assert sparse_map.landmarks_of(np.array([1, 7, 8])).tolist() == [1, 1, 1]
    places, ids, _ = sparse_map.observations([0, 1, 2])
    assert list(zip(places.tolist(), ids.tolist(), strict=True)) == [(0, 1), (0, 2), (1, 1), (2, 1)]
    assert len(sparse_map.ids) == 2


def test_landmark_that_two_tracks_show_is_shared_once():
    rows1, rows2 = shared_rows(np.array([5, 3, 5, 9]), np.array([9, 5, 1]))
    assert list(zip(rows1.tolist(), rows2.tolist(), strict=True)) == [(0, 1), (3, 0)]


def test_landmark_that_three_frames_disagree_with_is_gone_for_good():
    sparse_map = map_with([1, 2])
    place(sparse_map, [1, 2])
    for _ in range(3):
        sparse_map.count_agreement(np.array([1, 2]), np.array([True, False]))
    assert sparse_map.ids.tolist() == [1]
    assert not sparse_map.is_free(np.array([2]))[0]
    assert 2 not in sparse_map.add_key_frame(tracks_of(1, [1, 2]), HERE).ids


def test_landmark_that_agrees_as_often_as_not_stays():
    sparse_map = map_with([1])
    place(sparse_map, [1])
    for agrees in (False, True) * 10:
        sparse_map.count_agreement(np.array([1]), np.array([agrees]))
    assert sparse_map.ids.tolist() == [1]
