# SPDX-License-Identifier: BSD-3-Clause
"""A few things that stand elsewhere in another room agree on a pose, which says nothing."""

import numpy as np
import pytest

import epi360
from epi360.estimation.separate_things import Things, things_apart
from epi360.poses import Pose, rotation_from_vector

SEEDS = range(12)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def on_a_wall(poster, rng):
    """Points (N, 3) of a poster somewhere on one of the four walls of a room."""
    turn = rotation_from_vector([0.0, rng.integers(4) * np.pi / 2.0, 0.0])
    return (poster + [rng.uniform(-2.0, 2.0), rng.uniform(-0.2, 0.4), 2.5]) @ turn.T


def posters(seed, num, *, moved, num_random=0, num_points=60):
    """Bearings of some posters in two views of a room, or in two rooms; and the pose, if one."""
    rng = np.random.default_rng([seed, num])
    cameras = [
        (rotation_from_vector([0.0, rng.uniform(0.0, 6.28), 0.0]), rng.uniform(-1.0, 1.0, 3))
        for _ in range(2)
    ]
    cameras = [(R, centre * [1.0, 0.1, 1.0]) for R, centre in cameras]
    seen = [[], []]
    for _ in range(num):
        poster = (rng.random((num_points, 3)) - 0.5) * [1.0, 0.7, 0.0]
        here = on_a_wall(poster, rng)
        there = on_a_wall(poster, rng) if moved else here
        for view, (R, centre), points in zip(seen, cameras, (here, there), strict=True):
            view.append(unit((points - centre) @ R.T))
    noise = np.radians(0.05)
    b1, b2 = (
        np.concatenate(
            [unit(b + rng.normal(0.0, noise, b.shape)) for b in view]
            + [unit(rng.normal(size=(num_random, 3)))]
        )
        for view in seen
    )
    (R1, c1), (R2, c2) = cameras
    return b1, b2, Pose(R2 @ R1.T, R2 @ (c1 - c2))


def says_things(result):
    return any("lie on a few things" in warning for warning in result.warnings)


@pytest.mark.parametrize("num", [4, 8])
def test_a_pose_of_things_that_stand_elsewhere_is_refused(num):
    results = [epi360.estimate_relative_pose(*posters(s, num, moved=True)[:2]) for s in range(40)]
    refused = [result for result in results if says_things(result)]
    assert len(refused) >= 3
    assert sum(result.success for result in results) <= 1.5 * len(refused)
    for result in refused:
        assert result.status == "concentrated_inliers"
        assert result.probability <= 0.5
        assert np.isnan(result.cam2_from_cam1.rotation).all() and np.isnan(result.covariance).all()
        assert np.isfinite(result.alternatives[0].matrix()).all()


@pytest.mark.parametrize("num", [3, 4, 8])
@pytest.mark.parametrize("num_random", [0, 20])
def test_where_they_are_as_they_were_nothing_is_refused(num, num_random):
    num_right = 0
    for seed in SEEDS:
        b1, b2, pose = posters(seed, num, moved=False, num_random=num_random)
        result = epi360.estimate_relative_pose(b1, b2)
        assert not says_things(result)
        num_right += epi360.rotation_error_deg(result.cam2_from_cam1, pose) < 5.0
    assert num_right > 0.4 * len(SEEDS)


def street_with_car(seed, num_car, *, half_deg=20.0):
    """What a lens sees of a street, 400 matches, and after these a car that drove on; the pose."""
    rng = np.random.default_rng(seed)
    pose = Pose(
        rotation_from_vector(np.radians(rng.normal(0.0, 2.0, 3))), rng.normal(size=3) * [1, 0.2, 1]
    )
    spread = np.tan(np.radians(half_deg))
    depths = rng.uniform(5.0, 30.0, 400)
    scene = np.column_stack([*(rng.uniform(-spread, spread, (2, 400)) * depths), depths])
    car = np.array([-2.0, 1.0, 12.0]) + rng.uniform(-0.8, 0.8, (num_car, 3))
    views = (
        np.concatenate([scene, car]),
        np.concatenate([scene, car + [4.0, 0.0, 1.0]]) @ pose.rotation.T + pose.translation,
    )
    b1, b2 = (unit(unit(x) + rng.normal(0.0, np.radians(0.03), x.shape)) for x in views)
    return b1, b2, pose


@pytest.mark.parametrize("num_car", [10, 40])
def test_what_drives_through_a_narrow_view_refuses_nothing(num_car):
    for seed in SEEDS:
        b1, b2, pose = street_with_car(seed, num_car)
        result = epi360.estimate_relative_pose(b1, b2)
        assert result.success and not says_things(result)
        assert epi360.rotation_error_deg(result.cam2_from_cam1, pose) < 1.0


def test_matches_without_weight_are_no_things():
    weighed = [posters(seed, 5, moved=False) for seed in SEEDS]
    moved = [posters(seed, 4, moved=True) for seed in SEEDS]
    for (b1, b2, _), (other1, other2, _) in zip(weighed, moved, strict=True):
        both = np.concatenate([b1, other1]), np.concatenate([b2, other2])
        weights = np.arange(len(both[0])) < len(b1)
        alone = epi360.estimate_relative_pose(b1, b2)
        result = epi360.estimate_relative_pose(*both, weights=weights.astype(float))
        assert result.status == alone.status and not says_things(result)


def test_two_things_alone_are_a_warning():
    told = [epi360.estimate_relative_pose(*posters(s, 2, moved=False)[:2]) for s in SEEDS]
    doubted = [any("lie on two things" in w for w in each.warnings) for each in told]
    assert sum(doubted) > 0.4 * sum(each.success for each in told) > 0


def test_many_pairs_at_once_say_the_same():
    pairs = [posters(seed, 4, moved=True)[:2] for seed in SEEDS]
    for pair, result in zip(pairs, epi360.estimate_relative_poses(pairs), strict=True):
        alone = epi360.estimate_relative_pose(*pair)
        assert (result.status, result.warnings) == (alone.status, alone.warnings)


def test_what_counts_as_a_thing():
    b1, b2, _ = posters(0, 4, moved=True)
    agree = np.arange(len(b1)) < 120
    assert things_apart(b1, b2, agree) == Things(2, 2, 1.0)
    rng = np.random.default_rng(0)
    scattered = unit(rng.normal(size=(len(b1), 3)))
    both = [np.concatenate([b, other]) for b, other in ((b1, scattered), (b2, scattered))]
    assert things_apart(*both, np.concatenate([agree, agree])) is None  # most lie elsewhere
    room = unit(rng.normal(size=(2000, 3)))
    assert things_apart(room, room, np.ones(2000, bool)) is None  # one thing, all around


@pytest.mark.parametrize("num", [0, 1, 7])
def test_hardly_any_matches_show_no_things(num):
    b = unit(np.random.default_rng(1).normal(size=(num, 3)))
    assert things_apart(b, b, np.ones(num, bool)) is None
