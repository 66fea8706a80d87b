# SPDX-License-Identifier: BSD-3-Clause
"""A folder whose pairs agree on other angles than those of its camera is matched by these."""

import json
import re
from dataclasses import asdict, replace

import numpy as np
import pytest
from mapped_room import room_poses, write_picture

from epi360.cameras import Equirectangular, KannalaBrandt, Pinhole, load_cameras
from epi360.cameras.changed_camera import OF_LENS, changed_lens, what_changed
from epi360.cli import SUCCESS, main
from epi360.estimation.angle_changes import AngleChange
from epi360.estimation.shared_angles import OF_GIVEN, SharedAngles
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching import agreed_cameras, pair_work
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360_scenes import furnished_room

TOO_NARROW = {"horizontal_fov_deg": 350.0}
TRUE_LENS = KannalaBrandt(360, 360, 130.0, 130.0, 181.0, 178.0, 0.02, -0.008, max_angle_deg=90.0)


def write_camera(path, camera, **changes):
    camera = replace(camera, **changes)
    path.write_text(json.dumps({"model": type(camera).__name__, **asdict(camera)}))
    return str(path)


def errors_deg(run, truth):
    pairs = [
        (each.cam2_from_cam1, truth[each.image2].inverse() @ truth[each.image1])
        for each in run.verdicts
        if each.accepted
    ]
    return np.array([[rotation_error_deg(*pair), translation_error_deg(*pair)] for pair in pairs])


@pytest.fixture(scope="module")
def narrow(room_folder, tmp_path_factory):
    """The rendered room, whose panoramas are taken for 350 degrees."""
    folder, truth = room_folder
    camera = tmp_path_factory.mktemp("camera") / "camera.json"
    return folder, truth, write_camera(camera, Equirectangular(512, 256), **TOO_NARROW)


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    return tmp_path_factory.mktemp("agreed") / "matches"


@pytest.fixture(scope="module")
def run(narrow, output):
    folder, _, camera = narrow
    return match_images(find_images(folder, camera=camera), output)


@pytest.fixture(scope="module")
def kept(narrow, tmp_path_factory):
    folder, _, camera = narrow
    output = tmp_path_factory.mktemp("kept") / "matches"
    images = find_images(folder, camera=camera)
    return match_images(images, output, MatchOptions(keep_cameras=True))


def test_the_panoramas_are_matched_by_what_the_pairs_agree_on(run, narrow):
    assert run.cameras == {"camera": Equirectangular(512, 256)}
    assert run.agreed == ("camera: 360.0 degrees around, not 350",)
    assert np.median(errors_deg(run, narrow[1]), axis=0).max() < 0.2


def test_cameras_that_shall_be_kept_are(kept, narrow):
    assert kept.cameras == {"camera": Equirectangular(512, 256, **TOO_NARROW)}
    assert kept.agreed == ()
    assert np.median(errors_deg(kept, narrow[1]), axis=0).min() > 1.0


def test_the_output_holds_the_cameras_that_it_was_matched_by(run, output):
    assert load_cameras(output / "cameras.json") == run.cameras
    graph = load_matches(output)
    assert graph.cameras == run.cameras
    accepted = [pair for pair in graph.pairs if pair.geometry.status == "ok"]
    assert len(accepted) == sum(each.accepted for each in run.verdicts)


def test_right_panoramas_are_matched_once(room_folder, tmp_path, monkeypatch):
    verified = []
    monkeypatch.setattr(
        pair_work, "verified_matches", _counting(verified, pair_work.verified_matches)
    )
    run = match_images(find_images(room_folder[0]), tmp_path / "out")
    assert run.agreed == ()
    pairs = [keys for pairs in verified for keys in pairs]
    assert len(pairs) < 2 * len(run.verdicts)  # with all key points some are verified twice


def _counting(counts, verify):
    def counted(pairs, *args, **options):
        counts.append([pair.keys for pair in pairs])
        return verify(pairs, *args, **options)

    return counted


def test_a_second_run_only_reads(run, narrow, output, monkeypatch):
    folder, _, camera = narrow
    monkeypatch.setattr(pair_work, "verified_matches", None)
    monkeypatch.setattr("epi360.jobs.matching.folder_verdicts.find_rivals", lambda *_: {})
    again = match_images(find_images(folder, camera=camera), output)
    assert again.agreed == run.agreed
    assert again.num_found == len(again.verdicts)
    assert [each.status for each in again.verdicts] == [each.status for each in run.verdicts]


def test_threads_do_not_show(run, narrow, output, tmp_path):
    folder, _, camera = narrow
    other = tmp_path / "other"
    match_images(find_images(folder, camera=camera), other, MatchOptions(num_threads=1))
    assert (other / "cameras.json").read_bytes() == (output / "cameras.json").read_bytes()
    assert (other / "images.json").read_bytes() == (output / "images.json").read_bytes()


def test_cameras_by_which_matches_agree_less_closely_are_given_up(narrow, tmp_path, monkeypatch):
    folder, _, camera = narrow
    worse = AngleChange(1, "horizontal", -0.2, 0.001)
    none = [AngleChange(1, name, 0.0, 0.001) for name in ("vertical", "middle")]

    def misled(*_):
        return SharedAngles([[worse, *none]], np.ones(9), [(0, 0)] * 9)

    monkeypatch.setattr(agreed_cameras, "fit_shared_angles", misled)
    run = match_images(find_images(folder, camera=camera), tmp_path / "out")
    assert run.cameras["camera"].horizontal_fov_deg == 350.0
    assert run.agreed == ()
    assert any(each.accepted for each in run.verdicts)
    assert run.num_found == 0


def test_the_command_says_so_and_can_be_told_not_to(narrow, tmp_path, capsys):
    folder, _, camera = narrow
    words = ["match", str(folder), "--camera", camera, "--output", str(tmp_path / "out")]
    assert main(words) == SUCCESS
    said = " ".join(capsys.readouterr().out.split())
    assert "The pairs agree on other angles of camera: 360.0 degrees around, not 350." in said
    assert "--keep-cameras keeps those that were given" in said
    assert main([*words, "--keep-cameras"]) == SUCCESS
    said = " ".join(capsys.readouterr().out.split())
    assert "The pairs agree on other angles" not in said
    assert "would agree better with other angles of the cameras" in said


@pytest.fixture(scope="module")
def lens_folder(tmp_path_factory):
    """Pictures of the room through a lens."""
    room, folder = furnished_room(0), tmp_path_factory.mktemp("lens") / "pictures"
    truth = {}
    for number, world_from_cam in enumerate(room_poses(6)):
        name = f"{number}.png"
        write_picture(folder / name, room.render(TRUE_LENS, world_from_cam).image)
        truth[name] = world_from_cam
    return folder, truth


def test_a_lens_gets_its_focal_length_and_its_curve(lens_folder, tmp_path):
    folder, truth = lens_folder
    camera = write_camera(
        tmp_path / "lens.json", TRUE_LENS, fx=120.0, fy=120.0, k1=0.0, k2=0.0, max_angle_deg=100.0
    )
    run = match_images(find_images(folder, camera=camera), tmp_path / "out")
    angles = np.radians([20.0, 45.0, 70.0])
    rays = np.column_stack([np.sin(angles), 0.0 * angles, np.cos(angles)])
    x, _, z = run.cameras["camera"].bearings_from_pixels(TRUE_LENS.pixels_from_bearings(rays)).T
    assert np.arctan2(x, z) == pytest.approx(angles, rel=0.01)
    assert np.median(errors_deg(run, truth), axis=0).max() < 0.5
    (said,) = run.agreed
    assert re.fullmatch(r"camera: \d\d\.\d and \d\d\.\d degrees from the axis, not 60 and 90", said)


def test_the_lens_of_a_map_is_the_one_that_the_pairs_agree_on(lens_folder, tmp_path):
    pytest.importorskip("pycolmap")
    from epi360.jobs.mapping.map_folder import map_images

    camera = write_camera(tmp_path / "lens.json", TRUE_LENS, fx=120.0, fy=120.0)
    run = map_images(find_images(lens_folder[0], camera=camera), tmp_path / "out")
    assert run.matched.agreed
    (mapped,) = run.models[0].reconstruction.cameras.values()
    assert mapped.fx == pytest.approx(TRUE_LENS.fx, rel=0.01)
    assert mapped == run.matched.cameras["camera"] or mapped.fx == pytest.approx(
        run.matched.cameras["camera"].fx
    )


def test_other_images_are_replaced_with_wrong_cameras_too(narrow, lens_folder, tmp_path):
    folder, _, camera = narrow
    lens = write_camera(tmp_path / "lens.json", TRUE_LENS)
    match_images(find_images(lens_folder[0], camera=lens), tmp_path / "out")
    images = find_images(folder, camera=camera)
    run = match_images(images, tmp_path / "out", restart=True)
    assert run.agreed


SOME_LENSES = [
    Pinhole(1080, 1440, 1100.0, 1100.0, 540.0, 720.0),
    Pinhole(1000, 750, 1200.0, 1200.0, 500.0, 375.0),
    Pinhole(1000, 750, 6000.0, 6000.0, 500.0, 375.0),
    KannalaBrandt(1920, 1080, 300.0, 300.0, 960.0, 540.0, max_angle_deg=95.0),  # a small circle
]


@pytest.mark.parametrize("given", SOME_LENSES, ids=lambda each: f"{each.width}-{each.fx:.0f}")
def test_a_lens_is_told_by_angles_that_it_sees(given):
    now = changed_lens(given, np.array([0.05, 0.0, 0.0]))
    assert "degrees from the axis, not" in what_changed(given, now)


def test_a_photograph_is_told_by_its_focal_length():
    photograph = Pinhole(800, 600, 424.0, 424.0, 400.0, 300.0)
    words = what_changed(photograph, changed_lens(photograph, np.array([0.06])))
    assert words == "a focal length of 400.0 pixels, not 424"
    assert any(each in words for each in OF_LENS)


def changes_of(**sizes):
    names = ("horizontal", "vertical", "middle")
    return [AngleChange(1, name, sizes.get(name, 0.0), 1e-4) for name in names]


@pytest.mark.parametrize(
    ("given", "sizes", "expected"),
    [
        ((360, 180, 0), {"horizontal": -0.028}, (349.92, 180, 0)),
        ((350, 180, 0), {"horizontal": 0.0271}, (360, 180, 0)),
        ((360, 180, 0), {"vertical": -0.053, "middle": -0.066}, (360, 171.45, 4.28)),
        ((358, 178, 0), {"vertical": -0.06}, (358, 167.32, 0)),
        ((340, 178, 0), {"horizontal": 0.03}, (350.2, 178, 0)),
        ((340, 151.3, -2.3), {"horizontal": 0.03}, (350.2, 151.3, -2.3)),
    ],
)
def test_what_is_nearly_whole_is_whole_and_what_is_not_asked_for_stays(given, sizes, expected):
    camera = Equirectangular(512, 256, *given[:2], 0.0, given[2])
    found = agreed_cameras._changed(camera, changes_of(**sizes), OF_GIVEN)
    got = found.horizontal_fov_deg, found.vertical_fov_deg, found.center_latitude_deg
    assert got == pytest.approx(expected, abs=0.01)
    told = what_changed(camera, found)
    assert ("around" in told) == (got[0] != given[0])
    assert ("latitude" in told) == (abs(got[2] - given[2]) > 1e-6)


def test_panoramas_are_mapped_as_they_are_given(narrow, tmp_path, monkeypatch):
    pytest.importorskip("pycolmap")
    from epi360.jobs.mapping.map_folder import map_images

    monkeypatch.setattr(agreed_cameras, "fit_shared_angles", None)
    run = map_images(find_images(narrow[0]), tmp_path / "out")
    assert run.models
