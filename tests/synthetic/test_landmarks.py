# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360.poses import Pose
from epi360.synthetic import (
    TwoViewScene,
    sample_relative_pose,
    sample_von_mises_fisher,
    two_view_scene,
)
from epi360.synthetic.landmarks import rotation_from_euler
from epi360.synthetic.layouts import MIN_RANGE_M

LAYOUTS = ["room", "sphere", "cone", "plane", "behind"]


def generator(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


def essential(pose):
    x, y, z = pose.translation
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ pose.rotation


def angles_deg(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1)))


def same(a: TwoViewScene, b: TwoViewScene):
    return np.array_equal(a.bearings1, b.bearings1) and np.array_equal(a.bearings2, b.bearings2)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("seed", range(5))
def test_exact_bearings_point_at_the_landmarks_and_obey_the_epipolar_law(layout, seed):
    scene = two_view_scene(seed, layout=layout)
    points2 = scene.points @ scene.cam2_from_cam1.rotation.T + scene.cam2_from_cam1.translation
    ranges1, ranges2 = (np.linalg.norm(p, axis=1) for p in (scene.points, points2))
    np.testing.assert_allclose(scene.bearings1 * ranges1[:, None], scene.points, atol=1e-12)
    np.testing.assert_allclose(scene.bearings2 * ranges2[:, None], points2, atol=1e-12)
    residuals = np.einsum(
        "ni,ij,nj->n", scene.bearings2, essential(scene.cam2_from_cam1), scene.bearings1
    )
    np.testing.assert_allclose(residuals, 0, atol=1e-12)
    assert min(ranges1.min(), ranges2.min()) >= MIN_RANGE_M
    assert scene.inlier_mask.all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_scene_has_as_many_rows_as_asked_and_unit_bearings(layout):
    for num in (0, 1, 8, 300):
        scene = two_view_scene(3, num_matches=num, layout=layout, noise_deg=1, outlier_ratio=0.5)
        for rows in (scene.bearings1, scene.bearings2, scene.points):
            assert rows.shape == (num, 3)
        norms = np.linalg.norm(np.concatenate([scene.bearings1, scene.bearings2]), axis=1)
        np.testing.assert_allclose(norms, 1, atol=1e-12)


def test_a_seed_makes_the_same_scene_and_another_seed_another():
    options = {"noise_deg": 0.5, "outlier_ratio": 0.3}
    assert same(two_view_scene(7, **options), two_view_scene(7, **options))
    assert not same(two_view_scene(7, **options), two_view_scene(8, **options))


@pytest.mark.parametrize("seed", range(10))
def test_scenes_behind_the_cameras_have_negative_z_in_both(seed):
    scene = two_view_scene(seed, layout="behind")
    assert scene.bearings1[:, 2].max() < 0
    assert scene.bearings2[:, 2].max() < 0


def test_cone_landmarks_stay_in_their_cone_and_fill_it():
    scene = two_view_scene(0, layout="cone", cone_half_angle_deg=20, num_matches=2000)
    angles = angles_deg(scene.bearings1, np.array([[0.0, 0.0, 1.0]]))
    assert angles.max() <= 20
    # Uniform over the cap: 1 - cos is uniform; the median of 2000 is within 4 standard errors.
    share = (1 - np.cos(np.radians(np.median(angles)))) / (1 - np.cos(np.radians(20)))
    assert abs(share - 0.5) < 0.05


def test_plane_landmarks_lie_on_one_plane():
    points = two_view_scene(2, layout="plane").points
    singular_values = np.linalg.svd(points - points.mean(axis=0))[1]
    assert singular_values[2] < 1e-12
    assert singular_values[1] > 1


def test_room_landmarks_lie_on_six_planes_around_both_cameras():
    scene = two_view_scene(1, num_matches=600)
    low, high = scene.points.min(axis=0), scene.points.max(axis=0)
    gaps = np.minimum(np.abs(scene.points - low), np.abs(scene.points - high)).min(axis=1)
    np.testing.assert_allclose(gaps, 0, atol=1e-12)
    center2 = scene.cam2_from_cam1.inverse().translation
    assert (low < np.minimum(center2, 0)).all() and (high > np.maximum(center2, 0)).all()


@pytest.mark.parametrize("kappa, mean_deg", [(50, 10.18), (500, 3.21), (10000, 0.72)])
def test_noise_of_a_kappa_has_the_mean_angle_that_the_paper_prints(kappa, mean_deg):
    scene = two_view_scene(0, num_matches=200_000, kappa=kappa)
    exact = two_view_scene(0, num_matches=200_000)
    mean = angles_deg(scene.bearings2, exact.bearings2).mean()
    # The relative standard error of a mean of 200 000 Rayleigh angles is 0.12 %.
    assert abs(mean - mean_deg) < 0.005 * mean_deg + 0.005
    np.testing.assert_array_equal(scene.bearings1, exact.bearings1)


def test_noise_deg_is_the_deviation_per_tangent_axis():
    axis = np.tile([0.0, 0.0, 1.0], (200_000, 1))
    noisy = sample_von_mises_fisher(generator(), axis, 1 / np.radians(0.3) ** 2)
    deviations = np.degrees(np.std(noisy[:, :2], axis=0))
    np.testing.assert_allclose(deviations, 0.3, atol=0.003)
    by_degrees = two_view_scene(0, noise_deg=0.3)
    by_kappa = two_view_scene(0, kappa=1 / np.radians(0.3) ** 2)
    assert same(by_degrees, by_kappa)


def test_tiny_noise_keeps_its_digits():
    directions = two_view_scene(0).bearings1
    noisy = sample_von_mises_fisher(generator(), directions, 1e18)
    angles = np.radians(angles_deg(noisy, directions))
    assert 0.5e-9 < np.sqrt(np.mean(angles**2) / 2) < 2e-9


def test_weak_concentration_covers_the_whole_sphere():
    north = np.tile([0.0, 0.0, 1.0], (50_000, 1))
    cosines = sample_von_mises_fisher(generator(), north, 1e-6)[:, 2]
    # Uniform on [-1, 1]: mean 0, variance 1/3; five standard errors.
    assert abs(cosines.mean()) < 0.013
    assert abs(cosines.var() - 1 / 3) < 0.007


def test_noise_in_both_views_disturbs_view_1_as_well():
    both = two_view_scene(0, noise_deg=1, noise_in_both_views=True)
    assert angles_deg(both.bearings1, two_view_scene(0).bearings1).mean() > 0.5


@pytest.mark.parametrize("ratio, count", [(0.0, 0), (0.2, 40), (0.333, 67), (1.0, 200)])
def test_the_number_of_outliers_is_exact(ratio, count):
    scene = two_view_scene(0, outlier_ratio=ratio)
    assert np.sum(~scene.inlier_mask) == count
    changed = np.any(scene.bearings2 != two_view_scene(0).bearings2, axis=1)
    np.testing.assert_array_equal(changed, ~scene.inlier_mask)


def test_outliers_of_a_cone_stay_in_the_cone_of_view_2():
    scene = two_view_scene(0, layout="cone", cone_half_angle_deg=25, outlier_ratio=0.5)
    axis2 = scene.cam2_from_cam1.rotation[:, 2]
    assert angles_deg(scene.bearings2[~scene.inlier_mask], axis2[None]).max() <= 25


def test_sampled_poses_stay_in_the_ranges_of_the_paper():
    rng = generator()
    poses = [sample_relative_pose(rng) for _ in range(500)]
    translations = np.array([pose.translation for pose in poses])
    assert 0.95 < np.abs(translations).max() <= 1
    traces = np.array([np.trace(pose.rotation) for pose in poses])
    # Three turns of 45 deg in a row are at most 135 deg.
    assert np.degrees(np.arccos((traces.min() - 1) / 2)) < 135


def test_euler_angles_turn_about_x_first():
    turn = rotation_from_euler(np.radians([90.0, 0.0, 90.0]))
    # y -> z by the turn about x, and z stays z about z.
    np.testing.assert_allclose(turn @ [0, 1, 0], [0, 0, 1], atol=1e-15)


def test_a_given_pose_and_baseline_are_used():
    pose = Pose(rotation_from_euler(np.array([0.1, 0.2, 0.3])), np.array([3.0, 0.0, 4.0]))
    assert two_view_scene(0, cam2_from_cam1=pose).cam2_from_cam1 is pose
    scaled = two_view_scene(0, cam2_from_cam1=pose, baseline_m=0.5).cam2_from_cam1
    np.testing.assert_allclose(scaled.translation, [0.3, 0, 0.4], atol=1e-15)
    still = two_view_scene(0, baseline_m=0)
    turned = still.bearings1 @ still.cam2_from_cam1.rotation.T
    np.testing.assert_allclose(still.bearings2, turned, atol=1e-12)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"num_matches": -1}, "num_matches must be 0 or more, got -1"),
        ({"layout": "box"}, "layout must be one of room, sphere, cone, plane, behind, got 'box'"),
        ({"cone_half_angle_deg": 0}, "cone_half_angle_deg must be in"),
        ({"outlier_ratio": 20}, "outlier_ratio must be in .* got 20; 0.2 is 20 %"),
        ({"noise_deg": -0.1}, "noise_deg must be 0 or more"),
        ({"kappa": 0}, "kappa must be positive, got 0"),
        ({"noise_deg": 1, "kappa": 500}, "noise_deg or kappa, not both"),
        ({"baseline_m": float("nan")}, "baseline_m must be 0 or more, got nan"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        two_view_scene(0, **options)


def test_a_layout_that_the_pose_cannot_see_is_reported():
    about_face = Pose(rotation_from_euler(np.array([0.0, np.pi, 0.0])), np.zeros(3))
    with pytest.raises(ValueError, match="sees no landmarks of the layout 'behind'"):
        two_view_scene(0, layout="behind", cam2_from_cam1=about_face)


def test_a_pure_rotation_cannot_be_given_a_baseline():
    with pytest.raises(ValueError, match="no translation to rescale"):
        two_view_scene(0, cam2_from_cam1=Pose(np.eye(3), np.zeros(3)), baseline_m=1.0)


def test_directions_of_a_wrong_shape_are_named():
    with pytest.raises(ValueError, match=r"mean_directions must have shape \(N, 3\), got \(3,\)"):
        sample_von_mises_fisher(generator(), np.array([0.0, 0.0, 1.0]), 10)
