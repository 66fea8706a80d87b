# SPDX-License-Identifier: BSD-3-Clause
"""What the matches may be: five explanations and their probabilities, by laws and made by hand."""

from dataclasses import astuple, fields

import numpy as np
import pytest
from made_evidence import in_a_room, made_evidence, on_a_plane, turned, unrelated
from noisy_problems import noisy_scene

from epi360 import Explanations, _core, estimate_relative_pose, estimate_relative_poses
from epi360.poses import Pose, rotation_from_vector
from epi360.synthetic import two_view_scene

internals = _core.internals
NAMES = tuple(field.name for field in fields(Explanations))


def likeliest(explanations):
    return NAMES[int(np.argmax(astuple(explanations)))]


def explained(**changes):
    """Explanations of evidence made by hand, of a pose for which the regions speak."""
    said = {"log_ratio": 60.0, "regional_sigma": np.radians(1.0)} | changes
    found = internals.explain(made_evidence(**said))
    return Explanations(*(getattr(found, name) for name in NAMES))


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (turned, "rotation"),
        (unrelated, "nothing"),
        (on_a_plane, "surface"),
        (in_a_room, "motion"),
    ],
)
def test_the_explanation_that_is_true_is_the_likeliest(make, expected):
    results = [estimate_relative_pose(*make(seed)) for seed in range(12)]
    assert all(0.0 <= p <= 1.0 for each in results for p in astuple(each.explanations))
    sums = [sum(astuple(each.explanations)) for each in results]
    np.testing.assert_allclose(sums, 1.0, atol=1e-12)
    likely = [likeliest(each.explanations) for each in results]
    # Now and then noise alone tells the two poses of a plane apart.
    assert likely.count(expected) >= (8 if make is on_a_plane else 12)


def test_too_few_matches_explain_nothing():
    b1, b2 = in_a_room(0)
    result = estimate_relative_pose(b1[:4], b2[:4])
    assert astuple(result.explanations) == (1.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("make", [turned, unrelated, on_a_plane, in_a_room])
def test_an_accepted_pose_is_more_probable_than_each_other_explanation(make):
    for seed in range(8):
        result = estimate_relative_pose(*make(seed))
        x = result.explanations
        if result.success:
            found = x.surface + x.motion
            assert all(
                found >= 0.85 * (found + other) for other in (x.nothing, x.rotation, x.rival)
            )
            assert result.probability == pytest.approx(found, abs=1e-12)


def test_more_matches_that_agree_make_the_pose_surer():
    scene = noisy_scene(4, 0.2, 0.75, num_matches=400)
    b1, b2, right = scene.bearings1, scene.bearings2, scene.inlier_mask
    wrong = np.flatnonzero(~right)[:120]
    probabilities = []
    for count in (4, 8, 16, 32, 64):
        rows = np.concatenate([np.flatnonzero(right)[:count], wrong])
        probabilities.append(estimate_relative_pose(b1[rows], b2[rows]).explanations.motion)
    assert np.all(np.diff(probabilities) >= -1e-3)
    assert probabilities[0] < 0.05 and probabilities[-1] > 0.99


@pytest.mark.parametrize("name", ["log_ratio", "support", "rotation_rejection"])
def test_more_evidence_for_the_motion_is_never_less(name):
    rotation = {"rotation_support": 59, "rotation_log10_false_alarms": -40.0}
    steps = {
        "log_ratio": [{"log_ratio": value} for value in np.linspace(0.0, 200.0, 41)],
        "support": [{"support": value, "log_ratio": 20.0} for value in range(40, 100)],
        "rotation_rejection": [
            rotation | {"rotation_rejection": value} for value in np.linspace(-5.0, 9.0, 57)
        ],
    }[name]
    motion = [explained(**step).motion for step in steps]
    assert np.all(np.diff(motion) >= 0.0) and motion[-1] > 0.9 > 0.6 > motion[0]


def test_two_poses_that_are_as_likely_share_the_probability():
    equal = explained(rival_evidence=0.0)
    assert equal.rival == pytest.approx(equal.motion, rel=1e-9)
    assert 0.45 < equal.motion < 0.5
    assert explained(rival_evidence=-6.0).motion == pytest.approx(
        0.85 * (1.0 - explained(rival_evidence=-6.0).nothing), rel=1e-9
    )
    assert explained(rival_evidence=-40.0).rival < 1e-4


def test_matches_on_a_plane_are_explained_by_a_surface_and_others_are_not():
    shares = [explained(plane_share=share).surface for share in (0.0, 0.6, 0.85, 0.9, 0.95, 1.0)]
    assert np.all(np.diff(shares) >= 0.0)
    assert shares[1] < 1e-6 and shares[3] == pytest.approx(0.5, abs=0.01) and shares[-1] > 0.95


def test_the_second_pose_of_a_plane_may_be_less_likely_by_what_noise_sets_them_apart():
    plane = {"has_twin": True, "plane_share": 1.0}
    noisy = explained(rival_evidence=-10.0, **plane)
    assert 0.45 < noisy.rival < 0.5 < 2.0 * noisy.surface
    clear = explained(rival_evidence=-300.0, **plane)
    assert clear.rival < 1e-6 and clear.surface > 0.95


def test_the_unit_of_the_weights_does_not_change_the_explanations():
    b1, b2 = in_a_room(3)
    weights = np.random.default_rng(0).uniform(0.2, 1.0, len(b1))
    once = astuple(estimate_relative_pose(b1, b2, weights=weights).explanations)
    for unit in (1e-6, 1e6):
        scaled = astuple(estimate_relative_pose(b1, b2, weights=unit * weights).explanations)
        np.testing.assert_allclose(scaled, once, atol=1e-6)


@pytest.mark.parametrize("make", [turned, unrelated, on_a_plane, in_a_room])
def test_swapping_the_views_changes_hardly_anything(make):
    same = 0
    for seed in range(8):
        b1, b2 = make(seed)
        there = estimate_relative_pose(b1, b2).explanations
        back = estimate_relative_pose(b2, b1).explanations
        same += np.allclose(astuple(there), astuple(back), atol=0.02)
    # The samples are others: on a plane either of both poses may come first.
    assert same >= (6 if make is on_a_plane else 8)


def test_the_explanations_do_not_depend_on_the_number_of_threads():
    pairs = [make(seed) for seed in range(3) for make in (turned, unrelated, in_a_room)]
    one, three = (estimate_relative_poses(pairs, num_threads=n) for n in (1, 3))
    assert [each.explanations for each in one] == [each.explanations for each in three]


def test_a_rotation_is_spoken_for_by_the_regions_and_not_by_exchanged_partners():
    b1, b2 = turned(0)
    turn = rotation_from_vector([0.2, 0.7, -0.1])
    other = rotation_from_vector([0.3, 0.7, -0.1])
    said = {"scale": np.radians(0.1), "gate": np.radians(0.3), "share": 1e-4}
    assert internals.rotation_log_ratio(b1, b2, turn, **said) > 500.0
    assert internals.rotation_log_ratio(b1, b2, other, **said) < 1.0
    # One patch whose matches would agree with each other's partners is hardly evidence.
    axis = np.array([0.0, 0.0, 1.0])
    patch = axis + np.radians(0.05) * np.random.default_rng(0).normal(size=(200, 3))
    assert internals.rotation_log_ratio(patch, patch @ turn.T, turn, **said) < 15.0


def tripod_scene(seed, num_still, num_scene=60):
    """Two level views that have nothing in common but what carries the camera, below it."""
    rng = np.random.default_rng(seed)
    down = np.array([0.0, 1.0, 0.0])
    still = down + 0.3 * rng.normal(size=(num_still, 3))
    still /= np.linalg.norm(still, axis=1, keepdims=True)
    tilt = rotation_from_vector(np.radians(2.5) * rng.normal(size=3))  # levelled afterwards
    moved = still @ tilt.T + np.radians(0.1) * rng.normal(size=still.shape)
    b1, b2 = rng.normal(size=(2, num_scene, 3))
    return np.vstack([still, b1]), np.vstack([moved, b2]), down


def test_what_carries_the_camera_is_no_evidence_where_gravity_is_known():
    for seed in range(10):
        b1, b2, down = tripod_scene(seed, num_still=40)
        result = estimate_relative_pose(b1, b2, gravity1=down, gravity2=down)
        assert not result.success


def test_a_camera_that_looks_down_may_use_what_is_below_it():
    rng = np.random.default_rng(0)
    down = np.array([0.0, 1.0, 0.0])
    below = 1.5 + rng.uniform(-0.4, 0.4, 150)  # no plane
    x, z = rng.uniform(-0.5, 0.5, (2, 150))
    ground = np.column_stack([x, below, z])
    pose = Pose(rotation_from_vector([0.0, 0.3, 0.0]), np.array([0.25, 0.0, 0.1]))
    seen = ground @ pose.rotation.T + pose.translation
    noise = 1e-3 * rng.normal(size=(2, 150, 3))
    result = estimate_relative_pose(
        ground + noise[0], seen + noise[1], gravity1=down, gravity2=down
    )
    free = estimate_relative_pose(ground + noise[0], seen + noise[1])
    assert result.status == free.status


def test_a_scene_of_many_matches_leaves_no_doubt():
    scene = two_view_scene(1, num_matches=400, outlier_ratio=0.5, noise_deg=0.1)
    x = estimate_relative_pose(scene.bearings1, scene.bearings2).explanations
    assert x.motion > 0.999 and sum((x.nothing, x.rotation, x.surface, x.rival)) < 1e-3
