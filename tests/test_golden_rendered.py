# SPDX-License-Identifier: BSD-3-Clause
"""Pictures that the package renders give the poses they were rendered at, on every machine.

The real pairs of test_golden.py are not everywhere; these are. Beside each bound is what was
measured when the test was written (degrees of rotation / direction), so that the margin can be
seen: three times or more, as another OpenCV finds other key points.
"""

from functools import cache
from itertools import combinations

import numpy as np
import pytest
from rendered_views import write_png

from epi360 import (
    Equirectangular,
    KannalaBrandt,
    Pose,
    relative_pose_of_images,
    rotation_error_deg,
    translation_error_deg,
)
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.poses import rotation_from_vector
from epi360_scenes import scene

PANORAMA = Equirectangular(512, 256)  # a pixel is 0.7 degrees
FISHEYE = KannalaBrandt(360, 360, 105.0, 105.0, 180.0, 180.0, 0.01, -0.002, max_angle_deg=95.0)
# Cut off on the left, on the right and below: the optical axis is no longer in the middle.
CROP = KannalaBrandt(310, 300, 105.0, 105.0, 150.0, 180.0, 0.01, -0.002, max_angle_deg=95.0)

START = Pose(rotation_from_vector([0.03, 0.2, -0.02]), np.array([-0.4, -1.5, 0.1]))


def moved(turn, step_m):
    """World from camera after a turn and a step in the frame of the first camera."""
    return START @ Pose(rotation_from_vector(turn), np.array(step_m))


PLACES = {
    "start": START,
    "near": moved([0.02, 0.15, -0.03], [0.25, 0.02, 0.15]),
    "far": moved([-0.05, 1.1, 0.04], [0.9, 0.1, 0.6]),
    "turned": moved([0.1, -0.7, 0.05], [0.0, 0.0, 0.0]),
}


@cache
def room(name):
    return scene(name)


@cache
def picture(camera, place):
    """Picture of the living room from a named place, rendered once."""
    return room("living_room").render(camera, PLACES[place]).image


def truth(place1, place2):
    return PLACES[place2].inverse() @ PLACES[place1]


def estimate(place, camera1=PANORAMA, camera2=PANORAMA):
    images = picture(camera1, "start"), picture(camera2, place)
    return relative_pose_of_images(*images, camera1=camera1, camera2=camera2)


def assert_within(pose, expected, rotation_deg, translation_deg):
    assert rotation_error_deg(pose, expected) < rotation_deg
    assert translation_error_deg(pose, expected) < translation_deg


@pytest.mark.parametrize(
    ("place", "rotation_deg", "translation_deg"),
    [
        ("near", 0.2, 0.5),  # measured: 0.03 / 0.04
        ("far", 0.4, 0.7),  # 0.11 / 0.17
    ],
)
def test_two_panoramas_of_a_room(place, rotation_deg, translation_deg):
    result = estimate(place)
    assert result.status == "ok"
    assert_within(result.cam2_from_cam1, truth("start", place), rotation_deg, translation_deg)


@pytest.mark.parametrize(
    ("camera1", "camera2", "rotation_deg", "translation_deg"),
    [
        (FISHEYE, FISHEYE, 0.2, 0.7),  # measured: 0.01 / 0.13
        (FISHEYE, CROP, 0.2, 1.0),  # 0.02 / 0.25
        (PANORAMA, CROP, 0.4, 2.0),  # 0.12 / 0.64
    ],
    ids=["two fisheyes", "fisheye and its crop", "panorama and crop"],
)
def test_fisheye_images_of_a_room(camera1, camera2, rotation_deg, translation_deg):
    result = estimate("near", camera1, camera2)
    assert result.status == "ok"
    expected = truth("start", "near")
    assert_within(result.cam2_from_cam1, expected, rotation_deg, translation_deg)


def test_a_turn_on_the_spot_claims_no_translation():
    result = estimate("turned")
    assert result.status == "pure_rotation"
    assert (
        rotation_error_deg(result.cam2_from_cam1, truth("start", "turned")) < 0.1
    )  # measured: 0.01
    assert np.isnan(result.cam2_from_cam1.translation).all()


def test_a_folder_gives_the_poses_of_one_room_and_none_to_another_room(tmp_path):
    names = {f"{place}.png": place for place in ("far", "near", "start")}
    for name, place in names.items():
        write_png(tmp_path / "in" / name, picture(PANORAMA, place))
    write_png(tmp_path / "in" / "studio.png", room("studio").render(PANORAMA, START).image)
    options = MatchOptions(pairs="exhaustive", num_threads=1)
    run = match_images(find_images(tmp_path / "in"), tmp_path / "out", options)
    found = {(verdict.image1, verdict.image2): verdict for verdict in run.verdicts}
    assert list(found) == list(combinations([*names, "studio.png"], 2))
    for pair, verdict in found.items():
        assert verdict.accepted == ("studio.png" not in pair), pair
        if verdict.accepted:
            expected = truth(*(names[name] for name in pair))
            assert_within(
                verdict.cam2_from_cam1, expected, 0.4, 0.7
            )  # measured at most: 0.11 / 0.13
    graph = load_matches(tmp_path / "out")
    assert [(pair.image1, pair.image2) for pair in graph.pairs] == list(found)
