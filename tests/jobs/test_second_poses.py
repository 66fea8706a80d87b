# SPDX-License-Identifier: BSD-3-Clause
"""A pair whose first pose is refused gets the one that its other matches agree on."""

from dataclasses import dataclass, replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from level_views import CAMERA, NAMES, judge_otherwise, truth, write_tour

from epi360.jobs.graph.place_verdict import PlaceVerdict
from epi360.jobs.matching import place_job
from epi360.jobs.matching.implied_job import ImpliedPair
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.jobs.matching.match_job import MatchJob
from epi360.jobs.matching.pair_verdicts import PairVerdict, with_implied, with_second
from epi360.jobs.matching.pair_work import PairWork
from epi360.jobs.matching.second_poses import SECOND, SecondPair
from epi360.jobs.matching.verify_pairs import verify_pairs, without_geometries
from epi360.jobs.records.match_store import Verdict, VerifiedPair
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg
from epi360.report.match_table import describe_match
from epi360.report.pairs_table import pairs_csv

LOST = (0, 2)
LOST_NAMES = (NAMES[0], NAMES[2])
TURN = rotation_from_vector([0.0, 0.8, 0.0])


def unit(pose):
    return Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))


def turned(pose):
    return Pose(TURN @ pose.rotation, pose.translation)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tour")


@pytest.fixture(scope="module")
def tour(folder):
    return write_tour(folder / "pictures", is_level=False)


@pytest.fixture(autouse=True)
def nothing_is_implied(monkeypatch):
    """Second poses only: two other pairs would imply the same, and no rivals are asked."""
    for name in ("find_implied", "find_rivals"):
        monkeypatch.setattr(f"epi360.jobs.matching.folder_verdicts.{name}", lambda *_: {})


@pytest.fixture
def lost(monkeypatch):
    """The first look at one pair agrees with a wrong pose, by every third match of the right one.

    What is returned changes the first look, and by "second" what is found from the other matches;
    only "left" of these are left, if it is given.
    """
    changes = {"second": {}, "left": None}

    def changed(verified, pair, prior):
        if pair != LOST:
            return verified
        if prior == "second":
            return replace(verified, verdict=replace(verified.verdict, **changes["second"]))
        pose = turned(verified.verdict.cam2_from_cam1)
        values = {key: value for key, value in changes.items() if key not in ("second", "left")}
        verdict = replace(verified.verdict, **{"cam2_from_cam1": pose, **values})
        mask = verified.inlier_mask & (np.arange(len(verified.matches)) % 3 == 0)
        if changes["left"] is not None:
            mask = np.arange(len(mask)) >= changes["left"]
        return replace(verified, verdict=verdict, inlier_mask=mask)

    judge_otherwise(monkeypatch, changed)
    return changes


def verdict_on(run):
    (found,) = [v for v in run.verdicts if (v.image1, v.image2) == LOST_NAMES]
    return found


def is_right(pose):
    wanted = truth(*LOST, False)
    return rotation_error_deg(pose, wanted) < 0.5 and translation_error_deg(pose, wanted) < 1.5


def test_the_other_matches_give_a_pair_its_pose(tour, tmp_path, lost):
    run = match_images(tour, tmp_path)
    found = verdict_on(run)
    assert found.accepted and is_right(found.cam2_from_cam1)
    assert (found.prior, found.warnings[-1], found.accepted_for) == ("second", SECOND, SECOND)
    assert found.probability > 0.9 and found.num_triangles == 2
    assert run.num_by_others == 1
    assert "1 more pair was accepted because of what other pairs know" in describe_match(run)
    assert SECOND in pairs_csv(run).decode()


def test_it_is_named_to_what_looks_for_implied_poses(tour, tmp_path, lost, monkeypatch):
    """They take nothing from it: see `find_implied`."""
    named = []
    monkeypatch.setattr(
        "epi360.jobs.matching.folder_verdicts.find_implied",
        lambda settled, accepted, second: (
            named.extend(settled.images[each] for each in second) or {}
        ),
    )
    match_images(tour, tmp_path)
    assert named == [LOST]


def test_the_kept_result_has_that_pose_and_its_inliers(tour, tmp_path, lost):
    run = match_images(tour, tmp_path)
    found = verdict_on(run)
    pairs = [
        {(p.image1, p.image2): p for p in load_matches(tmp_path, by_others=by_others).pairs}
        for by_others in (True, False)
    ]
    kept, own = (each[LOST_NAMES] for each in pairs)
    assert kept.geometry.status == own.geometry.status == "ok"
    np.testing.assert_array_equal(
        kept.geometry.cam2_from_cam1.matrix(), found.cam2_from_cam1.matrix()
    )
    assert not is_right(own.geometry.cam2_from_cam1)
    np.testing.assert_array_equal(kept.matches, own.matches)
    inliers = {tuple(match) for match in kept.geometry.inliers.tolist()}
    assert len(inliers) == found.num_inliers > 50
    assert not inliers & {tuple(match) for match in own.geometry.inliers.tolist()}
    assert pairs_csv(match_images(tour, tmp_path)) == pairs_csv(run)


@pytest.mark.parametrize("is_level", [False, True])
def test_what_is_known_of_a_level_folder_is_known_of_second_poses(tmp_path, monkeypatch, is_level):
    known = {}
    estimated = PairWork.estimated

    def listened(work, matched, prior, **options):
        if prior == "second":
            known.update(options, was_asked=True)
        return estimated(work, matched, prior, **options)

    def loses_every_second_inlier(verified, pair, prior):
        if pair != LOST or prior == "second":
            return verified
        verdict = replace(
            verified.verdict, status="too_few_inliers", probability=0.0, cam2_from_cam1=Pose.nan()
        )
        return replace(
            verified, verdict=verdict, inlier_mask=np.arange(len(verified.matches)) % 2 == 0
        )

    monkeypatch.setattr(PairWork, "estimated", listened)
    judge_otherwise(monkeypatch, loses_every_second_inlier)
    run = match_images(write_tour(tmp_path / "level", is_level=is_level), tmp_path / "out")
    assert known.pop("was_asked")
    assert known == ({} if run.level is None else run.level.known)
    assert (run.level is not None) == is_level
    known.clear()
    upright = MatchOptions(upright_deg=1.0)
    match_images(write_tour(tmp_path / "level", is_level=is_level), tmp_path / "out2", upright)
    assert known.keys() == {"gravity1", "gravity2", "gravity_sigma_deg", "was_asked"}


@pytest.mark.parametrize("status", ["too_few_inliers", "planar_ambiguous"])
def test_a_pair_whose_matches_settled_nothing_gets_one_too(tour, tmp_path, lost, status):
    lost.update(status=status, cam2_from_cam1=Pose.nan())
    found = verdict_on(match_images(tour, tmp_path))
    assert found.accepted and found.prior == "second"


def test_a_camera_that_has_turned_has_no_second_pose(tour, tmp_path, lost):
    lost.update(status="pure_rotation")
    assert verdict_on(match_images(tour, tmp_path)).status == "pure_rotation"


@pytest.mark.parametrize("status", ["too_few_inliers", "concentrated_inliers"])
def test_a_pose_that_its_inliers_leave_a_doubt_about_may_be_the_second(
    tour, tmp_path, lost, status
):
    right = unit(truth(*LOST, False))
    lost["second"] = {
        "status": status,
        "cam2_from_cam1": Pose.nan(),
        "doubted": right,
        "rotation_sigma_deg": np.nan,
        "translation_sigma_deg": np.nan,
    }
    found = verdict_on(match_images(tour, tmp_path / "sure"))
    assert found.accepted and is_right(found.cam2_from_cam1)
    assert np.isnan(found.rotation_sigma_deg)
    lost["second"]["probability"] = 0.5
    assert not verdict_on(match_images(tour, tmp_path / "doubtful")).accepted


def test_a_wrong_pose_is_not_accepted(tour, tmp_path, lost):
    right = unit(truth(*LOST, False))
    lost["second"] = {"cam2_from_cam1": Pose(TURN.T @ right.rotation, right.translation)}
    found = verdict_on(match_images(tour, tmp_path))
    assert not found.accepted and found.prior == ""


@pytest.mark.parametrize("refused", ["", "may show a copy of the place"])
def test_the_surroundings_must_speak_for_it(tour, tmp_path, lost, monkeypatch, refused):
    place = PlaceVerdict(0.96, refused=refused)
    monkeypatch.setattr(place_job.Places, "on_more", lambda _, posed: [place] * len(posed))
    assert (verdict_on(match_images(tour, tmp_path)).prior == "second") == (refused == "")


def test_the_first_pose_is_no_second_one(tour, tmp_path, lost):
    """What it says has been refused, though more of its matches may be found."""
    right = unit(truth(*LOST, False))
    lost.update(cam2_from_cam1=right, status="too_few_inliers")
    assert not verdict_on(match_images(tour, tmp_path)).accepted


@pytest.mark.parametrize(("num_left", "is_asked"), [(14, False), (15, True)])
def test_too_few_matches_are_not_asked(tour, tmp_path, lost, monkeypatch, num_left, is_asked):
    lost.update(left=num_left)
    asked = []
    monkeypatch.setattr(MatchJob, "estimated", lambda _, matched, *__: asked.extend(matched) or {})
    assert not verdict_on(match_images(tour, tmp_path)).accepted
    assert [len(each.matches) for _, each in asked] == [num_left] * is_asked


def test_without_surfaces_there_are_no_second_poses(tour, tmp_path, lost, monkeypatch):
    """In a large folder only points are asked, where these agree."""
    monkeypatch.setattr(place_job, "_FEW_PAIRS", 0)
    monkeypatch.setattr(place_job, "leave_a_doubt", lambda *_: False)
    assert verdict_on(match_images(tour, tmp_path)).prior == ""


def test_a_picture_that_is_gone_meanwhile_leaves_the_pair_as_it_was(
    tour, tmp_path, lost, monkeypatch
):
    monkeypatch.setattr(place_job.Places, "on_more", lambda _, posed: [None] * len(posed))
    found = verdict_on(match_images(tour, tmp_path))
    assert not found.accepted and found.prior == ""


@dataclass(frozen=True)
class PicturesOf:
    """What is known of pairs, some of whose pictures are gone."""

    pairs: tuple
    gone: tuple

    def of_points(self, row):
        if row in self.gone:
            raise place_job.PictureGoneError
        return row


@pytest.mark.parametrize("gone", [(), (3,), (2, 4), (2, 3, 4)])
def test_poses_of_other_pictures_are_judged_where_one_is_gone(monkeypatch, gone):
    monkeypatch.setattr(
        place_job, "_with_surfaces", lambda *arguments: (list(arguments[2].values()), {})
    )
    judged = SimpleNamespace(on_doubted=lambda told: [f"on {row}" for row in told])
    places = place_job.Places({}, 2, PicturesOf((None, None), gone), {}, judged)
    told = places.on_more([None] * 3)
    assert told == [None if row in gone else f"on {row}" for row in (2, 3, 4)]
    assert places.on_more([]) == []


def with_a_copy(graph):
    """The graph, where more matches of the pair agree on a turned pose than on the right one."""
    rng = np.random.default_rng(0)
    pairs = {(p.image1, p.image2): p for p in graph.pairs}
    lost = pairs[LOST_NAMES]
    count = 3 * len(lost.matches)
    bearings = rng.normal(size=(count, 3))
    points = bearings / np.linalg.norm(bearings, axis=1, keepdims=True)
    points *= rng.uniform(0.5, 5.0, (count, 1))
    pose = turned(unit(truth(*LOST, False)))
    both = points, points @ pose.rotation.T + pose.translation
    images, rows = dict(graph.images), []
    for name, seen in zip(LOST_NAMES, both, strict=True):
        before = images[name].keypoints
        rows.append(len(before) + np.arange(count))
        keypoints = np.concatenate([before, CAMERA.pixels_from_bearings(seen)])
        images[name] = replace(images[name], keypoints=keypoints)
    matches = np.concatenate([lost.matches, np.column_stack(rows)])
    pairs[LOST_NAMES] = replace(lost, matches=matches)
    return replace(graph, images=images, pairs=tuple(pairs.values()))


def is_copied(graph, inliers):
    """Which inliers are of the matches that `with_a_copy` has added."""
    (pair,) = [p for p in graph.pairs if (p.image1, p.image2) == LOST_NAMES]
    return inliers[:, 0] >= len(graph.images[LOST_NAMES[0]].keypoints) - 3 * len(pair.matches) // 4


def test_given_matches_of_a_copy_do_not_hide_the_others(tour, folder):
    match_images(tour, folder / "matched")
    graph = with_a_copy(load_matches(folder / "matched", by_others=False))
    (alone,) = [
        p.geometry
        for p in verify_pairs(without_geometries(graph)).graph.pairs
        if (p.image1, p.image2) == LOST_NAMES
    ]
    assert not is_right(alone.cam2_from_cam1)
    found = verify_pairs(without_geometries(graph), pictures=folder / "pictures")
    (pair,) = [p for p in found.graph.pairs if (p.image1, p.image2) == LOST_NAMES]
    assert pair.geometry.status == "ok" and is_right(pair.geometry.cam2_from_cam1)
    assert not is_copied(graph, pair.geometry.inliers).any()
    assert is_copied(graph, alone.inliers).all()
    assert verdict_on(found).prior == "second"


VERDICTS = tuple(
    PairVerdict(
        image1=NAMES[first],
        image2=NAMES[second],
        status="ok",
        cam2_from_cam1=unit(truth(first, second, False)),
        rotation_sigma_deg=0.1,
        translation_sigma_deg=0.2,
        probability=0.97,
    )
    for first, second in combinations(range(4), 2)
)
KEYS = [(v.image1, v.image2) for v in VERDICTS]
ROW = KEYS.index(LOST_NAMES)


def lacking(*rows):
    """Verdicts of which some pairs have no pose."""
    none = {
        row: PairVerdict(status="too_few_inliers", image1=a, image2=b)
        for row, (a, b) in enumerate(KEYS)
        if row in rows
    }
    return [none.get(row, each) for row, each in enumerate(VERDICTS)]


BY = ((NAMES[0], NAMES[1]), (NAMES[1], NAMES[2]))  # pairs that imply the lost one


def second_of(row, *, pose=None, probability=1.0, place=0.99, **values):
    pose = VERDICTS[row].cam2_from_cam1 if pose is None else pose
    made = {"rotation_sigma_deg": 0.1, "translation_sigma_deg": 0.2, **values}
    own = Verdict(status="ok", prior="second", probability=probability, cam2_from_cam1=pose, **made)
    verified = VerifiedPair(KEYS[row], own, np.zeros((0, 2), int), np.zeros(0, bool))
    return SecondPair(verified, PlaceVerdict(place))


def test_its_probability_is_that_of_its_matches_and_its_surroundings():
    found = with_second(
        lacking(ROW), KEYS, {LOST_NAMES: second_of(ROW, probability=0.9)}, is_level=False
    )
    assert found[ROW].accepted and found[ROW].by_others and found[ROW].has_other_pose
    assert found[ROW].probability == pytest.approx(0.9 * 0.99)
    assert found[ROW].num_triangles == 2
    others = [row for row in range(len(KEYS)) if row != ROW]
    assert all(found[row] is VERDICTS[row] for row in others)


def test_a_pair_that_is_accepted_keeps_its_pose():
    pose = turned(VERDICTS[ROW].cam2_from_cam1)
    found = with_second(VERDICTS, KEYS, {LOST_NAMES: second_of(ROW, pose=pose)}, is_level=False)
    assert found == VERDICTS


@pytest.mark.parametrize("sigma_deg", [0.1, np.nan])
def test_an_open_triangle_speaks_against_it(sigma_deg):
    pose = turned(VERDICTS[ROW].cam2_from_cam1)
    sigmas = {"rotation_sigma_deg": sigma_deg, "translation_sigma_deg": sigma_deg}
    found = with_second(
        lacking(ROW), KEYS, {LOST_NAMES: second_of(ROW, pose=pose, **sigmas)}, is_level=False
    )
    assert found[ROW].status == "too_few_inliers"


def test_the_surest_is_tried_first_and_counts_for_the_next():
    """Two pairs close triangles with the others, but only one of them is of the right pose."""
    first, second = KEYS.index((NAMES[0], NAMES[1])), KEYS.index((NAMES[0], NAMES[2]))
    away = [row for row, names in enumerate(KEYS) if NAMES[0] in names]
    for sure in (first, second):
        poor = second if sure == first else first
        told = {
            KEYS[sure]: second_of(sure),
            KEYS[poor]: second_of(poor, pose=turned(VERDICTS[poor].cam2_from_cam1), place=0.96),
        }
        found = with_second(lacking(*away), KEYS, told, is_level=False)
        assert found[sure].accepted and not found[poor].accepted


@pytest.mark.parametrize(("probability", "fits"), [(0.96, True), (0.9, False)])
def test_what_joins_groups_alone_must_be_probable_by_its_own_matches(probability, fits):
    away = [row for row, names in enumerate(KEYS) if NAMES[0] in names]
    found = with_second(
        lacking(*away), KEYS, {LOST_NAMES: second_of(ROW, probability=probability)}, is_level=False
    )
    assert found[ROW].accepted == fits


@pytest.mark.parametrize("sigma_deg", [0.1, np.nan])
def test_accepted_pairs_that_state_no_errors_speak_against_it(sigma_deg):
    """So do doubted poses that are accepted for their surroundings."""
    sigmas = {"rotation_sigma_deg": sigma_deg, "translation_sigma_deg": sigma_deg}
    verdicts = [replace(each, **sigmas) if each.accepted else each for each in lacking(ROW)]
    pose = turned(VERDICTS[ROW].cam2_from_cam1)
    found = with_second(verdicts, KEYS, {LOST_NAMES: second_of(ROW, pose=pose)}, is_level=False)
    assert not found[ROW].accepted
    found = with_second(verdicts, KEYS, {LOST_NAMES: second_of(ROW)}, is_level=False)
    assert found[ROW].num_triangles == 2


@pytest.mark.parametrize(("is_level", "probability"), [(False, 0.96), (True, 0.9995)])
def test_in_a_level_folder_one_on_the_floor_must_be_more_probable(is_level, probability):
    away = [row for row, names in enumerate(KEYS) if NAMES[0] in names]
    for told, fits in ((probability, True), (probability - 0.02, False)):
        second = second_of(ROW, probability=told, floor_share=1.0)
        found = with_second(lacking(*away), KEYS, {LOST_NAMES: second}, is_level=is_level)
        assert found[ROW].accepted == fits


def test_pairs_with_a_second_pose_imply_others():
    """A triangle through a second pose that states no errors confirms what it implies."""
    third = KEYS.index((NAMES[1], NAMES[2]))
    sigmas = {"rotation_sigma_deg": np.nan, "translation_sigma_deg": np.nan}
    others = [row for row in range(len(KEYS)) if row not in (ROW, third, KEYS.index(BY[0]))]
    second = {KEYS[third]: second_of(third, probability=0.99, **sigmas)}
    verdicts = with_second(lacking(ROW, third, *others), KEYS, second, is_level=False)
    assert verdicts[third].accepted
    implied = ImpliedPair(second_of(ROW).verified, BY)
    found = with_implied(verdicts, KEYS, {LOST_NAMES: implied})
    assert found[ROW].accepted and found[ROW].num_triangles == 1
