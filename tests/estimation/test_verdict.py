# SPDX-License-Identifier: BSD-3-Clause
"""The rules of status and warnings, one by one, on evidence made by hand."""

import numpy as np
import pytest
from made_evidence import made_evidence

from epi360 import _core, estimate_relative_pose
from epi360.synthetic import two_view_scene

internals = _core.internals


def status_of(**changes):
    return internals.judge(made_evidence(**changes))[0]


def warnings_of(**changes):
    warnings = internals.judge(made_evidence(**changes))[1]
    return {each.code: (each.value, each.reference) for each in warnings}


# A rotation explains the inliers, which do not reject that the camera only turned.
ROTATION = {
    "rotation_support": 59,
    "rotation_log10_false_alarms": -40.0,
    "rotation_rejection": 1.0,
}
DISPLACED = ROTATION | {"num_displaced": 21, "displaced_rejection": 4.1}
DEGREE = np.pi / 180.0
CONCENTRATED = "concentrated_inliers"
REGIONS = {"support": 50, "regional_sigma": DEGREE}
OTHER = {"rival_evidence": -100.0, "only_rival": 30.0}
UNKNOWN_DIRECTION = {"rotation_rejection": 9.0, "direction_sigma": 26 * DEGREE}


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({}, "ok"),
        ({"num_usable": 4}, "too_few_matches"),
        ({"num_usable": 5}, "ok"),
        ({"num_usable": 7, "sample_size": 8}, "too_few_matches"),
        ({"num_usable": 8, "sample_size": 8}, "ok"),
        ({"num_usable": 4, "sample_size": 3}, "too_few_matches"),
        # Chance
        ({"log10_false_alarms": -2.9}, "too_few_inliers"),
        ({"log10_false_alarms": -3.1}, "ok"),
        ({"chance": 0.61}, "too_few_inliers"),
        ({"chance": 0.59}, "ok"),
        ({"num_distinct": 5}, "too_few_inliers"),
        ({"num_distinct": 6}, "ok"),
        ({"num_distinct": 14, "min_num_inliers": 15}, "too_few_inliers"),
        # A rotation alone
        (ROTATION, "pure_rotation"),
        (ROTATION | {"rotation_support": 23}, "ok"),
        (ROTATION | {"rotation_support": 24}, "pure_rotation"),
        (ROTATION | {"rotation_log10_false_alarms": -2.0}, "ok"),
        (ROTATION | {"log10_false_alarms": 5.0}, "pure_rotation"),
        (ROTATION | {"rotation_rejection": 3.9}, "pure_rotation"),
        # A part that turned: of all matches, and of the inliers of the pose
        (ROTATION | {"coverage": 0.44, "pose_coverage": 0.64}, CONCENTRATED),
        (ROTATION | {"coverage": 0.46, "pose_coverage": 0.8}, "pure_rotation"),
        (ROTATION | {"coverage": 0.44, "pose_coverage": 0.62}, "pure_rotation"),
        (ROTATION | {"rotation_rejection": 4.1}, "ok"),
        (ROTATION | {"rotation_log_ratio": 35.0}, "too_few_inliers"),
        (ROTATION | {"rotation_log_ratio": 35.8}, "pure_rotation"),
        (ROTATION | {"rotation_log_ratio": 15.0, "rotation_support": 100}, "pure_rotation"),
        # What the inliers determine
        (ROTATION | UNKNOWN_DIRECTION | {"rotation_sigma": 4 * DEGREE}, "pure_rotation"),
        (ROTATION | UNKNOWN_DIRECTION | {"rotation_sigma": 6 * DEGREE}, CONCENTRATED),
        ({"direction_sigma": 26 * DEGREE}, CONCENTRATED),
        ({"direction_sigma": 24 * DEGREE}, "ok"),
        ({"rotation_sigma": 21 * DEGREE}, CONCENTRATED),
        ({"rotation_sigma": 19 * DEGREE}, "ok"),
        ({"num_regions": 4.4}, CONCENTRATED),
        ({"num_regions": 4.6}, "ok"),
        # What the regions say: 0.85 lies at a log-likelihood ratio of 40.3 for a sigma of 1 degree
        (REGIONS | {"log_ratio": 40.0}, "too_few_inliers"),
        (REGIONS | {"log_ratio": 40.6}, "ok"),
        (REGIONS | {"log_ratio": 40.6, "regional_sigma": 1.1 * DEGREE}, "too_few_inliers"),
        (REGIONS | {"log_ratio": 40.6, "log_prior": -1.0}, "too_few_inliers"),
        (REGIONS | {"log_ratio": 30.0, "support": 70}, "ok"),
        (REGIONS | {"log_ratio": 30.0, "support": 60}, "too_few_inliers"),
        # A second pose
        ({"rival_evidence": -6.1}, "ok"),
        ({"rival_evidence": -5.9}, "planar_ambiguous"),
        ({"rival_evidence": -6.0 - 3.0 * 60**0.5 + 0.1, "has_twin": True}, "planar_ambiguous"),
        ({"rival_evidence": -6.0 - 3.0 * 60**0.5 - 0.1, "has_twin": True}, "ok"),
        ({"rival_evidence": 0.0, "rival_probability": 0.4}, "planar_ambiguous"),
        ({"rival_evidence": 0.0, "rival_probability": 0.4, "has_prior": True}, "ok"),
        ({"rival_evidence": 0.0, "rival_probability": 0.6, "has_prior": True}, "planar_ambiguous"),
        # Another motion with matches of its own: two standard deviations of their number
        (OTHER | {"only_pose": 48.0}, "ok"),
        (OTHER | {"only_pose": 47.0}, "planar_ambiguous"),
        (OTHER | {"only_pose": 47.0, "rival_probability": 0.4}, "ok"),
        (OTHER | {"only_pose": 47.0, "has_prior": True}, "planar_ambiguous"),
        (OTHER | {"only_pose": 20.0}, "planar_ambiguous"),
        # Behind a camera: 0.23 of 60 inliers
        ({"behind": 13.7}, "ok"),
        ({"mirrored_turn": 9.9}, "ok"),
        ({"mirrored_turn": 10.0}, "too_few_inliers"),
        ({"mirrored_turn": 13.9, "support": 200}, "ok"),
        ({"mirrored_turn": 14.1, "support": 200}, "too_few_inliers"),
        ({"behind": 13.9}, "too_few_inliers"),
        ({"behind": 9.9, "support": 20}, "ok"),
        ({"behind": 10.1, "support": 20}, "too_few_inliers"),
        # Both together: 0.85 beside either, and 0.74 of all
        (REGIONS | {"log_ratio": 40.6, "rival_evidence": -6.1}, "too_few_inliers"),
        (REGIONS | {"log_ratio": 60.0, "rival_evidence": -6.6}, "ok"),
        # More noise than the user knows of
        ({"max_noise": 0.002 / 2.99}, "ok"),
        ({"max_noise": 0.002 / 3.01}, "too_few_inliers"),
        (ROTATION | {"max_noise": 0.002 / 3.01}, "pure_rotation"),
        # Where the inliers are
        ({"spread": 0.029}, "concentrated_inliers"),
        ({"spread": 0.031}, "ok"),
        ({"spread": 0.029, "spread_of_matches": 0.14}, "ok"),
        ({"coverage": 6 / 48}, "concentrated_inliers"),
        ({"coverage": 7 / 48}, "ok"),
        ({"coverage": 6 / 48, "match_coverage": 0.3}, "ok"),
        ({"coverage": 6 / 48, "has_prior": True}, "ok"),
    ],
)
def test_each_rule_decides_on_its_side_of_the_limit(changes, status):
    assert status_of(**changes) == status


def test_missing_evidence_speaks_for_the_pose():
    bare = internals.Evidence()
    bare.num_usable = 10
    status, warnings = internals.judge(bare)
    assert status == "ok" and not warnings


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        (ROTATION | {"num_distinct": 3}, "too_few_inliers"),
        (ROTATION | {"spread": 0.01}, "concentrated_inliers"),
        (ROTATION | {"rival_evidence": 0.0}, "pure_rotation"),
        ({"rival_evidence": 0.0, "spread": 0.01}, "concentrated_inliers"),
        ({"num_usable": 3, "chance": 1.0}, "too_few_matches"),
    ],
)
def test_the_graver_status_wins(changes, status):
    assert status_of(**changes) == status


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, {}),
        ({"num_usable": 90}, {"missing_matches": (10.0, 100.0)}),
        ({"num_usable": 70, "num_copies": 30}, {"copies": (30.0, 100.0)}),
        (
            {"num_usable": 66, "num_copies": 30},
            {"missing_matches": (4.0, 100.0), "copies": (30.0, 100.0)},
        ),
        ({"parallax": 0.0119}, {"little_parallax": (0.0119, 0.002)}),
        ({"parallax": 0.0121}, {}),
        ({"coverage": 0.44}, {"partial_coverage": (0.44, 0.9)}),
        ({"coverage": 0.46}, {}),
        (ROTATION | {"coverage": 0.44}, {"partial_coverage": (0.44, 0.9)}),
        (
            ROTATION | {"coverage": 0.44, "pose_coverage": 0.8},
            {"partial_coverage": (0.44, 0.9)},
        ),
        (DISPLACED, {"displaced": (21.0, 59.0)}),
        (DISPLACED | {"displaced_rejection": 3.9}, {}),
        (DISPLACED | {"rotation_rejection": 4.1}, {}),
        (DISPLACED | {"num_distinct": 2}, {}),
        (DISPLACED | UNKNOWN_DIRECTION | {"rotation_sigma": 4 * DEGREE}, {}),
        ({"behind": 20.0}, {"mirrored": (20.0, 60.0)}),
        ({"behind": 10.0}, {}),
        ({"mirrored_turn": 10.0}, {"mirrored_turn": (10.0, 60.0)}),
        ({"mirrored_turn": 9.9}, {}),
        ({"behind": 20.0, "mirrored_turn": 20.0}, {"mirrored": (20.0, 60.0)}),
        ({"tilt": 0.051, "tilt_sigma": 0.01}, {"against_gravity": (0.051, 0.01)}),
        ({"tilt": 0.049, "tilt_sigma": 0.01}, {}),
        ({"tilt": 0.051, "tilt_sigma": 0.01, "num_distinct": 2}, {}),
        ({"max_noise": 0.002}, {"much_noise": (0.002, 0.002)}),
        ({"max_noise": 0.0021}, {}),
        ({"max_noise": 0.001, "rival_evidence": 0.0}, {}),
        ({"max_noise": 0.001, "num_distinct": 2}, {}),
        ({"max_noise": 0.0006}, {"much_noise": (0.002, 0.0006)}),
        ({"max_noise": 0.0006, "num_distinct": 2}, {}),
        ({"parallax": 0.01, "num_distinct": 2}, {}),
        ({"num_usable": 90, "num_distinct": 2}, {"missing_matches": (10.0, 100.0)}),
        ({"num_usable": 4}, {"missing_matches": (96.0, 100.0)}),
    ],
)
def test_a_warning_carries_the_numbers_that_it_compares(changes, expected):
    assert warnings_of(**changes) == expected


def test_much_noise_is_a_warning_only_above_the_limit_that_was_given():
    scene = two_view_scene(3, noise_deg=0.4, noise_in_both_views=True, outlier_ratio=0.2)
    matches = scene.bearings1, scene.bearings2
    free = estimate_relative_pose(*matches)
    assert free.success and not free.warnings
    above = estimate_relative_pose(*matches, max_noise_deg=1.01 * free.noise_deg)
    assert not above.warnings
    np.testing.assert_array_equal(above.cam2_from_cam1.rotation, free.cam2_from_cam1.rotation)
    below = estimate_relative_pose(*matches, max_noise_deg=0.99 * free.noise_deg)
    (warning,) = below.warnings
    assert f"{free.noise_deg:.3g} degrees" in warning and below.status == "ok"
    # It is searched for longer, and found again.
    rotations = below.cam2_from_cam1.rotation, free.cam2_from_cam1.rotation
    np.testing.assert_allclose(*rotations, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_many_times_the_limit_is_a_reason_to_refuse(seed):
    scene = two_view_scene(seed, noise_deg=0.4, noise_in_both_views=True, outlier_ratio=0.2)
    matches = scene.bearings1, scene.bearings2
    free = estimate_relative_pose(*matches)
    told = [
        estimate_relative_pose(*matches, max_noise_deg=free.noise_deg / times)
        for times in (1.5, 2.0, 4.0)
    ]
    assert [each.status for each in told] == ["ok", "ok", "too_few_inliers"]
    probabilities = [each.probability for each in told]
    assert free.probability >= probabilities[0] > probabilities[1] > 0.9 > probabilities[2]
    for each in told:
        assert each.probability == pytest.approx(
            each.explanations.surface + each.explanations.motion
        )
        assert "do the cameras belong to these images" in each.warnings[-1]
    assert np.isnan(told[-1].cam2_from_cam1.rotation).all()


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan, np.inf, "much"])
def test_a_limit_of_noise_that_is_no_positive_number_is_refused(limit):
    scene = two_view_scene(3)
    with pytest.raises(ValueError, match="max_noise_deg must be a positive number"):
        estimate_relative_pose(scene.bearings1, scene.bearings2, max_noise_deg=limit)


def test_a_result_outlives_the_arrays_that_share_its_memory():
    scene = two_view_scene(5, num_matches=50)
    result = estimate_relative_pose(scene.bearings1, scene.bearings2)
    mask, residuals = result.inlier_mask, result.residuals_rad
    kept = mask.copy(), residuals.copy()
    del result
    for seed in range(20):  # would overwrite memory that was given back
        estimate_relative_pose(scene.bearings1, scene.bearings2, seed=seed)
    np.testing.assert_array_equal(mask, kept[0])
    np.testing.assert_array_equal(residuals, kept[1])
