# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
from place_views import first_visit, mapped, second_visit
from scipy.spatial.transform import Rotation

from epi360.features.binary_features import BinaryFeatures
from epi360.odometry.loop_closure import close_loop
from epi360.odometry.pose_graph import PoseGraphEdge, optimize_pose_graph
from epi360.odometry.relocalization import PlaceOptions, num_cells, relocalize
from epi360.odometry.similarity import Similarity
from epi360.poses import rotation_error_deg


def drifted():
    """World of a second map: turned, moved and of another scale; world_from_map."""
    rotation = Rotation.from_rotvec([0.02, 0.3, -0.01]).as_matrix()
    return Similarity(0.8, rotation, np.array([0.3, -0.1, 0.4]))


def far_from(pose, other):
    return np.linalg.norm(pose.inverse().translation - other.inverse().translation)


def test_camera_that_comes_back_is_found_though_it_is_turned():
    old = mapped(3, first_visit())
    pose, features = second_visit()[0]
    found = relocalize(features, [old])
    assert found.success
    assert found.key_frame == 3
    assert rotation_error_deg(found.pose.cam_from_world, pose) < 0.4
    assert far_from(found.pose.cam_from_world, pose) < 0.03  # metres


def test_loop_says_place_and_scale_between_two_maps():
    old, new = mapped(0, first_visit()), mapped(40, second_visit(), drifted())
    loop = close_loop(new, old)
    assert loop.success
    assert (loop.old, loop.new) == (0, 40)
    scale = 1.0 / drifted().scale  # units of the second map in a metre
    truth = second_visit()[0][0] @ first_visit()[0][0].inverse()
    assert abs(np.log(loop.new_from_old.scale / scale)) < 0.03
    assert rotation_error_deg(loop.new_from_old.rotation, truth.rotation) < 0.4
    shift = loop.new_from_old.translation / scale - truth.translation
    assert np.linalg.norm(shift) < 0.03


def test_loop_as_an_edge_takes_the_drift_away():
    old, new = mapped(0, first_visit()), mapped(1, second_visit(), drifted())
    loop = close_loop(new, old)
    edges = [PoseGraphEdge(0, 1, loop.new_from_old, loop.information)]
    start = [Similarity.from_pose(view.cam_from_world) for view in (old, new)]
    result = optimize_pose_graph(start, edges)
    assert far_from(result.node_from_world[1].pose(), second_visit()[0][0]) < 0.03


def test_twin_room_seen_from_the_same_place_closes_no_loop():
    old = mapped(0, first_visit(0))
    for views in (first_visit(1), second_visit(1)):
        loop = close_loop(mapped(9, views), old)
        assert not loop.success
        assert loop.new_from_old is None
        assert not relocalize(views[0][1], [old]).success


def test_true_key_frame_is_found_behind_one_of_a_twin_room():
    twin, true = mapped(0, first_visit(1)), mapped(5, first_visit(0))
    assert relocalize(second_visit()[0][1], [twin, true]).key_frame == 5


def test_loop_that_asks_for_more_drift_than_the_path_allows_is_refused():
    old, new = mapped(0, first_visit()), mapped(40, second_visit(), drifted())
    assert close_loop(new, old, path_length=50.0).success
    refused = close_loop(new, old, path_length=1.0)
    assert refused.status == "drift_too_large"
    assert refused.new_from_old is None


def test_view_without_points_says_that_there_are_too_few():
    alone = mapped(0, first_visit()[:1])
    assert np.isnan(alone.points).all()
    assert relocalize(second_visit()[0][1], [alone]).status == "too_few_matches"
    assert close_loop(mapped(1, second_visit()), alone).status == "too_few_matches"


def test_features_without_matches_and_no_candidates_say_so():
    nothing = BinaryFeatures(np.zeros((0, 3)), np.zeros((0, 32), np.uint8))
    found = relocalize(nothing, [mapped(0, first_visit())])
    assert found.status == "too_few_matches"
    assert np.isnan(found.pose.cam_from_world.translation).all()
    assert relocalize(nothing, []).key_frame == -1


def test_inliers_that_are_not_spread_enough_are_not_believed():
    old = mapped(0, first_visit())
    strict = PlaceOptions(min_cells=49)
    status = relocalize(second_visit()[0][1], [old], options=strict).status
    assert status == "concentrated_inliers"


def test_cells_are_counted_over_the_whole_sphere():
    rng = np.random.default_rng(0)
    bearings = rng.standard_normal((2000, 3))
    bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
    assert num_cells(bearings) == 48
    assert num_cells(np.tile([0.0, 0.1, -0.995], (50, 1)) + 1e-3) == 1
    assert num_cells(np.zeros((0, 3))) == 0


def test_twin_room_explains_less_of_what_is_seen_than_the_room_itself():
    old = mapped(0, first_visit())
    lenient = PlaceOptions(min_explained_share=0.0)
    same = relocalize(second_visit(0)[0][1], [old], options=lenient)
    twin = relocalize(first_visit(1)[0][1], [old], options=lenient)
    assert twin.status == "ok"  # furniture alone would have been believed
    assert twin.explained_share < 0.5 < 0.6 < same.explained_share
