# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 render`: what is written, resumed and refused."""

import json

import cv2
import numpy as np
import pytest
from command_line import assert_help_names, assert_wrong_use

from epi360.cli import main


def run(capsys, *words):
    code = main(["render", *map(str, words)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def tree(folder):
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def test_the_command_writes_a_sequence_and_resumes_it(tmp_path, capsys):
    out = tmp_path / "sequence"
    words = (out, "--scene", "studio", "--num-frames", 2, "--width", 64)
    code, text, errors = run(capsys, *words)
    assert code == 0 and "2 frames of 64x32 pixels in" in text
    assert "frames: 2 of 2" in errors and "/s" in errors
    assert tree(out) == [
        "camera.json", "depth/tiff/1.tiff", "depth/tiff/2.tiff", "frm_ref.txt",
        "render.json", "rgb/1.png", "rgb/2.png", "rgb/frames.csv",
    ]  # fmt: skip
    assert cv2.imread(str(out / "rgb/2.png")).shape == (32, 64, 3)
    assert len(np.loadtxt(out / "frm_ref.txt")) == 2
    options = json.loads((out / "render.json").read_text())
    assert options["scene"] == "studio" and options["width"] == 64
    before = (out / "rgb/1.png").stat().st_mtime_ns
    (out / "rgb/2.png").unlink()
    assert run(capsys, *words)[0] == 0
    assert (out / "rgb/1.png").stat().st_mtime_ns == before and (out / "rgb/2.png").is_file()
    code, _, errors = run(capsys, *words, "--seed", 4)
    assert code == 2 and errors.count("\n") == 1
    assert "holds a sequence with seed 0, not 4" in errors


def test_effects_are_part_of_what_a_folder_was_made_with(tmp_path, capsys):
    out = tmp_path / "sequence"
    words = (out, "--scene", "studio", "--num-frames", 2, "--width", 32)
    assert run(capsys, *words)[0] == 0
    assert "loop" not in json.loads((out / "render.json").read_text())
    code, _, errors = run(capsys, *words, "--motion-blur", 3)
    assert code == 2 and "holds a sequence with motion_blur 1, not 3; choose another" in errors
    other = (tmp_path / "other", *words[1:], "--motion-blur", 3, "--exposure-change", 1)
    assert run(capsys, *other)[0] == run(capsys, *other)[0] == 0
    code, _, errors = run(capsys, tmp_path / "other", *words[1:])
    assert code == 2 and "holds a sequence with exposure_change 1.0, not 0.0; choose" in errors


def test_a_loop_ends_where_it_begins(tmp_path, capsys):
    words = ("--scene", "studio", "--num-frames", 90, "--width", 8, "--supersample", 1, "--loop")
    assert run(capsys, tmp_path / "loop", *words)[0] == 0
    rows = np.loadtxt(tmp_path / "loop" / "frm_ref.txt")
    np.testing.assert_allclose(rows[0, 1:], rows[-1, 1:], atol=1e-9)


def test_a_camera_with_more_pixels_than_any_command_reads_is_refused(tmp_path, capsys):
    calibration = tmp_path / "lens.json"
    lens = {"model": "KannalaBrandt", "width": 10**6, "height": 10**6, "fx": 1e5, "fy": 1e5}
    calibration.write_text(json.dumps({**lens, "cx": 5e5, "cy": 5e5}))
    words = ["render", tmp_path / "out", "--num-frames", 1, "--camera", calibration]
    assert_wrong_use(capsys, words, "--camera may have", "1000000x1000000")
    assert not (tmp_path / "out").exists()


def test_a_fisheye_sequence_has_the_size_of_its_camera(tmp_path, capsys):
    lens = {"model": "KannalaBrandt", "width": 48, "height": 40, "fx": 14, "fy": 14,
            "cx": 24, "cy": 20, "max_angle_deg": 95}  # fmt: skip
    calibration = tmp_path / "lens.json"
    calibration.write_text(json.dumps(lens))
    words = (tmp_path / "out", "--num-frames", 1, "--camera", calibration, "--scene", "studio")
    assert run(capsys, *words)[0] == 0
    depth = cv2.imread(str(tmp_path / "out/depth/tiff/1.tiff"), cv2.IMREAD_UNCHANGED)
    assert depth.shape == (40, 48) and depth[0, 0] == 0 and depth[20, 24] > 0


@pytest.mark.parametrize(
    "words, message",
    [
        (("--width", "63"), "--width must be a positive even number, got 63"),
        (("--num-frames", "0"), "--num-frames must be 1 or more, got 0"),
        (("--motion-blur", "2"), "--motion-blur must be odd"),
        (("--mesh", "none.glb", "--moving-people", "1"), "--moving-people walk through the built"),
        (("--supersample", "0"), "supersample must be 1 or more, got 0"),
        (("--mesh", "none.glb"), "none.glb"),
        (("--camera", "lens.json", "--width", "64"), "--width is that of a panorama"),
        (("--mesh", "none.glb", "--scene", "studio"), "--mesh or --scene, not both"),
    ],
)
def test_wrong_words_are_one_line_and_exit_code_2(words, message, tmp_path, capsys):
    assert_wrong_use(capsys, ["render", tmp_path / "out", *words], message)
    assert not (tmp_path / "out" / "rgb").exists()


def test_a_folder_that_cannot_be_written_is_reported(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    words = ("--num-frames", 1, "--width", 16, "--scene", "studio")
    code, _, errors = run(capsys, tmp_path / "file" / "out", *words)
    assert code == 2 and errors.count("\n") == 1 and "file" in errors


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "render", "--scene", "--seed", "--mesh", "--up", "--num-frames", "--step-m",
        "--max-turn-deg", "--height-m", "--clearance-m", "--width", "--camera", "--supersample",
        "--loop", "--moving-people", "--exposure-change", "--motion-blur", "--rolling-shutter-ms",
    )  # fmt: skip
