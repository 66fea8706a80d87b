# SPDX-License-Identifier: BSD-3-Clause
"""A pair whose own matches say something else gets the pose that two other pairs imply."""

import csv
import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from level_views import NAMES, doubted, judge_otherwise, truth, write_tour

from epi360.jobs.graph.implied_poses import Way
from epi360.jobs.matching import folder_verdicts
from epi360.jobs.matching.implied_job import IMPLIED, ImpliedPair, find_implied
from epi360.jobs.matching.match_folder import load_matches, match_images
from epi360.jobs.matching.match_job import MatchJob
from epi360.jobs.matching.pair_verdicts import PairVerdict, with_implied
from epi360.jobs.records.match_store import Verdict, VerifiedPair
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg
from epi360.report.match_table import describe_match
from epi360.report.pairs_table import pairs_csv

LOST = (0, 2)
LOST_NAMES = (NAMES[0], NAMES[2])


@pytest.fixture(scope="module")
def tour(tmp_path_factory):
    return write_tour(tmp_path_factory.mktemp("tour"), is_level=False)


@pytest.fixture
def lost(monkeypatch):
    """The own look at one pair finds nothing; returns what changes the look at implied poses."""
    changes = {}

    def changed(verified, pair, prior):
        if pair != LOST:
            return verified
        if prior == "implied":
            return replace(verified, verdict=replace(verified.verdict, **changes))
        verdict = Verdict(status="too_few_inliers", num_matches=verified.verdict.num_matches)
        return replace(verified, verdict=verdict, inlier_mask=np.zeros_like(verified.inlier_mask))

    judge_otherwise(monkeypatch, changed)
    return changes


def verdict_on(run, names=LOST_NAMES):
    (found,) = [v for v in run.verdicts if (v.image1, v.image2) == names]
    return found


def test_two_pairs_imply_the_pose_of_a_third(tour, tmp_path, lost):
    run = match_images(tour, tmp_path)
    found = verdict_on(run)
    assert found.accepted
    assert (found.prior, found.warnings[-1]) == ("implied", IMPLIED)
    assert rotation_error_deg(found.cam2_from_cam1, truth(*LOST, False)) < 0.5
    assert translation_error_deg(found.cam2_from_cam1, truth(*LOST, False)) < 1.5
    assert run.num_by_others == 1
    said = "1 more pair was accepted because of what other pairs know of the place."
    assert said in describe_match(run)
    rows = list(csv.DictReader(pairs_csv(run).decode().splitlines()))
    assert [row["reason"] for row in rows if row["prior"] == "implied"] == [IMPLIED]


@pytest.mark.parametrize(("num_distinct", "status"), [(7, "too_few_inliers"), (9, "ok")])
def test_matches_that_are_given_thrice_count_once(
    tour, tmp_path, monkeypatch, num_distinct, status
):
    right = truth(*LOST, False)
    unit = Pose(right.rotation, right.translation / np.linalg.norm(right.translation))

    def changed(verified, pair, prior):
        if pair != LOST:
            return verified
        if prior == "implied":
            verdict = replace(verified.verdict, status="ok", cam2_from_cam1=unit)
            return replace(verified, verdict=verdict)
        few = verified.matches[verified.inlier_mask][:num_distinct]
        verdict = Verdict(status="too_few_inliers", num_matches=3 * len(few))
        matches, none = np.repeat(few, 3, axis=0), np.zeros(3 * len(few), dtype=bool)
        return replace(verified, verdict=verdict, matches=matches, inlier_mask=none)

    judge_otherwise(monkeypatch, changed)
    assert verdict_on(match_images(tour, tmp_path)).status == status


def test_second_poses_imply_none(tour, tmp_path, lost, monkeypatch):
    def as_if_all_were_second(settled, accepted, second):
        return find_implied(settled, accepted, accepted)

    name = "epi360.jobs.matching.folder_verdicts.find_implied"
    monkeypatch.setattr(name, as_if_all_were_second)
    run = match_images(tour, tmp_path)
    assert verdict_on(run).status == "too_few_inliers"
    assert sum(verdict.accepted for verdict in run.verdicts) == 5


def test_the_kept_result_has_that_pose(tour, tmp_path, lost):
    run = match_images(tour, tmp_path)
    (pair,) = [p for p in load_matches(tmp_path).pairs if (p.image1, p.image2) == LOST_NAMES]
    found = verdict_on(run)
    assert pair.geometry.status == "ok"
    np.testing.assert_array_equal(
        pair.geometry.cam2_from_cam1.matrix(), found.cam2_from_cam1.matrix()
    )
    assert len(pair.geometry.inliers) == found.num_inliers
    assert pairs_csv(match_images(tour, tmp_path)) == pairs_csv(run)
    own = load_matches(tmp_path, by_others=False)
    assert [p.geometry.status for p in own.pairs].count("too_few_inliers") == 1


def test_a_damaged_file_of_implied_pairs_is_said(tour, tmp_path, lost):
    match_images(tour, tmp_path)
    (part,) = (tmp_path / "implied").iterdir()
    part.write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"part-\w+\.npz is missing or damaged; run epi360 match"):
        load_matches(tmp_path)
    match_images(tour, tmp_path)
    assert len(load_matches(tmp_path).pairs) == 6


@pytest.mark.parametrize("status", ["ok", "concentrated_inliers"])
def test_matches_that_say_something_else_get_no_pose(tour, tmp_path, lost, status):
    right = truth(*LOST, False)
    turned = Pose(rotation_from_vector([0.0, 0.05, 0.0]) @ right.rotation, right.translation)
    lost.update(status=status, cam2_from_cam1=turned, doubted=turned)
    run = match_images(tour, tmp_path)
    assert verdict_on(run).status == "too_few_inliers"
    assert run.num_by_others == 0
    assert not (tmp_path / "implied").exists()


@pytest.mark.parametrize("status", ["concentrated_inliers", "too_few_inliers"])
def test_few_inliers_or_close_ones_are_enough(tour, tmp_path, lost, status):
    right = truth(*LOST, False)
    unit = Pose(right.rotation, right.translation / np.linalg.norm(right.translation))
    lost.update(status=status, cam2_from_cam1=Pose.nan(), doubted=unit)
    found = verdict_on(match_images(tour, tmp_path))
    assert found.accepted
    np.testing.assert_array_equal(found.cam2_from_cam1.matrix(), unit.matrix())


def test_as_many_as_chance_explains_are_not(tour, tmp_path, lost, monkeypatch):
    right = truth(*LOST, False)
    unit = Pose(right.rotation, right.translation / np.linalg.norm(right.translation))
    lost.update(status="too_few_inliers", cam2_from_cam1=Pose.nan(), doubted=unit)
    monkeypatch.setattr(Way, "is_chance", lambda *_: True)
    assert not verdict_on(match_images(tour, tmp_path)).accepted


def test_a_probability_of_close_inliers_must_do(tour, tmp_path, lost):
    right = truth(*LOST, False)
    unit = Pose(right.rotation, right.translation / np.linalg.norm(right.translation))
    status = "concentrated_inliers"
    lost.update(status=status, cam2_from_cam1=Pose.nan(), doubted=unit, probability=0.5)
    assert not verdict_on(match_images(tour, tmp_path)).accepted


def test_all_matches_are_kept_and_those_of_the_pose_are_inliers(tour, tmp_path, lost):
    found = verdict_on(match_images(tour, tmp_path))
    (pair,) = [p for p in load_matches(tmp_path).pairs if (p.image1, p.image2) == LOST_NAMES]
    (own,) = [
        p
        for p in load_matches(tmp_path, by_others=False).pairs
        if (p.image1, p.image2) == LOST_NAMES
    ]
    np.testing.assert_array_equal(pair.matches, own.matches)
    assert found.num_matches == len(pair.matches) > found.num_inliers


@pytest.fixture
def refusing(monkeypatch):
    """The surroundings speak against the pose of one pair."""

    def refuse(verdicts, places, *, is_level):
        return tuple(
            replace(v, refused="shows another place") if (v.image1, v.image2) == LOST_NAMES else v
            for v in verdicts
        )

    monkeypatch.setattr(folder_verdicts, "checked", refuse)


def test_a_pair_that_is_refused_with_the_implied_pose_stays_refused(tour, tmp_path, refusing):
    run = match_images(tour, tmp_path)
    assert verdict_on(run).refused == "shows another place"
    assert run.num_by_others == 0


def test_a_refused_pair_is_refused_in_the_kept_result_too(tour, tmp_path, refusing):
    run = match_images(tour, tmp_path)
    accepted = {(v.image1, v.image2) for v in run.verdicts if v.accepted}
    kept = {(p.image1, p.image2): p.geometry for p in load_matches(tmp_path).pairs}
    assert {names for names, each in kept.items() if each.status == "ok"} == accepted
    assert kept[LOST_NAMES].status == "refused"
    own = load_matches(tmp_path, by_others=False)
    (alone,) = [p.geometry for p in own.pairs if (p.image1, p.image2) == LOST_NAMES]
    assert alone.status == "ok"
    np.testing.assert_array_equal(kept[LOST_NAMES].inliers, alone.inliers)


def test_colmap_gets_no_pose_of_a_refused_pair(tour, tmp_path, refusing):
    pytest.importorskip("pycolmap")
    from epi360.interop.colmap_database import read_colmap_database, write_colmap_database

    match_images(tour, tmp_path / "matched")
    write_colmap_database(tmp_path / "a.db", load_matches(tmp_path / "matched"))
    pairs = {(p.image1, p.image2): p for p in read_colmap_database(tmp_path / "a.db").pairs}
    lost = pairs.pop(LOST_NAMES)
    assert lost.geometry.status == "too_few_inliers" and len(lost.geometry.inliers) == 0
    assert len(lost.matches) > 100
    assert all(pair.geometry.status == "ok" for pair in pairs.values())


def test_a_result_that_does_not_say_what_was_refused_must_be_made_again(tour, tmp_path):
    match_images(tour, tmp_path)
    index = json.loads((tmp_path / "images.json").read_text())
    assert index.pop("refused") == []
    (tmp_path / "images.json").write_text(json.dumps(index))
    with pytest.raises(ValueError, match=r"an earlier epi360 made it; run epi360 match, or map,"):
        load_matches(tmp_path)
    assert len(load_matches(tmp_path, by_others=False).pairs) == 6
    match_images(tour, tmp_path)
    assert len(load_matches(tmp_path).pairs) == 6


def test_a_picture_that_is_gone_leaves_doubted_pairs_alone(tour, tmp_path, monkeypatch):
    panorama_of = MatchJob.panorama_of

    def without_first(verified, pair, prior):
        return verified if 0 in pair else doubted(verified)

    def lost(job, index):
        if index == 0:
            raise OSError("gone")
        return panorama_of(job, index)

    judge_otherwise(monkeypatch, without_first)
    monkeypatch.setattr(MatchJob, "panorama_of", lost)
    run = match_images(tour, tmp_path)
    assert [v.accepted for v in run.verdicts if NAMES[0] in (v.image1, v.image2)] == [True] * 3


VERDICTS = tuple(
    PairVerdict(
        image1=NAMES[first],
        image2=NAMES[second],
        status="ok",
        cam2_from_cam1=Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation)),
        rotation_sigma_deg=0.1,
        translation_sigma_deg=0.2,
        probability=0.9 + 0.01 * row,
    )
    for row, (first, second) in enumerate(combinations(range(4), 2))
    for pose in [truth(first, second, False)]
)
KEYS = [(v.image1, v.image2) for v in VERDICTS]
ROW = KEYS.index(LOST_NAMES)


def implied_verdicts(pose, verdicts=VERDICTS, keys=KEYS):
    """Verdicts of which the lost pair has no pose, and gets this one from the first other image."""
    without = list(verdicts)
    without[ROW] = PairVerdict(status="too_few_inliers", image1=NAMES[0], image2=NAMES[2])
    own = Verdict(
        status="ok",
        prior="implied",
        probability=0.5,
        cam2_from_cam1=pose,
        rotation_sigma_deg=np.nan,
        translation_sigma_deg=np.nan,
        doubted=pose,
    )
    by = ((NAMES[0], NAMES[1]), (NAMES[1], NAMES[2]))
    verified = VerifiedPair(LOST_NAMES, own, np.zeros((0, 2), int), np.zeros(0, bool))
    return with_implied(without, keys, {LOST_NAMES: ImpliedPair(verified, by)})


def test_it_is_right_if_both_pairs_are_that_imply_it():
    found = implied_verdicts(VERDICTS[ROW].cam2_from_cam1)
    expected = 0.5 * VERDICTS[KEYS.index((NAMES[0], NAMES[1]))].probability
    expected *= VERDICTS[KEYS.index((NAMES[1], NAMES[2]))].probability
    assert found[ROW].accepted and found[ROW].by_others
    assert found[ROW].probability == pytest.approx(expected)
    assert found[ROW].num_triangles == 2
    assert found[:ROW] == VERDICTS[:ROW]


def test_other_triangles_must_not_be_open():
    turned = list(VERDICTS)
    other = KEYS.index((NAMES[0], NAMES[3]))
    pose = turned[other].cam2_from_cam1
    wrong = Pose(rotation_from_vector([0.0, 0.8, 0.0]) @ pose.rotation, pose.translation)
    turned[other] = replace(turned[other], cam2_from_cam1=wrong)
    found = implied_verdicts(VERDICTS[ROW].cam2_from_cam1, turned)
    assert found[ROW].status == "too_few_inliers"


def test_pairs_of_images_that_cannot_be_read_have_no_keys():
    keys = [*KEYS[:-1], None]
    found = implied_verdicts(VERDICTS[ROW].cam2_from_cam1, VERDICTS, keys)
    assert found[-1] == VERDICTS[-1]
    assert found[ROW].accepted
