# SPDX-License-Identifier: BSD-3-Clause
"""Time stamps of frames, which always grow."""

from __future__ import annotations

from collections import deque

import numpy as np


class FrameClock:
    """Makes the time stamps of a sequence: those that are given, as long as they grow."""

    def __init__(self) -> None:
        self._count = 0
        self._has_stamps = False
        self._last: deque[float] = deque(maxlen=100)

    def stamp(self, given_s: float | None) -> tuple[float, str]:
        """Time stamp of the next frame in seconds, and a sentence if it is not the given one.

        The number of the frame if the first frame has none.
        """
        index, self._count = self._count, self._count + 1
        if index == 0:
            self._has_stamps = given_s is not None
        stamp, said = float(index) if given_s is None else float(given_s), ""
        if given_s is None and self._has_stamps:
            stamp = float("nan")
        if not self._last and not np.isfinite(stamp):
            stamp = 0.0
        elif self._last and not stamp > self._last[-1] or not np.isfinite(stamp):
            stamp, said = self._repaired(stamp)
        self._last.append(stamp)
        return stamp, said

    def _repaired(self, stamp: float) -> tuple[float, str]:
        """Stamp at the usual distance from the last one."""
        last = self._last[-1]
        step = float(np.median(np.diff(self._last))) if len(self._last) > 1 else 1.0
        wrong = f"its time stamp {stamp:g} s is not after {last:g} s"
        if not np.isfinite(stamp):
            wrong = "it has no time stamp"
        return last + step, f"{wrong}, so {last + step:g} s is taken"
