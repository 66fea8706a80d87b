# SPDX-License-Identifier: BSD-3-Clause
"""A folder that is matched once more says the same, without the work."""

import dataclasses
import json

import numpy as np
import pytest
from level_views import NAMES, judge_otherwise, write_tour

from epi360.jobs.matching import kept_verdicts, match_folder, match_job
from epi360.jobs.matching.kept_verdicts import KeptVerdicts
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.jobs.matching.pair_work import PairWork
from epi360.jobs.records.match_store import VERDICTS
from epi360.poses import Pose
from epi360.report.match_table import describe_match
from epi360.report.pairs_table import pairs_csv
from epi360.runs.remote_path import path_of

LOST = (0, 2)


@pytest.fixture(scope="module")
def tour(tmp_path_factory):
    return write_tour(tmp_path_factory.mktemp("tour"), is_level=False)


@pytest.fixture
def second_pose(monkeypatch):
    """One pair is refused by its first look, and gets the pose of the matches that this leaves."""

    def changed(verified, pair, prior):
        if pair != LOST or prior:
            return verified
        mask = np.arange(len(verified.matches)) % 3 == 0
        refused = dataclasses.replace(
            verified.verdict,
            status="too_few_inliers",
            num_inliers=int(mask.sum()),
            probability=0.0,
            cam2_from_cam1=Pose.nan(),
        )
        return dataclasses.replace(verified, verdict=refused, inlier_mask=mask)

    judge_otherwise(monkeypatch, changed)


@pytest.fixture
def judged(monkeypatch):
    """What `judge_folder` was asked and has said, each time it is asked."""
    told = []
    judge = match_folder.judge_folder

    def listened(*args, **options):
        told.append(judge(*args, **options))
        return told[-1]

    monkeypatch.setattr(match_folder, "judge_folder", listened)
    return told


@pytest.fixture
def estimates(monkeypatch):
    """Words for the matches that poses were estimated from, each time this was done."""
    priors = []
    estimated = PairWork.estimated

    def listened(work, matched, prior, **known):
        priors.append(prior)
        return estimated(work, matched, prior, **known)

    monkeypatch.setattr(PairWork, "estimated", listened)
    return priors


def as_text(value):
    """Everything of a result, in full digits."""
    with np.printoptions(floatmode="unique", threshold=10**9):
        if dataclasses.is_dataclass(value):
            return f"{type(value).__name__}({as_text(vars(value))})"
        if isinstance(value, dict):
            return sorted((repr(key), as_text(each)) for key, each in value.items())
        if isinstance(value, list | tuple):
            return [type(value).__name__, *map(as_text, value)]
        return repr(value)


def test_what_is_kept_is_what_was_said(tour, tmp_path, second_pose, judged):
    run = match_images(tour, tmp_path)
    (said,) = judged
    assert said.other_poses
    assert any(not verdict.accepted for verdict in said.settled.values())
    record = json.loads((tmp_path / VERDICTS).read_bytes())
    kept = KeptVerdicts(path_of(tmp_path), record["made_from"]).read(said.keys)
    assert as_text(kept) == as_text(said)
    again = match_images(tour, tmp_path)
    assert len(judged) == 1
    assert pairs_csv(again) == pairs_csv(run)
    assert again.num_by_others == run.num_by_others == 1
    (other,) = [
        p for p in load_matches(tmp_path).pairs if (p.image1, p.image2) == ("0.png", "2.png")
    ]
    assert other.geometry.status == "ok"


def test_who_asks_for_other_pairs_gets_no_kept_verdicts(tour, tmp_path, judged):
    everything = pairs_csv(match_images(tour, tmp_path))
    (tmp_path / "pairs.txt").write_text(f"{NAMES[0]} {NAMES[1]}\n")
    some = match_images(tour, tmp_path, MatchOptions(pairs=tmp_path / "pairs.txt"))
    assert len(some.verdicts) == 1
    assert pairs_csv(match_images(tour, tmp_path)) == everything
    assert len(judged) == 3


def test_other_code_does_not_believe_them(tour, tmp_path, judged, monkeypatch):
    match_images(tour, tmp_path)
    monkeypatch.setattr(kept_verdicts, "code_fingerprint", lambda: "other code")
    match_images(tour, tmp_path)
    assert len(judged) == 2


@pytest.mark.parametrize("damage", ["verdicts", "poses"])
def test_damaged_ones_count_as_none(tour, tmp_path, second_pose, judged, damage):
    run = match_images(tour, tmp_path)
    files = [tmp_path / VERDICTS] if damage == "verdicts" else tmp_path.glob("implied/part-*.npz")
    for file in files:
        file.write_bytes(file.read_bytes()[:-20])
    assert pairs_csv(match_images(tour, tmp_path)) == pairs_csv(run)
    assert len(judged) == 2
    assert len(load_matches(tmp_path).pairs) == len(run.verdicts)


def test_verdicts_without_their_level_pairs_count_as_none(tmp_path, judged, monkeypatch):
    tour = write_tour(tmp_path / "pictures")

    def lost(verified, pair, prior):
        if pair != LOST or prior:
            return verified
        verdict = dataclasses.replace(
            verified.verdict, status="too_few_inliers", cam2_from_cam1=Pose.nan()
        )
        return dataclasses.replace(verified, verdict=verdict)

    judge_otherwise(monkeypatch, lost)
    run = match_images(tour, tmp_path / "out")
    assert run.level is not None and run.num_gained == 1
    (part,) = (tmp_path / "out").glob("level-*/part-*.npz")
    content = part.read_bytes()
    part.write_bytes(content[:1000])
    assert pairs_csv(match_images(tour, tmp_path / "out")) == pairs_csv(run)
    assert len(judged) == 2
    assert part.read_bytes() == content


def test_verdicts_without_a_picture_are_not_kept(tour, tmp_path, judged, monkeypatch):
    read = match_job.read_panorama

    def unreadable(image, *more):
        if image.name == NAMES[1]:
            raise OSError(5, "Input/output error", str(image.path))
        return read(image, *more)

    monkeypatch.setattr(match_job, "read_panorama", unreadable)
    run = match_images(tour, tmp_path)
    assert list(run.gone) == [NAMES[1]]
    assert f"The surroundings of {NAMES[1]} were not compared" in describe_match(run)
    assert not (tmp_path / VERDICTS).exists()
    monkeypatch.undo()
    assert not match_images(tour, tmp_path).gone
    assert (tmp_path / VERDICTS).exists()


def test_what_some_matches_say_is_found_once(tour, tmp_path, second_pose, estimates):
    run = match_images(tour, tmp_path)
    assert "second" in estimates
    (tmp_path / VERDICTS).unlink()
    estimates.clear()
    assert pairs_csv(match_images(tour, tmp_path)) == pairs_csv(run)
    assert not estimates
    for file in tmp_path.glob("some-*/part-*.npz"):
        file.unlink()
    (tmp_path / VERDICTS).unlink()
    assert pairs_csv(match_images(tour, tmp_path)) == pairs_csv(run)
    assert "second" in estimates
