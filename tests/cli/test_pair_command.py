# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 pair`: words, exit codes, one line for what is wrong, nothing else on stderr."""

import json
import time
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from command_line import assert_help_names, assert_wrong_use

from epi360 import cli
from epi360.cameras import Equirectangular
from epi360.estimation.result import ImagePairResult
from epi360.interop.gpano import gpano_packet, with_gpano
from epi360.poses import Pose

CAMERA = Equirectangular(width=64, height=32)
ESTIMATE = "epi360.two_view.relative_pose_of_images"


def result_with(status="ok"):
    rotation = np.eye(3) if status in ("ok", "pure_rotation") else np.full((3, 3), np.nan)
    translation = np.array([0.0, 0.0, 1.0]) if status == "ok" else np.full(3, np.nan)
    return ImagePairResult(
        cam2_from_cam1=Pose(rotation, translation),
        E=np.cross(translation, rotation.T).T,
        inlier_mask=np.zeros(0, dtype=bool),
        residuals_rad=np.zeros(0),
        noise_deg=0.1,
        inlier_threshold_deg=0.3,
        parallax_deg=float("nan"),
        sphere_coverage=0.5,
        num_iterations=10,
        status=status,
        covariance=np.full((5, 5), np.nan),
        translation_basis=np.full((3, 2), np.nan),
        keypoints1=np.zeros((0, 2)),
        keypoints2=np.zeros((0, 2)),
    )


@pytest.fixture
def images(tmp_path):
    paths = [tmp_path / "a.png", tmp_path / "b.png"]
    for path in paths:
        assert cv2.imwrite(str(path), np.full((32, 64, 3), 90, np.uint8))
    return [str(path) for path in paths]


@pytest.fixture
def estimates(monkeypatch):
    """Calls of the library, which answers at once; set .status for another verdict."""
    calls = SimpleNamespace(status="ok", options=[])

    def estimate(image1, image2, **options):
        calls.options.append(options)
        options["progress"]("matching")
        return result_with(calls.status)

    monkeypatch.setattr(ESTIMATE, estimate)
    return calls


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["pair"], "two images"),
        (["pair", "a.jpg"], "two images"),
        (["pair", "a.jpg", "b.jpg", "c.jpg"], "c.jpg"),
        (["pair", "--nope"], "--nope"),
        (["pair", "a.jpg", "b.jpg", "--seed", "x"], "--seed"),
        (["pair", "a.jpg", "b.jpg", "--seed"], "--seed"),
        (["pair", "a.jpg", "b.jpg", "--inlier-threshold-deg", "wide"], "--inlier-threshold-deg"),
        (["pair", "--demo", "a.jpg", "b.jpg"], "--demo"),
        (["pair", "--demo", "--mask", "m.png"], "--demo"),
        (["pair", "a.jpg", "b.jpg", "--save-images", "d"], "--save-images needs --demo"),
        (["pair", "a.jpg", "b.jpg", "--camera", "c", "--camera2", "d"], "--camera1 and --camera2"),
        (["pair", "a.jpg", "b.jpg", "--mask", "c", "--mask1", "d"], "--mask1 and --mask2"),
        (["pair", "a.jpg", "b.jpg", "--json", "/no/such/folder/r.json"], "/no/such/folder"),
        (["pair", "a.jpg", "b.jpg", "--figure", "f.gif"], ".png"),
        (["pair", "a.jpg", "b.jpg", "--report", "f.txt"], "--report must end in .html"),
    ],
)
def test_wrong_words_are_one_line_and_exit_2(capsys, arguments, fragment):
    assert_wrong_use(capsys, arguments, fragment)


def test_outputs_are_checked_before_the_work(capsys, images, estimates, tmp_path):
    for option, name in (("--json", "x.json"), ("--figure", "x.png"), ("--report", "x.html")):
        missing = str(tmp_path / "missing" / name)
        assert_wrong_use(capsys, ["pair", *images, option, missing], option, "does not exist")
    assert estimates.options == []


def test_a_missing_image_is_wrong_use(capsys, images):
    assert_wrong_use(capsys, ["pair", images[0], "missing.jpg"], "missing.jpg")


def test_a_missing_camera_file_is_wrong_use(capsys, images):
    assert_wrong_use(capsys, ["pair", *images, "--camera", "missing.yaml"], "missing.yaml")


@pytest.mark.parametrize(
    "error", [ValueError("image1 must be 2:1,\n got 5:1"), OSError(28, "No space", "r.json")]
)
def test_errors_of_the_library_are_one_line(capsys, images, monkeypatch, error):
    def fail(*images, **options):
        raise error

    monkeypatch.setattr(ESTIMATE, fail)
    words = {ValueError: "image1 must be 2:1, got 5:1", OSError: "r.json: No space"}[type(error)]
    assert_wrong_use(capsys, ["pair", *images], words)


def test_an_interrupt_is_one_line_and_exit_130(capsys, images, monkeypatch):
    def interrupt(*images, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(ESTIMATE, interrupt)
    assert cli.main(["pair", *images]) == 130
    assert capsys.readouterr() == ("", "epi360: interrupted\n")


@pytest.mark.parametrize(
    ("status", "code"), [("ok", 0), ("pure_rotation", 1), ("too_few_inliers", 1)]
)
def test_the_exit_code_tells_a_pose_from_an_honest_failure(
    capsys, images, estimates, status, code, tmp_path
):
    estimates.status = status
    record, figure, report = (tmp_path / name for name in ("r.json", "f.png", "p.html"))
    arguments = ["pair", *images, "--json", str(record), "--figure", str(figure)]
    arguments += ["--report", str(report)]
    assert cli.main(arguments) == code
    captured = capsys.readouterr()
    assert captured.out.startswith(f"Status        {status}: ")
    assert captured.err == ""
    written = json.loads(record.read_text(encoding="utf-8"))
    assert (written["status"], written["image1"]) == (status, images[0])
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert report.read_bytes().endswith(b"</html>\n")


def test_options_reach_the_library_under_their_own_names(images, estimates):
    defaults = {"mask_nadir_deg": 0.0, "inlier_threshold_deg": "auto", "max_width": 4096, "seed": 0}
    cli.main(["pair", *images])
    assert {key: estimates.options[0][key] for key in defaults} == defaults
    given = ["--mask-nadir-deg", "20", "--inlier-threshold-deg", "0.5", "--max-width", "512"]
    cli.main(["pair", *images, *given, "--seed", "3", "--mask2", "m.png"])
    changed = {"mask_nadir_deg": 20.0, "inlier_threshold_deg": 0.5, "max_width": 512, "seed": 3}
    assert {key: estimates.options[1][key] for key in defaults} == changed
    assert (estimates.options[1]["mask1"], estimates.options[1]["mask2"]) == (None, Path("m.png"))


def test_upright_panoramas_have_gravity_below_or_where_their_files_state_it(images, estimates):
    cli.main(["pair", *images])
    assert (estimates.options[0]["gravity1"], estimates.options[0]["gravity2"]) == (None, None)
    path = Path(images[1])
    path.write_bytes(with_gpano(path.read_bytes(), gpano_packet(CAMERA, roll_deg=90.0)))
    cli.main(["pair", *images, "--upright", "2.5"])
    np.testing.assert_allclose(estimates.options[1]["gravity1"], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(estimates.options[1]["gravity2"], [1, 0, 0], atol=1e-12)
    assert estimates.options[1]["gravity_sigma_deg"] == 2.5


def test_a_camera_that_is_no_panorama_is_not_upright(capsys, images, estimates, tmp_path):
    camera = {"model": "Pinhole", "width": 64, "height": 32, "fx": 30, "fy": 30, "cx": 32, "cy": 16}
    (tmp_path / "camera.json").write_text(json.dumps(camera), encoding="utf-8")
    words = ["pair", *images, "--camera", str(tmp_path / "camera.json"), "--upright", "1"]
    assert_wrong_use(capsys, words, "--upright needs panoramas", images[0], "Pinhole")
    assert_wrong_use(capsys, ["pair", *images, "--upright", "90"], "--upright must be in (0, 45]")
    assert estimates.options == []


@pytest.fixture
def rig(tmp_path):
    """Calibration file of two cameras."""
    cameras = {
        name: {"model": "Equirectangular", "width": width, "height": 32}
        for name, width in (("left", 64), ("right", 50))
    }
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({"cameras": cameras}), encoding="utf-8")
    return str(path)


def test_a_mask_and_a_camera_for_both_reach_both_views(images, estimates, rig):
    cli.main(["pair", *images, "--mask", "m.png", "--camera", f"{rig}:left"])
    options = estimates.options[0]
    assert (options["mask1"], options["mask2"]) == (Path("m.png"), Path("m.png"))
    assert (options["camera1"], options["camera2"]) == (CAMERA, CAMERA)


def test_a_camera_of_a_rig_is_picked_by_name(capsys, images, estimates, rig):
    cli.main(["pair", *images, "--camera1", f"{rig}:left", "--camera2", f"{rig}:right"])
    assert estimates.options[0]["camera1"] == CAMERA
    assert estimates.options[0]["camera2"].width == 50
    capsys.readouterr()
    assert_wrong_use(capsys, ["pair", *images, "--camera", rig], "left, right", ":NAME")
    assert_wrong_use(capsys, ["pair", *images, "--camera", f"{rig}:up"], "'up'", "left, right")


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "pair", "--camera1", "--mask", "--mask-nadir-deg", "--inlier-threshold-deg",
        "--upright",
        "--json", "--figure", "--report", "--max-width", "--seed", "--demo", "--save-images",
    )  # fmt: skip


def test_the_demo_prints_the_estimate_beside_the_truth(capsys, tmp_path):
    record, folder = tmp_path / "demo.json", tmp_path / "images"
    began = time.process_time()
    arguments = ["pair", "--demo", "--json", str(record), "--save-images", str(folder)]
    assert cli.main(arguments) == 0
    assert time.process_time() - began < 20  # of the processor: a few; other programs do not count
    last = capsys.readouterr().out.splitlines()[-5:]
    assert last[0].split() == ["estimate", "truth", "error"]
    assert last[3:] == [f"wrote {record}", f"wrote {folder}"]
    truth = json.loads(record.read_text(encoding="utf-8"))["truth"]
    assert truth["rotation_error_deg"] < 0.3
    assert truth["translation_error_deg"] < 1.0
    assert sorted(path.name for path in folder.iterdir()) == ["demo1.png", "demo2.png"]
