# SPDX-License-Identifier: BSD-3-Clause
"""Frames of a sequence are matched with their neighbours, if these suffice."""

import shutil

import numpy as np
import pytest
from rendered_views import image_set, write_views

from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching import rival_poses
from epi360.jobs.matching.match_folder import load_matches, match_images
from epi360.jobs.pairs import pair_selection


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_views(tmp_path_factory.mktemp("views"))


@pytest.fixture(scope="module")
def run(folder, tmp_path_factory):
    return match_images(image_set(folder), tmp_path_factory.mktemp("output") / "matches")


@pytest.mark.parametrize(("inliers", "num_pairs"), [(1, 3), (10**6, 6)])
def test_all_pairs_are_matched_unless_the_first_ones_show_a_dense_sequence(
    run, folder, tmp_path, monkeypatch, inliers, num_pairs
):
    for name, value in (("_FEWEST_DENSE", 4), ("_DENSE_STEPS", (1,)), ("_DENSE_INLIERS", inliers)):
        monkeypatch.setattr(pair_selection, name, value)
    for num_found in (0, num_pairs):  # the second time everything is there
        other = match_images(image_set(folder), tmp_path)
        assert len(other.verdicts) == len(load_matches(tmp_path).pairs) == num_pairs
        assert other.how == ("3 of a dense sequence" if num_pairs == 3 else "exhaustive")
        assert other.num_found == num_found
    all_poses = {(v.image1, v.image2): v.cam2_from_cam1.matrix() for v in run.verdicts}
    for verdict in other.verdicts:
        expected = all_poses[verdict.image1, verdict.image2]
        np.testing.assert_array_equal(verdict.cam2_from_cam1.matrix(), expected)


def test_a_sequence_has_pictures_so_that_its_other_matches_are_not_asked(
    folder, tmp_path, monkeypatch
):
    for name, value in (("_FEWEST_DENSE", 4), ("_DENSE_STEPS", (1,)), ("_DENSE_INLIERS", 1)):
        monkeypatch.setattr(pair_selection, name, value)
    monkeypatch.setattr(rival_poses, "which_repeat", lambda votes: [True] * len(votes))
    run = match_images(image_set(folder), tmp_path)
    assert "of a dense sequence" in run.how
    assert all(verdict.accepted for verdict in run.verdicts)


def test_a_frame_that_is_there_twice_leaves_a_sequence_dense(folder, tmp_path, monkeypatch):
    """Equal images have equal keys, and a pair of keys is matched once."""
    for name, value in (("_FEWEST_DENSE", 4), ("_DENSE_STEPS", (1, 2)), ("_DENSE_INLIERS", 1)):
        monkeypatch.setattr(pair_selection, name, value)
    shutil.copytree(folder, tmp_path / "frames")
    first = min((tmp_path / "frames").rglob("*1.png"))
    shutil.copy(first, first.with_name(f"{first.stem}a{first.suffix}"))
    run = match_images(find_images(tmp_path / "frames"), tmp_path / "out")
    assert len(run.images) == 5 and "of a dense sequence" in run.how
