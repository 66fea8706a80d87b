# SPDX-License-Identifier: BSD-3-Clause
"""Maps of sequences that start from the odometry's poses: a rendered walk, also as a video."""

import json
import shutil

import numpy as np
import pytest
from rendered_views import write_png
from walked_room import elsewhere, error_share, frames, write_frames
from written_videos import write_video

pytest.importorskip("pycolmap")

from epi360.jobs.folder.image_set import find_images  # noqa: E402
from epi360.jobs.frames.frames_job import FramesOptions, extract_frames  # noqa: E402
from epi360.jobs.mapping.map_folder import MapOptions, map_images  # noqa: E402
from epi360.jobs.mapping.sequence_start import (  # noqa: E402
    _Frames,
    may_be_sequence,
    track_sequence,
)
from epi360.jobs.matching.match_folder import MatchOptions  # noqa: E402
from epi360.jobs.pairs.pair_selection import trajectory_pairs  # noqa: E402
from epi360.poses import Pose  # noqa: E402

NUM_IMAGES = 10


def options(**changes):
    return MapOptions(MatchOptions(num_threads=1), mapper_threads=1, **changes)


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """Folder of ten numbered frames, and the output of their map."""
    folder = tmp_path_factory.mktemp("walk")
    write_frames(folder / "rgb", NUM_IMAGES)
    run = map_images(find_images(folder / "rgb"), folder / "out", options())
    return folder, run


def error_of(run):
    images = run.models[0].reconstruction.images
    positions = np.array([image.cam_from_world.inverse().translation for image in images])
    return error_share(positions, [int(image.name[:3]) for image in images])


def test_a_sequence_is_mapped_from_the_poses_of_the_odometry(walk):
    folder, run = walk
    (attempt,) = run.attempts
    assert attempt.how == "the poses of the odometry" and attempt.num_registered == NUM_IMAGES
    assert error_of(run) < 0.004
    record = json.loads((folder / "out" / "mapping.json").read_text(encoding="utf-8"))
    assert record["track"] == run.track
    assert run.track["num_images"] == run.track["num_frames"] == NUM_IMAGES
    assert not run.track["reason"] and record["pairs"] == "exhaustive"


def test_a_second_run_tracks_and_maps_nothing_again(walk, monkeypatch):
    folder, first = walk
    monkeypatch.setattr(
        "epi360.jobs.mapping.sequence_start.Odometry", lambda *_, **__: pytest.fail()
    )
    again = map_images(find_images(folder / "rgb"), folder / "out", options())
    assert again.was_mapped and again.attempts == first.attempts and again.track == first.track


def test_sixteen_frames_are_matched_where_they_are_near_each_other_on_the_way(tmp_path):
    write_frames(tmp_path / "rgb", 16)
    run = map_images(find_images(tmp_path / "rgb"), tmp_path / "out", options())
    assert run.matched.how == f"{len(run.matched.verdicts)} of a tracked sequence"
    assert 16 < len(run.matched.verdicts) < 60  # of 120
    assert error_of(run) < 0.004


def test_without_track_all_pairs_are_matched_and_the_mapper_begins(tmp_path):
    write_frames(tmp_path / "rgb", 6)
    run = map_images(find_images(tmp_path / "rgb"), tmp_path / "out", options(track=False))
    assert [attempt.how for attempt in run.attempts] == ["incremental mapper"]
    assert run.track is None and run.matched.how == "exhaustive"
    assert run.models[0].reconstruction.images and error_of(run) < 0.006


def test_other_frames_are_tracked_again(walk, tmp_path):
    folder, _ = walk
    shutil.copytree(folder, tmp_path / "copy")
    images = find_images(tmp_path / "copy" / "rgb")
    output = tmp_path / "copy" / "out"
    assert track_sequence(images, output).num_frames == NUM_IMAGES
    before = (output / "tracked.json").read_bytes()
    (tmp_path / "copy" / "rgb" / "009.png").unlink()
    track_sequence(find_images(tmp_path / "copy" / "rgb"), output)
    assert (output / "tracked.json").read_bytes() != before


def test_images_without_a_pose_of_the_odometry_are_added(tmp_path):
    write_frames(tmp_path / "rgb", NUM_IMAGES)
    (tmp_path / "rgb" / "004.png").write_bytes(b"no picture")
    write_png(tmp_path / "rgb" / "005.png", np.full((256, 512, 3), 128, np.uint8))
    run = map_images(find_images(tmp_path / "rgb"), tmp_path / "out", options())
    assert "005.png" in run.unregistered
    assert run.models[0].reconstruction.images
    assert error_of(run) < 0.004


def test_all_frames_of_a_video_are_tracked_and_the_chosen_ones_placed(tmp_path):
    pytest.importorskip("av")
    video = write_video(tmp_path / "walk.mp4", frames(), options={}, codec_options={"crf": "10"})
    chosen = FramesOptions(every=3)
    folder = extract_frames(video, tmp_path / "out" / "frames", chosen).folder
    images = find_images(folder)
    run = map_images(images, tmp_path / "out", options(), video=video)
    assert run.track["num_images"] == len(images.images) == 6
    assert run.track["num_frames"] == run.track["num_tracked"] == 16
    assert run.attempts[0].how == "the poses of the odometry" and run.attempts[0].kept
    placed = run.models[0].reconstruction.images
    positions = np.array([image.cam_from_world.inverse().translation for image in placed])
    assert error_share(positions, [int(image.name[-10:-4]) for image in placed]) < 0.004


def test_the_masks_of_all_frames_of_a_video_count(tmp_path):
    pytest.importorskip("av")
    video = write_video(tmp_path / "a.mp4", frames()[:4])
    folder = extract_frames(video, tmp_path / "frames", FramesOptions(every=3)).folder
    masks = tmp_path / "masks"
    write_png(masks / "a_000001.png", np.full((*frames()[0].shape[:2], 3), 255, np.uint8))
    images = find_images(folder)
    assert [image.name for image in images.images] == ["a_000000.jpg", "a_000003.jpg"]

    def fingerprint():
        return _Frames(images, video, masks).fingerprint(tmp_path, 0.0, 0)

    before = fingerprint()
    assert fingerprint() == before
    write_png(masks / "a_000001.png", np.zeros((*frames()[0].shape[:2], 3), np.uint8))
    assert fingerprint() != before


def test_a_folder_whose_points_cannot_be_followed_is_no_sequence(tmp_path):
    places = [frames()[0], elsewhere()[0], frames()[9], elsewhere()[5], frames()[3]]
    for number, image in enumerate(places):
        write_png(tmp_path / "rgb" / f"{number}.png", np.roll(image, 190 * number, axis=1))
    images = find_images(tmp_path / "rgb")
    assert may_be_sequence(images)
    tracked = track_sequence(images, tmp_path)
    assert not tracked.cam_from_world
    assert tracked.reason == "points cannot be followed from image to image"


def test_past_a_gap_frames_are_not_followed(tmp_path):
    """What comes then may be the next room, which looks alike."""
    write_frames(tmp_path / "rgb", 5)
    for number, image in enumerate(elsewhere()[:5], start=5):
        write_png(tmp_path / "rgb" / f"{number:03d}.png", image)
    images = find_images(tmp_path / "rgb")
    for _ in range(2):  # the second time from the record
        tracked = track_sequence(images, tmp_path)
        assert not tracked.cam_from_world and tracked.past_gaps == ("005.png",)
        assert tracked.reason == "frames seem to be missing before 005.png"
    run = map_images(images, tmp_path / "out", options())
    assert any("missing before 005.png" in remark for remark in run.remarks)


def test_a_camera_that_stands_still_gives_no_poses_to_start_from(tmp_path):
    write_frames(tmp_path / "rgb", 6, same=True)
    told = []
    tracked = track_sequence(
        find_images(tmp_path / "rgb"), tmp_path, progress=lambda *said: told.append(said[1:])
    )
    assert told == [(done, tracked.num_frames) for done in range(tracked.num_frames + 1)]
    assert tracked.reason == "the camera has not moved far enough"


def test_names_that_differ_in_more_than_a_number_are_no_sequence(tmp_path):
    for name in ("hall.png", "kitchen 1.png", "kitchen 2.png", "stairs.png"):
        write_png(tmp_path / name, frames()[0])
    assert not may_be_sequence(find_images(tmp_path))


def test_pairs_end_where_the_way_is_longer_than_the_scene_is_deep_and_come_back():
    class Image:
        def __init__(self, name):
            self.name = name

    way = np.concatenate([np.arange(40), np.arange(40)[::-1]]) * 0.25
    images = [Image(str(number)) for number in range(len(way))]
    poses = {
        image.name: Pose(np.eye(3), np.array([-x, 0.0, 0.0]))
        for image, x in zip(images, way, strict=True)
    }
    pairs = trajectory_pairs(images, poses, dict.fromkeys(poses, 2.0))
    assert len(pairs) == len(set(pairs))
    assert [second for first, second in pairs if first == 0] == [1, 2, 4, 79]
    assert (5, 74) in pairs  # the same place on the way back
    del poses["0"]
    pairs = trajectory_pairs(images, poses, dict.fromkeys(poses, 2.0))
    assert [second for first, second in pairs if first == 0] == [1, 2, 4, 8, 16]
