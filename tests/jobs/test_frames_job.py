# SPDX-License-Identifier: BSD-3-Clause
"""Frames of a video: which are chosen, what is written, resumed and refused."""

import csv

import cv2
import numpy as np
import pytest
from written_videos import noise_frames, write_video

from epi360.cameras import Equirectangular
from epi360.jobs.frames.frame_selection import FrameChooser
from epi360.jobs.frames.frames_job import FramesOptions, extract_frames
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

av = pytest.importorskip("av")
CAMERA = Equirectangular(256, 128)
STEPS = 24


@pytest.fixture(scope="module")
def walk():
    """Panoramas of a room, 6 cm and a turn of 3 degrees apart."""
    room = furnished_room()
    return [
        room.render(
            CAMERA,
            Pose(rotation_from_vector([0, 0.05 * k, 0]), np.array([0.1, -1.5, 0.06 * k - 0.8])),
            supersample=1,
        ).image
        for k in range(STEPS)
    ]


@pytest.fixture(scope="module")
def video(walk, tmp_path_factory):
    return write_video(tmp_path_factory.mktemp("walk") / "walk.mp4", walk)


def chosen(pictures, parallax_deg=3.0, **options):
    chooser, frames = FrameChooser(CAMERA, parallax_deg, **options), []
    for index, picture in enumerate(pictures):
        frames += chooser.add(index, index / 25, picture)
    return [*frames, *chooser.finish()]


def test_frames_are_about_as_far_apart_as_asked_for(walk):
    near, far = chosen(walk, 3.0), chosen(walk, 6.0)
    assert 1.5 * len(far) <= len(near) + 1 < STEPS
    assert near[0].index < 4 and np.isnan(near[0].parallax_deg)
    assert all(2.2 <= frame.parallax_deg <= 5.5 for frame in near[1:])
    assert [frame.index for frame in near] == sorted({frame.index for frame in near})


def test_turning_on_the_spot_needs_one_frame():
    assert len(chosen(noise_frames(40))) == 1


def test_of_frames_that_are_as_good_the_sharpest_is_taken(walk):
    pairs = [(cv2.blur(picture, (3, 3)), picture) for picture in walk]
    indices = [frame.index for frame in chosen([p for pair in pairs for p in pair])]
    assert len(indices) > 3
    assert all(index % 2 for index in indices[1:])


def test_a_cut_gives_a_frame_on_each_side(walk):
    still = [walk[0]] * 6 + noise_frames(1, seed=5) * 6
    indices = [frame.index for frame in chosen(still)]
    assert indices[-1] >= 6 and indices[0] < 6


def test_black_frames_are_not_chosen(walk):
    black = [np.zeros_like(walk[0])] * 5
    indices = [frame.index for frame in chosen([*black, *walk, *black])]
    assert indices and min(indices) >= 5 and max(indices) < 5 + STEPS


def test_a_camera_that_stands_still_needs_bounded_memory():
    chooser = FrameChooser(CAMERA, 3.0)
    picture = noise_frames(1)[0]
    for index in range(200):
        assert list(chooser.add(index, index / 25, picture)) == []
        assert len(chooser._waiting) <= 32
    assert len(list(chooser.finish())) == 1


def test_the_folder_holds_the_frames_and_the_times_of_the_file(video, walk, tmp_path):
    run = extract_frames(video, tmp_path / "out", FramesOptions(parallax_deg=3.0))
    with (tmp_path / "out" / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(run.chosen) > 3
    for row, frame in zip(rows, run.chosen, strict=True):
        assert row["image"] == f"walk_{frame.index:06d}.jpg"
        assert float(row["timestamp_s"]) == frame.timestamp_s == pytest.approx(frame.index / 25)
        written = cv2.imread(str(tmp_path / "out" / row["image"]))[:, :, ::-1]
        assert np.abs(written.astype(int) - walk[frame.index]).mean() < 6
    assert run.num_frames == STEPS and run.remarks == ()


def test_a_short_video_gives_more_frames_that_are_nearer_to_each_other(video, tmp_path):
    few = extract_frames(video, tmp_path / "few", FramesOptions(parallax_deg=3.0))
    run = extract_frames(video, tmp_path / "out", FramesOptions())
    assert len(run.chosen) > 1.5 * len(few.chosen)
    assert "the camera moved little: a frame is taken each" in run.remarks[0]


def test_a_stopped_run_goes_on_and_equals_one_that_was_not(video, tmp_path):
    class StopError(Exception):
        pass

    def stop(stage, done, total):
        if stage == "frames" and done == 2:
            raise StopError

    with pytest.raises(StopError):
        extract_frames(video, tmp_path / "a", FramesOptions(), progress=stop)
    first = extract_frames(video, tmp_path / "a", FramesOptions())
    whole = extract_frames(video, tmp_path / "b", FramesOptions())
    assert first.num_new == whole.num_new - 2
    files = {path.name for path in (tmp_path / "b").iterdir()}
    assert files == {path.name for path in (tmp_path / "a").iterdir()}
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_every_nth_frame_between_two_times(video, tmp_path):
    options = FramesOptions(every=4, start_s=0.2, end_s=0.7)
    run = extract_frames(video, tmp_path / "out", options)
    assert [frame.index for frame in run.chosen] == [5, 9, 13, 17]


def test_the_quality_changes_the_size(video, tmp_path):
    sizes = []
    for quality in (60, 95):
        folder = tmp_path / str(quality)
        extract_frames(video, folder, FramesOptions(every=12, jpeg_quality=quality))
        sizes.append((folder / "walk_000000.jpg").stat().st_size)
    assert sizes[0] < 0.7 * sizes[1]


def test_a_folder_of_other_things_is_refused(video, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "photo.jpg").write_bytes(b"")
    with pytest.raises(ValueError, match="is not empty and holds no frames"):
        extract_frames(video, tmp_path / "full", FramesOptions())
    extract_frames(video, tmp_path / "out", FramesOptions(every=12))
    with pytest.raises(ValueError, match="holds frames with --every 12, not --every 6"):
        extract_frames(video, tmp_path / "out", FramesOptions(every=6))


def test_options_that_are_wrong_leave_the_folder_to_those_that_are_right(video, tmp_path):
    out, mask = tmp_path / "out", tmp_path / "mask.png"
    cv2.imwrite(str(mask), np.full((10, 20), 255, np.uint8))
    for options in (
        FramesOptions(camera=str(tmp_path / "typo.yaml")),
        FramesOptions(every=4, mask=mask),
        FramesOptions(start_s=60.0),
    ):
        with pytest.raises((ValueError, FileNotFoundError)):
            extract_frames(video, out, options)
        assert not out.exists()
    # Known only after all frames were read: the folder has a record, but no frames.
    with pytest.raises(ValueError, match="no frame to use between these times"):
        extract_frames(video, out, FramesOptions(start_s=0.001, end_s=0.002))
    assert len(extract_frames(video, out, FramesOptions(every=12)).chosen) == 2


def test_frames_of_other_options_are_replaced_when_that_is_asked_for(video, tmp_path):
    extract_frames(video, tmp_path / "out", FramesOptions(parallax_deg=3.0))
    with pytest.raises(ValueError, match=r"with no --every, not --every 12; do this"):
        extract_frames(video, tmp_path / "out", FramesOptions(every=12), remedy="do this")
    extract_frames(video, tmp_path / "out", FramesOptions(every=12), restart=True)
    names = sorted(path.name for path in (tmp_path / "out").glob("*.jpg"))
    assert names == ["walk_000000.jpg", "walk_000012.jpg"]


def test_a_mask_is_known_by_its_content(video, tmp_path):
    def options(name, column):
        mask = np.full((128, 256), 255, np.uint8)
        mask[:, column:] = 0
        cv2.imwrite(str(tmp_path / name), mask)
        return FramesOptions(every=12, mask=tmp_path / name)

    extract_frames(video, tmp_path / "out", options("a.png", 200))
    assert extract_frames(video, tmp_path / "out", options("b.png", 200)).num_new == 0
    with pytest.raises(ValueError, match="chosen with another mask"):
        extract_frames(video, tmp_path / "out", options("a.png", 100))


def test_a_run_on_a_damaged_video_goes_on_with_the_same_frames(video, tmp_path):
    data = bytearray(video.read_bytes())
    with av.open(str(video)) as container:
        packets = [(p.pos, p.size) for p in container.demux(video=0) if p.size]
    for place, size in (packets[3], packets[4]):
        data[place + 4 : place + size] = bytes(size - 4)
    damaged = tmp_path / "walk.mp4"
    damaged.write_bytes(data)
    run = extract_frames(damaged, tmp_path / "out", FramesOptions(every=3))
    assert not any("cut off" in remark for remark in run.remarks)
    files = sorted((tmp_path / "out").glob("*.jpg"))
    before = [path.read_bytes() for path in files]
    for path in files[-3:]:
        path.unlink()
    assert extract_frames(damaged, tmp_path / "out", FramesOptions(every=3)).num_new == 3
    assert [path.read_bytes() for path in files] == before


def test_frames_that_show_nothing_are_refused_with_what_to_do(tmp_path):
    grey = write_video(tmp_path / "grey.mp4", [np.full((128, 256, 3), 90, np.uint8)] * 5)
    with pytest.raises(ValueError, match=r"no frame to use: they are too dark.*--every N"):
        extract_frames(grey, tmp_path / "out", FramesOptions())


def test_frames_that_are_no_panoramas_need_a_camera(tmp_path):
    video = write_video(tmp_path / "phone.mp4", noise_frames(4, (128, 192)))
    with pytest.raises(ValueError, match="shows no panoramas .* give its camera"):
        extract_frames(video, tmp_path / "out", FramesOptions())
    assert len(extract_frames(video, tmp_path / "all", FramesOptions(every=1)).chosen) == 4


def test_an_early_end_is_said(tmp_path, video):
    data = write_video(
        tmp_path / "whole.mp4", noise_frames(60, seed=2), options={"movflags": "faststart"}
    ).read_bytes()
    (tmp_path / "cut.mp4").write_bytes(data[: int(0.6 * len(data))])
    run = extract_frames(tmp_path / "cut.mp4", tmp_path / "out", FramesOptions(every=5))
    assert len(run.chosen) >= 3 and "the file is cut off" in run.remarks[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"every": 0}, "every must be 1 or more, got 0"),
        ({"parallax_deg": 0}, "parallax_deg must be between 0 and 90"),
        ({"jpeg_quality": 101}, "jpeg_quality must be from 1 to 100"),
        ({"start_s": 2.0, "end_s": 1.0}, "end must not be before start"),
        ({"start_s": float("nan")}, "start must be a number of seconds, got nan"),
        ({"end_s": float("nan")}, "end must be a number of seconds, got nan"),
        ({"every": 2, "parallax_deg": 3.0}, "parallax_deg must not be given with every"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        FramesOptions(**options)
