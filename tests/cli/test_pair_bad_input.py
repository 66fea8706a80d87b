# SPDX-License-Identifier: BSD-3-Clause
"""Whatever the user hands in: one clear sentence and the right exit code, never a wrong pose."""

import json

import cv2
import numpy as np
import pytest

from epi360 import Equirectangular, cli, estimate_relative_pose, relative_pose_of_images
from epi360.synthetic import two_view_scene
from epi360_scenes import demo_pair


def noise_image(height, width, seed=0):
    noise = np.random.default_rng(seed).normal(size=(height, width, 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return (128 + 45 * smooth / smooth.std()).clip(0, 255).astype(np.uint8)


def dual_fisheye_frame(height=256):
    """Two circles of texture side by side on black."""
    v, u = np.mgrid[:height, :height] + 0.5
    inside = np.hypot(u - height / 2, v - height / 2) < 0.48 * height
    disc = np.where(inside[:, :, None], noise_image(height, height), 0).astype(np.uint8)
    return np.hstack([disc, disc[:, ::-1]])


def encoded(image, extension=".png"):
    return cv2.imencode(extension, image)[1].tobytes()


def camera_file(**numbers):
    camera = {"model": "Equirectangular", **numbers}
    return json.dumps({"cameras": {"c": camera}}).encode()


@pytest.fixture(scope="module")
def pair():
    return demo_pair(width=512)


@pytest.fixture(scope="module")
def files(tmp_path_factory, pair):
    """Folder with two good panoramas and everything that is not."""
    folder = tmp_path_factory.mktemp("images")
    good = encoded(pair.image1[:, :, ::-1])
    contents = {
        "a.png": good,
        "b.png": encoded(pair.image2[:, :, ::-1]),
        "small_b.png": encoded(cv2.resize(pair.image2, (360, 180))[:, :, ::-1]),
        "truncated.png": good[: len(good) // 2],
        "truncated.jpg": encoded(pair.image1, ".jpg")[:20000],
        "text.jpg": b"This is no picture.\n",
        "empty.jpg": b"",
        "wide.png": encoded(noise_image(100, 500)),
        "square.png": encoded(noise_image(200, 200)),
        "x.insp": encoded(dual_fisheye_frame(), ".jpg"),
        "dual.png": encoded(dual_fisheye_frame()),
        "black.png": encoded(np.zeros((256, 512, 3), np.uint8)),
        "small_mask.png": encoded(np.full((128, 256), 255, np.uint8)),
        "black_mask.png": encoded(np.zeros((256, 512), np.uint8)),
        "text.yaml": b"This is no calibration.\n",
        "not_finite.json": camera_file(width=float("nan"), height=32),
        "other.json": camera_file(width=64, height=32),
        "part.json": camera_file(width=500, height=100, vertical_fov_deg=72),
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    (folder / "folder.jpg").mkdir()
    return folder


@pytest.fixture
def run(files, monkeypatch, capfd):
    """Exit code, stdout and stderr of the command, run where the files are."""
    monkeypatch.chdir(files)

    def run_command(*words):
        code = cli.main(["pair", *words])
        captured = capfd.readouterr()  # also what libraries write below Python
        return code, captured.out, captured.err

    return run_command


def assert_refused(outcome, *fragments):
    code, out, err = outcome
    assert code == 2
    assert out == ""
    assert err.startswith("epi360: error: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert "Traceback" not in err
    assert len(err) < 300
    for fragment in fragments:
        assert fragment in err


UNUSABLE_IMAGES = [
    ("missing.jpg", ["missing.jpg does not exist"]),
    ("folder.jpg", ["folder.jpg is a folder"]),
    ("text.jpg", ["text.jpg is not a JPEG, PNG"]),
    ("empty.jpg", ["empty.jpg is empty"]),
    ("truncated.png", ["truncated.png is a truncated PNG file"]),
    ("truncated.jpg", ["truncated.jpg is a truncated JPEG file"]),
    ("wide.png", ["must be 2:1, got 500x100", "field of view"]),
    ("square.png", ["must be 2:1, got 200x200", "field of view"]),
    ("x.insp", ["x.insp is a raw dual fisheye file", "export a stitched panorama first"]),
    ("dual.png", ["looks like a raw dual fisheye frame", "export a stitched panorama first"]),
]


@pytest.mark.parametrize(("name", "fragments"), UNUSABLE_IMAGES, ids=lambda v: str(v)[:12])
def test_an_unusable_image_is_refused_in_either_place(run, name, fragments):
    assert_refused(run(name, "b.png"), "image1", *fragments)
    assert_refused(run("a.png", name), "image2", *fragments)


@pytest.mark.parametrize(
    ("words", "fragments"),
    [
        (["--mask", "small_mask.png"], ["--mask must", "512x256", "256x128"]),
        (["--mask2", "small_mask.png"], ["mask2", "512x256", "256x128"]),
        (["--mask1", "missing.png"], ["mask1 missing.png does not exist"]),
        (["--mask1", "text.jpg"], ["mask1 text.jpg is not"]),
        (["--mask1", "black_mask.png"], ["mask1", "white"]),
        (["--camera", "missing.yaml"], ["missing.yaml"]),
        (["--camera", "text.yaml"], ["text.yaml"]),
        (["--camera", "a.png"], ["a.png"]),
        (["--camera", "folder.jpg"], ["folder.jpg"]),
        (["--camera1", "not_finite.json"], ["width"]),
        (["--camera1", "other.json"], ["image1 is 512x256", "64x32"]),
        (["--camera2", "other.json"], ["image2 is 512x256", "64x32"]),
        (["--inlier-threshold-deg", "0"], ["--inlier-threshold-deg", "0"]),
        (["--inlier-threshold-deg", "-1"], ["--inlier-threshold-deg", "-1"]),
        (["--inlier-threshold-deg", "nan"], ["--inlier-threshold-deg", "nan"]),
    ],
    ids=lambda v: " ".join(v)[:40],
)
def test_what_does_not_fit_the_images_is_refused(run, words, fragments):
    assert_refused(run("a.png", "b.png", *words), *fragments)


@pytest.mark.parametrize(
    "words",
    [
        ["--max-width", "0"],
        ["--max-width", "-5"],
        ["--mask-nadir-deg", "-10"],
        ["--mask-nadir-deg", "200"],
        ["--mask-nadir-deg", "nan"],
    ],
    ids=" ".join,
)
def test_an_option_out_of_its_range_is_refused(run, words):
    assert_refused(run("a.png", "b.png", *words), f"{words[0]} must be")


def test_nothing_is_written_for_refused_input(run, tmp_path):
    record, figure = tmp_path / "r.json", tmp_path / "f.png"
    assert_refused(run("a.png", "dual.png", "--json", str(record), "--figure", str(figure)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("names", [("black.png", "black.png"), ("a.png", "black.png")])
def test_a_black_image_is_an_honest_failure(run, tmp_path, names):
    record, figure = tmp_path / "r.json", tmp_path / "f.png"
    code, out, err = run(*names, "--json", str(record), "--figure", str(figure))
    assert code == 1
    assert err == ""
    assert out.startswith("Status        too_few_matches: ")
    written = json.loads(record.read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert written["status"] == "too_few_matches"
    numbers = np.array(written["cam2_from_cam1"]["rotation"], dtype=float)  # null is NaN
    assert np.isnan(numbers).all()
    assert figure.stat().st_size > 0


def test_the_same_image_twice_claims_no_translation(run, tmp_path):
    record = tmp_path / "r.json"
    code, out, err = run("a.png", "a.png", "--json", str(record))
    assert (code, err) == (1, "")
    assert out.startswith("Status        pure_rotation: ")
    written = json.loads(record.read_text(encoding="utf-8"), parse_constant=pytest.fail)
    pose = written["cam2_from_cam1"]
    assert np.isnan(np.array(pose["translation"], dtype=float)).all()
    np.testing.assert_allclose(pose["rotation"], np.eye(3), atol=1e-6)


def test_two_panoramas_of_different_sizes_simply_work(run):
    code, out, err = run("a.png", "small_b.png")
    assert (code, err) == (0, "")
    assert out.startswith("Status        ok: ")


def test_a_5_to_1_image_with_its_field_of_view_is_searched(run):
    code, out, err = run("wide.png", "wide.png", "--camera", "part.json")
    assert (code, err) == (1, "")
    assert out.startswith("Status        pure_rotation: ")


@pytest.mark.parametrize(("name", "fragments"), UNUSABLE_IMAGES, ids=lambda v: str(v)[:12])
def test_the_library_raises_what_the_command_says(files, pair, name, fragments):
    error = FileNotFoundError if name == "missing.jpg" else ValueError
    with pytest.raises(error) as caught:
        relative_pose_of_images(pair.image1, files / name)
    for fragment in fragments:
        assert fragment in str(caught.value)


@pytest.mark.parametrize("count", [0, 1, 3, 4])
def test_fewer_than_five_matches_are_an_honest_failure(count):
    scene = two_view_scene(0)
    result = estimate_relative_pose(scene.bearings1[:count], scene.bearings2[:count])
    assert result.status == "too_few_matches"
    assert not result.success
    assert np.isnan(result.cam2_from_cam1.matrix()[:3]).all()
    assert np.isnan(result.E).all()
    assert result.num_inliers == 0
    assert result.num_matches == count


@pytest.mark.parametrize("value", [0.0, np.inf, -np.inf])
@pytest.mark.parametrize("view", [1, 2])
def test_infinite_and_zero_bearings_are_refused_with_their_row(value, view):
    scene = two_view_scene(0)
    bearings = [scene.bearings1.copy(), scene.bearings2.copy()]
    bearings[view - 1][7] = value
    with pytest.raises(ValueError, match=f"bearings{view} must .* row 7"):
        estimate_relative_pose(*bearings)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((512, 1024, 2)), "image1 must have shape"),
        (np.zeros((0, 0, 3), np.uint8), "image1 must have shape"),
        (np.zeros((64, 128), np.int64), "image1 must be uint8"),
        (np.full((64, 128), 7.0), r"image1 of floats must lie in \[0, 1\]"),
    ],
)
def test_an_array_that_is_no_picture_is_refused(array, message):
    with pytest.raises(ValueError, match=message):
        relative_pose_of_images(array, array)


def test_a_picture_of_a_few_pixels_is_an_honest_failure():
    for height in (1, 2, 8):
        image = noise_image(height, 2 * height)
        result = relative_pose_of_images(image, image)
        assert result.status == "too_few_matches"


def test_a_camera_of_another_size_is_refused(pair):
    with pytest.raises(ValueError, match="image2 is 512x256 but its camera is 64x32"):
        relative_pose_of_images(pair.image1, pair.image2, camera2=Equirectangular(64, 32))


@pytest.mark.parametrize("option", ["--json", "--figure", "--report"])
def test_an_output_never_replaces_an_input(tmp_path, capsys, option):
    image = tmp_path / "a.png"
    cv2.imwrite(str(image), np.zeros((64, 128, 3), np.uint8))
    before = image.read_bytes()
    link = tmp_path / "link.png"
    link.symlink_to(image)
    for target in (image, link):
        assert cli.main(["pair", str(image), str(image), option, str(target)]) == 2
        captured = capsys.readouterr()
        assert captured.out == "" and "must not be the file of" in captured.err
    assert image.read_bytes() == before


def test_two_outputs_are_two_files(tmp_path, capsys):
    both = str(tmp_path / "out.png")
    assert cli.main(["pair", "--demo", "--json", both, "--figure", both]) == 2
    assert "--figure must not be the file of --json" in capsys.readouterr().err


def test_a_read_only_file_is_not_replaced(tmp_path, capsys):
    kept = tmp_path / "kept.json"
    kept.write_text("mine")
    kept.chmod(0o444)
    assert cli.main(["pair", "--demo", "--json", str(kept)]) == 2
    assert "read-only" in capsys.readouterr().err
    assert kept.read_text() == "mine"
