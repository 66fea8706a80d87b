# SPDX-License-Identifier: BSD-3-Clause
"""The NumPy twins of verdict and testimony: by hand, by laws, and against the native ones."""

from dataclasses import astuple, fields

import numpy as np
import pytest
from made_evidence import in_a_room, of_two_motions, on_a_plane, turned, unrelated
from noisy_problems import noisy_scene, unit_pose

from epi360 import RansacOptions, _core
from epi360.estimation.explanations_reference import (
    PairEvidence,
    explanations_reference,
    log_odds_by_regions,
)
from epi360.estimation.pair_arrays import native_pair
from epi360.estimation.testimony_reference import (
    LARGEST_GROUP,
    agreement_by_exchange,
    neighbour_groups,
    reference_testimony,
    region_votes,
    rotation_log_ratio_reference,
)
from epi360.poses import Pose, rotation_from_vector
from epi360.synthetic import two_view_scene

internals = _core.internals
NAMES = [field.name for field in fields(PairEvidence)]
KINDS = [unrelated, turned, on_a_plane, in_a_room, of_two_motions]
DEGREE = np.pi / 180.0
SAID = {"scale": 0.1 * DEGREE, "gate": 0.26 * DEGREE, "density": 0.35}
DOWN = np.array([0.0, 1.0, 0.0])
# Of the regression: what docs/estimator.md states.
CONSTANT, PER_RATIO, PER_SIGMA, PER_MAJORITY = -2.7, 0.11, -1.2, 6.0
TURN = rotation_from_vector([0.5, -1.1, 0.3])


def units(bearings):
    return bearings / np.linalg.norm(bearings, axis=1, keepdims=True)


def core_answer(b1, b2, gravity=None):
    options = RansacOptions()
    pair = native_pair(b1, b2, gravity=gravity or (None, None), gravity_sigma=DEGREE)
    (answer,) = _core.estimate_relative_poses(
        [pair],
        residual="sampson",
        threshold=0.0,
        threshold_in_pixels=False,
        sample_size=5,
        min_iterations=options.min_iterations,
        max_iterations=options.max_iterations,
        confidence=options.confidence,
        min_num_inliers=options.min_num_inliers,
        shared_error=options.shared_error,
        num_threads=1,
    )
    return answer


def evidence_of(evidence):
    return PairEvidence(**{name: getattr(evidence, name) for name in NAMES})


def by_core(evidence):
    x = internals.explain(evidence)
    return x.nothing, x.rotation, x.surface, x.motion, x.rival


# ---- by hand


def test_by_hand_the_log_odds_of_a_pose_are_the_terms_that_the_documents_name():
    said = PairEvidence(log_ratio=10.0, regional_sigma=DEGREE, num_effective=100, support=40)
    base = log_odds_by_regions(said)
    for changes, more in (
        ({"log_ratio": 20.0}, 10.0 * PER_RATIO),
        ({"regional_sigma": np.e * DEGREE}, PER_SIGMA),
        ({"support": 60}, 0.1 * PER_MAJORITY),
        ({"log_prior": -1.5}, -1.5),
    ):
        assert log_odds_by_regions(changed(said, **changes)) - base == pytest.approx(more)
    assert base == pytest.approx(CONSTANT + 10.0 * PER_RATIO)


def test_by_hand_two_equal_poses_without_background_have_one_half_each():
    x = explanations_reference(PairEvidence(num_usable=9, rival_evidence=0.0, support=9))
    assert (x.motion, x.rival) == (pytest.approx(0.5), pytest.approx(0.5))


@pytest.mark.parametrize(
    ("lead", "regions", "log_odds"),
    [
        (-100.0, 0.0, 6.0),  # what all matches say counts 6 more than the regions
        (-100.0, -20.0, -14.0),  # which may say the opposite
        (100.0, 20.0, 14.0),
        (0.0, 2.0, 0.0),  # and within that nothing
        (0.0, np.nan, 0.0),
    ],
)
def test_by_hand_the_regions_bound_what_all_matches_say_of_a_second_pose(lead, regions, log_odds):
    x = explanations_reference(
        PairEvidence(num_usable=9, support=9, rival_evidence=lead, rival_regions=regions)
    )
    assert np.log(x.motion / x.rival) == pytest.approx(log_odds)


def test_by_hand_a_side_that_contradicts_makes_two_poses_equally_probable():
    x = explanations_reference(
        PairEvidence(num_usable=9, support=9, rival_evidence=-50.0, num_contradicting=8)
    )
    assert x.motion == pytest.approx(0.5)


def test_by_hand_at_the_limits_of_the_tests_the_odds_are_those_of_what_is_accepted():
    sure = PairEvidence(num_usable=99, num_effective=99, support=50)
    lacking = explanations_reference(changed(sure, rival_evidence=-6.0))
    assert lacking.motion / (lacking.motion + lacking.rival) == pytest.approx(0.85)
    by_chance = explanations_reference(changed(sure, log10_false_alarms=-3.0))
    assert by_chance.motion / (by_chance.motion + by_chance.nothing) == pytest.approx(0.85)
    noisy = explanations_reference(changed(sure, noise=0.03, max_noise=0.01))
    assert noisy.motion / (noisy.motion + noisy.nothing) == pytest.approx(0.85)
    turn = {"rotation_support": 50, "rotation_log10_false_alarms": -30.0, "rotation_rejection": 4.0}
    rejected = explanations_reference(changed(sure, **turn))
    assert rejected.motion / (rejected.motion + rejected.rotation) == pytest.approx(0.85)


def test_by_hand_three_matches_far_apart_have_a_vote_each_and_neighbours_share_theirs():
    b1 = units(np.array([[1.0, 0.0, 0.0], [1.0, 0.01, 0.0], [0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(region_votes(b1, b1), [0.5, 0.5, 1.0])


def test_groups_of_neighbours_hold_every_match_once():
    b = units(np.random.default_rng(0).normal(size=(203, 3)))
    groups = list(neighbour_groups(b, reach=0.0))
    assert max(map(len, groups)) <= LARGEST_GROUP and min(map(len, groups)) >= 3
    np.testing.assert_array_equal(np.sort(np.concatenate(groups)), np.arange(203))


@pytest.mark.parametrize("num", [0, 1])
def test_without_neighbours_nobody_exchanges_partners(num):
    b = np.array([[0.0, 0.0, 1.0]])[:num]
    (group,) = neighbour_groups(b, reach=0.1)
    assert len(group) == num
    assert np.isfinite(
        internals.testimony(b, b, np.eye(3), np.array([0.0, 0.0, 1.0]), **SAID)
    ).all()


def test_neighbours_nearer_than_the_reach_are_not_parted():
    b = units(np.random.default_rng(0).normal(size=(203, 3)))
    for reach in np.radians([10.0, 40.0, 90.0]):
        groups = list(neighbour_groups(b, reach))
        np.testing.assert_array_equal(np.sort(np.concatenate(groups)), np.arange(203))
        sides = np.array([np.ptp(b[group], axis=0).max() for group in groups])
        sizes = np.array([len(group) for group in groups])
        assert (sides[sizes > LARGEST_GROUP] < reach).all()
        assert (sides > 0.3 * reach)[sizes > LARGEST_GROUP].all()
    assert len(list(neighbour_groups(b, reach=4.0))) == 1


def test_in_a_large_neighbourhood_each_exchanges_partners_with_four_from_all_over_it():
    b = units(np.array([[x, 0.0, 1.0] for x in np.linspace(-0.5, 0.5, 20)]))
    asked = []

    def agrees(b1, b2):
        asked.append(np.abs(b1[:, 0] - b2[:, 0]))
        return np.ones(len(b1), dtype=bool)

    np.testing.assert_array_equal(agreement_by_exchange(b, b, gate=1.0, agrees=agrees), 1.0)
    for apart in asked:
        assert len(apart) == 4 * len(b)
        assert apart.min() > 0.15 and apart.max() > 0.6


# ---- against the native ones


@pytest.mark.parametrize("make", KINDS)
def test_the_core_finds_the_same_explanations_as_numpy(make):
    for seed in range(6):
        answer = core_answer(*make(seed))
        mine = astuple(explanations_reference(evidence_of(answer.evidence)))
        np.testing.assert_allclose(mine, by_core(answer.evidence), rtol=1e-9, atol=1e-15)
        assert sum(mine) == pytest.approx(1.0, abs=1e-12)


def test_the_core_finds_the_same_explanations_of_any_evidence():
    rng = np.random.default_rng(0)
    for _ in range(500):
        evidence = internals.Evidence()
        for name, value in {
            "num_usable": int(rng.integers(3, 200)),
            "num_effective": int(rng.integers(1, 200)),
            "support": int(rng.integers(0, 150)),
            "log10_false_alarms": rng.normal(-3.0, 5.0),
            "chance": rng.uniform(0.0, 0.7),
            "rotation_support": int(rng.integers(0, 150)),
            "rotation_log10_false_alarms": rng.normal(-6.0, 5.0),
            "rotation_rejection": rng.normal(4.0, 3.0),
            "rotation_log_ratio": rng.normal(30.0, 20.0),
            "log_ratio": rng.normal(40.0, 20.0),
            "regional_sigma": DEGREE * rng.uniform(0.1, 5.0),
            "log_prior": -rng.exponential(),
            "has_prior": bool(rng.integers(2)),
            "rival_evidence": -rng.exponential(20.0),
            "rival_probability": rng.uniform(),
            "rival_regions": rng.choice([np.nan, rng.normal(0.0, 8.0)]),
            "num_contradicting": int(rng.integers(0, 3) == 0),
            "is_only_crowd": bool(rng.integers(0, 4) == 0),
            "only_pose": float(rng.integers(0, 60)),
            "only_rival": float(rng.integers(0, 60)),
            "behind": float(rng.integers(0, 15)),
            "mirrored_turn": float(rng.integers(0, 15)),
            "plane_share": rng.uniform(),
            "has_twin": bool(rng.integers(2)),
        }.items():
            setattr(evidence, name, value)
        mine = astuple(explanations_reference(evidence_of(evidence)))
        np.testing.assert_allclose(mine, by_core(evidence), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("gravity", [None, (DOWN, DOWN)])
@pytest.mark.parametrize("make", [on_a_plane, in_a_room, of_two_motions])
def test_the_core_hears_the_same_of_the_regions_as_numpy(make, gravity):
    compared = 0
    for seed in range(4):
        b1, b2 = make(seed)
        answer = core_answer(b1, b2, gravity)
        if answer.status not in ("ok", "planar_ambiguous"):
            continue
        said = reference_testimony(
            units(b1),
            units(b2),
            Pose(answer.rotation, answer.translation),
            scale=answer.scale,
            gate=answer.threshold,
            density=answer.evidence.chance / (2.0 * answer.threshold),
            gravity=gravity,
        )
        e = answer.evidence
        heard = e.log_ratio, e.regional_sigma, e.num_regions
        np.testing.assert_allclose(said, heard, rtol=1e-7)
        compared += 1
    assert compared or (gravity and make is not in_a_room)


@pytest.mark.parametrize("half_angle_deg", [20.0, 40.0])
def test_the_core_hears_the_same_of_neighbours_that_noise_hides_as_numpy(half_angle_deg):
    for seed in range(3):
        scene = two_view_scene(
            seed, num_matches=150, layout="cone", cone_half_angle_deg=half_angle_deg
        )
        b1, b2, pose = scene.bearings1, scene.bearings2, unit_pose(scene)
        noise = {"scale": 1.5 * DEGREE, "gate": 4.0 * DEGREE, "density": 1.0}
        groups = list(neighbour_groups(b1, 4.0 * noise["gate"]))
        assert max(map(len, groups)) > LARGEST_GROUP
        heard = internals.testimony(b1, b2, pose.rotation, pose.translation, **noise)
        said = reference_testimony(b1, b2, pose, **noise)
        np.testing.assert_allclose((said.log_ratio, said.direction_sigma), heard, rtol=1e-7)


def test_the_core_hears_the_same_of_a_rotation_as_numpy():
    for seed in range(4):
        b1, b2 = map(units, turned(seed))
        answer = core_answer(b1, b2)
        assert answer.status == "pure_rotation"
        gate, rotation = answer.threshold, np.ascontiguousarray(answer.rotation)
        share = internals.rotation_chance(b1, b2, rotation, gate=gate, seed=0)
        said = rotation_log_ratio_reference(
            b1, b2, rotation, scale=answer.scale, gate=gate, wrong_share=share
        )
        assert said == pytest.approx(answer.evidence.rotation_log_ratio, rel=1e-9)


# ---- laws


def room(seed):
    scene = noisy_scene(seed, 0.1, 0.5, num_matches=200)
    return scene.bearings1, scene.bearings2, unit_pose(scene)


@pytest.mark.parametrize("seed", range(4))
def test_the_order_of_the_matches_does_not_matter(seed):
    b1, b2, pose = room(seed)
    shuffled = np.random.default_rng(seed).permutation(len(b1))
    once = reference_testimony(b1, b2, pose, **SAID)
    again = reference_testimony(b1[shuffled], b2[shuffled], pose, **SAID)
    np.testing.assert_allclose(again, once, rtol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_order_of_the_views_does_not_matter(seed):
    b1, b2, pose = room(seed)
    back = pose.inverse()
    once = reference_testimony(b1, b2, pose, **SAID)
    again = reference_testimony(b2, b1, back, **SAID)
    assert again.log_ratio == pytest.approx(once.log_ratio, rel=1e-9)
    assert again.num_regions == pytest.approx(once.num_regions, rel=1e-9)
    # The inverse pose has its direction in the other view, where the rotation counts with it.
    assert again.direction_sigma == pytest.approx(once.direction_sigma, rel=0.4)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("view", [1, 2])
def test_turning_a_camera_changes_who_exchanges_partners_and_nothing_else(seed, view):
    b1, b2, pose = room(seed)
    once = reference_testimony(b1, b2, pose, **SAID)
    if view == 1:
        turned_pose = Pose(pose.rotation @ TURN.T, pose.translation)
        again = reference_testimony(b1 @ TURN.T, b2, turned_pose, **SAID)
    else:
        turned_pose = Pose(TURN @ pose.rotation, TURN @ pose.translation)
        again = reference_testimony(b1, b2 @ TURN.T, turned_pose, **SAID)
    np.testing.assert_allclose(again, once, rtol=0.05)


@pytest.mark.parametrize("make", [unrelated, turned, in_a_room])
@pytest.mark.parametrize("change", ["swapped", "first turned", "second turned", "shuffled"])
def test_what_says_the_same_has_the_same_explanations(make, change):
    for seed in range(4):
        b1, b2 = make(seed)
        order = np.random.default_rng(seed).permutation(len(b1))
        changed_views = {
            "swapped": (b2, b1),
            "first turned": (b1 @ TURN.T, b2),
            "second turned": (b1, b2 @ TURN.T),
            "shuffled": (b1[order], b2[order]),
        }[change]
        once, again = (core_answer(*views).evidence for views in ((b1, b2), changed_views))
        np.testing.assert_allclose(by_core(again), by_core(once), atol=0.03)


@pytest.mark.parametrize("seed", range(4))
def test_copies_of_matches_do_not_make_a_pose_surer(seed):
    b1, b2, pose = room(seed)
    once = reference_testimony(b1, b2, pose, **SAID)
    twice = reference_testimony(np.tile(b1, (2, 1)), np.tile(b2, (2, 1)), pose, **SAID)
    assert twice.log_ratio <= once.log_ratio
    assert twice.num_regions <= 1.001 * once.num_regions
    assert twice.direction_sigma >= 0.999 * once.direction_sigma


def changed(evidence, **changes):
    return PairEvidence(**{name: getattr(evidence, name) for name in NAMES} | changes)
