# SPDX-License-Identifier: BSD-3-Clause
"""A walk along a corridor with equal doors, of which frames are missing."""

from functools import cache

import numpy as np
import pytest

from epi360 import Odometry
from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.odometry.surroundings import Surroundings
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes.corridor import corridor_of_equal_doors

CAMERA = Equirectangular(768, 384)
START_M, STEP_M, NUM_BEFORE, NUM_AFTER = -6.0, 0.06, 14, 4


@cache
def room():
    return corridor_of_equal_doors(1, plain_floor=True)


def world_from_cam(number):
    sway = np.sin(0.5 * number)
    turn = rotation_from_vector([0.01 * sway, 0.1 * np.sin(0.05 * number), 0.01])
    return Pose(turn, np.array([0.02 * sway, -1.5 + 0.01 * sway, START_M + STEP_M * number]))


@cache
def frame(number):
    return room().render(CAMERA, world_from_cam(number), supersample=1).image


def tracked(pictures):
    odometry = Odometry(CAMERA)
    for picture in pictures:
        odometry.add_frame(picture)
    return odometry


def walked_without(num_missing):
    """Odometry of a walk; frames are missing before the one with number `NUM_BEFORE`."""
    after = NUM_BEFORE + num_missing
    numbers = (*range(NUM_BEFORE), *range(after, after + NUM_AFTER))
    return tracked(frame(number) for number in numbers)


def test_the_map_does_not_go_on_at_another_door():
    odometry = walked_without(40)  # 2.4 m, which is not far from one door to the next
    after = odometry.results()[NUM_BEFORE:]
    assert after[0].follows_gap and "seems to show another place" in after[0].message
    assert {each.status for each in after} == {"lost"}
    assert odometry.num_segments == 2
    assert "another place, map 2" in after[-1].message


def test_points_alone_would_say_so(monkeypatch):
    """Nothing but what is around a door tells it from its equals."""
    monkeypatch.setattr(Surroundings, "deny", lambda *_, **__: False)
    odometry = walked_without(40)
    places = odometry.trajectory().positions
    assert len(places) == NUM_BEFORE + NUM_AFTER and odometry.num_segments == 1
    walked = np.linalg.norm(places[NUM_BEFORE - 1] - places[0]) / (NUM_BEFORE - 1)
    gap = np.linalg.norm(places[NUM_BEFORE] - places[NUM_BEFORE - 1])
    assert gap < 20 * walked  # of 41 steps


@pytest.mark.parametrize("num_missing", [0, 6])
def test_over_a_small_gap_the_map_goes_on(num_missing):
    odometry = walked_without(num_missing)
    assert odometry.num_segments == 1
    assert all(each.status == "tracked" for each in odometry.results())
    places = odometry.trajectory().positions
    walked = np.linalg.norm(places[NUM_BEFORE - 1] - places[0]) / (NUM_BEFORE - 1)
    gap = np.linalg.norm(places[NUM_BEFORE] - places[NUM_BEFORE - 1])
    assert gap == pytest.approx((num_missing + 1) * walked, rel=0.1)


def test_where_the_camera_stood_before_it_is_found_again():
    """Two pictures of one place have no parallax, so that nothing speaks against it."""
    black = np.zeros_like(frame(0))
    there, back = range(NUM_BEFORE), range(NUM_BEFORE - 2, NUM_BEFORE - 7, -1)
    odometry = tracked([*map(frame, there), *[black] * 3, *map(frame, back)])
    results = odometry.results()
    assert odometry.num_segments == 1
    assert [each.status for each in results[-5:]] == ["tracked"] * 5
    places = odometry.trajectory().positions
    np.testing.assert_allclose(places[-5:], places[list(back)], atol=0.02 * np.ptp(places))


def test_a_lens_that_follows_few_points_walks_on(monkeypatch):
    asked = []
    monkeypatch.setattr(Surroundings, "deny", lambda *_, **__: asked.append(1))
    lens = KannalaBrandt(384, 384, 112.0, 112.0, 192.0, 192.0, 0, 0, 0, 0, max_angle_deg=95)
    odometry = Odometry(lens)
    for number in range(12):
        pose = world_from_cam(number)
        odometry.add_frame(room().render(lens, pose, supersample=1).image)
    assert odometry.num_segments == 1 and not asked
