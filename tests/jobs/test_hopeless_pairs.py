# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of different places: all key points are matched only where that may find something."""

import numpy as np
import pytest
from rendered_views import NAMES, image_set, write_png, write_views

from epi360.cameras import Equirectangular
from epi360.features import match_features
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching import match_folder, pair_work
from epi360.jobs.matching.match_folder import MatchOptions, match_images
from epi360.jobs.records import match_store
from epi360.poses import Pose
from epi360_scenes import scene


@pytest.fixture
def looks(monkeypatch):
    """How many key points of both images are compared in each look from now on."""
    sizes = []
    compare = pair_work.look

    def noted(features1, features2, before=None):
        sizes.append((len(features1), len(features2), before is not None))
        return compare(features1, features2, before)

    monkeypatch.setattr(pair_work, "look", noted)
    return sizes


@pytest.fixture
def strangers(tmp_path):
    """Two images of different places."""
    views = write_views(tmp_path / "views", NAMES[:1])
    camera = Equirectangular(512, 256)
    place = Pose(np.eye(3), np.array([-0.5, -1.4, 0.3]))
    write_png(views / NAMES[1], scene("studio").render(camera, place).image)
    return image_set(views, NAMES[:2])


def opened_work(images, output):
    return match_folder._open_work(images, output, MatchOptions(num_threads=1), restart=False)


def test_images_of_different_places_are_looked_at_once(strangers, tmp_path, looks):
    (verdict,) = match_images(strangers, tmp_path / "out").verdicts
    assert verdict.status == "too_few_inliers" and verdict.probability < 0.05
    assert len(looks) == 1


def test_faint_images_of_different_places_are_looked_at_again(
    strangers, tmp_path, looks, monkeypatch
):
    # Most of the key points are faint: the stronger ones say little about the pair.
    monkeypatch.setattr(pair_work, "CONTRAST_THRESHOLD", 0.06)
    match_images(strangers, tmp_path / "out")
    assert [before for _, _, before in looks] == [False, True]
    assert 2 * looks[0][0] < looks[1][0]


@pytest.mark.parametrize("is_new_process", [False, True])
def test_a_level_folder_asks_for_all_key_points_of_such_a_pair(
    strangers, tmp_path, looks, is_new_process
):
    work = opened_work(strangers, tmp_path / "out")
    for index in (0, 1):
        work.find_key(index)
        work.find_features(index)
    (name,) = work.verify_parts([[(0, 1)]]).files
    if is_new_process:
        known = dict(work.inputs.keys)
        work = opened_work(strangers, tmp_path / "out")
        work.inputs.keys.update(known)
    level = Level(gravity_sigma_deg=0.5, elevation_sigma_deg=2.0)
    work.verify_part_again(name, {work.keys_of((0, 1)): (0, 1)}, level)
    assert [before for _, _, before in looks] == [False, not is_new_process]
    (first,) = match_store.read_parts(tmp_path / "out")
    (second,) = match_store.read_parts(tmp_path / "out", level.store)
    everything = [len(work._features_of(index)[0]) for index in (0, 1)]
    assert list(looks[1][:2]) == everything > list(looks[0][:2])
    features = [work._features_of(index)[0] for index in (0, 1)]
    np.testing.assert_array_equal(second.matches, match_features(*features))
    assert len(second.matches) != len(first.matches)
