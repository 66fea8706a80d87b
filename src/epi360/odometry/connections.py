# SPDX-License-Identifier: BSD-3-Clause
"""Whether the newest key frames of a map show a place of another one."""

from __future__ import annotations

from collections.abc import Mapping

from epi360.odometry.map_parts import Connection
from epi360.odometry.segment import Segment

Ends = tuple[int, int]

_MOST_ASKED = 2  # maps for a key frame, in turn: each takes 10 to 50 ms
_REST = 2  # key frames after a map that does not show the place
# After one that seems to show it, while the pictures are not sure; as many more each time, for a
# corridor seems to show it all along.
_REST_IN_DOUBT, _LONGEST_REST = 2, 16


class Connections:
    """What is known of connections between the map that is tracked and others.

    Two of different key frames must agree before maps are joined.
    """

    def __init__(self) -> None:
        self._last: dict[Ends, Connection] = {}
        self._num_doubts: dict[Ends, int] = {}
        self._rest_until: dict[Ends, int] = {}
        self._asked: dict[int, int] = {}  # when another map was asked last
        self._num_key_frames = 0

    def find(
        self, active: int, segments: Mapping[int, Segment]
    ) -> tuple[int, tuple[Connection, Connection]] | None:
        """Look for the place of the newest key frame of a map in other ones.

        Returns the number of a map that shows it, with two connections that agree.
        """
        self._num_key_frames += 1
        now = self._num_key_frames
        others = [
            number
            for number in sorted(segments, key=lambda each: (self._asked.get(each, 0), each))
            if number != active and self._rest_until.get((active, number), 0) <= now
        ]
        for number in others[:_MOST_ASKED]:
            self._asked[number] = now
            found = segments[active].connection(segments[number])
            agreeing = self._told((active, number), found)
            if agreeing is not None:
                return number, agreeing
        return None

    def forget(self) -> None:
        """Forget all connections, as maps have been moved or joined."""
        self._last, self._num_doubts, self._rest_until = {}, {}, {}

    def _told(self, ends: Ends, found: Connection | None) -> tuple[Connection, Connection] | None:
        """Count what was found of two maps; two connections that agree, once there are such."""
        now = self._num_key_frames
        if found is None:
            self._rest_until[ends] = now + _REST
            return None
        if not found.is_sure:
            doubts = self._num_doubts[ends] = self._num_doubts.get(ends, 0) + 1
            self._rest_until[ends] = now + min(_REST_IN_DOUBT * doubts, _LONGEST_REST)
            return None
        self._num_doubts[ends] = 0
        before, self._last[ends] = self._last.get(ends), found
        return (before, found) if before is not None and found.agrees_with(before) else None
