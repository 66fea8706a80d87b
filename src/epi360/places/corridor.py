# SPDX-License-Identifier: BSD-3-Clause
"""Whether a pair shows a corridor whose things repeat, so that the next door looks like this one.

A pose that puts one door upon the next looks right around all doors, and is nearly as probable as
the right one. Two things tell such a place: what both views show is much longer than wide, and
much of a panorama matches other parts of the same panorama. But a floor that has a texture and
looks the same in both views tells one door from the next.

There, right poses are told from others by logistic regression on the seven numbers of
`own_evidence.shown_by`. `benchmarks/corridor_evidence.py` fits it to rendered corridors, and writes
``corridor_evidence.json``. Most is told by how many cells both views show from directions that are
more than 45 degrees apart: doors that are taken for others are seen from nearly one direction.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from epi360.features.self_likeness import share_like_itself
from epi360.features.shared_surfaces import SharedSurfaces, grid
from epi360.features.warped_patches import Panorama
from epi360.places.own_evidence import OwnEvidence, Scaling, shown_by
from epi360.places.shared_points import PosedPair, cloud_of

Array = NDArray[np.float64]

ODDS = "corridor_evidence.json"  # beside this file
# Of right pairs of `zind_tour`, and of photographed home 304, none is beyond all three.
_LONG, _WIDE, _LIKE_ITSELF = 2.0, 2.0, 0.22
_MOST = (5, 95)  # percentiles of what was found
_FEWEST_CELLS = 30
# Of cells 15 degrees below the horizon, whose normals are within 37 degrees of upright: their least
# number, and share of all. Wrong poses have 75 and 0.07 at most, right ones on plain floors, too.
_BELOW, _LEVEL = np.sin(np.radians(15.0)), 0.8
_FEWEST_ON_FLOOR, _LEAST_ON_FLOOR = 80, 0.1
# Of these cells, so many must lie on one plane but for a tenth of its distance: in a room with
# tables 0.43 do, of corridors nearly all. Skirtings, and doors that lie upon others, are at no
# distance.
_FLAT, _LEAST_ON_PLANE, _NUM_FITS = 0.1, 1.0 / 3.0, 5
# Of what lies 5 degrees below the horizon and lower, the share that is so much deeper than the
# floor. Of 463 pairs of rendered corridors with a floor, of whose matches 70 % and more are right,
# none has 0.3; of six with less than half of them right, four.
_BELOW_HORIZON, _DEEPER, _MOST_BELOW, _FEWEST_LOW = np.sin(np.radians(5.0)), 1.3, 0.3, 8
_AXES_RAD = np.radians(np.arange(0.0, 180.0, 10.0))
_ACROSS = np.stack([np.cos(_AXES_RAD), np.sin(_AXES_RAD)])  # (2, 18)


@dataclass(frozen=True, eq=False)
class Odds(Scaling):
    """How much the seven numbers speak for a pose in a corridor.

    ``odds`` (8,) are the log-odds of a pose whose numbers are ``centre`` (7,), and what a
    ``spread`` (7,) more of each adds.
    """

    odds: Array

    def of(self, shown: Array) -> float:
        """Log-odds of a pose that shows these numbers (7,)."""
        return float(self.odds[0] + self.scaled(shown) @ self.odds[1:])


_FITTED = Odds.of_record(json.loads(files(__package__).joinpath(ODDS).read_text("utf-8")))


def shown_by_itself(
    pair: PosedPair,
    views: tuple[SharedSurfaces, SharedSurfaces],
    panoramas: Sequence[Panorama],
    *,
    is_corridor: bool = False,
) -> OwnEvidence:
    """Weigh what has grown from both sides of a pair, in a corridor as it must be weighed there.

    ``is_corridor`` says that it is one, whatever these two views show of it.
    """
    own = OwnEvidence.of(pair, views)
    if not own.is_known or not (is_corridor or repeats_itself(views, panoramas)):
        return own
    floors = [plane for view in views if (plane := _floor_of(view)) is not None]
    if len(floors) < len(views):
        return own.among_equal_doors(_FITTED.of(shown_by(pair, views)))
    lies_below = max(_share_below_floor(pair, side, floor) for side, floor in enumerate(floors))
    return own.among_equal_doors(-np.inf) if lies_below > _MOST_BELOW else own


def show_a_floor(views: Sequence[SharedSurfaces]) -> bool:
    """Whether much of what was found in both views is one flat floor, which has no doors."""
    return all(_floor_of(view) is not None for view in views)


def _floor_of(view: SharedSurfaces) -> Array | None:
    """Plane (3,) of the floor, points x of which have plane @ x = 1; None if little shows one.

    What else is level may be tables. The camera may be tilted.
    """
    is_below = grid().directions[:, 1] > _BELOW
    cells = view.found & is_below & (np.abs(view.normals[:, 1]) > _LEVEL)
    least = max(_FEWEST_ON_FLOOR, _LEAST_ON_FLOOR * np.count_nonzero(view.found))
    if np.count_nonzero(cells) < least:
        return None
    points = view.depths[cells, None] * grid().directions[cells].astype(np.float64)
    plane = np.array([0.0, 1.0 / np.median(points[:, 1]), 0.0])
    for _ in range(_NUM_FITS):  # what lies elsewhere, and so far off, counts less and less
        off = np.abs(points @ plane - 1.0)
        weights = 1.0 / (1.0 + np.square(off / max(_FLAT, float(np.median(off)))))
        plane = np.linalg.lstsq(weights[:, None] * points, weights, rcond=None)[0]
    is_near = np.abs(points @ plane - 1.0) < _FLAT
    return None if np.mean(is_near) < _LEAST_ON_PLANE else np.asarray(plane, np.float64)


def _share_below_floor(pair: PosedPair, side: int, plane: Array) -> float:
    """Share of the inliers below the horizon whose points lie below the floor, a plane (3,).

    The pose may be right and its matches wrong: those of doors that lie on one epipolar curve put
    them far behind walls and floor.
    """
    points = cloud_of(pair, side, 0.0).points
    depths = points @ plane  # 1 on the floor, 0 at the height of the camera
    distances = np.linalg.norm(plane) * np.linalg.norm(points, axis=1)
    low = depths > _BELOW_HORIZON * distances
    if np.count_nonzero(low) < _FEWEST_LOW:
        return 0.0
    return float(np.mean(depths[low] > _DEEPER))


def repeats_itself(views: Sequence[SharedSurfaces], panoramas: Sequence[Panorama]) -> bool:
    """Whether both panoramas show a corridor, and either looks like other parts of itself."""
    if not all(map(is_long_and_narrow, views)):
        return False
    return max(map(share_like_itself, panoramas)) > _LIKE_ITSELF


def is_long_and_narrow(view: SharedSurfaces) -> bool:
    """Whether what was found is longer than wide, and not much wider than high, as no street is."""
    if np.count_nonzero(view.found) < _FEWEST_CELLS:
        return False
    points = view.depths[view.found, None] * grid().directions[view.found]
    height = float(np.ptp(np.percentile(points[:, 1], _MOST)))
    spans = np.ptp(np.percentile(points[:, [0, 2]] @ _ACROSS, _MOST, axis=0), axis=0)
    across = np.maximum(np.roll(spans, len(_AXES_RAD) // 2), 1e-9)  # a quarter turn on
    longest = int(np.argmax(spans / across))
    length, width = float(spans[longest]), float(across[longest])
    return length > _LONG * width and width < _WIDE * height
