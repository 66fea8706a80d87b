# SPDX-License-Identifier: BSD-3-Clause
"""Matches that nobody has verified: poses for their pairs, and what COLMAP does with them."""

import dataclasses

import numpy as np
import pytest
from colmap_graphs import panoramas_of_points, relative_pose

from epi360.jobs.matching.verify_pairs import unverified_pairs, verify_pairs
from epi360.poses import rotation_error_deg, translation_error_deg


def unverified(graph):
    pairs = tuple(dataclasses.replace(pair, geometry=None) for pair in graph.pairs)
    return dataclasses.replace(graph, pairs=pairs)


def test_pairs_get_the_poses_that_their_matches_have():
    poses, graph = panoramas_of_points(4)
    assert len(unverified_pairs(unverified(graph))) == 6
    verified = verify_pairs(unverified(graph))
    assert not unverified_pairs(verified)
    for pair in verified.pairs:
        truth = relative_pose(poses[pair.image1], poses[pair.image2])
        assert pair.geometry.status == "ok" and len(pair.geometry.inliers) > 190
        assert rotation_error_deg(pair.geometry.cam2_from_cam1, truth) < 0.1
        assert translation_error_deg(pair.geometry.cam2_from_cam1, truth) < 1.0


def test_a_pair_that_has_a_geometry_keeps_it():
    _, graph = panoramas_of_points(3)
    first, *others = graph.pairs
    mixed = unverified(dataclasses.replace(graph, pairs=tuple(others)))
    mixed = dataclasses.replace(mixed, pairs=(first, *mixed.pairs))
    assert verify_pairs(mixed).pairs[0] is not None
    assert verify_pairs(mixed).pairs[0].geometry is first.geometry


def test_random_matches_are_refused():
    _, graph = panoramas_of_points(2)
    rng = np.random.default_rng(0)
    (pair,) = graph.pairs
    shuffled = np.column_stack([np.arange(200), rng.permutation(200)])
    wrong = dataclasses.replace(graph, pairs=(dataclasses.replace(pair, matches=shuffled),))
    (found,) = verify_pairs(unverified(wrong)).pairs
    assert found.geometry.status == "too_few_inliers"


def test_an_image_without_a_camera_is_named():
    _, graph = panoramas_of_points(2)
    images = {name: dataclasses.replace(image, camera=None) for name, image in graph.images.items()}
    nameless = dataclasses.replace(unverified(graph), images=images)
    with pytest.raises(ValueError, match="0.jpg has no camera"):
        verify_pairs(nameless)


def test_colmap_triangulates_what_was_verified_and_nothing_else(tmp_path):
    """The way of hloc's triangulation: a model with poses, a database with verified matches."""
    pycolmap = pytest.importorskip("pycolmap")
    from epi360.interop import PosedImage, Reconstruction, write_colmap_database, write_colmap_model

    poses, graph = panoramas_of_points(5)
    posed = tuple(PosedImage(name, "theta", pose) for name, pose in poses.items())
    write_colmap_model(tmp_path / "model", Reconstruction(graph.cameras, posed))
    counts = []
    for number, one in enumerate((unverified(graph), verify_pairs(unverified(graph)))):
        database, found = tmp_path / f"{number}.db", tmp_path / f"{number}"
        write_colmap_database(database, one)
        found.mkdir()
        model = pycolmap.triangulate_points(
            pycolmap.Reconstruction(str(tmp_path / "model")), database, tmp_path, found
        )
        counts.append(model.num_points3D())
    assert counts[0] == 0 and counts[1] > 190
