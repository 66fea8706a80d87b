# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 frames`, and a video in place of a folder, as a user types them."""

import pytest
from command_line import assert_help_names, assert_wrong_use
from rendered_views import NAMES, pictures
from written_videos import noise_frames, write_video

from epi360.cli import FAILURE, SUCCESS, main
from epi360.jobs.frames.frame_selection import FrameChooser

pytest.importorskip("av")


def test_frames_are_written_and_counted(tmp_path, capsys):
    video = write_video(tmp_path / "walk.mp4", noise_frames(10))
    words = ["frames", str(video), str(tmp_path / "out"), "--every", "4"]
    assert main(words) == SUCCESS
    assert "3 of 10 frames, 0.00 to 0.32 s, in" in capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / "out").glob("*.jpg")) == [
        "walk_000000.jpg", "walk_000004.jpg", "walk_000008.jpg",
    ]  # fmt: skip
    assert main(words) == SUCCESS


def test_match_takes_a_video(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    views = pictures()[:2]
    write_video(tmp_path / "tour.mp4", [views[0]] * 2 + [views[1]] * 2)
    assert main(["match", "tour.mp4"]) == SUCCESS
    assert "Accepted      1" in capsys.readouterr().out
    assert len(list((tmp_path / "tour-epi360" / "frames").glob("tour_*.jpg"))) == len(NAMES[:2])
    assert (tmp_path / "tour-epi360" / "pairs.csv").is_file()


def test_match_chooses_frames_again_when_it_is_told_to_restart(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    views = pictures()[:2]
    write_video(tmp_path / "tour.mp4", [views[0]] * 2 + [views[1]] * 2)
    assert main(["match", "tour.mp4"]) == SUCCESS
    capsys.readouterr()
    words = ["match", "tour.mp4", "--mask-nadir-deg", "10"]
    assert_wrong_use(capsys, words, "--mask-nadir-deg 0.0, not --mask-nadir-deg 10.0; choose anoth")
    assert main([*words, "--restart"]) == SUCCESS


@pytest.mark.parametrize("number", [0, 2])
def test_an_interrupted_choice_of_frames_begins_again(tmp_path, capsys, monkeypatch, number):
    video = write_video(tmp_path / "walk.mp4", noise_frames(4))
    words = ["frames", str(video), str(tmp_path / "out")]
    add, looked_at = FrameChooser.add, []

    def interrupted(chooser, index, *frame):
        looked_at.append(index)
        if looked_at == list(range(number + 1)):
            raise KeyboardInterrupt
        return add(chooser, index, *frame)

    monkeypatch.setattr(FrameChooser, "add", interrupted)
    assert main(words) == 130
    assert "the same command goes on from there" in capsys.readouterr().err
    assert main(words) == SUCCESS
    assert looked_at[number + 1] == 0
    assert list((tmp_path / "out").glob("walk_*.jpg"))


def test_a_still_camera_is_said_to_be_still(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / "still.mp4", noise_frames(1) * 8)
    assert main(["match", "still.mp4"]) == FAILURE
    assert "the camera moved less than 0.3 degrees of parallax" in capsys.readouterr().out


def test_wrong_use_is_one_line(tmp_path, capsys):
    video = write_video(tmp_path / "walk.mp4", noise_frames(3))
    out = tmp_path / "out"
    assert_wrong_use(capsys, ["frames", video, out, "--every", "0"], "--every must be 1 or more")
    assert_wrong_use(capsys, ["frames", tmp_path / "none.mp4", out], "none.mp4 does not exist")
    assert_wrong_use(capsys, ["match", tmp_path / "none.mp4"], "none.mp4 does not exist")
    assert_wrong_use(capsys, ["map", tmp_path / "none.mp4"], "none.mp4 does not exist")
    assert_wrong_use(capsys, ["frames", video, out, "--start", "nan"], "--start must be a number")
    assert_wrong_use(capsys, ["track", video, "--end", "nan"], "--end must be a number of seconds")
    both = ["--every", "2", "--parallax-deg", "3"]
    assert_wrong_use(capsys, ["frames", video, out, *both], "--parallax-deg must not be given")
    assert not out.exists()


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "frames", "--every", "--start", "--end", "--parallax-deg", "--camera", "--mask",
        "--mask-nadir-deg", "--jpeg-quality", "VIDEO", "OUT",
    )  # fmt: skip
