# SPDX-License-Identifier: BSD-3-Clause
"""Frames before which some are missing are told, for the map may go on in another place."""

import numpy as np
import pytest
from walked_room import frames

from epi360 import Odometry
from epi360.cameras import Equirectangular
from epi360.odometry.gaps import Gaps


@pytest.mark.parametrize(
    ("followed", "usual"),
    [
        ([700, 690, 710, 640], None),
        ([700, 690, 710, 400], 700),
        ([700, 690, 710, 480], None),
        ([700, 690, 400], None),  # two frames say little
        ([60, 50, 55, 3], None),  # no frames of one clip
        ([700, 650, 560, 480, 400], None),  # slowly fewer
    ],
)
def test_far_fewer_points_than_usual_are_a_gap(followed, usual):
    gaps = Gaps()
    told = [gaps.usual_before(each) for each in followed]
    assert told[:-1] == [None] * (len(followed) - 1)
    assert told[-1] == usual


def test_after_a_gap_what_is_usual_is_found_anew():
    gaps = Gaps()
    told = [gaps.usual_before(each) for each in (700, 700, 700, 100, 200, 300, 400, 150)]
    assert told == [None] * 3 + [700] + [None] * 3 + [300]


def test_a_clip_that_goes_on_elsewhere_says_so():
    pictures = frames()[:8]
    height, width = pictures[0].shape[:2]
    odometry = Odometry(Equirectangular(width, height))
    for picture in pictures[:6]:
        odometry.add_frame(picture)
    # The other way round, so that no point is where it would be followed to.
    result = odometry.add_frame(np.ascontiguousarray(pictures[6][::-1, ::-1]))
    assert result.follows_gap and "frames seem to be missing before it" in result.message
    assert not any(each.follows_gap for each in odometry.results()[:6])
