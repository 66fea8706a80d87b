# SPDX-License-Identifier: BSD-3-Clause
"""A walk of which frames are missing, so that another map begins, and the way back to the first."""

from copy import deepcopy
from functools import cache

import numpy as np
import pytest

from epi360 import Odometry, OdometryOptions
from epi360.cameras import Equirectangular
from epi360.jobs.trajectories import align
from epi360.odometry import segment
from epi360.odometry.loop_closure import LoopClosure
from epi360.odometry.map_parts import Connection
from epi360.odometry.pose_graph import diagonal_information
from epi360.odometry.relocalization import map_view
from epi360.odometry.similarity import Similarity
from epi360.odometry.surroundings import Surroundings
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

CAMERA = Equirectangular(512, 256)
STEP_M, NUM_BEFORE, NUM_MISSING, NUM_AFTER = 0.1, 10, 22, 4
LAST = NUM_BEFORE + NUM_MISSING + NUM_AFTER


def world_from_cam(number, aside_m):
    sway = np.sin(0.7 * number)
    turn = rotation_from_vector([0.01 * sway, 0.03 * number, 0.008 * sway])
    place = [-1.2 + STEP_M * number + 0.3 * aside_m, -1.5 + 0.01 * sway, 0.01 * number - 0.3]
    return Pose(turn, np.array(place) + [0.0, 0.0, aside_m])


def walk():
    there = [*range(NUM_BEFORE), *range(LAST - NUM_AFTER, LAST)]
    back = range(LAST, -1, -1)
    return [world_from_cam(k, 0.0) for k in there] + [world_from_cam(k, 0.1) for k in back]


@cache
def frames():
    room = furnished_room(1)
    return [room.render(CAMERA, pose, supersample=1).image for pose in walk()]


def tracked(**options):
    odometry = Odometry(CAMERA, options=OdometryOptions(**options))
    for image in frames():
        odometry.add_frame(image)
    return odometry


@cache
def two_maps():
    return tracked(loop_closure=False)


def metres_from(positions, indices):
    """Similarity from a world to the room, and how far positions are from the truth then."""
    truth = np.array([walk()[index].translation for index in indices])
    fit = align(positions, truth, "sim3")
    errors = np.linalg.norm(fit.apply(positions) - truth, axis=1)
    return Similarity(fit.scale, fit.rotation, fit.translation), errors


def test_the_way_back_joins_two_maps():
    odometry = tracked()
    assert odometry.num_segments == 1
    results = odometry.results()
    joined = [each for each in results if "joins map 2 to map 1" in each.message]
    assert len(joined) == 1 and joined[0].loop_frame < NUM_BEFORE
    is_tracked = [each.status == "tracked" for each in results]
    assert np.mean(is_tracked) > 0.95
    trajectory = odometry.trajectory()
    _, errors = metres_from(trajectory.positions, trajectory.indices)
    assert errors.max() < 0.02
    first = results[0].cam_from_world  # the world stays that of the map that began first
    np.testing.assert_allclose(first.matrix(), np.eye(4), atol=1e-9)
    indices = [each.index for each in odometry.key_frames()]
    assert indices == sorted(indices)
    assert odometry.began_past(NUM_BEFORE) and not odometry.began_past(NUM_BEFORE - 3)


def test_maps_are_not_joined_where_the_pictures_do_not_make_it_sure(monkeypatch):
    monkeypatch.setattr(Surroundings, "deny", lambda *_, in_doubt=False, **__: in_doubt)
    assert tracked().num_segments == 2


def test_without_loops_no_maps_are_joined():
    odometry = two_maps()
    assert odometry.num_segments == 2
    told = {each.message.rpartition("(")[2] for each in odometry.results()[: NUM_BEFORE - 1]}
    assert told == {"in map 1, which is not connected)"}
    assert not odometry.began_past(NUM_BEFORE)


def connection_by_truth(new, old):
    """Connection of the last key frame of one map with the first of another."""
    metres = {}
    for each in (new, old):
        key_frames = each.map.key_frames
        centers = np.array([key_frame.center for key_frame in key_frames])
        metres[each], _ = metres_from(centers, [key_frame.index for key_frame in key_frames])
    views = []
    for each, number in ((new, len(new.map.key_frames) - 1), (old, 0)):
        key_frame = each.map.key_frames[number]
        features = each.recognition.features(frames()[key_frame.index][:, :, 1].copy())
        views.append(map_view(number, key_frame.cam_from_world, features, []))
    new_from_world, old_from_world = (Similarity.from_pose(each.cam_from_world) for each in views)
    new_from_old_world = metres[new].inverse() @ metres[old]
    new_from_old = new_from_world @ new_from_old_world @ old_from_world.inverse()
    information = diagonal_information(0.003, 0.003, 0.01)
    loop = LoopClosure(0, views[0].key_frame, new_from_old, information, 50, 20, "ok")
    return Connection.of(loop, *views, 0.012, is_sure=True)


@pytest.mark.parametrize("taking", [1, 2])
def test_whichever_map_takes_in_the_other_all_frames_are_where_they_were(taking, monkeypatch):
    segments = deepcopy(two_maps()._segments)
    own, other = segments[taking], segments[3 - taking]
    older = segments[1]
    before = {index: older.pose_of(index).matrix() for index in older.frames}
    num_frames = len(own.frames) + len(other.frames)
    fresh = iter(range(10**6, 2 * 10**6, 10**4))
    connection = connection_by_truth(own, other)
    monkeypatch.setattr(segment, "_MOST_AT_A_JOIN", 0)
    own.take_in(other, (connection, connection), lambda count: next(fresh) + np.arange(count))
    assert len(own.frames) == num_frames
    for index, matrix in before.items():
        np.testing.assert_allclose(own.pose_of(index).matrix(), matrix, atol=1e-9)
    indices = sorted(own.frames)
    centers = np.array([own.pose_of(index).inverse().translation for index in indices])
    _, errors = metres_from(centers, indices)
    assert errors.max() < 0.03
    own.pose_waiting()
    again = np.array([own.pose_of(index).inverse().translation for index in indices])
    np.testing.assert_allclose(again, centers, atol=0.01)
    own.adjust_all()
    points = own.points()
    assert np.isfinite(points.positions).all()
