# SPDX-License-Identifier: BSD-3-Clause
"""A pair of a folder that shows two poses is accepted with neither."""

import pytest
from rendered_views import write_png
from twin_rooms import rooms

from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching import rival_poses
from epi360.jobs.matching.match_folder import match_images
from epi360.jobs.records.match_store import VERDICTS
from epi360.places.repeated_place import MANY_OTHERS
from epi360.report.pairs_table import verdict_reason

MIXED = "a1.png", "mixed.png"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three pictures of a room, and one that shows it from two places, half and half."""
    folder = tmp_path_factory.mktemp("tour")
    pictures = {name: picture for name, (_, picture) in rooms().items() if name[0] == "a"}
    mixed = pictures["a2.png"].copy()
    half = mixed.shape[1] // 2
    mixed[:, half:] = pictures["a0.png"][:, half:]
    for name, picture in {**pictures, "mixed.png": mixed}.items():
        write_png(folder / "pictures" / name, picture)
    return folder


def matched(folder):
    return match_images(find_images(folder / "pictures"), folder / "out")


@pytest.fixture(scope="module")
def run(folder):
    return matched(folder)


def verdict_of(run, names):
    (found,) = [each for each in run.verdicts if (each.image1, each.image2) == names]
    return found


def test_neither_pose_is_accepted(run):
    verdict = verdict_of(run, MIXED)
    assert verdict.status == "refused" and not verdict.accepted
    assert "for other matches agree on another pose" in verdict_reason(verdict, run)
    assert verdict.probability <= 0.5


@pytest.mark.parametrize("names", [("a0.png", "a1.png"), ("a1.png", "a2.png")])
def test_right_pairs_have_one(run, names):
    assert verdict_of(run, names).accepted
    assert MANY_OTHERS not in verdict_of(run, names).warnings


@pytest.mark.usefixtures("run")
def test_many_matches_of_a_pose_that_looks_less_right_are_a_warning(folder, monkeypatch):
    monkeypatch.setattr(rival_poses, "looks_right", lambda _: False)
    (folder / "out" / VERDICTS).unlink()
    told = matched(folder)
    assert verdict_of(told, MIXED).accepted and MANY_OTHERS in verdict_of(told, MIXED).warnings
    assert MANY_OTHERS not in verdict_of(told, ("a0.png", "a1.png")).warnings
