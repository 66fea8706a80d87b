# SPDX-License-Identifier: BSD-3-Clause
"""Changes of the cameras' angles that many pairs share."""

from dataclasses import replace

import numpy as np
import pytest
from rooms_by_wrong_cameras import (
    LENS,
    OTHER_LENS,
    PANORAMA,
    PINHOLE,
    errors_deg,
    estimated,
    seen,
)

from epi360 import estimate_relative_pose
from epi360.cameras.changed_angles import PairOfAngles
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.shared_angles import (
    OF_CHANGED,
    OF_GIVEN,
    Limits,
    fit_shared_angles,
)
from epi360.estimation.shared_angles_fit import PosedMatches

NO_CHANGES = {
    "panorama": (PANORAMA, (0.0, 0.0, 0.0)),
    "lens": (LENS, (0.0,)),
    "photograph": (PINHOLE, (0.0,)),
}


MAX_NOISE_DEG = 1.0


def estimate(bearings1, bearings2, max_noise_deg):
    return estimate_relative_pose(
        bearings1, bearings2, options=IMAGE_OPTIONS, max_noise_deg=max_noise_deg
    )


def posed(seed, camera, changes, other=None, cameras=(0, 0), **options):
    bearings, truth = seen(seed, camera, changes, other, **options)
    result = estimated(bearings)
    pose, noise_deg = result.cam2_from_cam1, result.noise_deg
    return PosedMatches(cameras, bearings, pose, noise_deg, MAX_NOISE_DEG), truth


def pairs_of(camera, changes, num=8, **options):
    return [posed(seed, camera, changes, **options)[0] for seed in range(num)]


def sizes(shared, camera=0):
    return [each.change for each in shared.changes[camera]]


@pytest.mark.parametrize(
    ("camera", "changes", "tolerance"),
    [
        (PANORAMA, (-0.028, 0.0, 0.0), 0.002),
        (PANORAMA, (0.0, -0.05, 0.0785), 0.005),
        (LENS, (0.05,), 0.002),
        (LENS, (-0.1,), 0.002),
        (PINHOLE, (0.06,), 0.002),
        (PINHOLE, (-0.1,), 0.002),
    ],
)
def test_pairs_say_what_their_camera_is(camera, changes, tolerance):
    shared = fit_shared_angles(pairs_of(camera, changes), [camera], estimate)
    assert sizes(shared)[: len(changes)] == pytest.approx(changes, abs=tolerance)
    assert len(sizes(shared)) == len(changes)
    assert shared.is_clear(0, OF_GIVEN)


def test_the_ends_of_a_panorama_that_are_near_their_poles_stay_there():
    cut = fit_shared_angles(pairs_of(PANORAMA, (0.0, -0.05, -0.0785)), [PANORAMA], estimate)
    _, vertical, middle = sizes(cut)
    assert middle == pytest.approx(0.5 * np.pi * vertical, abs=1e-12)  # the highest one stays
    narrow = fit_shared_angles(pairs_of(PANORAMA, (-0.028, 0.004, 0.003)), [PANORAMA], estimate)
    assert sizes(narrow)[1:] == [0.0, 0.0]
    part = replace(PANORAMA, vertical_fov_deg=120.0)
    free = fit_shared_angles(pairs_of(PANORAMA, (0.0, 0.05, 0.03)), [part], estimate)
    assert sizes(free)[1:] == pytest.approx([0.05, 0.03], abs=0.005)


@pytest.mark.parametrize("kind", NO_CHANGES)
def test_right_cameras_stay(kind):
    camera, changes = NO_CHANGES[kind]
    shared = fit_shared_angles(pairs_of(camera, changes), [camera], estimate)
    assert np.abs(sizes(shared)).max() < 0.005
    assert not shared.is_clear(0, OF_GIVEN)


def test_the_standard_deviations_are_those_of_many_samples():
    changes, over_sigma = (0.0, -0.05, 0.0785), []
    for first in range(0, 60, 6):
        some = [posed(seed, PANORAMA, changes, num=150)[0] for seed in range(first, first + 6)]
        found = fit_shared_angles(some, [PANORAMA], estimate).changes[0]
        over_sigma.append(
            [
                abs(each.change - true) / each.sigma
                for each, true in zip(found, changes, strict=True)
            ]
        )
    assert 0.4 < np.median(over_sigma) < 1.7  # of a Gaussian 0.67, of 6 samples a little more


def test_each_camera_has_its_own_changes_and_one_that_is_fixed_has_none():
    some = [posed(seed, LENS, (0.06,), (0.0,), cameras=(0, 1))[0] for seed in range(8)]
    some += [posed(seed, LENS, (0.06,), cameras=(0, 0))[0] for seed in range(8, 12)]
    shared = fit_shared_angles(some, [LENS, OTHER_LENS], estimate)
    assert sizes(shared)[0] == pytest.approx(0.06, abs=0.003)
    assert sizes(shared, 1)[0] == pytest.approx(0.0, abs=0.003)
    fixed = fit_shared_angles(some, [LENS, None], estimate)
    assert sizes(fixed)[0] == pytest.approx(0.06, abs=0.003)
    assert fixed.changes[1] == []


def test_a_wrong_camera_among_right_ones_is_found_by_its_own_pairs():
    some = pairs_of(LENS, (0.06,), num=5)
    some += [posed(seed, OTHER_LENS, (0.0,), cameras=(1, 1))[0] for seed in range(20, 27)]
    shared = fit_shared_angles(some, [LENS, OTHER_LENS], estimate)
    assert shared.is_clear(0, OF_GIVEN)
    assert not shared.is_clear(1, OF_GIVEN)
    assert shared.gain_of(1) < 0.05 < shared.gain_of(0)


def test_cameras_that_all_stay_are_refused():
    with pytest.raises(ValueError, match="must have one that may change"):
        fit_shared_angles(pairs_of(LENS, (0.06,), num=2), [None], estimate)


def test_a_camera_without_pairs_is_not_clear():
    shared = fit_shared_angles(pairs_of(LENS, (0.06,), num=5), [LENS, PANORAMA], estimate)
    assert not shared.is_clear(1, OF_GIVEN)
    assert np.isnan(shared.gain_of(1))


def test_wrong_poses_among_the_pairs_do_not_decide():
    some = pairs_of(PANORAMA, (-0.028, 0.0, 0.0))
    for seed in range(2):
        bearings, _ = seen(50 + seed, PANORAMA, (0.0, 0.0, 0.0), wrong=0)
        turned = bearings[0], np.roll(bearings[1], 7, axis=0)
        some.append(PosedMatches((0, 0), turned, some[seed].cam2_from_cam1, 0.3, MAX_NOISE_DEG))
    shared = fit_shared_angles(some, [PANORAMA], estimate)
    assert sizes(shared)[0] == pytest.approx(-0.028, abs=0.003)
    assert shared.is_clear(0, OF_GIVEN)


def test_poses_are_right_by_the_changed_angles():
    changes = (0.1,)
    matched, truths = zip(*(posed(seed, LENS, changes) for seed in range(8)), strict=True)
    shared = fit_shared_angles(matched, [LENS], estimate)
    before, after = [], []
    for each, truth in zip(matched, truths, strict=True):
        angles = PairOfAngles.of((LENS, LENS), each.bearings, is_curved=True)
        curve = (*sizes(shared), 0.0)[:2]
        views = angles.changed(np.array(curve))
        result = estimate(*(view.bearings for view in views), MAX_NOISE_DEG)
        before.append(errors_deg(each.cam2_from_cam1, truth))
        after.append(errors_deg(result.cam2_from_cam1, truth))
    assert (np.median(after, axis=0) < 0.15 * np.median(before, axis=0)).all()


def test_the_order_of_pairs_and_matches_does_not_matter():
    some = pairs_of(LENS, (0.05,), num=5)
    shared = fit_shared_angles(some, [LENS], estimate)
    again = fit_shared_angles(some[::-1], [LENS], estimate)
    assert sizes(again) == pytest.approx(sizes(shared), abs=1e-6)
    assert again.gains[::-1] == pytest.approx(shared.gains, abs=1e-4)


def test_a_start_is_gone_on_from():
    some = pairs_of(PANORAMA, (0.0, -0.1, 0.157))
    first = fit_shared_angles(some[:4], [PANORAMA], estimate)
    shared = fit_shared_angles(some, [PANORAMA], estimate, start=first.sizes)
    assert sizes(shared) == pytest.approx([0.0, -0.1, 0.157], abs=0.006)


def test_smaller_changes_are_clear_in_a_camera_that_was_changed_before():
    shared = fit_shared_angles(pairs_of(LENS, (0.006,)), [LENS], estimate, OF_CHANGED)
    assert shared.is_clear(0, OF_CHANGED)
    assert not shared.is_clear(0, OF_GIVEN)
    assert not shared.is_clear(0, Limits(share_of_large=0.0, gain=np.inf))
