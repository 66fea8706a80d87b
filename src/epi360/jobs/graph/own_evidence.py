# SPDX-License-Identifier: BSD-3-Clause
"""What a pair shows by itself: how much of both views grows together, and what differs in it.

Of a right pair most of both views grows (`features.shared_surfaces`); of another place with the
same door little does, and what grows has holes: cells that must be there, by those around them, and
look different. A copy of the room grows as much, and has holes where its owners put other things.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.features.shared_surfaces import LEAST_CONTRAST, SeenCells, SharedSurfaces, grid
from epi360.jobs.graph.shared_points import PosedPair

Array = NDArray[np.float64]

# What a pair shows by itself: logarithms of the larger number of cells found in either view, and of
# the share of cells that differ where they are expected, up to 45 and up to 20 degrees of view
# change. Mean and covariance over right pairs of one room (183), right pairs through a door (97),
# pairs of copies of a room (127) and of different rooms (414) of four rendered homes. Each variance
# is larger by 0.01, for other homes are different.
_OF_ROOMS = (
    np.array([7.68, -2.66, -3.28]),
    np.array([[0.117, -0.100, -0.161], [-0.100, 0.181, 0.233], [-0.161, 0.233, 0.474]]),
)
_OF_DOORS = (
    np.array([6.74, -1.94, -2.00]),
    np.array([[0.155, -0.074, -0.107], [-0.074, 0.138, 0.112], [-0.107, 0.112, 0.254]]),
)
_OF_COPIES = (
    np.array([7.38, -1.92, -2.00]),
    np.array([[0.129, -0.043, -0.033], [-0.043, 0.048, 0.038], [-0.033, 0.038, 0.098]]),
)
_OF_OTHERS = (
    np.array([6.03, -1.56, -1.61]),
    np.array([[0.359, -0.049, -0.013], [-0.049, 0.069, 0.046], [-0.013, 0.046, 0.111]]),
)
_SHARE_OF_ROOMS = 0.65  # of the right pairs
# Beyond what pairs of these homes show, densities of unlike width say the opposite.
_LEAST_SHOWN, _MOST_SHOWN = np.log([320.0, 0.01, 0.01]), np.log([5000.0, 0.3, 0.3])
# Photographed tours grow less than rendered ones, and are right: this speaks for a pair only.
_MOST_OVER_OTHERS, _MOST_OVER_COPIES = 8.0, 5.0
_DIFFERS, _CLEARLY_HIDDEN = 0.5, 0.8
_LARGEST_CHANGES_DEG = (45.0, 20.0)
_NUM_NEAR = 7  # cells that say how far the other camera sees in a direction


@dataclass(frozen=True)
class OwnEvidence:
    """Log-likelihood ratios of a pose by what the pair shows by itself.

    Over that of another place with a similar thing, and over that of a copy of the place.
    """

    over_others: float = 0.0
    over_copies: float = 0.0

    @classmethod
    def of(cls, pair: PosedPair, views: tuple[SharedSurfaces, SharedSurfaces]) -> OwnEvidence:
        """Weigh how much of both views grows, and how little of it differs."""
        expected = [_expected(pair, side, views) for side in (0, 1)]
        differs, changes_deg = (np.concatenate(each) for each in zip(*expected, strict=True))
        shares = [
            (np.count_nonzero(differs & kept) + 3) / (np.count_nonzero(kept) + 30)
            for kept in (changes_deg < largest_deg for largest_deg in _LARGEST_CHANGES_DEG)
        ]
        most = max(int(np.count_nonzero(view.found)) for view in views)
        shown = np.clip(np.log([most + 20, *shares]), _LEAST_SHOWN, _MOST_SHOWN)
        right = np.logaddexp(
            np.log(_SHARE_OF_ROOMS) + _log_density(shown, *_OF_ROOMS),
            np.log(1 - _SHARE_OF_ROOMS) + _log_density(shown, *_OF_DOORS),
        )
        over_others = right - _log_density(shown, *_OF_OTHERS)
        over_copies = right - _log_density(shown, *_OF_COPIES)
        return cls(
            float(np.clip(over_others, 0.0, _MOST_OVER_OTHERS)),
            float(np.clip(over_copies, 0.0, _MOST_OVER_COPIES)),
        )


def _log_density(values: Array, mean: Array, covariance: Array) -> float:
    """Logarithm of a normal density, but for a constant that all have in common."""
    centred = values - mean
    return float(
        -(centred @ np.linalg.solve(covariance, centred) + np.linalg.slogdet(covariance)[1]) / 2
    )


def _expected(
    pair: PosedPair, side: int, views: Sequence[SharedSurfaces]
) -> tuple[NDArray[np.bool_], Array]:
    """Whether cells differ, where those around say what must be seen there, and view changes."""
    here, there = views[side], views[1 - side]
    (cells,) = np.nonzero((here.expected_depths > 0) & (here.contrasts >= LEAST_CONTRAST))
    seen = SeenCells.of(pair.other_from(side), cells, here.expected_depths[cells])
    near = grid().nearest(seen.directions, _NUM_NEAR)
    nearest = np.where(there.found[near], there.depths[near], np.inf).min(axis=1)
    kept = nearest >= _CLEARLY_HIDDEN * seen.ranges
    return here.expected_likeness[cells[kept]] < _DIFFERS, seen.changes_deg[kept]
