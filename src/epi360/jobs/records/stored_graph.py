# SPDX-License-Identifier: BSD-3-Clause
"""Images and pairs of a match folder that take as little memory as on the disk.

What `MatchGraph` holds is made when it is asked for: 64-bit matches, poses and key points would
take six times as much.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from epi360.interop import MatchedImage, MatchedPair, TwoViewGeometry
from epi360.jobs.records.match_store import matches_of_part, poses_of_part
from epi360.runs.arrays import Arrays

Item = TypeVar("Item")
# What a part also has, such as its warnings, is longer than its matches.
_KEPT = ("status", "numbers", "ends", "matches", "inlier_mask")


class OnDemand(Sequence[Item]):
    """A sequence whose items are made of their rows each time."""

    def __init__(self, make: Callable[[int], Item], rows: Sequence[int]) -> None:
        self._make, self._rows = make, rows

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> OnDemand[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | OnDemand[Item]:
        if isinstance(index, slice):
            return OnDemand(self._make, self._rows[index])
        return self._make(self._rows[index])


@dataclass(eq=False)
class StoredPairs:
    """Pairs in the arrays of their parts."""

    _parts: list[Arrays] = field(default_factory=list)
    _names: list[tuple[str, str]] = field(default_factory=list)
    _places: list[tuple[int, int]] = field(default_factory=list)  # part and row
    _by_others: list[str] = field(default_factory=list)  # status

    def add_part(self, arrays: Arrays) -> int:
        """Keep what is needed of a part, and return its number."""
        self._parts.append({name: arrays[name] for name in _KEPT})
        return len(self._parts) - 1

    def add(self, names: tuple[str, str], place: tuple[int, int], by_others: str = "") -> None:
        """Append the pair of these images: a row of a part.

        ``by_others`` is the status that other pairs give it, "" where it keeps its own. If they say
        "ok", they believe the doubted pose.
        """
        self._names.append(names)
        self._places.append(place)
        self._by_others.append(by_others)

    def pairs(self) -> OnDemand[MatchedPair]:
        """All pairs, in the order in which they came."""
        return OnDemand(self._pair, range(len(self._names)))

    def _pair(self, index: int) -> MatchedPair:
        number, row = self._places[index]
        arrays = self._parts[number]
        matches, inlier_mask = matches_of_part(arrays, row)
        pose, doubted = poses_of_part(arrays, row)
        status = self._by_others[index] or str(arrays["status"][row])
        if self._by_others[index] == "ok":
            pose = doubted
        geometry = TwoViewGeometry(status, pose, matches[inlier_mask])
        return MatchedPair(*self._names[index], matches, geometry)


@dataclass(eq=False)
class StoredImages(Mapping[str, MatchedImage]):
    """Images by name, in the order in which they came."""

    _images: dict[str, tuple[str, str | None, NDArray[np.float32]]] = field(default_factory=dict)

    def add(self, name: str, camera: str, frame: str | None, pixels: NDArray[np.float32]) -> None:
        """Append an image with its key points (N, 2)."""
        self._images[name] = camera, frame, pixels

    def __getitem__(self, name: str) -> MatchedImage:
        camera, frame, pixels = self._images[name]
        return MatchedImage(name, camera, pixels.astype(float), frame=frame)

    def __iter__(self) -> Iterator[str]:
        return iter(self._images)

    def __len__(self) -> int:
        return len(self._images)
