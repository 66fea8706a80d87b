# SPDX-License-Identifier: BSD-3-Clause
"""A map does not begin with the motion of the clouds."""

import numpy as np
import pytest
from drifting_clouds import STEP, TURN, meadow

from epi360.cameras import Equirectangular
from epi360.odometry.frame_result import FrameTracks
from epi360.odometry.initialization import Waiting
from epi360.poses import translation_error_deg

PANORAMA = Equirectangular(2000, 1000)


def start_of(bearings):
    waiting = Waiting(PANORAMA, np.radians(2.0), 0)
    for index, each in enumerate(bearings):
        ids = np.arange(len(each))
        start = waiting.add(FrameTracks(index, ids, each, PANORAMA.pixels_from_bearings(each)))
    return start


def test_a_tripod_below_drifting_clouds_waits():
    start = start_of(meadow(TURN, num_ground=850))
    assert not start.has_begun and start.status == "turning"


@pytest.mark.parametrize("num_things", [0, 300])
def test_who_walks_below_them_begins_a_map_with_the_own_step(num_things):
    start = start_of(meadow(STEP, num_things=num_things, num_sky=500))
    assert start.has_begun
    assert translation_error_deg(start.result.cam2_from_cam1, STEP) < 2.0
