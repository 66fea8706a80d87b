# SPDX-License-Identifier: BSD-3-Clause
"""Corridors with equal doors: what tells them, and what a pose there must show."""

from dataclasses import replace

import numpy as np
import pytest

from epi360.features.shared_surfaces import NUM_CELLS, SharedSurfaces, grid
from epi360.places import corridor
from epi360.places.corridor import (
    is_long_and_narrow,
    repeats_itself,
    show_a_floor,
    shown_by_itself,
)
from epi360.places.own_evidence import OwnEvidence
from epi360.places.same_place import EQUAL_DOORS, doubts, limited_in_folder, same_place
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose

NO_PICTURES = (None, None)


def view_in_a_box(half_width, half_length, heading=0.0, shown=NUM_CELLS):
    """What a camera in the middle of a room sees of its walls; what is nearest is bare."""
    directions = grid().directions.astype(np.float64)
    c, s = np.cos(heading), np.sin(heading)
    across, along = (directions[:, [0, 2]] @ np.array([[c, -s], [s, c]])).T
    with np.errstate(divide="ignore"):
        depths = np.minimum(half_width / np.abs(across), half_length / np.abs(along))
    is_wall = (np.abs(depths * directions[:, 1]) < 1.2) & (depths > 1.5)
    is_wall[shown:] = False
    none = np.zeros(NUM_CELLS, np.float32)
    return SharedSurfaces(
        contrasts=none + 10,
        depths=np.where(is_wall, depths, 0).astype(np.float32),
        likeness=none,
        normals=np.zeros((NUM_CELLS, 3), np.float32),
        expected_depths=none,
        expected_likeness=none,
        counts=np.ones(NUM_CELLS, dtype=bool),
    )


ROOM, CORRIDOR = view_in_a_box(2.5, 3.0), view_in_a_box(1.0, 14.0)
STREET = view_in_a_box(6.0, 60.0)


@pytest.mark.parametrize(
    ("view", "is_corridor"),
    [
        (CORRIDOR, True),
        (view_in_a_box(1.0, 14.0, heading=0.4), True),
        (view_in_a_box(1.0, 14.0, heading=2.5), True),
        (replace(CORRIDOR, depths=7 * CORRIDOR.depths), True),  # in other units
        (ROOM, False),
        (view_in_a_box(1.0, 14.0, shown=20), False),  # too few cells
        (STREET, False),
    ],
)
def test_a_corridor_is_long_and_narrow(view, is_corridor):
    assert is_long_and_narrow(view) == is_corridor


@pytest.mark.parametrize(
    ("views", "shares", "repeats"),
    [
        ((CORRIDOR, CORRIDOR), (0.3, 0.1), True),
        ((CORRIDOR, CORRIDOR), (0.1, 0.3), True),
        ((CORRIDOR, CORRIDOR), (0.1, 0.1), False),  # a corridor of a home
        ((ROOM, CORRIDOR), (0.3, 0.3), False),  # through a door
        ((ROOM, ROOM), (0.3, 0.3), False),
    ],
)
def test_a_long_place_that_looks_like_itself_repeats(monkeypatch, views, shares, repeats):
    shown = dict(enumerate(shares))
    monkeypatch.setattr(corridor, "share_like_itself", shown.get)
    assert repeats_itself(views, (0, 1)) == repeats


def test_pictures_of_rooms_are_not_searched(monkeypatch):
    monkeypatch.setattr(corridor, "share_like_itself", None)
    assert not repeats_itself((ROOM, CORRIDOR), NO_PICTURES)


# The median numbers of right poses and of wrong ones in corridors, of `corridor_evidence.py`.
RIGHT = np.array([-1.34, 5.63, 6.73, -1.80, -3.11, -4.20, -3.73])
WRONG = np.array([-1.33, 3.00, 6.85, -1.83, -3.17, -4.09, -3.44])


def among_doors(odds):
    return OwnEvidence(8.0, 8.0).among_equal_doors(odds)


def test_doors_that_are_seen_from_one_direction_may_be_others():
    """Cells that both views show from very different directions speak for a pose, holes do not."""
    assert corridor._FITTED.of(RIGHT) > 1.5 and corridor._FITTED.of(WRONG) < -1.5
    odds = []
    for turned in np.linspace(2.0, 8.0, 20):
        odds.append(corridor._FITTED.of(np.array([*RIGHT[:1], turned, *RIGHT[2:]])))
    assert (np.diff(odds) >= 0).all() and odds[0] < 0 < odds[-1]
    more_differs = RIGHT + [0, 0, 0, 0, 0, 0, 1.0]
    assert corridor._FITTED.of(more_differs) < corridor._FITTED.of(RIGHT) - 1.0


def test_nothing_is_known_beyond_the_limits():
    fitted = corridor._FITTED
    assert fitted.of(fitted.most + 5.0) == fitted.of(fitted.most)
    assert fitted.of(fitted.least - 5.0) == fitted.of(fitted.least)


def test_what_would_do_in_a_room_is_not_enough_among_equal_doors():
    in_a_room = OwnEvidence(8.0, 8.0)
    assert same_place(in_a_room).here > 0.99
    assert same_place(among_doors(0.0)).here == pytest.approx(0.5, abs=0.01)
    assert same_place(among_doors(1.0)).here < 0.75
    assert same_place(among_doors(3.0)).here > 0.94


def test_more_evidence_is_never_worth_less():
    told = [same_place(among_doors(odds)).here for odds in np.linspace(-10, 15, 50)]
    assert (np.diff(told) >= 0).all()


def test_a_corridor_is_not_the_open():
    long = OwnEvidence(8.0, 8.0, in_the_open=True)
    assert not long.among_equal_doors(2.0).in_the_open
    in_folder = limited_in_folder(among_doors(-4.0), folder_in_the_open=True)
    assert -1 < in_folder.over_copies < 0


def test_weights_of_homes_do_not_undo_it():
    own = among_doors(8.0)
    assert own.weighed_as_in_homes() == own


def test_a_doubt_says_that_the_place_repeats():
    own = among_doors(2.0)
    place = same_place(own)
    assert doubts(own, place) == (EQUAL_DOORS,)
    sure = among_doors(9.0)
    assert doubts(sure, same_place(sure)) == ()


def with_a_floor(view, num_cells, normal=(0.0, 1.0, 0.0)):
    """The same view, which also shows so many cells right below it; of its walls four hundred."""
    order = np.argsort(-grid().directions[:, 1], kind="stable")
    kept = np.zeros(NUM_CELLS, dtype=bool)
    kept[np.flatnonzero(view.found)[:400]] = True
    depths = np.where(kept, view.depths, 0).astype(np.float32)
    normals = np.tile(np.float32([1.0, 0.0, 0.0]), (NUM_CELLS, 1))
    below = order[:num_cells]
    depths[below], normals[below] = 1.5 / grid().directions[below, 1], normal
    return replace(view, depths=depths, normals=normals)


@pytest.mark.parametrize(
    ("floors", "knows"),
    [
        ((100, 100), True),
        ((0, 0), False),
        ((100, 0), False),
        ((70, 100), False),
        ((1000, 1000), True),
    ],
)
def test_a_floor_counts_that_both_views_show(floors, knows):
    views = [with_a_floor(CORRIDOR, num_cells) for num_cells in floors]
    assert show_a_floor(views) == knows


def test_a_skirting_is_no_floor():
    assert not show_a_floor([with_a_floor(CORRIDOR, 200, (0.0, 0.6, 0.8))] * 2)


def test_what_is_at_no_one_depth_is_no_floor():
    """Doors that lie upon others give points below the horizon, far away and at any distance."""
    view = with_a_floor(CORRIDOR, 300)
    is_floor = view.normals[:, 1] == 1.0
    factors = np.where(is_floor, np.resize([0.8, 1.0, 1.3, 1.7], NUM_CELLS), 1.0)
    assert not show_a_floor([replace(view, depths=np.float32(factors * view.depths))] * 2)


def pair_over_a_floor(depth):
    """A pair along a corridor whose points below the horizon are at so many times its floor."""
    pose = Pose(np.eye(3), np.array([0.0, 0.0, -1.0]))
    angles = np.linspace(0.3, 2.8, 40)
    points = np.column_stack([0.8 * np.cos(angles), np.full(40, 1.5), 0.5 + np.sin(angles)])
    points *= depth
    bearings = [points, points + pose.translation]
    bearings = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in bearings]
    return PosedPair.of((0, 1), pose, np.tile(np.arange(40)[:, None], 2), bearings)


@pytest.mark.parametrize(
    ("num_cells", "depth", "expected"),
    [
        (0, 1.0, among_doors(corridor._FITTED.of(WRONG))),
        (300, 1.0, OwnEvidence(8.0, 8.0)),  # as elsewhere
        (300, 0.6, OwnEvidence(8.0, 8.0)),  # things that stand on the floor
        (300, 2.0, among_doors(-np.inf)),  # the matches cannot be right
    ],
)
def test_with_a_floor_a_pair_is_weighed_by_it(monkeypatch, num_cells, depth, expected):
    monkeypatch.setattr(corridor, "repeats_itself", lambda *_: True)
    monkeypatch.setattr(corridor.OwnEvidence, "of", lambda *_: OwnEvidence(8.0, 8.0))
    monkeypatch.setattr(corridor, "shown_by", lambda *_: WRONG)
    views = (with_a_floor(CORRIDOR, num_cells),) * 2
    own = shown_by_itself(pair_over_a_floor(depth), views, NO_PICTURES)
    assert own == expected
    assert (same_place(own).here < 0.5) == (expected.over_copies < 0)


def test_a_place_that_is_known_to_repeat_is_weighed_so(monkeypatch):
    monkeypatch.setattr(corridor, "repeats_itself", lambda *_: False)
    monkeypatch.setattr(corridor.OwnEvidence, "of", lambda *_: OwnEvidence(8.0, 8.0))
    monkeypatch.setattr(corridor, "shown_by", lambda *_: WRONG)
    views = (with_a_floor(CORRIDOR, 0),) * 2
    assert shown_by_itself(None, views, NO_PICTURES) == OwnEvidence(8.0, 8.0)
    known = shown_by_itself(None, views, NO_PICTURES, is_corridor=True)
    assert known == among_doors(corridor._FITTED.of(WRONG))
