# SPDX-License-Identifier: BSD-3-Clause
"""A sequence whose tracks agree on another lens is tracked once more by that."""

import dataclasses
import json

import numpy as np
import pytest
from rendered_views import write_png
from walked_room import error_share, world_from_cam

from epi360 import Odometry, load_camera
from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.cameras.calibration.own import camera_record
from epi360.cli import main
from epi360.interop.tum import read_tum_trajectory
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching.tracked_lens import agreed_camera
from epi360.jobs.tracking.track_job import TrackOptions, track_frames
from epi360.report.match_table import describe_agreed
from epi360.report.track_words import track_sentences
from epi360_scenes import furnished_room

TRUE_LENS = KannalaBrandt(360, 360, 125.0, 125.0, 181.0, 178.0, 0.02, -0.008, max_angle_deg=85.0)
TOO_WIDE = dataclasses.replace(TRUE_LENS, fx=115.0, fy=115.0, max_angle_deg=95.0)
NUM_FRAMES = 20


def write_lens(path, lens):
    path.write_text(json.dumps({"model": "KannalaBrandt", **dataclasses.asdict(lens)}))
    return str(path)


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lens") / "film"
    folder.mkdir()
    room = furnished_room(1)
    for index in range(NUM_FRAMES):
        image = room.render(TRUE_LENS, world_from_cam(index), supersample=1).image
        write_png(folder / f"{index:03}.png", image)
    return folder


def error_of(run):
    centers = [each.cam_from_world.inverse().translation for each in run.results]
    return error_share(np.array(centers), np.arange(NUM_FRAMES))


def test_the_sequence_is_tracked_by_the_lens_that_its_tracks_agree_on(film, tmp_path, capsys):
    camera, out = write_lens(tmp_path / "lens.json", TOO_WIDE), tmp_path / "track"
    run = track_frames(film, out, TrackOptions(camera=camera))
    assert run.agreed.endswith("degrees from the axis, not 60 and 90")
    assert any(run.agreed in sentence for sentence in track_sentences(run))
    found = load_camera(out / "camera.json")
    assert found.fx == pytest.approx(TRUE_LENS.fx, rel=0.01)
    assert json.loads((out / "track.json").read_text())["agreed"] == run.agreed
    assert main(["track", str(film), "--camera", camera, "--out", str(out), "--keep-cameras"]) == 0
    assert "agree on other angles" not in capsys.readouterr().out
    (out / "camera.json").write_text(json.dumps(camera_record(found)))
    own = str(out / "camera.json")  # it is kept, for it is the one that is given
    assert track_frames(film, out, TrackOptions(camera=own)).agreed == ""
    assert load_camera(own) == found
    assert main(["track", str(film), "--camera", camera, "--out", str(out), "--keep-cameras"]) == 0
    assert not (out / "camera.json").exists()
    kept = read_tum_trajectory(out / "trajectory.txt")
    centers = [image.cam_from_world.inverse().translation for image in kept.images]
    assert error_of(run) < 0.2 * error_share(np.array(centers), np.arange(NUM_FRAMES))


def test_a_right_lens_stays(film, tmp_path):
    camera = write_lens(tmp_path / "lens.json", TRUE_LENS)
    run = track_frames(film, tmp_path / "track", TrackOptions(camera=camera))
    assert run.agreed == "" and not (tmp_path / "track" / "camera.json").exists()
    assert run.counts["tracked"] == NUM_FRAMES


def test_a_map_starts_from_what_that_lens_tracks(film, tmp_path):
    pytest.importorskip("pycolmap")
    from epi360.jobs.mapping.map_folder import map_images

    camera, out = write_lens(tmp_path / "lens.json", TOO_WIDE), tmp_path / "map"
    run = map_images(find_images(film, camera=camera), out)
    (mapped,) = run.models[0].reconstruction.cameras.values()
    assert run.matched.agreed and mapped.fx == pytest.approx(TRUE_LENS.fx, rel=0.01)
    assert len(run.models[0].reconstruction.images) == NUM_FRAMES
    assert run.attempts[0].num_registered == NUM_FRAMES and "odometry" in run.attempts[0].how
    assert run.track["num_images"] == NUM_FRAMES
    before = (out / "tracked-again.json").read_bytes()
    assert map_images(find_images(film, camera=camera), out).was_mapped
    assert (out / "tracked-again.json").read_bytes() == before
    assert "The tracks agree on other angles of camera: " in describe_agreed(run.matched)[0]


def test_nothing_is_said_before_a_map_begins_and_of_panoramas():
    assert agreed_camera(Odometry(TRUE_LENS).key_frames(), TRUE_LENS, 0) is None
    assert agreed_camera([], Equirectangular(512, 256), 0) is None
