# SPDX-License-Identifier: BSD-3-Clause
"""A folder whose poses say that it is level: pairs in doubt are looked at again with that known."""

import csv
import json
from dataclasses import asdict, replace
from itertools import combinations

import numpy as np
import pytest
from level_views import (
    CAMERA,
    NAMES,
    doubted,
    judge_otherwise,
    pictures,
    truth,
    world_from_cam,
    write_tour,
)
from rendered_views import write_png

from epi360.cameras import KannalaBrandt
from epi360.cameras.upright import elevation_deg, tilt_deg
from epi360.cli import SUCCESS, main
from epi360.cli.command import WRONG_USE
from epi360.interop.gpano import gpano_packet, with_gpano
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.graph.level_folder import Level, find_level
from epi360.jobs.matching import folder_verdicts, match_job, place_job, verified_matches
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.jobs.records.match_store import VERDICTS, Verdict
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg
from epi360.report.match_table import describe_match
from epi360.report.pairs_table import pairs_csv

LOST = (0, 2)  # a pair that finds no pose unless it is known to be level
TILTED = (1, 3)  # a pair that finds a wrong one
LEVEL = Level(gravity_sigma_deg=0.5, elevation_sigma_deg=2.0)


def verdict_of(tilt=0.2, turn=80.0, elevation=1.0, **values):
    rotation = rotation_from_vector(np.radians([tilt, 0, 0])) @ rotation_from_vector(
        np.radians([0, turn, 0])
    )
    rise = np.radians(elevation)
    pose = Pose(rotation, np.array([np.cos(rise), -np.sin(rise), 0.0]))
    return Verdict(**{"status": "ok", "probability": 0.999, "cam2_from_cam1": pose, **values})


def test_poses_that_keep_the_vertical_and_the_height_make_a_level_folder():
    level = find_level([verdict_of(turn=20 * k) for k in range(9)] + [verdict_of(tilt=40)])
    assert level == LEVEL
    assert level.prior == "level, one height"


def test_the_sigmas_follow_the_poses_within_limits():
    tilts = [0.5, 1.2, 1.3, 1.4, 2.8]
    level = find_level([verdict_of(tilt=tilt, elevation=2.4) for tilt in tilts])
    assert level.gravity_sigma_deg == pytest.approx(np.sqrt(np.mean(np.square(tilts)) / 2), abs=0.1)
    assert level.elevation_sigma_deg == pytest.approx(1.5 * 2.4, abs=0.1)


def test_stairs_leave_a_folder_level_but_not_of_one_height():
    level = find_level([verdict_of(elevation=20.0 * (k % 2)) for k in range(10)])
    assert level == Level(0.5)
    assert level.prior == "level"


@pytest.mark.parametrize(
    "verdicts",
    [
        [verdict_of() for _ in range(4)],
        [verdict_of() for _ in range(8)] + [verdict_of(tilt=5) for _ in range(2)],
        [verdict_of(tilt=2) for _ in range(10)],
        [verdict_of(probability=0.98) for _ in range(10)],
        [verdict_of(status="too_few_inliers") for _ in range(10)],
        [verdict_of(turn=3) for _ in range(20)] + [verdict_of(tilt=14), verdict_of(tilt=15)],
    ],
    ids=["too few", "some tilted", "all a little", "not sure", "no poses", "askew, straight on"],
)
def test_other_poses_do_not(verdicts):
    assert find_level(verdicts) is None


def test_who_is_asked_again_and_which_answer_is_kept():
    found, lost = verdict_of(), Verdict(status="too_few_inliers")
    turned = Verdict(status="pure_rotation", cam2_from_cam1=Pose(np.eye(3), np.full(3, np.nan)))
    for tilted in (verdict_of(tilt=1.6), verdict_of(elevation=7.0)):
        assert LEVEL.asks_again(tilted)
        assert LEVEL.keeps(tilted, lost)
    assert Level(0.5).fits(verdict_of(elevation=7.0))
    assert LEVEL.asks_again(lost)
    assert LEVEL.keeps(lost, found)
    assert not LEVEL.keeps(lost, turned)
    doubtful = replace(found, warnings=("inliers cover little",))
    assert LEVEL.asks_again(doubtful)
    assert not LEVEL.keeps(doubtful, lost)
    for settled in (found, turned):
        assert not LEVEL.asks_again(settled)


def test_a_pose_is_no_more_probable_than_with_the_prior():
    """Matches of one door with another leave a pose that is level, but hardly another way round."""
    doubtful = replace(verdict_of(probability=0.99), warnings=("inliers cover little",))
    lost = Verdict(status="too_few_inliers", probability=0.8)
    told = LEVEL.told(doubtful, lost)
    assert (told.status, told.probability) == ("ok", 0.8)
    assert told.cam2_from_cam1 is doubtful.cam2_from_cam1
    surer = verdict_of(probability=0.999)
    assert LEVEL.told(doubtful, surer) is surer
    assert LEVEL.told(lost, Verdict(status="too_few_inliers", probability=0.2)) is lost


def test_a_rotation_that_tilts_is_in_doubt_too():
    pose = Pose(rotation_from_vector([0.2, 0.0, 0.0]), np.full(3, np.nan))
    turned = Verdict(status="pure_rotation", cam2_from_cam1=pose)
    assert LEVEL.asks_again(turned)
    assert LEVEL.keeps(turned, Verdict(status="too_few_inliers"))


@pytest.fixture(scope="module")
def tour(tmp_path_factory):
    return write_tour(tmp_path_factory.mktemp("tour"))


@pytest.fixture
def bad_first_look(monkeypatch):
    """The first phase loses a pair and tilts another."""

    def changed(verified, pair, prior):
        if prior or pair not in (LOST, TILTED):
            return verified
        if pair == LOST:
            verdict = Verdict(status="too_few_inliers", num_matches=verified.verdict.num_matches)
        else:
            pose = verified.verdict.cam2_from_cam1
            tilted = Pose(rotation_from_vector([0.0, 0.0, 0.2]) @ pose.rotation, pose.translation)
            verdict = replace(verified.verdict, cam2_from_cam1=tilted, probability=0.9)
        return replace(verified, verdict=verdict)

    judge_otherwise(monkeypatch, changed)
    monkeypatch.setattr("epi360.jobs.graph.level_folder._FEWEST_POSES", 4)  # of the six pairs


@pytest.fixture
def priors(monkeypatch):
    """Number of pairs and prior of every estimate from now on."""
    calls = []
    estimate = verified_matches.estimate_relative_poses

    def noted(pairs, **options):
        calls.append((len(pairs), options.get("gravity_sigma_deg")))
        return estimate(pairs, **options)

    monkeypatch.setattr("epi360.jobs.matching.folder_verdicts.find_rivals", lambda *_: {})
    monkeypatch.setattr(verified_matches, "estimate_relative_poses", noted)
    return calls


def stored(output):
    return {path.relative_to(output): path.read_bytes() for path in output.glob("*/part-*.npz")}


def test_a_level_folder_finds_the_pairs_that_the_first_look_lost(tour, tmp_path, bad_first_look):
    run = match_images(tour, tmp_path)
    assert run.level.prior == "level, one height"
    assert (run.num_gained, run.num_lost) == (1, 0)
    graph = load_matches(tmp_path)
    for verdict, pair, matched in zip(
        run.verdicts, combinations(range(4), 2), graph.pairs, strict=True
    ):
        assert verdict.accepted, verdict
        assert verdict.prior == (run.level.prior if pair in (LOST, TILTED) else "")
        assert rotation_error_deg(verdict.cam2_from_cam1, truth(*pair)) < 0.5
        assert translation_error_deg(verdict.cam2_from_cam1, truth(*pair)) < 1.5
        assert matched.geometry.status == "ok"
        pose = matched.geometry.cam2_from_cam1
        np.testing.assert_array_equal(pose.matrix(), verdict.cam2_from_cam1.matrix())
        assert len(matched.geometry.inliers) == verdict.num_inliers
    line = describe_match(run).splitlines()[-1]
    assert line.startswith("The panoramas are level (tilt 0.5 degrees, one height within 2.")
    assert line.endswith("1 more pair was accepted with that.")
    rows = list(csv.DictReader(pairs_csv(run).decode().splitlines()))
    assert [row["prior"] for row in rows].count("level, one height") == 2
    assert all(0.85 < float(row["probability"]) <= 1 for row in rows)


@pytest.mark.parametrize("calls_before_the_stop", [0, 1])
def test_a_run_that_is_stopped_in_the_second_phase_goes_on_to_the_same_bytes(
    tour, tmp_path, bad_first_look, priors, monkeypatch, calls_before_the_stop
):
    monkeypatch.setattr(match_job, "PAIRS_PER_PART", 2)
    options = MatchOptions(num_threads=1)
    whole = match_images(tour, tmp_path / "whole", options)
    seen = []

    def stop(stage, done, total):
        seen.append(stage)
        if seen.count("level pairs") > calls_before_the_stop:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        match_images(tour, tmp_path / "stopped", options, progress=stop)
    with pytest.raises(FileNotFoundError, match="no complete result"):
        load_matches(tmp_path / "stopped")
    before = stored(tmp_path / "stopped")
    priors.clear()
    again = match_images(tour, tmp_path / "stopped", options)
    assert all(sigma is not None for _, sigma in priors)  # the first phase was complete
    assert pairs_csv(again) == pairs_csv(whole)
    assert before.items() <= stored(tmp_path / "stopped").items()
    assert stored(tmp_path / "stopped") == stored(tmp_path / "whole")
    priors.clear()
    assert pairs_csv(match_images(tour, tmp_path / "stopped", options)) == pairs_csv(whole)
    assert priors == []


def test_a_doubted_pose_that_the_others_confirm_is_the_pose_of_the_pair(
    tour, tmp_path, bad_first_look, monkeypatch
):
    def changed(verified, pair, prior):
        return doubted(verified) if prior and pair == LOST else verified

    judge_otherwise(monkeypatch, changed)
    monkeypatch.setattr(place_job, "_FEW_PAIRS", 0)  # surfaces would clear it without the others
    run = match_images(tour, tmp_path)
    (found,) = [verdict for verdict in run.verdicts if verdict.confirmed]
    assert (found.image1, found.image2) == tuple(NAMES[index] for index in LOST)
    assert found.accepted
    assert run.num_gained == 1
    assert rotation_error_deg(found.cam2_from_cam1, truth(*LOST)) < 0.5
    (matched,) = [
        pair
        for pair in load_matches(tmp_path).pairs
        if (pair.image1, pair.image2) == (found.image1, found.image2)
    ]
    assert matched.geometry.status == "ok"
    pose = matched.geometry.cam2_from_cam1
    np.testing.assert_array_equal(pose.matrix(), found.cam2_from_cam1.matrix())
    assert pairs_csv(match_images(tour, tmp_path)) == pairs_csv(run)


def test_another_prior_is_another_record(tour, tmp_path, bad_first_look, priors, monkeypatch):
    match_images(tour, tmp_path)
    before = stored(tmp_path)
    priors.clear()
    monkeypatch.setattr(folder_verdicts, "find_level", lambda verdicts: Level(1.5))
    (tmp_path / VERDICTS).unlink()
    run = match_images(tour, tmp_path)
    assert priors == [(2, 1.5)]
    assert before.items() < stored(tmp_path).items()
    assert {verdict.prior for verdict in run.verdicts} == {"", "level"}


def test_restart_throws_away_what_was_made_with_a_prior(tour, tmp_path, bad_first_look):
    output, fresh = tmp_path / "output", tmp_path / "fresh"
    match_images(tour, output)
    assert list(output.glob("level-*"))
    match_images(tour, output, MatchOptions(seed=5), restart=True)
    match_images(tour, fresh, MatchOptions(seed=5))
    assert stored(output) == stored(fresh)
    match_images(tour, output, MatchOptions(upright_deg=1.0), restart=True)
    assert not list(output.glob("level-*"))


@pytest.mark.parametrize("tour_is_level", [True, False])
def test_a_folder_that_needs_no_second_phase_is_untouched(
    tmp_path, priors, monkeypatch, tour_is_level
):
    monkeypatch.setattr("epi360.jobs.graph.level_folder._FEWEST_POSES", 4)
    images = write_tour(tmp_path / "tour", tour_is_level)
    stages = []
    run = match_images(images, tmp_path / "out", progress=lambda stage, *_: stages.append(stage))
    assert (run.level is not None) == tour_is_level
    assert ("level pairs" in stages) == tour_is_level
    assert {sigma for _, sigma in priors} == {None}
    assert {path.parent.name for path in stored(tmp_path / "out")} == {"pairs"}
    assert {verdict.prior for verdict in run.verdicts} == {""}
    monkeypatch.setattr(folder_verdicts, "find_level", lambda verdicts: None)
    other = match_images(images, tmp_path / "without")
    assert stored(tmp_path / "without") == stored(tmp_path / "out")
    assert pairs_csv(other) == pairs_csv(run)
    for verdict, pair in zip(run.verdicts, combinations(range(4), 2), strict=True):
        assert verdict.accepted
        right = truth(*pair, is_level=tour_is_level)
        assert rotation_error_deg(verdict.cam2_from_cam1, right) < 0.5


def test_upright_panoramas_are_known_from_the_first_look(tour, tmp_path, priors):
    run = match_images(tour, tmp_path, MatchOptions(upright_deg=0.7))
    assert {sigma for _, sigma in priors} == {0.7}
    assert run.level is None
    assert {verdict.prior for verdict in run.verdicts} == {"upright"}
    assert all(verdict.accepted for verdict in run.verdicts)
    with pytest.raises(ValueError, match=r"made with upright 0\.7, now it is None"):
        match_images(tour, tmp_path)


def test_parts_of_panoramas_are_level_as_well(tmp_path):
    for name, picture in zip(NAMES, pictures(True), strict=True):
        write_png(tmp_path / "parts" / name, picture[:240, 6:-6])
    part = replace(
        CAMERA,
        width=500,
        height=240,
        horizontal_fov_deg=360 * 500 / 512,
        vertical_fov_deg=168.75,
        center_latitude_deg=5.625,
    )
    file = tmp_path / "part.json"
    file.write_text(json.dumps({"model": "Equirectangular", **asdict(part)}))
    run = match_images(find_images(tmp_path / "parts", camera=str(file)), tmp_path / "out")
    assert run.level == LEVEL
    assert run.agreed == ()


def test_what_a_file_states_about_its_pitch_comes_first(tmp_path, monkeypatch):
    write_tour(tmp_path)
    packet = gpano_packet(CAMERA, pitch_deg=10.0)
    for name in NAMES[:2]:
        path = tmp_path / name
        path.write_bytes(with_gpano(path.read_bytes(), packet))
    given = []
    estimate = verified_matches.estimate_relative_poses

    def noted(pairs, **options):
        given.extend(zip(options["gravity1"], options["gravity2"], strict=True))
        return estimate(pairs, **options)

    monkeypatch.setattr("epi360.jobs.matching.folder_verdicts.find_rivals", lambda *_: {})
    monkeypatch.setattr(verified_matches, "estimate_relative_poses", noted)
    match_images(find_images(tmp_path), tmp_path / "out", MatchOptions(upright_deg=1.0))
    pitched = [0.0, np.cos(np.radians(10)), -np.sin(np.radians(10))]
    np.testing.assert_allclose(given[0], [pitched, pitched], atol=1e-12)
    np.testing.assert_allclose(given[1], [pitched, [0, 1, 0]], atol=1e-12)


def test_only_panoramas_can_be_upright(tour, tmp_path):
    fisheye = KannalaBrandt(512, 256, 100, 100, 256, 128)
    images = replace(tour, cameras=dict.fromkeys(tour.cameras, fisheye))
    with pytest.raises(ValueError, match=r"--upright needs panoramas.*0\.png.*KannalaBrandt"):
        match_images(images, tmp_path, MatchOptions(upright_deg=1.0))
    with pytest.raises(ValueError, match=r"--upright must be in \(0, 45\]"):
        MatchOptions(upright_deg=0.0)


def test_tilt_and_elevation_are_what_they_are_called():
    pose = world_from_cam(0, is_level=False)
    assert tilt_deg(pose.rotation) == pytest.approx(np.degrees(0.15), abs=1e-9)
    assert elevation_deg(np.array([3.0, -4.0, 0.0])) == pytest.approx(np.degrees(np.arctan2(4, 3)))


def test_the_map_of_a_level_folder_says_so_and_takes_its_pairs(
    tour, tmp_path, bad_first_look, capsys
):
    pytest.importorskip("pycolmap")
    words = ["map", str(tour.folder), "--output", str(tmp_path / "out")]
    assert main(words) == SUCCESS
    printed = capsys.readouterr().out
    assert "registered   4 of 4 images" in printed
    assert "The panoramas are level (tilt 0.5 degrees, one height within 2." in printed
    assert main([*words, "--upright", "60"]) == WRONG_USE
    assert "--upright must be in (0, 45] degrees, got 60.0" in capsys.readouterr().err
