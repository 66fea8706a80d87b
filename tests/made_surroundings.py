# SPDX-License-Identifier: BSD-3-Clause
"""Made evidence on the pairs of a folder: what others know of their surroundings."""

from itertools import combinations

import numpy as np

from epi360.jobs.graph.place_check import judge_places
from epi360.jobs.graph.place_evidence import Evidence, Sightings
from epi360.jobs.graph.surface_evidence import OWN, VISIBLE, SurfaceSightings
from epi360.places.own_evidence import OwnEvidence
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose

NUM_CELLS = 20
NOBODY = np.empty(0, np.int64)


def shows(over_others=0.0, over_copies=0.0, *, as_in_homes=None, **details):
    """What a pair shows, by both sets of weights unless other ratios are given."""
    ratios = as_in_homes or (over_others, over_copies)
    return OwnEvidence(over_others, over_copies, as_in_homes=ratios, **details)


# What pairs of one room show by themselves.
ALL_GROWS, LITTLE_GROWS, NOTHING_GROWS = shows(5.0, 6.0), shows(1.0, 1.0), shows()


def posed(images, *, turn=None):
    """A pair of which only the images and the rotation matter."""
    pose = Pose(np.eye(3) if turn is None else turn, [0.0, 0.0, 1.0])
    return PosedPair(images, pose, (NOBODY,) * 2, (np.empty((0, 3)),) * 2, 0.1, 0.1, 0.1)


def judged(images, evidence):
    return judge_places([posed(pair) for pair in images], evidence).verdicts


def sightings(rng, witnesses, share, *, num=200, beyond=-0.1):
    """Points that some pairs know, of which a share is found; all are visible by default."""
    count = num if len(witnesses) else 0
    places = np.arange(count) % NUM_CELLS
    same = rng.random(NUM_CELLS) < share  # what lies together is one surface
    found = np.where(same[places], rng.random(count) < 0.97, rng.random(count) < 0.1)
    names = rng.choice(witnesses, count) if count else np.empty(0, np.int64)
    return Sightings(
        names.astype(np.int64),
        places,
        np.zeros(count, np.int64),
        found,
        np.array([OWN]),
        np.full((count, 1), beyond),
    )


def nothing():
    return sightings(np.random.default_rng(0), [], 1.0)


def no_surfaces():
    return surfaces_of([], 0.0)


def surfaces_of(witnesses, ratio, *, num=600, hidden=VISIBLE):
    """Cells that some pairs know, in so many parts of the view, all with one ratio."""
    count = num if len(witnesses) else 0
    return SurfaceSightings(
        np.resize(np.array([*witnesses, 0], np.int32)[: max(len(witnesses), 1)], count),
        np.arange(count).astype(np.int16),
        np.full(count, ratio, np.float32),
        np.array([OWN]),
        np.full((count, 1), hidden, np.int8),
    )


def evidence_on(pairs, shares, *, seed=0, one_sided=(), silent=(), **options):
    """All pairs that share an image witness for each other; right ones show it by themselves."""
    rng = np.random.default_rng(seed)
    found = []
    for row, (pair, share) in enumerate(zip(pairs, shares, strict=True)):
        sides = []
        for side in (0, 1):
            near = [k for k, other in enumerate(pairs) if k != row and pair[side] in other]
            is_silent = row in silent or (side == 1 and row in one_sided)
            sides.append(nothing() if is_silent else sightings(rng, near, share, **options))
        for made, offset in zip(sides, (0, 1000), strict=True):
            made.cells[:] += offset
        surfaces = (no_surfaces(), no_surfaces())
        own = ALL_GROWS if share > 0.9 and row not in silent else NOTHING_GROWS
        found.append(Evidence((sides[0], sides[1]), surfaces, own))
    return found


def pairs_of_twin_rooms():
    """Two rooms of four panoramas; all pairs, and which are within a room."""
    pairs = list(combinations(range(8), 2))
    return pairs, np.array([a // 4 == b // 4 for a, b in pairs])
