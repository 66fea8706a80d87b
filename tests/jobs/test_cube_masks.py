# SPDX-License-Identifier: BSD-3-Clause
"""Masks of cube faces: as files under two names, and as alpha channel."""

import json

import cv2
import numpy as np
import pytest
from cube_inputs import plain_reconstruction, read_picture, two_panoramas, write_png

from epi360.cameras import KannalaBrandt
from epi360.jobs.cubes.cube_faces import CubemapOptions
from epi360.jobs.cubes.cubemap import export_cubemap
from epi360.jobs.cubes.face_sampler import FaceSampler

FISHEYE = KannalaBrandt(200, 200, 60.0, 60.0, 100.0, 100.0, 0, 0, 0, 0, max_angle_deg=95)


def test_masks_are_cut_like_the_panoramas(tmp_path):
    folder, source = two_panoramas(tmp_path, ("sub/ä.png", "b.png"))
    mask = np.full((128, 256), 255, np.uint8)
    mask[:, :128] = 0  # the left half of the world
    write_png(tmp_path / "mask.png", mask)
    out = tmp_path / "out"
    masks = {"sub/ä.png": tmp_path / "mask.png"}
    export_cubemap(folder, source, out, masks=masks, mask_nadir_deg=30.0)
    front = read_picture(out / "masks" / "sub" / "ä_front.jpg.png")[..., 0]
    assert not front[:, :31].any() and front[:, 33:].all()
    down = read_picture(out / "masks" / "b_down.jpg.png")[..., 0]
    radius = 32 * np.tan(np.radians(30))
    away = np.hypot(*(np.indices((64, 64)) + 0.5 - 32))
    assert not down[away < radius - 2].any() and down[away > radius + 2].all()
    assert read_picture(out / "masks" / "b_up.jpg.png").all()


@pytest.mark.parametrize("suffix", [".png", ".tif", ".webp", ".bmp"])
def test_opaque_pictures_have_no_masks(tmp_path, suffix):
    folder, _ = two_panoramas(tmp_path, ("a.png",))
    opaque = np.dstack([cv2.imread(str(folder / "a.png")), np.full((128, 256), 255, np.uint8)])
    picture = opaque if suffix == ".png" else opaque[:, :, :3]
    cv2.imwrite(str(folder / f"b{suffix}"), picture)
    export_cubemap(folder, plain_reconstruction([f"b{suffix}"]), tmp_path / "out")
    assert not (tmp_path / "out" / "masks").exists()


def test_what_is_transparent_is_masked(tmp_path):
    folder, source = two_panoramas(tmp_path, ("a.png", "b.png"))
    opaque = cv2.imread(str(folder / "a.png"))
    alpha = np.full((128, 256), 255, np.uint8)
    alpha[104:] = 0  # 56 degrees below the horizon
    cv2.imwrite(str(folder / "a.png"), np.dstack([opaque, alpha]))
    mask = np.full((128, 256), 255, np.uint8)
    mask[:10] = 0
    write_png(tmp_path / "mask.png", mask)
    out = tmp_path / "out"
    export_cubemap(folder, source, out, masks={"a.png": tmp_path / "mask.png"})
    down, up = (read_picture(out / "masks" / f"a_{face}.jpg.png") for face in ("down", "up"))
    assert not down[32, 32].any() and down[1, 1].all()
    assert not up[32, 32].any() and up[1, 1].all()
    assert read_picture(out / "masks" / "b_down.jpg.png").all()
    export_cubemap(folder, source, tmp_path / "no_mask")
    assert not read_picture(tmp_path / "no_mask" / "masks" / "a_down.jpg.png")[32, 32].any()


def test_every_face_has_a_mask_that_nerfstudio_is_told_of_or_none_has(tmp_path):
    folder, source = two_panoramas(tmp_path, ("sub/ä.png", "b.png"))
    write_png(tmp_path / "mask.png", np.full((128, 256), 255, np.uint8))
    out = tmp_path / "out"
    export_cubemap(folder, source, out)
    assert "mask_path" not in (out / "transforms.json").read_text()
    export_cubemap(folder, source, out, masks={"sub/ä.png": tmp_path / "mask.png"})
    frames = json.loads((out / "transforms.json").read_text(encoding="utf-8"))["frames"]
    assert len(frames) == 12
    for frame in frames:
        assert frame["mask_path"] == frame["file_path"].replace("images/", "masks/") + ".png"
        mask = cv2.imdecode(np.fromfile(out / frame["mask_path"], np.uint8), -1)
        assert mask.shape == (64, 64) and mask.all()  # nerfstudio wants one channel


@pytest.mark.parametrize("kind", ["jpg", "png"])
def test_each_mask_is_also_where_the_colmap_reader_of_nerfstudio_looks(tmp_path, kind):
    """It takes (masks / name).with_suffix(".png"), COLMAP takes masks / (name + ".png")."""
    folder, source = two_panoramas(tmp_path, ("sub/ä.1.png", "b.png"))
    out, options = tmp_path / "out", CubemapOptions(image_format=kind)
    export_cubemap(folder, source, out, options, mask_nadir_deg=30.0)
    faces = [path.relative_to(out / "images") for path in out.rglob(f"images/**/*.{kind}")]
    assert len(faces) == 12
    for face in faces:
        theirs = (out / "masks" / face).with_suffix(".png")
        assert theirs.read_bytes() == (out / "masks" / f"{face}.png").read_bytes()
    assert len(list(out.rglob("masks/**/*.png"))) == 24
    export_cubemap(folder, plain_reconstruction(["b.png"]), out, options, mask_nadir_deg=30.0)
    assert len(list(out.rglob("masks/**/*.png"))) == 12


def test_alpha_is_transparent_where_the_mask_is_black(tmp_path):
    folder, source = two_panoramas(tmp_path)
    options = CubemapOptions(image_format="png", alpha=True)
    export_cubemap(folder, source, tmp_path / "out", options, mask_nadir_deg=30.0)
    for name in ("a_down.png", "a_front.png"):
        face = cv2.imdecode(np.fromfile(tmp_path / "out" / "images" / name, np.uint8), -1)
        mask = read_picture(tmp_path / "out" / "masks" / f"{name}.png")[..., 0]
        assert face.shape == (64, 64, 4)
        np.testing.assert_array_equal(face[..., 3], mask)
    assert mask.all() and face[..., :3].any()
    export_cubemap(folder, source, tmp_path / "opaque", options)  # nothing is masked
    face = cv2.imdecode(np.fromfile(tmp_path / "opaque/images/a_up.png", np.uint8), -1)
    assert face.shape == (64, 64, 3)


def test_a_camera_that_does_not_see_all_around_gets_masks(tmp_path):
    write_png(tmp_path / "in" / "a.png", np.full((200, 200, 3), 200, np.uint8))
    source = plain_reconstruction(["a.png"], FISHEYE)
    export_cubemap(tmp_path / "in", source, tmp_path / "out")
    frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
    assert len(frames) == 5 and all("mask_path" in frame for frame in frames)


def test_a_mask_of_all_panoramas_is_cut_once(tmp_path, monkeypatch):
    cuts = []
    mask_of = FaceSampler.mask
    monkeypatch.setattr(FaceSampler, "mask", lambda *a: cuts.append(1) or mask_of(*a))
    folder, source = two_panoramas(tmp_path)
    write_png(tmp_path / "mask.png", np.full((128, 256), 255, np.uint8))
    masks = dict.fromkeys(("a.png", "b.png"), tmp_path / "mask.png")
    export_cubemap(folder, source, tmp_path / "out", masks=masks, mask_nadir_deg=20.0)
    assert len(cuts) == 6
    for face in ("a_down.jpg.png", "b_down.jpg.png"):
        assert not read_picture(tmp_path / "out" / "masks" / face).all()


def test_what_a_lens_does_not_light_is_masked(tmp_path):
    """Most calibration files do not say where a lens ends."""
    endless = KannalaBrandt(200, 200, 60.0, 60.0, 100.0, 100.0, 0, 0, 0, 0)
    v, u = np.mgrid[:200, :200] + 0.5
    radius = np.hypot(u - 100, v - 100)
    for number, dark in enumerate((0, 40)):  # a dark corner of a room is lit in another picture
        lit = np.where(radius < 95, 200, 0).astype(np.uint8)
        lit[100 - dark : 100, 150 : 150 + dark] = 0
        write_png(tmp_path / "in" / f"{number}.png", np.repeat(lit[..., None], 3, axis=2))
    source = plain_reconstruction(["0.png", "1.png"], endless)
    export_cubemap(tmp_path / "in", source, tmp_path / "out")
    num_used = 0
    for face in (tmp_path / "out" / "images").iterdir():
        mask = read_picture(tmp_path / "out" / "masks" / f"{face.name}.png")[..., 0] > 127
        num_used += np.count_nonzero(mask)
        if face.name.startswith("0"):
            assert (read_picture(face)[mask] > 100).all()
        elif face.name.startswith("1_right"):
            assert (read_picture(face)[mask] < 100).any()  # dark, but no end of the lens
    assert num_used > 0
