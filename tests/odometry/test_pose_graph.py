# SPDX-License-Identifier: BSD-3-Clause
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from epi360.odometry.pose_graph import (
    PoseGraphEdge,
    diagonal_information,
    move_points,
    optimize_pose_graph,
)
from epi360.odometry.pose_graph_edges import Edges, Nodes, edge_jacobians, edge_residuals
from epi360.odometry.similarity import Similarity
from epi360.poses import Pose, rotation_error_deg


def random_similarity(rng, spread=0.3):
    rotation = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    return Similarity(np.exp(spread * rng.standard_normal()), rotation, rng.standard_normal(3))


def assert_same(a, b, atol):
    np.testing.assert_allclose(a.rotation, b.rotation, rtol=0, atol=atol)
    np.testing.assert_allclose(a.translation, b.translation, rtol=0, atol=atol)
    assert abs(np.log(a.scale / b.scale)) <= atol


def circle(num, radius=20.0):
    """Cameras cam_from_world that walk round a circle, looking ahead."""
    poses = []
    for angle in np.linspace(0.0, 2 * np.pi, num, endpoint=False):
        rotation = Rotation.from_rotvec([0.1 * np.sin(3 * angle), -angle, 0.0]).as_matrix()
        center = radius * np.array([np.sin(angle), 0.1 * np.sin(2 * angle), np.cos(angle)])
        poses.append(Similarity(1.0, rotation, -rotation @ center))
    return poses


def chained(first, steps):
    nodes = [first]
    for step in steps:
        nodes.append(step @ nodes[-1])
    return nodes


def neighbours(nodes):
    return [
        PoseGraphEdge(i, i + 1, nodes[i + 1] @ nodes[i].inverse()) for i in range(len(nodes) - 1)
    ]


def centers(nodes):
    return np.array([node.pose().inverse().translation for node in nodes])


@pytest.mark.parametrize("seed", range(5))
def test_similarities_form_a_group(seed):
    rng = np.random.default_rng(seed)
    a, b, c = (random_similarity(rng) for _ in range(3))
    one = Similarity(1.0, np.eye(3), np.zeros(3))
    assert_same((a @ b) @ c, a @ (b @ c), 1e-12)
    assert_same(a @ a.inverse(), one, 1e-12)
    assert_same(a.inverse() @ a, one, 1e-12)
    points = rng.standard_normal((4, 3))
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-12)


def test_rigid_pose_of_a_similarity_keeps_the_camera_centre():
    node = random_similarity(np.random.default_rng(1))
    center = node.inverse().translation
    np.testing.assert_allclose(node.pose().inverse().translation, center, atol=1e-12)
    np.testing.assert_array_equal(node.pose().rotation, node.rotation)


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_scale_must_be_positive_and_finite(scale):
    with pytest.raises(ValueError, match="scale must be positive"):
        Similarity(scale, np.eye(3), np.zeros(3))


@pytest.mark.parametrize("seed", range(5))
def test_jacobians_equal_finite_differences(seed):
    rng = np.random.default_rng(seed)
    nodes = Nodes.of([random_similarity(rng) for _ in range(4)])
    i, j = np.array([0, 1, 2, 3]), np.array([1, 2, 0, 1])
    edges = Edges(i, j, Nodes.of([random_similarity(rng) for _ in i]), np.zeros((4, 7, 7)))
    by_i, by_j = edge_jacobians(nodes, edges)
    step = 1e-6
    for ends, jacobians in ((i, by_i), (j, by_j)):
        for edge, node in enumerate(ends):
            for parameter in range(7):
                change = np.zeros((4, 7))
                change[node, parameter] = step
                after = edge_residuals(nodes.moved(change), edges)[edge]
                before = edge_residuals(nodes.moved(-change), edges)[edge]
                slope = (after - before) / (2 * step)
                np.testing.assert_allclose(jacobians[edge, :, parameter], slope, atol=1e-7)


def test_jacobian_of_a_zero_residual_is_exact():
    nodes = circle(5)
    edges = neighbours(nodes)
    arrays = Edges(
        np.arange(4),
        np.arange(1, 5),
        Nodes.of([edge.j_from_i for edge in edges]),
        np.zeros((4, 7, 7)),
    )
    _, by_j = edge_jacobians(Nodes.of(nodes), arrays)
    np.testing.assert_allclose(by_j[:, :3, :3], np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-12)


def test_exact_loop_closes_exactly_from_a_wrong_start():
    truth = circle(60)
    edges = [*neighbours(truth), PoseGraphEdge(59, 0, truth[0] @ truth[59].inverse())]
    rng = np.random.default_rng(0)
    start = [truth[0]]
    for node in truth[1:]:
        turn = Rotation.from_rotvec(0.2 * rng.standard_normal(3)).as_matrix()
        wrong = Similarity(np.exp(0.2 * rng.standard_normal()), turn, rng.standard_normal(3))
        start.append(wrong @ node)
    result = optimize_pose_graph(start, edges)
    assert result.converged
    assert result.cost < 1e-18
    for found, node in zip(result.node_from_world, truth, strict=True):
        assert_same(found, node, 1e-8)


def test_turning_moving_and_scaling_the_world_changes_nothing_else():
    rng = np.random.default_rng(2)
    truth = circle(30)
    noisy = [
        PoseGraphEdge(
            edge.i, edge.j,
            Similarity(1.0, np.eye(3), 0.05 * rng.standard_normal(3)) @ edge.j_from_i,
        )
        for edge in [*neighbours(truth), PoseGraphEdge(29, 0, truth[0] @ truth[29].inverse())]
    ]  # fmt: skip
    world_from_other = random_similarity(rng)
    plain = optimize_pose_graph(truth, noisy)
    turned = optimize_pose_graph([node @ world_from_other for node in truth], noisy)
    np.testing.assert_allclose(turned.cost, plain.cost, rtol=1e-9)
    for a, b in zip(turned.node_from_world, plain.node_from_world, strict=True):
        assert_same(a, b @ world_from_other, 1e-6)  # the search stops where rounding begins


def test_fixed_nodes_stay_and_hold_the_gauge():
    truth = circle(20)
    edges = neighbours(truth)
    moved = [truth[0], *(Similarity(1.1, np.eye(3), np.ones(3)) @ node for node in truth[1:])]
    result = optimize_pose_graph(moved, edges, fixed=[7])
    assert_same(result.node_from_world[7], moved[7], 0.0)
    for k in (0, 19):
        expected = truth[k] @ truth[7].inverse() @ moved[7]
        assert_same(result.node_from_world[k], expected, 1e-8)


def test_nodes_that_no_fixed_node_holds_stay():
    truth = circle(6)
    edges = [*neighbours(truth[:3]), PoseGraphEdge(3, 4, truth[4] @ truth[3].inverse())]
    moved = [truth[0]] + [Similarity(1.0, np.eye(3), np.ones(3)) @ node for node in truth[1:]]
    result = optimize_pose_graph(moved, edges)
    assert_same(result.node_from_world[2], truth[2], 1e-8)
    for k in (3, 4, 5):
        assert_same(result.node_from_world[k], moved[k], 0.0)


def drifted_loop(num):
    """Steps of a loop whose scale shrinks by a fifth, evenly, and the true edge that closes it."""
    truth = circle(num)
    scales = 0.8 ** (np.arange(num) / (num - 1))
    steps = []
    for k, edge in enumerate(neighbours(truth)):
        step = edge.j_from_i
        steps.append(Similarity(1.0, step.rotation, scales[k + 1] * step.translation))
    closing = truth[0] @ truth[-1].inverse()
    loop = Similarity(1.0 / scales[-1], closing.rotation, closing.translation)
    # The loop is sure: the least squares would share the drift with its edge otherwise.
    edge = PoseGraphEdge(num - 1, 0, loop, 1e8 * np.eye(7))
    return truth, chained(truth[0], steps), edge


def test_scale_drift_of_a_loop_of_2000_nodes_is_removed_in_two_seconds():
    truth, drifted, loop = drifted_loop(2000)
    assert np.linalg.norm(centers(drifted) - centers(truth), axis=1).max() > 2.0
    begin = time.process_time()
    result = optimize_pose_graph(drifted, [*neighbours(drifted), loop])
    seconds = time.process_time() - begin
    assert result.converged
    np.testing.assert_allclose(centers(result.node_from_world), centers(truth), rtol=0, atol=1e-5)
    np.testing.assert_allclose(result.node_from_world[-1].scale, 0.8, rtol=1e-6)
    assert seconds < 2.0 * 2  # two cores may both be counted


def test_random_drift_of_a_loop_becomes_much_smaller():
    rng = np.random.default_rng(4)
    truth = circle(400)
    steps = []
    for edge in neighbours(truth):
        turn = Rotation.from_rotvec(np.radians(0.3) * rng.standard_normal(3)).as_matrix()
        noise = Similarity(1.0, turn, 0.01 * rng.standard_normal(3))
        steps.append(noise @ edge.j_from_i)
    drifted = chained(truth[0], steps)
    information = diagonal_information(np.radians(0.3), 0.01, 0.01)
    edges = [
        PoseGraphEdge(edge.i, edge.j, edge.j_from_i, information) for edge in neighbours(drifted)
    ]
    edges.append(PoseGraphEdge(399, 0, truth[0] @ truth[399].inverse(), 100.0 * information))
    result = optimize_pose_graph(drifted, edges)
    before = np.linalg.norm(centers(drifted) - centers(truth), axis=1)
    after = np.linalg.norm(centers(result.node_from_world) - centers(truth), axis=1)
    assert after.max() < 0.5 * before.max()
    assert rotation_error_deg(result.node_from_world[399].pose(), truth[399].pose()) < 0.2


def test_edge_that_contradicts_the_others_has_the_largest_cost():
    truth = circle(50)
    wrong = Similarity(1.0, np.eye(3), np.array([3.0, 0.0, 0.0]))
    edges = [
        *neighbours(truth),
        PoseGraphEdge(49, 0, truth[0] @ truth[49].inverse()),
        PoseGraphEdge(25, 0, truth[0] @ truth[25].inverse()),
        PoseGraphEdge(30, 5, wrong @ truth[5] @ truth[30].inverse()),
    ]
    result = optimize_pose_graph(truth, edges)
    assert int(np.argmax(result.edge_costs)) == len(edges) - 1


def test_points_keep_their_place_before_their_key_frame():
    rng = np.random.default_rng(5)
    before = [Similarity.from_pose(node.pose()) for node in circle(4)]
    after = [random_similarity(rng) @ node for node in before]
    points = rng.standard_normal((7, 3))
    reference = np.array([0, 1, 2, 3, 3, 0, -1])
    moved = move_points(points, reference, before, after)
    for point, new, k in zip(points[:-1], moved[:-1], reference[:-1], strict=True):
        seen = before[k].apply(point[None])[0]
        np.testing.assert_allclose(after[k].apply(new[None])[0], seen, atol=1e-12)
    np.testing.assert_array_equal(moved[-1], points[-1])


def test_point_moved_with_its_camera_is_seen_in_the_same_direction():
    node = Similarity.from_pose(Pose(np.eye(3), np.array([0.0, 0.0, 1.0])))
    grown = Similarity(2.0, np.eye(3), np.array([0.0, 0.0, 1.0]))
    moved = move_points(np.array([[1.0, 0.0, 1.0]]), np.array([0]), [node], [grown])
    # Before: (1, 0, 2) in the camera. The world shrank to half: the camera is at z = -0.5.
    np.testing.assert_allclose(moved, [[0.5, 0.0, 0.5]], atol=1e-15)
    seen = grown.pose().rotation @ moved[0] + grown.pose().translation
    np.testing.assert_allclose(np.cross(seen, [1.0, 0.0, 2.0]), 0.0, atol=1e-15)


def test_wrong_input_is_named():
    nodes = circle(3)
    edge = neighbours(nodes)[0]
    with pytest.raises(ValueError, match="at least one node"):
        optimize_pose_graph(nodes, [edge], fixed=[])
    with pytest.raises(ValueError, match="numbers of 3 nodes, got 3"):
        optimize_pose_graph(nodes, [edge], fixed=[3])
    with pytest.raises(ValueError, match=r"edges\[0\] must join two of 3 nodes, got 1 and 1"):
        optimize_pose_graph(nodes, [PoseGraphEdge(1, 1, edge.j_from_i)])
    with pytest.raises(ValueError, match="finite 7x7 matrix"):
        optimize_pose_graph(nodes, [PoseGraphEdge(0, 1, edge.j_from_i, np.eye(6))])


def test_graph_without_edges_stays_as_it_is():
    nodes = circle(3)
    result = optimize_pose_graph(nodes, [])
    assert result.converged
    assert_same(result.node_from_world[2], nodes[2], 0.0)
    assert optimize_pose_graph([], []).node_from_world == []
