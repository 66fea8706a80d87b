# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas of a rendered corridor with equal doors: the next door is not taken for this one."""

import numpy as np
import pytest
from equal_doors import panoramas, truth, write_panoramas

from epi360 import relative_pose_of_images
from epi360.jobs.matching.match_folder import match_images
from epi360.places import corridor
from epi360.places.same_place import EQUAL_DOORS
from epi360.poses import poses_agree, translation_error_deg


def found(name1, name2):
    return relative_pose_of_images(*(panoramas()[name][1] for name in (name1, name2)))


def test_a_step_that_shows_enough_is_believed():
    result = found("a.png", "b.png")
    assert result.success
    assert poses_agree(result.cam2_from_cam1, truth("a.png", "b.png"), 1.0, 3.0)


@pytest.mark.parametrize("names", [("a.png", "c.png"), ("c.png", "a.png")])
def test_a_door_upon_the_next_is_refused_and_its_pose_is_kept(names):
    result = found(*names)
    assert result.status == "another_place"
    assert EQUAL_DOORS in result.warnings
    assert np.isnan(result.cam2_from_cam1.translation).all()
    assert translation_error_deg(result.alternatives[0], truth(*names)) > 150.0


def test_the_same_pose_would_be_believed_elsewhere(monkeypatch):
    monkeypatch.setattr(corridor, "repeats_itself", lambda *_: False)
    assert found("a.png", "c.png").success


def test_a_folder_says_why_it_refuses_the_pair(tmp_path):
    run = match_images(write_panoramas(tmp_path), tmp_path / "matched")
    verdicts = {(each.image1, each.image2): each for each in run.verdicts}
    assert verdicts["a.png", "b.png"].accepted
    refused = verdicts["a.png", "c.png"]
    assert not refused.accepted
    assert refused.refused.startswith("shows a place that repeats itself")
