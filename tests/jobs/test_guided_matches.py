# SPDX-License-Identifier: BSD-3-Clause
"""More matches along the epipolar curves of known poses."""

import dataclasses

import numpy as np
import pytest
from colmap_graphs import panoramas_of_points

from epi360.features.matching import rounded_descriptors
from epi360.interop import TwoViewGeometry
from epi360.jobs.mapping import guided_matches
from epi360.jobs.mapping.guided_matches import View, with_guided
from epi360.poses import Pose

NOISE_DEG = 0.06  # of 0.3 pixels of a panorama 2000 wide


def few_inliers(num_points=600, num_images=2, seed=0, repeated=4):
    """Pairs of which 40 of 600 matches are known, and the descriptors of all key points.

    Each descriptor comes on several points, so that no key point can be told from all others.
    """
    _, graph = panoramas_of_points(num_images, num_points=num_points, seed=seed)
    rng = np.random.default_rng(seed)
    kinds = rng.normal(size=(num_points // repeated, 128))
    kinds /= np.linalg.norm(kinds, axis=1, keepdims=True)
    kind = np.arange(num_points) % len(kinds)
    described = {}
    for name in graph.images:
        found = kinds[kind] + 0.02 * rng.normal(size=(num_points, 128))
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        described[name] = rounded_descriptors(found.astype(np.float32))
    known = np.stack([np.arange(40)] * 2, axis=1)
    pairs = tuple(
        dataclasses.replace(
            pair,
            matches=known,
            geometry=dataclasses.replace(pair.geometry, inliers=known),
        )
        for pair in graph.pairs
    )
    return dataclasses.replace(graph, pairs=pairs), described


def noise_of(graph):
    return {(pair.image1, pair.image2): NOISE_DEG for pair in graph.pairs}


def test_key_points_that_repeat_are_told_apart_along_their_curves():
    graph, described = few_inliers()
    (pair,) = with_guided(graph, noise_of(graph), described.__getitem__, 1).pairs
    more = pair.geometry.inliers[40:]
    assert len(more) > 300
    assert np.mean(more[:, 0] == more[:, 1]) > 0.95
    for side in (0, 1):
        assert len(np.unique(pair.geometry.inliers[:, side])) == len(pair.geometry.inliers)
    np.testing.assert_array_equal(pair.matches, pair.geometry.inliers)
    (before,) = graph.pairs
    np.testing.assert_array_equal(pair.geometry.inliers[:40], before.geometry.inliers)
    assert pair.geometry.cam2_from_cam1 is before.geometry.cam2_from_cam1


def test_somebody_hears_how_far_it_is():
    graph, described = few_inliers(num_images=3)
    heard = []
    with_guided(graph, noise_of(graph), described.__getitem__, 2, lambda *told: heard.append(told))
    assert heard == [("more matches", count, 3) for count in range(4)]


def test_a_wrong_pose_finds_far_fewer():
    graph, described = few_inliers()
    (pair,) = graph.pairs
    right = pair.geometry.cam2_from_cam1
    wrong = Pose(right.rotation, np.roll(right.translation, 1))
    told = dataclasses.replace(pair.geometry, cam2_from_cam1=wrong)
    astray = dataclasses.replace(graph, pairs=(dataclasses.replace(pair, geometry=told),))
    found = [
        len(with_guided(each, noise_of(graph), described.__getitem__, 1).pairs[0].geometry.inliers)
        for each in (graph, astray)
    ]
    assert found[1] - 40 < 0.3 * (found[0] - 40)


def test_all_matches_are_near_the_curve_in_front_and_as_alike_as_the_inliers():
    graph, described = few_inliers(seed=3)
    (pair,) = graph.pairs
    views = [
        View(
            graph.cameras["theta"].bearings_from_pixels(graph.images[name].keypoints),
            described[name],
        )
        for name in (pair.image1, pair.image2)
    ]
    gate = np.radians(0.1)
    more = guided_matches.guided_matches(*views, pair.geometry, gate)
    b1, b2 = views[0].bearings[more[:, 0]], views[1].bearings[more[:, 1]]
    pose = pair.geometry.cam2_from_cam1
    E = np.cross(np.eye(3), pose.translation) @ pose.rotation
    sines = np.einsum("ni,ij,nj->n", b2, E, b1)
    n1 = np.linalg.norm(b2 @ E - sines[:, None] * b1, axis=1)
    n2 = np.linalg.norm(b1 @ E.T - sines[:, None] * b2, axis=1)
    assert (np.abs(sines) / np.hypot(n1, n2) < gate * 1.001).all()
    products = np.sum(views[0].descriptors[more[:, 0]] * views[1].descriptors[more[:, 1]], axis=1)
    known = np.sum(views[0].descriptors[:40] * views[1].descriptors[:40], axis=1)
    assert products.min() >= np.quantile(known, 0.1) - 1e-6


@pytest.mark.parametrize("status", ["planar_ambiguous", "pure_rotation", "refused"])
def test_only_poses_that_are_ok_guide(status):
    graph, described = few_inliers()
    (pair,) = graph.pairs
    told = TwoViewGeometry(status, pair.geometry.cam2_from_cam1, pair.geometry.inliers)
    other = dataclasses.replace(graph, pairs=(dataclasses.replace(pair, geometry=told),))
    assert with_guided(other, noise_of(graph), described.__getitem__, 1) is other


def test_pairs_with_many_inliers_or_unknown_noise_and_large_maps_keep_what_they_have(monkeypatch):
    graph, described = few_inliers()
    assert with_guided(graph, {}, described.__getitem__, 1) is graph
    monkeypatch.setattr(guided_matches, "_ENOUGH", 40)
    assert with_guided(graph, noise_of(graph), described.__getitem__, 1) is graph
    monkeypatch.undo()
    monkeypatch.setattr(guided_matches, "MOST_PAIRS", 0)
    assert with_guided(graph, noise_of(graph), described.__getitem__, 1) is graph


def test_the_number_of_threads_and_of_rows_at_once_changes_nothing(monkeypatch):
    graph, described = few_inliers(num_images=4)
    found = []
    for rows, num_threads in ((512, 1), (512, 3), (37, 1)):
        monkeypatch.setattr(guided_matches, "_ROWS_AT_ONCE", rows)
        pairs = with_guided(graph, noise_of(graph), described.__getitem__, num_threads).pairs
        found.append([pair.geometry.inliers.tolist() for pair in pairs])
    assert found[0] == found[1] == found[2]
    assert min(map(len, found[0])) > 100
