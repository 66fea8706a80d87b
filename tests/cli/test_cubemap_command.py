# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 cubemap`: what is printed and written, exit codes."""

import cv2
import numpy as np
import pytest
from command_line import assert_help_names, assert_wrong_use

from epi360 import cli

pytest.importorskip("pycolmap")

from epi360.interop.colmap_model import read_colmap_model  # noqa: E402


@pytest.mark.parametrize("model", ["sparse/0", ".", "transforms.json"])
def test_a_model_that_is_there_is_cut_without_mapping(
    room_folder, room_run, tmp_path, capsys, model
):
    model, images = str(room_run[0] / model), str(room_folder[0])
    out = tmp_path / "cube"
    assert cli.main(["cubemap", model, images, str(out), "--faces", "up", "--face-size", "32"]) == 0
    assert capsys.readouterr().out == f"wrote {out} (6 cube faces)\n"
    again = read_colmap_model(out / "sparse" / "0")
    assert {camera.width for camera in again.cameras.values()} == {32}


def test_native_flat_and_alpha_faces(room_folder, room_run, tmp_path, capsys):
    model, images = str(room_run[0] / "sparse" / "0"), str(room_folder[0])
    words = ["cubemap", model, images, str(tmp_path / "out"), "--face-size", "native", "--flat"]
    more = ["--alpha", "--image-format", "png", "--mask-nadir-deg", "20", "--faces", "down"]
    assert cli.main([*words, *more]) == 0
    again = read_colmap_model(tmp_path / "out" / "sparse" / "0")
    assert {camera.width for camera in again.cameras.values()} == {162}  # 512 / pi = 162.97, even
    files = {path.name for path in (tmp_path / "out" / "images").iterdir()}
    assert files == {image.name for image in again.images} and len(files) == 6
    face = cv2.imread(str(tmp_path / "out" / "images" / min(files)), cv2.IMREAD_UNCHANGED)
    assert face.shape == (162, 162, 4) and not face[81, 81, 3] and face[0, 0, 3]


def test_an_image_that_is_not_in_the_folder_is_named(room_folder, room_run, tmp_path, capsys):
    empty = tmp_path / "empty"
    empty.mkdir()
    model = room_run[0] / "sparse" / "0"
    assert_wrong_use(capsys, ["cubemap", model, empty, tmp_path / "out"], ".png")


def test_faces_show_no_pixel_that_is_masked_out(room_folder, room_run, tmp_path, capsys):
    mask = np.full((256, 512), 255, np.uint8)
    mask[128:] = 0  # the lower half of every panorama
    assert cv2.imwrite(str(tmp_path / "mask.png"), mask)
    model, images = str(room_run[0] / "sparse" / "0"), str(room_folder[0])
    words = ["cubemap", model, images, str(tmp_path / "out"), "--mask", str(tmp_path / "mask.png")]
    assert cli.main([*words, "--faces", "down", "front", "--face-size", "32"]) == 0
    shares = {"down": [], "front": []}
    for path in (tmp_path / "out" / "masks").rglob("*.jpg.png"):
        face = path.name.removesuffix(".png").rpartition(".")[0].rpartition("_")[2]
        shares[face].append((cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 0).mean())
    assert len(shares["down"]) == len(shares["front"]) == 6
    assert max(shares["down"]) == 0.0
    np.testing.assert_allclose(shares["front"], 0.5, atol=0.04)  # a row of 32 is 0.03


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["DATABASE", "IMAGES", "OUT"], "holds matches"),
        (["MODEL", "IMAGES", "IMAGES"], "cannot be written into"),
        (["MODEL", "IMAGES", "OUT", "--fov-deg", "180"], " --fov-deg must be"),
        (["MODEL", "IMAGES", "OUT", "--mask-nadir-deg=-5"], " --mask-nadir-deg must"),
        (["MODEL", "IMAGES", "OUT", "--alpha"], " --image-format must be png"),
        (["MODEL", "IMAGES", "OUT", "--face-size", "3"], " --face-size must be 8"),
        (["NOWHERE", "IMAGES", "OUT"], "does not exist"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(
    room_folder, room_run, tmp_path, capsys, words, message
):
    output, _ = room_run
    paths = {
        "IMAGES": room_folder[0], "DATABASE": output / "database.db",
        "MODEL": output / "sparse" / "0", "OUT": tmp_path / "out", "NOWHERE": tmp_path / "no",
    }  # fmt: skip
    assert_wrong_use(capsys, ["cubemap", *(paths.get(word, word) for word in words)], message)
    assert not (tmp_path / "out").exists()


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "cubemap", "--mask", "--mask-nadir-deg", "--face-size", "--fov-deg", "--faces",
        "--image-format", "--jpeg-quality", "--flat", "--alpha",
    )  # fmt: skip
