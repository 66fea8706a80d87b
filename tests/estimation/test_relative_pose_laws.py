# SPDX-License-Identifier: BSD-3-Clause
"""Laws of the robust estimator on exact data, with and without outliers."""

from dataclasses import fields

import numpy as np
import pytest
from noisy_problems import noisy_scene, unit_pose

from epi360 import Equirectangular, RansacOptions, estimate_absolute_pose, estimate_relative_pose
from epi360.epipolar import essential_from_pose, pose_residuals, tangent_basis
from epi360.poses import Pose, rotation_from_vector
from epi360.synthetic import two_view_scene

# Outliers may lie within the smallest gate of exact data, 4e-6 rad, and then move the pose by less.
ATOL = 1e-6
OUTLIERS = [0.0, 0.3]


def exact_scene(seed, outliers=0.0, layout="room"):
    return two_view_scene(seed, num_matches=80, layout=layout, outlier_ratio=outliers)


def pose_of(bearings1, bearings2, **options):
    result = estimate_relative_pose(bearings1, bearings2, **options)
    assert result.status == "ok"
    return result.cam2_from_cam1


def any_turn(seed):
    axis = np.random.default_rng(seed).normal(size=3)
    return Pose(rotation_from_vector(2.5 * axis / np.linalg.norm(axis)), np.zeros(3))


def assert_same_pose(a, b):
    np.testing.assert_allclose(a.rotation, b.rotation, atol=ATOL)
    np.testing.assert_allclose(a.translation, b.translation, atol=ATOL)


@pytest.mark.parametrize("outliers", OUTLIERS)
@pytest.mark.parametrize("layout", ["room", "sphere", "behind", "cone"])
@pytest.mark.parametrize("seed", range(5))
def test_exact_matches_give_the_truth_wherever_the_points_lie(seed, layout, outliers):
    scene = exact_scene(seed, outliers, layout)
    result = estimate_relative_pose(scene.bearings1, scene.bearings2)
    assert result.status == "ok"
    assert_same_pose(result.cam2_from_cam1, unit_pose(scene))
    assert result.inlier_mask[scene.inlier_mask].all()


def test_every_point_behind_both_cameras_is_nothing_special():
    scene = noisy_scene(0, 0.2, 0.3, layout="behind")
    assert (scene.bearings1[:, 2] < 0.0).all()
    result = estimate_relative_pose(scene.bearings1, scene.bearings2)
    assert result.success and result.inlier_mask[scene.inlier_mask].mean() > 0.95


@pytest.mark.parametrize("outliers", OUTLIERS)
@pytest.mark.parametrize("seed", range(20))
def test_turning_a_camera_turns_the_pose(seed, outliers):
    scene, turn = exact_scene(seed, outliers), any_turn(seed)
    b1, b2, R = scene.bearings1, scene.bearings2, turn.rotation
    before = pose_of(b1, b2)
    assert_same_pose(pose_of(b1, b2 @ R.T), turn @ before)
    assert_same_pose(pose_of(b1 @ R.T, b2), before @ turn.inverse())


@pytest.mark.parametrize("outliers", OUTLIERS)
@pytest.mark.parametrize("seed", range(20))
def test_swapping_the_views_inverts_the_pose(seed, outliers):
    scene = exact_scene(seed, outliers)
    forward = pose_of(scene.bearings1, scene.bearings2)
    assert_same_pose(pose_of(scene.bearings2, scene.bearings1), forward.inverse())


@pytest.mark.parametrize("outliers", OUTLIERS)
@pytest.mark.parametrize("seed", range(20))
def test_the_order_of_the_matches_does_not_matter(seed, outliers):
    scene = exact_scene(seed, outliers)
    order = np.random.default_rng(seed).permutation(80)
    before = pose_of(scene.bearings1, scene.bearings2)
    assert_same_pose(pose_of(scene.bearings1[order], scene.bearings2[order]), before)


@pytest.mark.parametrize("seed", range(5))
def test_the_lengths_of_the_bearings_do_not_matter(seed):
    scene = exact_scene(seed, 0.3)
    lengths = np.random.default_rng(seed).uniform(0.01, 100.0, (80, 1))
    before = pose_of(scene.bearings1, scene.bearings2)
    assert_same_pose(pose_of(lengths * scene.bearings1, scene.bearings2 / lengths), before)


@pytest.mark.parametrize("seed", range(5))
def test_the_seed_of_the_sampling_does_not_matter_on_exact_data(seed):
    scene = exact_scene(seed, 0.3)
    before = pose_of(scene.bearings1, scene.bearings2, seed=0)
    assert_same_pose(pose_of(scene.bearings1, scene.bearings2, seed=seed + 1), before)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"inlier_threshold_deg": 1.0},
        {"residual": "angular"},
        {"residual": "paper"},
        {"options": RansacOptions(minimal_solver="eight_point")},
        {"seed": 12345678901234567890},
        {"seed": -1},
    ],
)
def test_same_input_and_seed_give_the_same_bits(options):
    scene = noisy_scene(3, 0.3, 0.5)
    assert_same_bits(
        *(estimate_relative_pose(scene.bearings1, scene.bearings2, **options) for _ in range(2))
    )


def test_the_alternatives_of_a_plane_are_the_same_bits_too():
    scene = noisy_scene(13, 0.1, 0.3, layout="plane")
    first, second = (estimate_relative_pose(scene.bearings1, scene.bearings2) for _ in range(2))
    assert first.status == "planar_ambiguous" and len(first.alternatives) == 1
    assert_same_bits(first, second)


def assert_same_bits(first, second):
    for field in fields(first):
        if field.name == "cam2_from_cam1":
            np.testing.assert_array_equal(
                first.cam2_from_cam1.matrix(), second.cam2_from_cam1.matrix()
            )
        elif field.name == "alternatives":
            assert len(first.alternatives) == len(second.alternatives)
            for pose, again in zip(first.alternatives, second.alternatives, strict=True):
                np.testing.assert_array_equal(pose.matrix(), again.matrix())
        else:
            np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name))


@pytest.mark.parametrize(
    "options",
    [
        {"inlier_threshold_deg": 0.1},
        {"inlier_threshold_deg": 3},
        {"residual": "angular"},
        {"residual": "paper"},
        {"options": RansacOptions(minimal_solver="eight_point")},
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_every_residual_solver_and_threshold_finds_the_truth_of_exact_data(options, seed):
    scene = exact_scene(seed)
    assert_same_pose(pose_of(scene.bearings1, scene.bearings2, **options), unit_pose(scene))


def test_the_parts_of_a_result_agree_with_one_another():
    scene = noisy_scene(4, 0.3, 0.4)
    result = estimate_relative_pose(scene.bearings1, scene.bearings2)
    pose = result.cam2_from_cam1
    assert result.success and result.num_matches == 200
    assert result.num_inliers == result.inlier_mask.sum()
    assert result.inlier_mask.shape == result.residuals_rad.shape == (200,)
    np.testing.assert_allclose(np.linalg.norm(pose.translation), 1.0, atol=1e-12)
    np.testing.assert_array_equal(result.E, essential_from_pose(pose))
    np.testing.assert_array_equal(result.translation_basis, tangent_basis(pose.translation))
    gate = np.radians(result.inlier_threshold_deg)
    assert np.abs(result.residuals_rad[result.inlier_mask]).max() < gate
    assert 2.0 * result.noise_deg < result.inlier_threshold_deg < 5.0 * result.noise_deg
    np.testing.assert_allclose(result.covariance, result.covariance.T, atol=1e-18)
    assert (np.linalg.eigvalsh(result.covariance) > 0.0).all()
    turned = scene.bearings1 @ pose.rotation.T
    sine = np.linalg.norm(np.cross(turned, scene.bearings2), axis=1)
    parallax = np.arctan2(sine, np.einsum("ij,ij->i", turned, scene.bearings2))
    median = np.degrees(np.median(parallax[result.inlier_mask]))
    assert result.parallax_deg == pytest.approx(median, abs=0.1)  # an even number has two middles
    assert 0.5 < result.sphere_coverage <= 1.0 and result.num_iterations >= 30
    assert result.alternatives == () and result.warnings == ()


@pytest.mark.parametrize("residual", ["sampson", "angular", "paper"])
def test_residuals_are_those_of_the_pose(residual):
    scene = noisy_scene(5, 0.3, 0.3)
    result = estimate_relative_pose(scene.bearings1, scene.bearings2, residual=residual)
    expected = pose_residuals(result.cam2_from_cam1, scene.bearings1, scene.bearings2, residual)
    np.testing.assert_allclose(result.residuals_rad, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("seed", "baseline_m"),
    # Five-point samples of these once gave matrices that are not essential, and a ValueError.
    [(6, 0.05), (135, 0.05), (97, 0.02)],
)
def test_rotations_are_orthonormal_whatever_the_samples_were(seed, baseline_m):
    scene = noisy_scene(seed, 0.1, 0.2, baseline_m=baseline_m)
    result = estimate_relative_pose(scene.bearings1, scene.bearings2)
    for pose in (result.cam2_from_cam1, *result.alternatives):
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)


def with_gaps(scene, rows):
    b1, b2 = scene.bearings1.copy(), scene.bearings2.copy()
    b1[rows[::2]] = np.nan
    b2[rows[1::2], 1] = np.nan
    return b1, b2


def test_missing_rows_are_counted_but_never_inliers_and_change_nothing_else():
    scene, rows = exact_scene(6, 0.3), np.array([0, 7, 8, 40, 79])
    b1, b2 = with_gaps(scene, rows)
    result = estimate_relative_pose(b1, b2)
    kept = np.setdiff1d(np.arange(80), rows)
    without = estimate_relative_pose(scene.bearings1[kept], scene.bearings2[kept])
    assert result.num_matches == 80 and result.success
    assert not result.inlier_mask[rows].any() and np.isnan(result.residuals_rad[rows]).all()
    np.testing.assert_array_equal(result.inlier_mask[kept], without.inlier_mask)
    np.testing.assert_array_equal(result.cam2_from_cam1.matrix(), without.cam2_from_cam1.matrix())
    assert result.warnings == (
        "5 of 80 matches are missing (NaN, as of pixels outside their image, or weight 0)",
    )


def test_matches_of_weight_zero_are_as_good_as_missing():
    scene = noisy_scene(7, 0.2)
    wrong = np.arange(200) < 120  # a consistent other motion that would win
    other = any_turn(3).rotation
    b2 = np.where(wrong[:, None], scene.bearings2 @ other.T, scene.bearings2)
    result = estimate_relative_pose(scene.bearings1, b2, weights=(~wrong).astype(float))
    alone = estimate_relative_pose(scene.bearings1[~wrong], b2[~wrong])
    assert result.success and not result.inlier_mask[wrong].any()
    np.testing.assert_array_equal(result.cam2_from_cam1.matrix(), alone.cam2_from_cam1.matrix())


def test_jacobians_of_nan_make_a_match_missing():
    camera = Equirectangular(1024, 512)
    scene = noisy_scene(8, 0.2)
    J1, J2 = (
        camera.bearing_jacobians(camera.pixels_from_bearings(b))
        for b in (scene.bearings1, scene.bearings2)
    )
    J1[:3], J2[9] = np.nan, np.nan
    result = estimate_relative_pose(
        scene.bearings1, scene.bearings2, residual="tangent_sampson", jacobians1=J1, jacobians2=J2
    )
    assert result.success and not result.inlier_mask[[0, 1, 2, 9]].any()
    assert result.warnings[0].startswith("4 of 200 matches are missing")


@pytest.mark.parametrize("scale", [0.001, 10.0])
def test_only_the_ratios_of_the_weights_matter(scale):
    scene = noisy_scene(1, 0.3, 0.3)
    plain = estimate_relative_pose(scene.bearings1, scene.bearings2)
    scaled = estimate_relative_pose(scene.bearings1, scene.bearings2, weights=np.full(200, scale))
    assert scaled.status == plain.status
    assert_same_pose(scaled.cam2_from_cam1, plain.cam2_from_cam1)
    assert scaled.noise_deg == pytest.approx(plain.noise_deg, abs=1e-6)
    np.testing.assert_allclose(scaled.covariance, plain.covariance, atol=1e-9)


def test_pixels_and_options_of_another_kind_are_refused_with_the_remedy():
    scene = two_view_scene(0, num_matches=40)
    with pytest.raises(ValueError, match=r"got \(40, 2\); turn pixels into bearings with camera"):
        estimate_relative_pose(scene.bearings1[:, :2], scene.bearings2)
    with pytest.raises(ValueError, match=r"got \(40, 2\); turn pixels into bearings with camera"):
        estimate_absolute_pose(scene.bearings1[:, :2], scene.bearings1)
    with pytest.raises(TypeError, match=r"options must be RansacOptions\(...\), got dict"):
        estimate_relative_pose(scene.bearings1, scene.bearings2, options={"max_iterations": 9})
