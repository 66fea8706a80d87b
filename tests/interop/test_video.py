# SPDX-License-Identifier: BSD-3-Clause
"""Videos: frames with their times, metadata of the sphere, and what is refused."""

import os
import struct
import sys

import numpy as np
import pytest
from written_videos import box, noise_frames, with_box, write_video

from epi360.cameras import Equirectangular
from epi360.interop.video import is_video, open_video
from epi360.interop.video_boxes import SPHERICAL_UUID

av = pytest.importorskip("av")

XMP = (
    '<rdf:SphericalVideo xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" '
    'xmlns:GSpherical="http://ns.google.com/videos/1.0/spherical/">'
    "<GSpherical:Spherical>true</GSpherical:Spherical>{more}"
    "<GSpherical:ProjectionType>equirectangular</GSpherical:ProjectionType>"
    "</rdf:SphericalVideo>"
)


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """File of 50 frames at 25 a second, its index at the end."""
    return write_video(tmp_path_factory.mktemp("clip") / "walk.mp4", noise_frames(50))


def full_box(kind, content):
    return box(kind, b"\0\0\0\0" + content)


def sphere_boxes(projection):
    head = full_box(b"svhd", b"test\0")
    return box(b"sv3d", head + box(b"proj", full_box(b"prhd", bytes(12)) + projection))


def rewritten(tmp_path, clip, parent, new, name="sphere.mp4"):
    path = tmp_path / name
    path.write_bytes(with_box(clip.read_bytes(), parent, new))
    return path


def test_frames_have_the_pictures_times_and_indices_of_the_file(clip):
    video = open_video(clip)
    frames = list(video)
    assert [frame.index for frame in frames] == list(range(50))
    np.testing.assert_allclose([f.timestamp_s for f in frames], np.arange(50) / 25, atol=1e-9)
    for frame, picture in zip(frames, noise_frames(50), strict=True):
        assert frame.image.shape == (128, 256, 3) and frame.error is None
        assert np.abs(frame.image.astype(int) - picture).mean() < 12  # compressed
    assert video.ending is None
    info = video.info
    assert (info.width, info.height, info.num_frames) == (256, 128, 50)
    assert info.frame_rate == pytest.approx(25) and info.duration_s == pytest.approx(2.0)
    assert not info.is_360 and info.camera() == Equirectangular(256, 128)


def test_uneven_time_stamps_are_kept(tmp_path):
    times = [0, 40, 95, 130, 300, 310, 350, 1000]
    path = write_video(tmp_path / "uneven.mkv", noise_frames(8), times=times)
    assert [round(1000 * frame.timestamp_s) for frame in open_video(path)] == times


def test_a_title_that_is_no_utf_8_is_no_reason_to_refuse_a_video(tmp_path):
    path = tmp_path / "title.mkv"
    with av.open(str(path), "w") as container:
        container.metadata["title"] = "Maerz in Wien"
        stream = container.add_stream("libx264", rate=25)
        stream.height, stream.width = 128, 256
        stream.pix_fmt = "yuv420p"
        for picture in noise_frames(5):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    data = path.read_bytes()
    assert data.count(b"Maerz in Wien") == 1
    path.write_bytes(data.replace(b"Maerz in Wien", b"M\xe4rz in Wien."))  # Latin-1
    assert len(list(open_video(path))) == 5


def test_a_last_frame_that_is_shown_for_long_is_no_early_end(tmp_path):
    times = [0, 40, 80, 120, 160, 200, 240, 3000]
    video = open_video(write_video(tmp_path / "slides.mp4", noise_frames(8), times=times))
    assert [round(1000 * frame.timestamp_s) for frame in video] == times
    assert video.ending is None


@pytest.mark.parametrize("start_s", [0.0, 0.48, 0.5, 1.0, 1.96])
def test_frames_from_the_middle_are_those_of_the_whole_video(clip, start_s):
    video = open_video(clip)
    whole = [frame for frame in video if start_s <= frame.timestamp_s <= 1.97]
    part = list(video.frames(start_s, 1.97))
    assert [f.index for f in part] == [f.index for f in whole] and part
    for frame, other in zip(part, whole, strict=True):
        np.testing.assert_array_equal(frame.image, other.image)


@pytest.mark.parametrize("start_s", [0.3, 0.52, 1.0])
def test_frames_that_lean_on_the_group_before_keep_their_index(tmp_path, start_s):
    codec_options = {"x264-params": "open-gop=1:bframes=3:b-adapt=0:keyint=10:scenecut=0"}
    path = write_video(tmp_path / "open.mp4", noise_frames(40), codec_options=codec_options)
    video = open_video(path)
    whole = {frame.index: frame for frame in video}
    part = list(video.frames(start_s))
    assert part[0].index == int(np.ceil(start_s * 25)) and len(part) == 40 - part[0].index
    for frame in part:
        assert frame.timestamp_s == whole[frame.index].timestamp_s
        np.testing.assert_array_equal(frame.image, whole[frame.index].image)


def test_a_video_that_was_cut_off_gives_the_frames_up_to_there_and_says_so(tmp_path):
    options = {"movflags": "faststart"}
    whole = write_video(tmp_path / "whole.mp4", noise_frames(100, seed=1), options=options)
    data = whole.read_bytes()
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(data[: int(0.6 * len(data))])
    video = open_video(cut)
    num_read = sum(frame.image is not None for frame in video)
    assert 20 < num_read < 90
    assert "ends at frame" in video.ending and "its header states 4.00 s" in video.ending


def test_a_damaged_stretch_costs_its_frames_and_no_others(tmp_path, clip):
    data = bytearray(clip.read_bytes())
    middle = data.index(b"mdat") + (data.index(b"moov") - data.index(b"mdat")) // 2
    data[middle : middle + 60] = np.random.default_rng(0).bytes(60)
    path = tmp_path / "scratched.mp4"
    path.write_bytes(data)
    frames = list(open_video(path))
    assert 45 <= len(frames) <= 51
    assert [frame.index for frame in frames] == list(range(len(frames)))
    for frame in frames:
        assert (frame.image is None) == (frame.error is not None)


def with_lost_packets(path, clip, which):
    """A copy of a file in which some packets, counted as they are stored, are zeros."""
    with av.open(str(clip)) as container:
        packets = [(p.pos, p.size, p.is_keyframe) for p in container.demux(video=0) if p.size]
    data = bytearray(clip.read_bytes())
    for number in which(packets):
        place, size, _ = packets[number]
        data[place + 4 : place + size] = bytes(size - 4)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    "which", [lambda _: [5, 6, 15], lambda packets: [k for k, p in enumerate(packets) if p[2]][1:2]]
)
def test_frames_of_a_damaged_video_have_the_index_of_the_whole_one(tmp_path, clip, which):
    whole = {frame.timestamp_s: frame.index for frame in open_video(clip)}
    video = open_video(with_lost_packets(tmp_path / "damaged.mp4", clip, which))
    frames = list(video)
    assert {frame.timestamp_s: frame.index for frame in frames} == whole
    assert video.ending is None
    assert any(frame.image is None for frame in frames)
    for start_s in (0.2, 0.5, 1.0, 1.6):
        assert all(whole[frame.timestamp_s] == frame.index for frame in video.frames(start_s))


def test_a_video_without_its_index_is_refused_with_what_to_do(tmp_path, clip):
    cut = tmp_path / "cut.mp4"
    data = clip.read_bytes()
    for length in (data.index(b"moov") - 200, data.index(b"moov") + 200):
        cut.write_bytes(data[:length])
        with pytest.raises(ValueError, match="is cut off: the index that cameras write last"):
            open_video(cut)


def test_spherical_video_v1_is_read_from_the_file(tmp_path, clip):
    packet = box(b"uuid", SPHERICAL_UUID + XMP.format(more="").encode())
    info = open_video(rewritten(tmp_path, clip, b"trak", packet)).info
    assert info.is_360 and info.sphere.projection == "equirectangular"
    assert info.camera() == Equirectangular(256, 128)


def test_the_cropped_area_of_v1_is_the_camera(tmp_path):
    names = ("CroppedAreaImageWidthPixels", "CroppedAreaImageHeightPixels",
             "CroppedAreaLeftPixels", "CroppedAreaTopPixels",
             "FullPanoWidthPixels", "FullPanoHeightPixels")  # fmt: skip
    values = (128, 128, 64, 0, 256, 128)
    more = "".join(
        f"<GSpherical:{name}>{value}</GSpherical:{name}>"
        for name, value in zip(names, values, strict=True)
    )
    half = write_video(tmp_path / "half.mp4", noise_frames(3, (128, 128)))
    packet = box(b"uuid", SPHERICAL_UUID + XMP.format(more=more).encode())
    camera = open_video(rewritten(tmp_path, half, b"trak", packet)).info.camera()
    assert (camera.horizontal_fov_deg, camera.vertical_fov_deg) == (180.0, 180.0)


def test_a_cropped_area_with_thousands_of_digits_is_none(tmp_path, clip):
    names = ("CroppedAreaImageWidthPixels", "CroppedAreaImageHeightPixels", "CroppedAreaLeftPixels",
             "CroppedAreaTopPixels", "FullPanoWidthPixels", "FullPanoHeightPixels")  # fmt: skip
    more = "".join(f"<GSpherical:{name}>{'9' * 5000}</GSpherical:{name}>" for name in names)
    packet = box(b"uuid", SPHERICAL_UUID + XMP.format(more=more).encode())
    info = open_video(rewritten(tmp_path, clip, b"trak", packet)).info
    assert info.camera() == Equirectangular(256, 128)


def test_spherical_video_v2_says_which_part_is_shown(tmp_path):
    quarter = 2**30
    equi = full_box(b"equi", struct.pack(">4I", 0, 0, quarter, quarter))
    half = write_video(tmp_path / "half.mp4", noise_frames(3, (128, 128)))
    info = open_video(rewritten(tmp_path, half, b"avc1", sphere_boxes(equi))).info
    assert info.is_360 and info.camera().horizontal_fov_deg == pytest.approx(180.0)


@pytest.mark.parametrize(
    ("new", "message"),
    [
        (full_box(b"st3d", b"\1"), "has two eyes .top-bottom.; export one"),
        (sphere_boxes(full_box(b"cbmp", bytes(8))), "has the projection cubemap; export it as"),
    ],
)
def test_other_projections_and_stereo_are_refused(tmp_path, clip, new, message):
    with pytest.raises(ValueError, match=message):
        open_video(rewritten(tmp_path, clip, b"avc1", new))


def discs():
    """Raw frame of a 360 camera: two lit circles on black."""
    v, u = np.mgrid[:256, :512]
    inside = np.hypot(u % 256 - 127.5, v - 127.5) < 122
    texture = np.random.default_rng(0).integers(90, 250, (256, 512, 3))
    return (inside[:, :, None] * texture).astype(np.uint8)


def test_raw_dual_fisheye_frames_are_refused_with_what_to_do(tmp_path):
    path = write_video(tmp_path / "raw.mp4", [discs()] * 3)
    with pytest.raises(ValueError, match="raw dual fisheye.*export a stitched 360 video"):
        open_video(path)


def test_a_camera_file_with_a_square_stream_is_one_raw_circle_and_a_stitched_one_is_taken(tmp_path):
    square = write_video(tmp_path / "lens.mp4", noise_frames(3, (128, 128)))
    raw = square.rename(tmp_path / "lens.insv")
    with pytest.raises(ValueError, match="raw 360 video .1 streams of 128x128."):
        open_video(raw)
    stitched = write_video(tmp_path / "whole.mp4", noise_frames(3)).rename(tmp_path / "a.insv")
    assert open_video(stitched).info.width == 256


def test_what_is_no_video_is_one_clear_sentence(tmp_path):
    text, empty = tmp_path / "text.mp4", tmp_path / "empty.mp4"
    text.write_bytes(b"hello world " * 100)
    empty.write_bytes(b"")
    with pytest.raises(ValueError, match="is no video file that FFmpeg can read"):
        open_video(text)
    with pytest.raises(ValueError, match="is empty"):
        open_video(empty)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        open_video(tmp_path / "none.mp4")
    with pytest.raises(ValueError, match="is a folder"):
        open_video(tmp_path)
    if os.name == "posix":
        os.mkfifo(tmp_path / "pipe.mp4")
        with pytest.raises(ValueError, match="pipe.mp4 must be a file, got a pipe"):
            open_video(tmp_path / "pipe.mp4")


def test_sound_alone_is_no_video(tmp_path):
    path = tmp_path / "sound.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=16000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        frame.sample_rate = 16000
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with pytest.raises(ValueError, match="holds no video stream"):
        open_video(path)


def test_a_film_of_damaged_boxes_ends_the_reading_of_boxes(tmp_path, clip):
    rng = np.random.default_rng(0)
    original = clip.read_bytes()
    start = original.index(b"moov")
    for _ in range(30):
        data = bytearray(original)
        for place in rng.integers(start, len(data), 20):
            data[place] = rng.integers(256)
        path = tmp_path / "damaged.mp4"
        path.write_bytes(data)
        try:
            open_video(path)
        except ValueError as error:
            assert str(path) in str(error) and "\n" not in str(error)


def test_boxes_in_boxes_without_end_are_not_followed(tmp_path):
    nested = b""
    for _ in range(3000):
        nested = box(b"moov", nested)
    path = tmp_path / "deep.mp4"
    path.write_bytes(box(b"ftyp", b"isom\0\0\0\0") + nested)
    with pytest.raises(ValueError, match="deep.mp4"):
        open_video(path)


def test_without_pyav_the_message_says_what_to_install(clip, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImportError, match=r"videos need av: pip install 'epi360\[video\]'"):
        open_video(clip)


def test_names_of_videos(tmp_path):
    assert is_video("A.MP4") and is_video("b.insv")
    assert not is_video("b.txt") and not is_video(tmp_path)
