# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from noisy_problems import noisy_scene

from epi360 import RansacOptions, estimate_relative_pose

SCENE = noisy_scene(0, 0.2, 0.3, num_matches=100)
J = np.zeros((100, 3, 2))


def with_row(bearings, row, value):
    changed = bearings.copy()
    changed[row] = value
    return changed


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"minimal_solver": "seven_point"}, "five_point or eight_point, got 'seven_point'"),
        ({"min_iterations": 0}, "1 <= min_iterations <= max_iterations .* got 0 and 10000"),
        ({"max_iterations": 10}, "1 <= min_iterations <= max_iterations .* got 20 and 10"),
        ({"confidence": 0.0}, "confidence must be between 0 and 1, got 0.0"),
        ({"confidence": 1.0}, "confidence must be between 0 and 1, got 1.0"),
        ({"confidence": float("nan")}, "confidence must be between 0 and 1, got nan"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        RansacOptions(**options)


def test_a_misspelt_option_is_a_type_error():
    with pytest.raises(TypeError, match="max_iteration"):
        RansacOptions(max_iteration=10)
    with pytest.raises(TypeError, match="threshold"):
        estimate_relative_pose(SCENE.bearings1, SCENE.bearings2, threshold=1.0)


def test_options_are_frozen():
    with pytest.raises(AttributeError):
        RansacOptions().confidence = 0.5


@pytest.mark.parametrize("threshold", ["foo", -1.0, 0.0, 45.1, float("nan"), np.inf, None, "nan"])
def test_thresholds_that_are_no_angle_are_refused(threshold):
    with pytest.raises(ValueError, match=r'inlier_threshold_deg must be "auto" or in \(0, 45\]'):
        estimate_relative_pose(SCENE.bearings1, SCENE.bearings2, inlier_threshold_deg=threshold)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"residual": "l2"}, "residual must be one of paper, angular, .* got 'l2'"),
        ({"residual": "tangent_sampson"}, "tangent_sampson needs jacobians1 and jacobians2"),
        (
            {"residual": "tangent_sampson", "jacobians1": J},
            "tangent_sampson needs jacobians1 and jacobians2",
        ),
        (
            {"residual": "tangent_sampson", "jacobians1": J, "jacobians2": J[:5]},
            r"jacobians2 must have shape \(100, 3, 2\), got \(5, 3, 2\)",
        ),
        ({"weights": np.ones(99)}, r"weights must have shape \(100,\), got \(99,\)"),
        ({"weights": np.full(100, -0.1)}, "weights must be finite and not negative"),
        ({"weights": np.full(100, np.nan)}, "weights must be finite and not negative"),
        ({"bearings1": SCENE.bearings1[:50]}, "must have the same length, got 50 and 100"),
        ({"bearings2": SCENE.bearings2[:, :2]}, r"bearings2 must have shape \(N, 3\), got \(100,"),
        ({"bearings1": np.zeros(3)}, r"bearings1 must have shape \(N, 3\), got \(3,\)"),
        (
            {"bearings2": np.column_stack([500.0 + 400.0 * SCENE.bearings2[:, :2], np.ones(100)])},
            r"bearings2 must be directions .* like pixels \(u, v, 1\); .*bearings_from_pixels",
        ),
        (
            {"bearings1": with_row(SCENE.bearings1, 17, np.inf)},
            "bearings1 must be finite .* row 17 is infinite",
        ),
        (
            {"bearings2": with_row(SCENE.bearings2, 99, 0.0)},
            "bearings2 must have non-zero length .* row 99",
        ),
    ],
)
def test_wrong_input_is_refused_by_name(change, message):
    arguments = {"bearings1": SCENE.bearings1, "bearings2": SCENE.bearings2} | change
    with pytest.raises(ValueError, match=message):
        estimate_relative_pose(**arguments)


def test_only_the_bearings_are_positional():
    with pytest.raises(TypeError, match="positional"):
        estimate_relative_pose(SCENE.bearings1, SCENE.bearings2, 1.0)


def test_jacobians_may_be_given_to_residuals_that_do_not_use_them():
    expected = estimate_relative_pose(SCENE.bearings1, SCENE.bearings2)
    found = estimate_relative_pose(SCENE.bearings1, SCENE.bearings2, jacobians1=J, jacobians2=J)
    np.testing.assert_array_equal(found.cam2_from_cam1.matrix(), expected.cam2_from_cam1.matrix())


def test_lists_and_single_precision_are_arrays_too():
    found = estimate_relative_pose(
        SCENE.bearings1.tolist(), SCENE.bearings2.astype(np.float32), inlier_threshold_deg="1"
    )
    assert found.success and found.inlier_threshold_deg == pytest.approx(1.0, abs=1e-12)


def test_an_empty_list_has_no_matches():
    result = estimate_relative_pose([], [])
    assert result.status == "too_few_matches" and result.num_matches == 0


def test_the_input_is_not_changed():
    copies = SCENE.bearings1.copy(), SCENE.bearings2.copy()
    estimate_relative_pose(3.0 * SCENE.bearings1, SCENE.bearings2)
    np.testing.assert_array_equal(SCENE.bearings1, copies[0])
    np.testing.assert_array_equal(SCENE.bearings2, copies[1])


def test_views_that_are_not_contiguous_are_fine():
    wide = np.zeros((200, 6))
    wide[::2, ::2] = SCENE.bearings1
    found = estimate_relative_pose(wide[::2, ::2], np.asfortranarray(SCENE.bearings2))
    expected = estimate_relative_pose(SCENE.bearings1, SCENE.bearings2)
    # The sum of squares of a row may be rounded in another order.
    np.testing.assert_allclose(
        found.cam2_from_cam1.matrix(), expected.cam2_from_cam1.matrix(), atol=1e-9
    )


def test_the_limit_on_iterations_holds():
    scene = noisy_scene(1, 0.3, 0.8)
    options = RansacOptions(min_iterations=5, max_iterations=40)
    result = estimate_relative_pose(
        scene.bearings1, scene.bearings2, inlier_threshold_deg=1.0, options=options
    )
    assert 5 <= result.num_iterations <= 40
    automatic = estimate_relative_pose(scene.bearings1, scene.bearings2, options=options)
    assert automatic.num_iterations <= 4 * 40  # one to four rounds


def test_fewer_inliers_than_asked_for_are_not_believed():
    options = RansacOptions(min_num_inliers=90)
    result = estimate_relative_pose(SCENE.bearings1, SCENE.bearings2, options=options)
    assert result.status == "too_few_inliers" and result.num_inliers > 60
    assert np.isnan(result.cam2_from_cam1.rotation).all()


def test_a_printed_result_says_verdict_and_pose_and_not_a_row_a_match():
    result = estimate_relative_pose(SCENE.bearings1, SCENE.bearings2)
    text = repr(result)
    assert text.startswith("RelativePoseResult(status='ok', probability=")
    assert f"num_inliers={result.num_inliers}, num_matches=100" in text
    assert repr(result.cam2_from_cam1) in text
    assert len(text) < 900


def test_rays_of_a_wide_pinhole_are_no_pixels():
    rays = SCENE.bearings1[SCENE.bearings1[:, 2] > 0.1]
    rays = rays / rays[:, 2:]
    rays[:, 2] = 1.0
    assert estimate_relative_pose(rays, rays).status == "pure_rotation"
