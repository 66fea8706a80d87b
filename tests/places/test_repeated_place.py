# SPDX-License-Identifier: BSD-3-Clause
"""A pair whose other matches agree on another pose that looks right as well."""

from dataclasses import replace

import numpy as np
import pytest
from twin_rooms import rooms, truth

import epi360
from epi360.features.warped_patches import Panorama
from epi360.places import repeated_place
from epi360.places.own_evidence import OwnEvidence
from epi360.places.repeated_place import MANY_OTHERS, REPEATED, with_rival_pose
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg

TURN = rotation_from_vector([0.0, 0.8, 0.0])


def picture(name):
    return rooms()[f"{name}.png"][1]


@pytest.fixture(scope="module")
def found():
    """An accepted result, and the cameras and pictures of the pair."""
    names = "a0", "a1"
    result = epi360.relative_pose_of_images(*map(picture, names))
    assert result.success
    height, width = picture("a0").shape[:2]
    camera = epi360.Equirectangular(width, height)
    return result, (camera, camera), tuple(Panorama.of(picture(name)) for name in names)


class Rival:
    """What an estimate from the other matches says: another pose, or the same one."""

    def __init__(self, result, *, is_another=True, status="ok", share=1.0):
        self.asked = 0
        pose = result.cam2_from_cam1
        self.pose = Pose(TURN @ pose.rotation, pose.translation) if is_another else pose
        kept = np.arange(len(result.inlier_mask)) < share * result.num_inliers
        self._inlier_mask = result.inlier_mask
        self._result = replace(result, cam2_from_cam1=self.pose, status=status, inlier_mask=kept)

    def __call__(self, bearings1, bearings2):
        self.asked += 1
        known = np.isfinite(bearings1).all(axis=1)
        assert (known == ~self._inlier_mask).all()  # the inliers are not asked
        return self._result


@pytest.mark.parametrize(
    ("own", "rival", "is_doubted"),
    [
        (OwnEvidence(6.0, 3.0), {}, True),
        (OwnEvidence(6.0, 3.0), {"share": 0.3}, True),
        (OwnEvidence(6.0, 3.0), {"share": 0.2}, False),  # four times as many agree with the pose
        (OwnEvidence(3.0, 3.0), {"share": 0.3}, False),  # it looks like another place
        (OwnEvidence(6.0, 1.0), {"share": 0.3}, False),
        (OwnEvidence(6.0, 3.0, is_known=False), {"share": 0.3}, False),
        (OwnEvidence(6.0, 3.0), {"is_another": False}, False),
        (OwnEvidence(6.0, 3.0), {"status": "too_few_inliers"}, False),
    ],
)
def test_a_rival_must_look_right_and_be_another_pose(monkeypatch, found, own, rival, is_doubted):
    monkeypatch.setattr(repeated_place.OwnEvidence, "of", lambda *_: own)
    result, cameras, panoramas = found
    estimate = Rival(result, **rival)
    told = with_rival_pose(result, cameras, panoramas, estimate)
    assert estimate.asked == 1
    if not is_doubted:
        assert told is result
        return
    assert told.status == "planar_ambiguous"
    assert told.cam2_from_cam1 is result.cam2_from_cam1
    assert told.alternatives[0] is estimate.pose
    assert told.warnings[-1] == REPEATED
    assert told.probability == pytest.approx(0.5 * result.probability)


@pytest.mark.parametrize("own", [OwnEvidence(3.0, 3.0), OwnEvidence(6.0, 3.0, is_known=False)])
def test_many_matches_of_another_pose_are_a_warning(monkeypatch, found, own):
    monkeypatch.setattr(repeated_place.OwnEvidence, "of", lambda *_: own)
    result, cameras, panoramas = found
    told = with_rival_pose(result, cameras, panoramas, Rival(result, share=0.4))
    assert told.warnings == (*result.warnings, MANY_OTHERS)
    assert replace(told, warnings=result.warnings) == result


def test_where_few_matches_are_left_nothing_is_asked(found):
    result, cameras, panoramas = found
    few = replace(result, inlier_mask=np.arange(len(result.inlier_mask)) >= 14)
    estimate = Rival(few)
    assert with_rival_pose(few, cameras, panoramas, estimate) is few
    refused = replace(result, status="too_few_inliers")
    assert with_rival_pose(refused, cameras, panoramas, estimate) is refused
    assert estimate.asked == 0


def error_deg(pose, expected):
    return max(rotation_error_deg(pose, expected), translation_error_deg(pose, expected))


@pytest.mark.parametrize(("here", "left", "right"), [("a0", "a2", "a1"), ("a1", "a2", "a0")])
def test_halves_of_two_views_say_two_poses(here, left, right):
    """The right half of the second picture was taken from somewhere else in the room."""
    mixed = picture(left).copy()
    half = mixed.shape[1] // 2
    mixed[:, half:] = picture(right)[:, half:]
    told = epi360.relative_pose_of_images(picture(here), mixed)
    assert told.status == "planar_ambiguous" and REPEATED in told.warnings
    poses = [told.cam2_from_cam1, told.alternatives[0]]
    for name in (left, right):
        expected = truth(f"{here}.png", f"{name}.png")
        assert min(error_deg(pose, expected) for pose in poses) < 3.0


def test_what_is_left_of_a_right_pair_says_nothing(found):
    result, _, _ = found
    assert not {REPEATED, MANY_OTHERS} & set(result.warnings)
