# SPDX-License-Identifier: BSD-3-Clause
"""Pairs that see the cameras of a rig turned otherwise than its calibration says."""

import numpy as np
import pytest

from epi360.jobs.graph.rig_check import RigDoubt, Turn, rig_doubts
from epi360.poses import Pose, rotation_from_vector

NOISE_DEG = 0.1
FRONT, BACK = np.eye(3), rotation_from_vector([0.0, np.pi, 0.0])


def rig_from_world(frame):
    return rotation_from_vector([0.02, 0.1 * frame, -0.01 * frame])


def turn(first, second, true_rig, rng):
    """What a pair of images, (frame, camera) each, says of a rig that is as it is."""
    images = [true_rig[camera] @ rig_from_world(frame) for frame, camera in (first, second)]
    noise = rotation_from_vector(rng.normal(0.0, np.radians(NOISE_DEG), 3))
    names = [(f"frame {frame}", camera) for frame, camera in (first, second)]
    return Turn(*names, noise @ images[1] @ images[0].T, NOISE_DEG)


def stated(off_deg=0.0):
    bumped = rotation_from_vector([np.radians(off_deg), 0.0, 0.0]) @ BACK
    return {"front": Pose(FRONT, np.zeros(3)), "back": Pose(bumped, np.array([0.0, 0.0, 0.03]))}


def turns_of(pairs):
    rng = np.random.default_rng(0)
    true_rig = {"front": FRONT, "back": BACK}
    return [turn(first, second, true_rig, rng) for first, second in pairs]


AT_ONE_MOMENT = [((frame, "front"), (frame, "back")) for frame in range(4)]
FROM_MOMENT_TO_MOMENT = [
    pair
    for frame in range(4)
    for pair in (
        ((frame, "front"), (frame + 1, "front")),
        ((frame + 1, "back"), (frame, "front")),
    )
]
BY_THE_OTHER_CAMERA = [
    pair
    for frame in range(4)
    for pair in (((frame + 1, "back"), (frame, "back")), ((frame, "front"), (frame + 1, "back")))
]


@pytest.mark.parametrize("pairs", [AT_ONE_MOMENT, FROM_MOMENT_TO_MOMENT, BY_THE_OTHER_CAMERA])
@pytest.mark.parametrize("off_deg", [0.0, 0.5, 4.0, 90.0])
def test_a_rig_that_is_stated_otherwise_is_told(pairs, off_deg):
    doubts = rig_doubts(turns_of(pairs), stated(off_deg))
    if off_deg < 1.0:  # pairs of real lenses are not better
        assert doubts == []
        return
    (doubt,) = doubts
    assert doubt == RigDoubt(("back", "front"), 4, doubt.off_deg)
    assert doubt.off_deg == pytest.approx(off_deg, abs=0.3)


def test_two_pairs_may_both_be_wrong():
    assert rig_doubts(turns_of(AT_ONE_MOMENT[:2]), stated(90.0)) == []


def test_pairs_whose_rotation_between_the_moments_is_unknown_say_nothing():
    assert rig_doubts(turns_of(FROM_MOMENT_TO_MOMENT[1::2]), stated(90.0)) == []


def test_one_wrong_pair_changes_nothing():
    turns = turns_of(AT_ONE_MOMENT)
    turns[0] = Turn(turns[0].first, turns[0].second, np.eye(3), NOISE_DEG)
    assert rig_doubts(turns, stated()) == []
