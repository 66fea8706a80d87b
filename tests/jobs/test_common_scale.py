# SPDX-License-Identifier: BSD-3-Clause
"""How long translations are, in one unit: by the points and surfaces that pairs share."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from epi360.features.shared_surfaces import grid
from epi360.jobs.graph.common_scale import common_scale
from epi360.jobs.graph.surface_evidence import KnownView
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose, rotation_from_vector

CENTERS = np.array([[0.0, 0, 0], [1.0, 0, 0.2], [0.4, 0.1, 2.0], [-1.5, 0, 1.0], [3.0, 0.2, -1.0]])
POSES = [
    Pose(rotation_from_vector([0.0, 0.4 * k, 0.03 * k]), center).inverse()
    for k, center in enumerate(CENTERS)
]
RADIUS = 6.0  # of a round room about the origin


def posed_pair(first, second, points, noise_deg=0.05):
    """A pair of images with the key points of points that both see, by their numbers."""
    rng = np.random.default_rng(10 * first + second)
    pose = POSES[second] @ POSES[first].inverse()
    bearings = []
    for image in (first, second):
        seen = points[:, 1:] @ POSES[image].rotation.T + POSES[image].translation
        seen += (
            np.radians(noise_deg)
            * np.linalg.norm(seen, axis=1, keepdims=True)
            * rng.normal(size=seen.shape)
        )
        bearings.append(seen / np.linalg.norm(seen, axis=1, keepdims=True))
    names = points[:, 0].astype(np.int64)
    unit = Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))
    return PosedPair((first, second), unit, (names, names), tuple(bearings), noise_deg, 0.1, 0.2)


def some_points(count, seed=0):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points *= RADIUS / np.linalg.norm(points, axis=1, keepdims=True)
    return np.column_stack([np.arange(count) + 1000 * seed, points])


def true_logs(pairs):
    return np.log([np.linalg.norm(CENTERS[a] - CENTERS[b]) for a, b in (p.images for p in pairs)])


def assert_right(found, pairs, atol):
    misses = (found.log_lengths - true_logs(pairs))[found.is_sure]
    np.testing.assert_allclose(misses, np.median(misses), atol=atol)


def view_of(pair, side, factor=1.0):
    """Depths of all cells of the round room as a camera sees them, in units of the pair."""
    pose = POSES[pair.images[side]]
    rays = grid().directions.astype(float) @ pose.rotation
    center = pose.inverse().translation
    along = rays @ center
    depths = -along + np.sqrt(along**2 + RADIUS**2 - center @ center)
    length = np.linalg.norm(CENTERS[pair.images[0]] - CENTERS[pair.images[1]])
    cells = np.arange(0, len(rays), 40)
    return KnownView(
        cells.astype(np.int16),
        (factor * depths[cells] / length).astype(np.float32),
        np.zeros((len(cells), 3), np.float16),
        np.full(len(cells), 0.05, np.float16),
        np.ones(len(cells), bool),
    )


def views_of(pairs):
    return {(row, side): view_of(pair, side) for row, pair in enumerate(pairs) for side in (0, 1)}


def test_points_that_pairs_share_say_how_long_all_are():
    points = some_points(80)
    pairs = [posed_pair(*ends, points) for ends in combinations(range(5), 2)]
    found = common_scale(pairs, {})
    assert found.is_sure.all()
    assert_right(found, pairs, 0.03)


def test_the_order_of_pairs_and_images_does_not_matter():
    points = some_points(80)
    pairs = [posed_pair(*ends, points) for ends in combinations(range(5), 2)]
    turned = [
        replace(
            pair,
            images=pair.images[::-1],
            cam2_from_cam1=pair.cam2_from_cam1.inverse(),
            bearings=pair.bearings[::-1],
        )
        for pair in reversed(pairs)
    ]
    first, second = common_scale(pairs, {}), common_scale(turned, {})
    differences = first.log_lengths - second.log_lengths[::-1]
    np.testing.assert_allclose(differences, np.median(differences), atol=1e-6)


def test_surfaces_say_it_where_no_points_are_shared():
    pairs = [posed_pair(0, k, some_points(20, seed=k)) for k in range(1, 5)]
    assert not common_scale(pairs, {}).is_sure.any()
    found = common_scale(pairs, views_of(pairs))
    assert found.is_sure.all()
    assert_right(found, pairs, 0.05)


def test_what_contradicts_the_others_is_not_believed():
    """One pair takes its surroundings for four times as large."""
    points = some_points(80)
    pairs = [posed_pair(*ends, points) for ends in combinations(range(4), 2)]
    views = {**views_of(pairs), (0, 0): view_of(pairs[0], 0, factor=4.0)}
    found = common_scale(pairs, views)
    assert found.is_sure.all()
    assert_right(found, pairs, 0.05)


def test_a_pair_that_shares_nothing_is_not_sure():
    points = some_points(80)
    pairs = [posed_pair(*ends, points) for ends in combinations(range(4), 2)]
    pairs.append(posed_pair(3, 4, some_points(5, seed=7)))
    found = common_scale(pairs, {})
    assert found.is_sure.tolist() == [True] * 6 + [False]


@pytest.mark.parametrize("pairs", [[], [posed_pair(0, 1, some_points(40))]])
def test_one_pair_has_a_unit_of_its_own(pairs):
    found = common_scale(pairs, {})
    assert len(found.log_lengths) == len(pairs) and not found.is_sure.any()
