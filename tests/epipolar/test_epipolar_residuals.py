# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from exact_matches import any_pose, any_turn, disturbed, exact_matches

from epi360 import Equirectangular
from epi360.epipolar import (
    RESIDUALS,
    angular_residuals,
    essential_from_pose,
    paper_residuals,
    pose_residuals,
    residual_jacobians,
    sampson_residuals,
    tangent_basis,
    tangent_sampson_residuals,
)
from epi360.poses import Pose, rotation_from_vector
from epi360.synthetic import two_view_scene

HALF_DEGREE = np.radians(0.5)
E_RIGHT = essential_from_pose(Pose(np.eye(3), [1, 0, 0]))
# One match in the plane y = 0, which holds the baseline, and one lifted out of it by 0.5 degrees.
FORWARD = [[0.0, 0.0, 1.0]]
UNLIFTED = np.array([[0, 0, 1], [1, 0, 1], [0.3, 0, -1], [-1, 0, -0.1]], dtype=float)


def lifted_by_half_a_degree(directions):
    """Move directions of the plane y = 0 towards -y (up) by 0.5 degrees."""
    unit = directions / np.linalg.norm(directions, axis=1)[:, None]
    return np.cos(HALF_DEGREE) * unit - np.sin(HALF_DEGREE) * np.array([0.0, 1.0, 0.0])


def unit_jacobians(bearings):
    return np.stack([tangent_basis(b) for b in bearings])


def test_half_a_degree_out_of_plane_is_half_a_degree_anywhere_on_the_sphere():
    b1 = np.repeat(FORWARD, 4, axis=0)
    found = angular_residuals(E_RIGHT, b1, lifted_by_half_a_degree(UNLIFTED))
    np.testing.assert_allclose(np.degrees(found), 0.5, atol=1e-12)
    found = paper_residuals(E_RIGHT, b1, lifted_by_half_a_degree(UNLIFTED))
    np.testing.assert_allclose(found, np.sin(HALF_DEGREE), atol=1e-14)


def test_half_a_degree_shared_by_two_views_is_less_by_root_two():
    # C = sin, both normals are unit long and tilted: C / sqrt(2 - 2 C^2) = tan / sqrt 2.
    found = sampson_residuals(E_RIGHT, FORWARD, lifted_by_half_a_degree(np.array(FORWARD)))
    np.testing.assert_allclose(found, np.tan(HALF_DEGREE) / np.sqrt(2.0), atol=1e-14)


def test_the_other_side_of_the_plane_has_the_other_sign():
    below = lifted_by_half_a_degree(UNLIFTED) * [1.0, -1.0, 1.0]
    found = angular_residuals(E_RIGHT, np.repeat(FORWARD, 4, axis=0), below)
    np.testing.assert_allclose(np.degrees(found), -0.5, atol=1e-12)


def test_a_bearing_along_the_normal_is_a_right_angle_away():
    np.testing.assert_allclose(
        np.degrees(angular_residuals(E_RIGHT, FORWARD, [[0, -1, 0]])), 90.0, atol=1e-12
    )


def test_the_epipole_of_view_1_has_no_plane():
    assert np.isnan(angular_residuals(E_RIGHT, [[1, 0, 0]], FORWARD)[0])
    assert np.isnan(paper_residuals(E_RIGHT, [[1, 0, 0]], FORWARD)[0])


@pytest.mark.parametrize("residual", RESIDUALS)
@pytest.mark.parametrize("layout", ["sphere", "room", "behind"])
def test_exact_matches_have_no_residual(residual, layout):
    b1, b2, pose, _ = exact_matches(0, layout=layout)
    J1, J2 = unit_jacobians(b1), unit_jacobians(b2)
    found = pose_residuals(pose, b1, b2, residual, J1, J2)
    np.testing.assert_allclose(found, 0.0, atol=1e-13)


@pytest.mark.parametrize("residual", ["paper", "angular", "sampson"])
@pytest.mark.parametrize("seed", range(5))
def test_residuals_do_not_change_when_a_camera_turns_and_nothing_else(residual, seed):
    b1, b2, _, _ = exact_matches(seed)
    pose, turn = any_pose(seed), Pose(any_turn(seed + 9), np.zeros(3))
    before = pose_residuals(pose, b1, b2, residual)
    turned2 = pose_residuals(turn @ pose, b1, b2 @ turn.rotation.T, residual)
    turned1 = pose_residuals(pose @ turn.inverse(), b1 @ turn.rotation.T, b2, residual)
    np.testing.assert_allclose(turned2, before, atol=1e-12)
    np.testing.assert_allclose(turned1, before, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_sampson_treats_both_views_alike(seed):
    b1, b2, _, _ = exact_matches(seed)
    E, J1, J2 = essential_from_pose(any_pose(seed)), unit_jacobians(b1), unit_jacobians(b2)
    np.testing.assert_allclose(
        sampson_residuals(E.T, b2, b1), sampson_residuals(E, b1, b2), atol=1e-14
    )
    np.testing.assert_allclose(
        tangent_sampson_residuals(E.T, b2, b1, J2, J1),
        tangent_sampson_residuals(E, b1, b2, J1, J2),
        atol=1e-14,
    )


@pytest.mark.parametrize("seed", range(5))
def test_tangent_sampson_with_unit_jacobians_is_the_angular_sampson(seed):
    b1, b2, _, _ = exact_matches(seed)
    E, J1, J2 = essential_from_pose(any_pose(seed)), unit_jacobians(b1), unit_jacobians(b2)
    expected = sampson_residuals(E, b1, b2)
    np.testing.assert_allclose(tangent_sampson_residuals(E, b1, b2, J1, J2), expected, atol=1e-13)
    in_pixels = tangent_sampson_residuals(E, b1, b2, 0.01 * J1, 0.01 * J2)
    np.testing.assert_allclose(in_pixels, 100.0 * expected, atol=1e-11)


def test_sampson_residuals_scatter_like_the_noise_of_each_view():
    scene = two_view_scene(
        0, num_matches=20_000, layout="room", noise_deg=0.4, noise_in_both_views=True
    )
    found = pose_residuals(scene.cam2_from_cam1, scene.bearings1, scene.bearings2, "sampson")
    # The standard deviation of 20,000 samples is itself known to 0.5 %: four times that.
    assert np.degrees(found.std()) == pytest.approx(0.4, abs=0.02 * 0.4)
    assert np.degrees(found.mean()) == pytest.approx(0.0, abs=4 * 0.4 / np.sqrt(20_000))


def test_angular_residuals_scatter_like_noise_in_view_2_alone():
    scene = two_view_scene(1, num_matches=20_000, layout="sphere", noise_deg=0.4)
    found = pose_residuals(scene.cam2_from_cam1, scene.bearings1, scene.bearings2, "angular")
    assert np.degrees(found.std()) == pytest.approx(0.4, abs=0.02 * 0.4)


def test_tangent_sampson_residuals_scatter_like_the_pixel_noise():
    camera = Equirectangular(1024, 512)
    scene = two_view_scene(2, num_matches=20_000, layout="room")
    rng, size = np.random.default_rng(2), (1024, 512)
    pixels1, pixels2 = (
        np.clip(camera.pixels_from_bearings(b) + rng.normal(0.0, 0.7, (20_000, 2)), 0.0, size)
        for b in (scene.bearings1, scene.bearings2)
    )
    found = pose_residuals(
        scene.cam2_from_cam1,
        camera.bearings_from_pixels(pixels1),
        camera.bearings_from_pixels(pixels2),
        "tangent_sampson",
        camera.bearing_jacobians(pixels1),
        camera.bearing_jacobians(pixels2),
    )
    away_from_poles = np.abs(scene.bearings1[:, 1]) < 0.98
    away_from_poles &= np.abs(scene.bearings2[:, 1]) < 0.98
    assert found[away_from_poles].std() == pytest.approx(0.7, abs=0.02 * 0.7)


@pytest.mark.parametrize(
    "direction", [*np.eye(3), *-np.eye(3), [1, 1, 1], [1e-9, 1, 0], [3, -2, 1]]
)
def test_tangent_basis_completes_a_direction_to_a_right_handed_frame(direction):
    t = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    frame = np.column_stack([tangent_basis(t), t])
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, atol=1e-15)


@pytest.mark.parametrize("residual", ["paper", "angular", "sampson"])
@pytest.mark.parametrize("seed", range(5))
def test_residual_jacobians_equal_central_differences(residual, seed):
    b1, b2, _, _ = exact_matches(seed)
    pose, step = any_pose(seed), 1e-6  # residuals of any size, not only small ones

    def residuals_after(change):
        t = pose.translation + tangent_basis(pose.translation) @ change[3:]
        R = rotation_from_vector(change[:3]) @ pose.rotation
        return pose_residuals(Pose(R, t / np.linalg.norm(t)), b1, b2, residual)

    numeric = np.stack(
        [(residuals_after(step * e) - residuals_after(-step * e)) / (2 * step) for e in np.eye(5)],
        axis=1,
    )
    analytic = residual_jacobians(pose, b1, b2, residual)
    # Central differences: rounding 1e-16 / step plus third derivatives times step^2.
    np.testing.assert_allclose(analytic, numeric, atol=1e-6)


@pytest.mark.parametrize("residual", ["paper", "angular", "sampson"])
def test_missing_rows_have_no_residual_and_others_keep_theirs(residual):
    b1, b2, pose, _ = exact_matches(2, 10)
    b2 = disturbed(b2, 1.0, 2)
    expected = pose_residuals(pose, b1, b2, residual)
    b1[3], b2[8, 0] = np.nan, np.nan
    found = pose_residuals(pose, b1, b2, residual)
    missing = np.isin(np.arange(10), [3, 8])
    np.testing.assert_array_equal(np.isnan(found), missing)
    np.testing.assert_array_equal(found[~missing], expected[~missing])


def test_lengths_of_bearings_do_not_change_residuals():
    b1, b2, _, _ = exact_matches(3)
    E = essential_from_pose(any_pose(3))
    for function in (paper_residuals, angular_residuals, sampson_residuals):
        np.testing.assert_allclose(
            function(E, 7.0 * b1, 0.01 * b2), function(E, b1, b2), atol=1e-14
        )


def test_unknown_residual_is_refused_with_the_known_ones():
    b1, b2, pose, _ = exact_matches(0)
    with pytest.raises(ValueError, match="residual must be one of paper, angular.*got 'huber'"):
        pose_residuals(pose, b1, b2, "huber")
    with pytest.raises(ValueError, match="residual must be paper, angular, .* got 'tang"):
        residual_jacobians(pose, b1, b2, "tangent_sampson")


def test_tangent_sampson_asks_for_its_jacobians():
    b1, b2, pose, _ = exact_matches(0)
    with pytest.raises(ValueError, match="tangent_sampson needs jacobians1 and jacobians2"):
        pose_residuals(pose, b1, b2, "tangent_sampson")
    with pytest.raises(ValueError, match=r"jacobians2 must have shape \(40, 3, 2\), got \(39"):
        pose_residuals(pose, b1, b2, "tangent_sampson", unit_jacobians(b1), unit_jacobians(b2)[:39])
