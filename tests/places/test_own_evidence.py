# SPDX-License-Identifier: BSD-3-Clause
"""What a pair shows by itself: hand-made surfaces, and how what they show is weighed."""

import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from epi360.features.shared_surfaces import NUM_CELLS, SharedSurfaces, grid
from epi360.places import own_evidence
from epi360.places.own_evidence import (
    EVERY,
    HOMES,
    SHOWN,
    WEIGHTS,
    OwnEvidence,
    Weights,
    shown_by,
    terms,
)
from epi360.places.same_place import limited_in_folder, same_place
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose

RECORD = json.loads(files(own_evidence.__package__).joinpath(WEIGHTS).read_text("utf-8"))
FITTED, FITTED_TO_HOMES = (Weights.of_record(RECORD[kind]) for kind in (EVERY, HOMES))
REAL = np.array([-1.36, 5.89, 6.84, -2.15, -1.56, -2.59, -1.74])  # medians of public tours
# Means of thousands of pairs of rendered homes.
ONE_ROOM = np.array([-2.14, 5.74, 7.34, -2.04, -2.74, -4.04, -2.72])
DOOR = np.array([-1.53, 6.26, 6.46, -1.98, -1.95, -3.19, -2.07])
COPY = np.array([-1.48, 4.60, 6.81, -2.38, -1.50, -2.67, -1.92])
OTHER = np.array([-0.97, 3.82, 5.69, -2.01, -1.51, -2.75, -1.67])
NOBODY = np.zeros(0, dtype=np.int64)
PAIR = PosedPair(
    (0, 1),
    Pose(np.eye(3), np.array([1.0, 0.0, 0.0])),
    (NOBODY, NOBODY),
    (np.zeros((0, 3)), np.zeros((0, 3))),
    0.1,
    0.1,
    0.1,
)


def seen_along(bearings1, bearings2):
    rows = np.arange(len(bearings1))
    return replace(PAIR, bearings=(bearings1, bearings2), keypoints=(rows, rows))


def views_of(is_found, differs=None, contrasts=10.0, depth=6.0):
    """Both views show a sphere of that radius in some cells; all of them must be there."""
    found = np.asarray(is_found)
    differs = np.zeros(NUM_CELLS, dtype=bool) if differs is None else differs
    view = SharedSurfaces(
        contrasts=np.full(NUM_CELLS, contrasts, np.float32),
        depths=np.where(found & ~differs, depth, 0).astype(np.float32),
        likeness=np.where(found & ~differs, 0.9, -1).astype(np.float32),
        normals=np.zeros((NUM_CELLS, 3), np.float32),
        expected_depths=np.where(found, depth, 0).astype(np.float32),
        expected_likeness=np.where(differs, 0.1, 0.9).astype(np.float32),
        counts=np.ones(NUM_CELLS, dtype=bool),
    )
    return view, view


def shown(*args, **values):
    return dict(zip(SHOWN, np.exp(shown_by(PAIR, views_of(*args, **values))), strict=True))


CAP = grid().directions[:, 1] > 0.3
HIGH = grid().directions[:, 1] < -0.8
DOWN, UP = np.array([0.0, 0.8, 0.6]), np.array([0.0, -0.6, 0.8])


def test_a_whole_surface_has_few_edges_and_a_frayed_one_many():
    whole = shown(CAP)["edges"]
    frayed = shown(CAP & (np.random.default_rng(0).uniform(size=NUM_CELLS) < 0.15))["edges"]
    assert whole < 0.12
    assert frayed > 3 * whole


def test_cells_of_another_depth_are_an_edge():
    step = views_of(CAP)[0]
    near = grid().directions[:, 0] > 0.0
    depths = np.where(near, 0.5, 1.0).astype(np.float32)
    step = replace(step, depths=step.depths * depths, expected_depths=step.expected_depths * depths)
    edges = np.exp(shown_by(PAIR, (step, step)))[SHOWN.index("edges")]
    assert edges > 1.2 * shown(CAP)["edges"]


def test_holes_count_as_what_differs():
    holes = CAP & (np.random.default_rng(1).uniform(size=NUM_CELLS) < 0.2)
    same, differing = shown(CAP), shown(CAP, holes)
    for name in ("inside", "textured"):
        assert same[name] < 0.01
        assert 0.1 < differing[name] < 0.3
    assert shown(CAP, holes, contrasts=6.0)["faint"] > 10 * shown(CAP, contrasts=6.0)["faint"]


def test_numbers_are_those_of_both_views():
    seen = shown(CAP, contrasts=20.0)
    assert seen["strong"] == pytest.approx(2 * CAP.sum() + 20)
    assert seen["turned"] == pytest.approx(20)  # of six baselines, no ray turns by 45 degrees
    assert shown(CAP, contrasts=20.0, depth=1.2)["turned"] > 500
    assert shown(CAP)["strong"] == pytest.approx(20)


def test_bare_cells_of_the_other_view_are_told_from_textured_ones():
    first = views_of(CAP)[0]
    bare = replace(first, contrasts=np.zeros(NUM_CELLS, np.float32))
    shares = np.exp(shown_by(PAIR, (first, bare)))
    assert shares[SHOWN.index("bare")] > 0.95
    assert shown(CAP)["bare"] < 0.01


@pytest.mark.parametrize(
    ("share", "is_known", "is_partial"),
    [
        (1.0, True, False),
        (0.6, True, False),
        (0.5, True, True),
        (0.2, True, True),
        (0.1, False, True),
    ],
)
def test_a_pair_knows_how_much_of_the_sphere_it_sees(share, is_known, is_partial):
    whole, part = views_of(CAP)
    part = replace(part, counts=np.arange(NUM_CELLS) < share * NUM_CELLS)
    for views in ((whole, part), (part, whole)):
        own = OwnEvidence.of(PAIR, views)
        assert (own.is_known, own.is_partial) == (is_known, is_partial)


def test_what_is_clearly_behind_something_is_not_expected():
    near = views_of(CAP, depth=2.0)[0]
    far = replace(near, expected_depths=3 * near.expected_depths)
    assert np.exp(shown_by(PAIR, (far, near)))[SHOWN.index("strong")] == pytest.approx(20)


def test_what_lies_at_very_different_distances_is_in_the_open():
    near = views_of(CAP)[0]
    shares = np.random.default_rng(0).uniform(size=NUM_CELLS)
    for factor, is_open in ((1.0, False), (5.0, False), (10.0, True)):
        depths = near.depths * np.where(shares < 0.5, 1.0, factor).astype(np.float32)
        view = replace(near, depths=depths)
        assert OwnEvidence.of(PAIR, (view, view)).in_the_open == is_open
        assert not OwnEvidence.of(PAIR, (view, near)).in_the_open


def test_where_nothing_grows_nothing_speaks_for_the_pair():
    assert OwnEvidence.of(PAIR, views_of(np.zeros(NUM_CELLS, dtype=bool))).over_others < 0.0


def test_a_pair_on_the_floor_alone_has_nothing_to_say_in_a_folder():
    shown_there = views_of(CAP | HIGH, contrasts=20.0)
    for num_above, is_heard in ((0, False), (2, False), (4, True)):
        bearings = np.array([DOWN] * (100 - num_above) + [UP] * num_above)
        own = OwnEvidence.of(seen_along(bearings, bearings), shown_there)
        assert own.inliers_on_floor != is_heard
        assert (limited_in_folder(own) != OwnEvidence()) == is_heard
    higher = np.array([UP] * 50 + [DOWN] * 50)  # both images must see it below
    own = OwnEvidence.of(seen_along(bearings, higher), shown_there)
    assert limited_in_folder(own) != OwnEvidence()


def test_where_the_floor_alone_grows_it_says_nothing_of_the_place():
    """Two rooms with one floor: their walls show other things, or nothing."""
    mostly_down = np.array([DOWN] * 90 + [UP] * 10)
    pair = seen_along(mostly_down, mostly_down)
    (view, _) = views_of(CAP, contrasts=20.0)
    own = OwnEvidence.of(pair, (view, view))
    assert own.grown_on_floor and not own.inliers_on_floor
    assert limited_in_folder(own) == OwnEvidence()
    assert same_place(replace(own, over_others=9.0, over_copies=9.0)).here < 0.51
    bare = grid().directions[:, 1] < 0.0
    plain = replace(view, contrasts=np.where(bare, 1.0, 20.0).astype(np.float32))
    higher = views_of(CAP | HIGH, contrasts=20.0)[0]
    half_down = np.array([DOWN] * 80 + [UP] * 20)
    for bearings, views in (
        (mostly_down, (view, plain)),  # there is nothing else to see
        (mostly_down, (higher, higher)),
        (half_down, (view, view)),
    ):
        assert not OwnEvidence.of(seen_along(bearings, bearings), views).grown_on_floor


def test_the_file_holds_weights_from_many_pairs():
    assert RECORD["shown"] == list(SHOWN)
    assert min(RECORD["num_pairs"].values()) > 300
    for fitted in (FITTED, FITTED_TO_HOMES):
        assert (fitted.least < fitted.most).all()
        assert (fitted.spread > 0.0).all()
        assert fitted.over_others.shape == fitted.over_copies.shape == (36,)


def test_terms_are_one_the_numbers_and_their_products():
    np.testing.assert_array_equal(terms(np.array([2.0, 3.0])), [1, 2, 3, 4, 6, 9])
    np.testing.assert_array_equal(terms(np.zeros((5, 7)))[:, 0], np.ones(5))


def test_ratios_weigh_what_is_shown_in_units_of_the_spread():
    no, only = np.zeros(36), np.zeros(36)
    only[[0, 2]] = 0.5, 3.0
    limits = np.full(7, 10.0)
    weights = Weights(-limits, limits, np.full(7, 1.0), np.full(7, 2.0), no, only)
    assert weights.ratios(np.array([0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0])) == (0.0, 6.5)


@pytest.mark.parametrize(
    ("fitted", "over_copies", "over_others"), [(FITTED, -0.7, -2.5), (FITTED_TO_HOMES, -2.0, -5.0)]
)
def test_typical_pairs_are_told_apart(fitted, over_copies, over_others):
    assert min(fitted.ratios(ONE_ROOM)) > 4.0
    assert min(fitted.ratios(DOOR)) > 1.0
    assert fitted.ratios(COPY)[1] < over_copies
    assert fitted.ratios(OTHER)[0] < over_others


def test_in_homes_with_copies_what_differs_tells_more():
    """Typical pairs of real tours: more differs than of rendered pairs of one room."""
    assert FITTED.ratios(REAL)[1] > 0.3
    assert FITTED_TO_HOMES.ratios(REAL)[1] < FITTED.ratios(REAL)[1] - 1.0
    own = OwnEvidence(2.0, 1.0, in_the_open=True, as_in_homes=(3.0, -4.0))
    expected = OwnEvidence(3.0, -4.0, in_the_open=True, as_in_homes=(3.0, -4.0))
    assert own.weighed_as_in_homes() == expected


def test_a_pair_on_one_wall_is_weighed_as_in_homes_and_has_nothing_to_say_in_a_folder():
    grown = views_of(CAP & (grid().directions[:, 0] > 0.5), contrasts=20.0)
    x, y = np.random.default_rng(0).uniform(-2.0, 2.0, (2, 200))
    for depths, is_wall in ((np.full(200, 2.0), True), (2.0 + (x > 0), False)):
        points = np.column_stack([x, y, depths])
        other = points + PAIR.cam2_from_cam1.translation
        bearings = tuple(each / np.linalg.norm(each, axis=1)[:, None] for each in (points, other))
        own = OwnEvidence.of(seen_along(*bearings), grown)
        assert own.on_one_wall == is_wall and not own.inliers_on_floor
        ratios = (own.over_others, own.over_copies)
        assert own.as_in_homes == pytest.approx(FITTED_TO_HOMES.ratios(shown_by(PAIR, grown)))
        assert (ratios == own.as_in_homes) == is_wall
        assert (limited_in_folder(own) == OwnEvidence()) == is_wall


def test_beyond_what_pairs_have_shown_nothing_more_is_said():
    for limit, beyond in ((FITTED.least, -100.0), (FITTED.most, 100.0)):
        assert FITTED.ratios(limit + beyond) == FITTED.ratios(limit)


def test_no_more_is_believed_than_the_limits():
    rng = np.random.default_rng(2)
    found = [OwnEvidence.of(PAIR, views_of(CAP, contrasts=6.0, depth=1.0))]
    for share in (0.02, 0.3, 1.0):
        for contrast in (6.0, 20.0):
            holes = CAP & (rng.uniform(size=NUM_CELLS) < 0.3)
            grown = CAP & (rng.uniform(size=NUM_CELLS) < share)
            found += [
                OwnEvidence.of(PAIR, views_of(grown, differs, contrast))
                for differs in (None, holes & grown)
            ]
    in_folder = list(map(limited_in_folder, found))
    assert min(own.over_others for own in in_folder) == 0.0
    assert min(own.over_copies for own in in_folder) >= -5.0
    assert max(own.over_copies for own in in_folder) <= 10.0
    assert limited_in_folder(OwnEvidence(20.0, 20.0)) == OwnEvidence(10.0, 10.0)
    assert limited_in_folder(OwnEvidence(-20.0, -20.0)) == OwnEvidence(0.0, -5.0)


def test_in_the_open_a_folder_believes_as_little_in_copies_as_a_pair_does():
    for over_copies in (-2.0, 3.0):
        indoors = OwnEvidence(8.0, over_copies)
        in_the_open = replace(indoors, in_the_open=True)
        less, more = (
            limited_in_folder(in_the_open, street).over_copies for street in (False, True)
        )
        assert less == limited_in_folder(indoors, folder_in_the_open=True).over_copies
        odds = [place.copy / place.here for place in map(same_place, (indoors, in_the_open))]
        assert more - less == pytest.approx(np.log(odds[0] / odds[1]), rel=0.02)


def test_what_drives_along_does_not_speak_for_a_copy_in_a_folder_in_the_open():
    tram = OwnEvidence(8.0, -9.0, in_the_open=True)
    assert limited_in_folder(tram, folder_in_the_open=True).over_copies == 0.0
    assert limited_in_folder(tram).over_copies < 0.0


@pytest.fixture
def fitting(monkeypatch):
    """The benchmark that fits the weights; it holds its process to one thread."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(variable, "1")
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "benchmarks"))
    import own_evidence as fitting

    return fitting


def test_the_fit_gives_log_likelihood_ratios_whatever_the_numbers_of_pairs(fitting):
    rng, shown = np.random.default_rng(5), []
    moves = {"other room": (0, 4000), "copy": (1, 1500)}
    for case, count in (("one room", 3000), ("through a door", 700)):
        shown += [
            fitting.Shown("0", fitting.RENDERED, case, each) for each in rng.normal(size=(count, 7))
        ]
    for case, (number, count) in moves.items():
        numbers = rng.normal(size=(count, 7))
        numbers[:, number] -= 1.0
        shown += [fitting.Shown("0", fitting.RENDERED, case, each) for each in numbers]
    fitted = fitting._weights(shown)
    for x in (np.zeros(7), np.eye(7)[0], -np.eye(7)[1], np.eye(7)[2]):
        # Of normal densities of unit variance, one of which is moved by -1.
        np.testing.assert_allclose(fitted.ratios(x), x[:2] + 0.5, atol=0.25)
