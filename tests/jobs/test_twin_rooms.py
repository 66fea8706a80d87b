# SPDX-License-Identifier: BSD-3-Clause
"""Rendered rooms that are copies of each other: `match_images` tells them apart."""

import csv

import cv2
import numpy as np
import pytest
from rendered_views import write_png, write_views
from twin_rooms import exposed_and_visited, rooms, truth, write_rooms

from epi360 import rotation_error_deg, translation_error_deg
from epi360.jobs.folder import panoramas
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.graph.place_evidence import Surroundings
from epi360.jobs.matching import folder_verdicts, place_job
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.poses import rotation_from_vector
from epi360.report.folder_page import summary_sentences
from epi360.report.match_table import describe_match
from epi360.report.pairs_table import pairs_csv
from epi360_scenes.lenses import Lens

ALL = MatchOptions(pairs="exhaustive")
POSED = ("ok", "refused")  # whose matches agree with a pose


def is_right(verdict):
    pose, wanted = verdict.cam2_from_cam1, truth(verdict.image1, verdict.image2)
    errors = rotation_error_deg(pose, wanted), translation_error_deg(pose, wanted)
    return max(errors) < 2


def in_one_room(verdict):
    return verdict.image1[0] == verdict.image2[0]


@pytest.fixture(scope="module", params=[None, exposed_and_visited])
def run(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rooms")
    return match_images(write_rooms(folder / "a", changed=request.param), folder / "out", ALL)


def test_pairs_of_one_room_are_accepted_and_right(run):
    pairs = [verdict for verdict in run.verdicts if in_one_room(verdict)]
    assert len(pairs) == 6
    assert all(verdict.accepted and is_right(verdict) for verdict in pairs)


def test_pairs_of_twin_rooms_are_refused_though_their_matches_agree(run):
    between = [v for v in run.verdicts if not in_one_room(v) and v.status in POSED]
    between = [v for v in between if v.image1[1] != v.image2[1]]  # seen from other places
    assert len(between) >= 5
    alone = [v.explanations.surface + v.explanations.motion for v in between]
    assert min(alone) > 0.95
    assert max(verdict.probability for verdict in between) < 0.5
    assert all(verdict.refused.startswith("shows another place") for verdict in between)
    # Pairs within one of both rooms say so.
    assert all(verdict.contradicted_by for verdict in between)
    named = [pair for verdict in between for pair in verdict.contradicted_by]
    assert all(first[0] == second[0] for first, second in named)


def test_cameras_at_the_same_place_of_both_rooms_have_not_turned(run):
    same = [v for v in run.verdicts if v.image1[1] == v.image2[1]]
    assert [v.status for v in same] == ["refused"] * 3
    assert min(v.explanations.rotation for v in same) > 0.95
    assert all(v.refused.startswith("shows another place, as other pairs say") for v in same)
    assert all(a[0] != b[0] for v in same for a, b in v.contradicted_by)
    assert all(v.contradicted_by and "does not fit" in v.warnings[-1] for v in same)
    kept = {(p.image1, p.image2): p.geometry for p in load_matches(run.folder).pairs}
    assert all(kept[v.image1, v.image2].status == "refused" for v in same)


def test_the_table_and_the_summary_say_why(run):
    rows = list(csv.DictReader(pairs_csv(run).decode().splitlines()))
    told = {(row["status"], row["accepted"]) for row in rows}
    assert told == {("ok", "yes"), ("refused", "no")}
    assert "parts of the views that both cameras must see look the same" in pairs_csv(run).decode()
    assert "shows another place" in describe_match(run)


def test_one_room_loses_no_pair_to_other_exposures_and_people(tmp_path):
    images = write_rooms(tmp_path / "a", letters="a", changed=exposed_and_visited)
    run = match_images(images, tmp_path / "out", ALL)
    assert all(verdict.accepted and is_right(verdict) for verdict in run.verdicts)


def test_fisheye_frames_of_twin_rooms_are_told_apart(tmp_path):
    for name, (pose, picture) in rooms().items():
        towards = pose.rotation.T @ rotation_from_vector([0.0, 2.6, 0.0])
        lens = Lens.of(200.0, 768, towards)
        write_png(tmp_path / "a" / name, lens.picture(picture))
    lens.write_camera(tmp_path / "lens.yaml")
    images = find_images(tmp_path / "a", camera=str(tmp_path / "lens.yaml"))
    run = match_images(images, tmp_path / "out", ALL)
    agreeing = [verdict for verdict in run.verdicts if verdict.status in POSED]
    assert sum(not in_one_room(verdict) for verdict in agreeing) >= 4
    assert [verdict.accepted for verdict in agreeing] == list(map(in_one_room, agreeing))
    assert sum(verdict.accepted for verdict in agreeing) == 6


def test_small_panoramas_of_twin_rooms_are_told_apart(tmp_path):
    """Alone, two panoramas of that size are not compared."""
    for name, (_, picture) in rooms().items():
        small = cv2.resize(picture, (496, 248), interpolation=cv2.INTER_AREA)
        write_png(tmp_path / "a" / name, small)
    run = match_images(find_images(tmp_path / "a"), tmp_path / "out", ALL)
    assert all(in_one_room(verdict) for verdict in run.verdicts if verdict.accepted)
    assert sum(verdict.accepted for verdict in run.verdicts) == 6


def test_a_second_run_says_the_same_on_one_thread(tmp_path):
    images = write_rooms(tmp_path / "a")
    runs = [
        match_images(images, tmp_path / "out", MatchOptions(pairs="exhaustive", num_threads=count))
        for count in (2, 1)
    ]
    assert pairs_csv(runs[0]) == pairs_csv(runs[1])


def test_a_picture_that_is_gone_costs_only_the_check(tmp_path, monkeypatch):
    write_views(tmp_path / "a")
    expected = match_images(find_images(tmp_path / "a"), tmp_path / "first", ALL)

    def lost(path, mask):
        raise OSError("gone")

    monkeypatch.setattr(panoramas, "read_masked_image", lost)
    run = match_images(find_images(tmp_path / "a"), tmp_path / "second", ALL)
    assert [v.accepted for v in run.verdicts] == [v.accepted for v in expected.verdicts]


def test_an_error_in_the_check_itself_is_no_picture_that_is_gone(tmp_path, monkeypatch):
    """Otherwise the pair would be accepted without a word."""
    write_views(tmp_path / "a")

    def broken(*_):
        raise ValueError("a defect")

    monkeypatch.setattr(Surroundings, "of_points", broken)
    with pytest.raises(ValueError, match="a defect"):
        match_images(find_images(tmp_path / "a"), tmp_path / "out", ALL)


def test_surroundings_of_too_many_pairs_are_said_to_be_unknown(tmp_path, monkeypatch):
    for module in (place_job, folder_verdicts):
        monkeypatch.setattr(module, "MOST_PAIRS", 5)
    run = match_images(write_rooms(tmp_path / "a"), tmp_path / "out", ALL)
    wrong = [v for v in run.verdicts if v.accepted and not in_one_room(v)]
    assert wrong and run.num_not_compared == sum(v.accepted for v in run.verdicts)
    said = f"The surroundings of {run.num_not_compared} accepted pairs were not"
    assert said in describe_match(run)
    assert any(each.startswith(said) for each in summary_sentences(run))


@pytest.mark.parametrize("alone", ["b1", "b2"])
def test_pairs_with_one_panorama_of_the_other_room_do_not_vouch_for_each_other(tmp_path, alone):
    """They say the same, so that they know the same of the other room: what they agree in."""
    write_rooms(tmp_path / "a", letters="a")
    write_png(tmp_path / "a" / f"{alone}.png", rooms()[f"{alone}.png"][1])
    run = match_images(find_images(tmp_path / "a"), tmp_path / "out", ALL)
    claimed = [v for v in run.verdicts if not in_one_room(v) and v.status in POSED]
    assert len(claimed) >= 2
    assert [v.accepted for v in run.verdicts] == [in_one_room(v) for v in run.verdicts]


def test_what_a_mask_leaves_out_speaks_against_nobody(tmp_path):
    """The roof of a car fills two fifths of each picture, at the same place in all."""
    texture = np.random.default_rng(0).integers(0, 255, (60, 160, 3)).astype(np.uint8)
    roof = cv2.resize(texture, (768, 384), interpolation=cv2.INTER_CUBIC)
    top = 230
    write_rooms(tmp_path / "a", changed=lambda _, picture: np.vstack([picture[:top], roof[top:]]))
    mask = np.full((384, 768, 3), 255, np.uint8)
    mask[top:] = 0
    write_png(tmp_path / "mask.png", mask)
    images = find_images(tmp_path / "a", mask=tmp_path / "mask.png")
    run = match_images(images, tmp_path / "out", ALL)
    assert [v.accepted for v in run.verdicts] == [in_one_room(v) for v in run.verdicts]
