# SPDX-License-Identifier: BSD-3-Clause
"""Frames of a folder and of a video come the same way."""

import cv2
import numpy as np
import pytest
from rendered_views import write_png
from walked_room import write_frames
from written_videos import noise_frames, write_video

from epi360.cameras import Equirectangular
from epi360.jobs.frames.frame_source import open_frames, read_frame_times


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "images"
    for index, picture in enumerate(noise_frames(11)):
        write_png(folder / f"{index}.png", picture)
    return folder


def test_a_folder_gives_its_images_in_natural_order_without_times(folder):
    source = open_frames(folder)
    frames = list(source)
    assert [frame.name for frame in frames] == [f"{index}.png" for index in range(11)]
    assert {(frame.timestamp_s, frame.usable) for frame in frames} == {(None, None)}
    np.testing.assert_array_equal(frames[10].image, noise_frames(11)[10])
    assert source.num_frames == 11 and source.ending is None


def test_the_table_of_frames_gives_the_times_and_names_what_is_missing(folder):
    rows = "image,timestamp_s\n0.png,0.5\ngone.png,0.6\n1.png,0.75\n2.png,\n"
    (folder / "frames.csv").write_text(rows)
    (folder / "1.png").write_bytes(b"no picture")
    frames = list(open_frames(folder))
    assert [(frame.name, frame.timestamp_s) for frame in frames[:4]] == [
        ("0.png", 0.5), ("gone.png", 0.6), ("1.png", 0.75), ("2.png", None),
    ]  # fmt: skip
    assert isinstance(frames[1].image, FileNotFoundError)
    assert "is not a JPEG" in str(frames[2].image)
    assert len(frames) == 12
    assert [f.name for f in open_frames(folder, start_s=0.6, end_s=0.8)] == ["gone.png", "1.png"]


def test_frames_say_which_pixels_are_transparent(folder):
    opaque = np.full((128, 256, 1), 255, np.uint8)
    opaque[100:] = 0
    rgba = np.dstack([noise_frames(1)[0], opaque])
    cv2.imwrite(str(folder / "0.png"), rgba)
    usable = next(iter(open_frames(folder))).usable
    assert usable is not None and usable[:96].all() and not usable[99:].any()


@pytest.mark.parametrize("cell", ["", "nan", "inf"])
def test_what_is_no_time_is_none(folder, cell):
    (folder / "frames.csv").write_text(f"image,timestamp_s\n0.png,{cell}\n")
    assert read_frame_times(folder) == {"0.png": None}


def test_a_video_gives_names_with_the_index_and_its_own_times(tmp_path):
    pytest.importorskip("av")
    source = open_frames(write_video(tmp_path / "walk.mp4", noise_frames(30)), start_s=0.4, end_s=1)
    frames = list(source)
    assert [frame.name for frame in frames] == [f"walk_{i:06d}.jpg" for i in range(10, 26)]
    np.testing.assert_allclose([frame.timestamp_s for frame in frames], np.arange(10, 26) / 25)
    assert abs(source.num_frames - 16) <= 1
    assert frames[0].image.shape == (128, 256, 3)
    assert source.camera() == Equirectangular(256, 128)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"image,timestamp_s\n\xe4.png,0\n", "frames.csv must be a text file in UTF-8"),
        (b"image,timestamp_s\n" + b"x" * 200_000 + b",0\n", "frames.csv must be a table"),
        (b"image,timestamp_s\n0.png,soon\n", "frames.csv must hold numbers"),
        (b"image\n0.png\n", "frames.csv must have the columns"),
    ],
)
def test_a_damaged_table_is_named(folder, content, message):
    (folder / "frames.csv").write_bytes(content)
    with pytest.raises(ValueError, match=message):
        open_frames(folder)


def test_a_path_that_leads_out_of_the_folder_is_refused(folder):
    (folder / "frames.csv").write_text("image,timestamp_s\n../0.png,0.5\n")
    with pytest.raises(ValueError, match="leads out of"):
        open_frames(folder)


def test_what_holds_no_frames_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match="has no JPEG"):
        open_frames(tmp_path / "empty")
    with pytest.raises(FileNotFoundError, match="image folder .* does not exist"):
        open_frames(tmp_path / "none")
    (tmp_path / "notes.txt").write_text("words")
    with pytest.raises(ValueError, match="no video file|needs? av|need av"):
        open_frames(tmp_path / "notes.txt")


def test_the_camera_of_a_folder_is_that_of_its_first_picture(tmp_path):
    write_frames(tmp_path / "rgb", 2)
    (tmp_path / "rgb" / "!.png").write_text("no picture")
    assert open_frames(tmp_path / "rgb").camera() == Equirectangular(512, 256)


def raw_frame(height=200):
    """Two discs of noise on black, side by side."""
    v, u = np.mgrid[:height, :height] + 0.5
    inside = np.hypot(u - height / 2, v - height / 2) < 0.48 * height
    lit = np.random.default_rng(0).integers(60, 200, (height, height))
    disc = np.where(inside, lit, 0).astype(np.uint8)
    return np.repeat(np.hstack([disc, disc])[:, :, None], 3, axis=2)


def test_raw_dual_fisheye_frames_are_no_panoramas(tmp_path):
    (tmp_path / "0.png").write_text("no picture")
    write_png(tmp_path / "1.png", raw_frame())
    with pytest.raises(ValueError, match=r"1\.png looks like a raw dual fisheye frame"):
        open_frames(tmp_path).camera()


def test_photographs_cut_to_the_shape_of_panoramas_are_none(tmp_path):
    part = smooth_panorama()[40:168, 100:356].astype(np.uint8)
    write_png(tmp_path / "1.png", cv2.resize(part, (512, 256)))
    with pytest.raises(ValueError, match=r"1\.png has the shape of a panorama, but .* camera"):
        open_frames(tmp_path).camera()


def smooth_panorama():
    noise = np.random.default_rng(0).uniform(0, 255, (8, 16, 3)).astype(np.float32)
    return cv2.resize(noise, (512, 256), interpolation=cv2.INTER_CUBIC).clip(0, 255)
