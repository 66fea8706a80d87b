# SPDX-License-Identifier: BSD-3-Clause
"""What a pair shows by itself: hand-made surfaces, and the densities of rendered homes."""

import json
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from epi360.features.shared_surfaces import NUM_CELLS, SharedSurfaces, grid
from epi360.jobs.graph import own_evidence
from epi360.jobs.graph.own_evidence import (
    COPY,
    DENSITIES,
    DOOR,
    OTHER,
    ROOM,
    SHOWN,
    Densities,
    OwnEvidence,
    shown_by,
)
from epi360.jobs.graph.shared_points import PosedPair
from epi360.poses import Pose

RECORD = json.loads(files(own_evidence.__package__).joinpath(DENSITIES).read_text("utf-8"))
FITTED = Densities.of_record(RECORD)
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
    )
    return view, view


def shown(*args, **values):
    return dict(zip(SHOWN, np.exp(shown_by(PAIR, views_of(*args, **values))), strict=True))


CAP = grid().directions[:, 1] > 0.3


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


def test_what_is_clearly_behind_something_is_not_expected():
    near = views_of(CAP, depth=2.0)[0]
    far = replace(near, expected_depths=3 * near.expected_depths)
    assert np.exp(shown_by(PAIR, (far, near)))[SHOWN.index("strong")] == pytest.approx(20)


def test_where_nothing_grows_nothing_speaks_for_the_pair():
    assert OwnEvidence.of(PAIR, views_of(np.zeros(NUM_CELLS, dtype=bool))).over_others == 0.0


def test_the_file_holds_densities_of_many_pairs():
    assert RECORD["shown"] == list(SHOWN)
    assert set(FITTED.cases) == {ROOM, DOOR, COPY, OTHER}
    assert min(case["num_pairs"] for case in RECORD["cases"].values()) > 400
    for density in FITTED.cases.values():
        np.testing.assert_array_equal(density.covariance, density.covariance.T)
        assert np.linalg.eigvalsh(density.covariance).min() > 0.005
    assert (FITTED.least < FITTED.most).all()


def test_pairs_are_most_like_their_own_case():
    means = {case: density.mean for case, density in FITTED.cases.items()}
    assert min(FITTED.ratios(means[ROOM])) > 4.0
    assert min(FITTED.ratios(means[DOOR])) > 1.0
    assert FITTED.ratios(means[COPY])[1] < -1.0
    assert FITTED.ratios(means[OTHER])[0] < -3.0


def test_beyond_what_pairs_have_shown_nothing_more_is_said():
    for limit, beyond in ((FITTED.least, -100.0), (FITTED.most, 100.0)):
        assert FITTED.ratios(limit + beyond) == FITTED.ratios(limit)


def test_no_more_is_believed_than_the_limits():
    rng, found = np.random.default_rng(2), []
    for share in (0.02, 0.3, 1.0):
        for contrast in (6.0, 20.0):
            holes = CAP & (rng.uniform(size=NUM_CELLS) < 0.3)
            grown = CAP & (rng.uniform(size=NUM_CELLS) < share)
            found += [
                OwnEvidence.of(PAIR, views_of(grown, differs, contrast))
                for differs in (None, holes & grown)
            ]
    assert min(own.over_others for own in found) == 0.0
    assert min(own.over_copies for own in found) == -2.0
    assert max(own.over_copies for own in found) == 8.0
