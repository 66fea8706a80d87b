# SPDX-License-Identifier: BSD-3-Clause
"""Frames before which some are missing: far fewer points are followed to them than to others."""

from __future__ import annotations

from collections import deque

import numpy as np

# Of the usual number of points, past a gap over which points alone do not say where the camera is.
# In rendered corridors, frames that were placed at another door have 0.39 and less, but for one
# with 0.65; past right steps of 0.4 m it is 0.55 and more.
FAR_SHARE = 0.5
# From frame to frame, also of every fourth of four real clips, 0.97 of the usual number and more;
# of clips of a lens that follows 130 points, 0.77. Past gaps in rendered corridors, and from one
# room into its twin, up to 0.60, but 0.86 where a door comes to lie just where the last one was.
_LEAST_SHARE = 0.65
_FEWEST, _USUAL = 3, 10  # frames that say what is usual
_FEWEST_POINTS = 100  # fewer are followed between pictures that are no frames of one clip


class Gaps:
    """Watches how many points are followed from frame to frame."""

    def __init__(self) -> None:
        self._followed: deque[int] = deque(maxlen=_USUAL)

    def usual_before(self, num_tracked: int) -> int | None:
        """How many points are followed as a rule, if this is far less than that; else None.

        What is usual is found out anew after a gap.
        """
        usual = int(np.median(self._followed)) if len(self._followed) >= _FEWEST else 0
        if usual < _FEWEST_POINTS or num_tracked >= _LEAST_SHARE * usual:
            self._followed.append(num_tracked)
            return None
        self._followed.clear()
        return usual
