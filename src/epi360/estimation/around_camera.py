# SPDX-License-Identifier: BSD-3-Clause
"""Whether matches lie around the camera: what passes by, clouds and water lie on one side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OUTSIDE_HEMISPHERE = 0.1  # least share outside any hemisphere; one always holds four of five
MOST_AROUND = 64  # that are looked at
LEAST_SPREAD = 0.08  # mean square of the sines of their angles to any plane through the camera


def are_all_around(views: Sequence[Array], chosen: Mask) -> bool:
    """Whether chosen matches, unit bearings (N, 3) in both views, fit into no hemisphere."""
    rows = np.flatnonzero(chosen)
    count = min(len(rows), MOST_AROUND)
    some = rows[np.arange(count) * len(rows) // max(count, 1)]
    return min(share_outside_hemisphere(view[some]) for view in views) >= OUTSIDE_HEMISPHERE


def surround(views: Sequence[Array], chosen: Mask) -> bool:
    """Whether chosen matches also lie near to no plane through the camera, as the horizon is."""
    moments = [view[chosen].T @ view[chosen] / max(chosen.sum(), 1) for view in views]
    spread = min(np.linalg.eigvalsh(each)[0] for each in moments)
    return bool(spread > LEAST_SPREAD) and are_all_around(views, chosen)


def share_outside_hemisphere(bearings: Array) -> float:
    """Share of bearings (N, 3) outside the hemisphere that holds most, its edge included."""
    if len(bearings) < 2:
        return 0.0
    first, second = np.triu_indices(len(bearings), k=1)
    heights = np.cross(bearings[first], bearings[second]) @ bearings.T
    edge = np.arange(len(first))
    heights[edge, first] = heights[edge, second] = 0.0  # through these two it goes
    most = 2 + max((heights > 0.0).sum(axis=1).max(), (heights < 0.0).sum(axis=1).max())
    return 1.0 - float(most) / len(bearings)
