# SPDX-License-Identifier: BSD-3-Clause
"""Key points are found once for each content and come back as they were."""

import dataclasses
import struct

import cv2
import numpy as np
import pytest
from rendered_views import SIZES, pictures, write_png, write_views

from epi360.cameras import Equirectangular
from epi360.features import extract_features
from epi360.jobs.folder import feature_cache
from epi360.jobs.folder.feature_cache import ExtractionOptions, FeatureCache, UnreadableImageError
from epi360.jobs.folder.image_set import SourceImage
from epi360.runs.arrays import read_arrays

CAMERA = Equirectangular(*SIZES[0])
OPTIONS = ExtractionOptions(max_width=512, max_features=400, mask_nadir_deg=0.0)


@pytest.fixture
def cache(tmp_path):
    (tmp_path / "cache").mkdir()
    return FeatureCache(tmp_path / "cache", OPTIONS)


@pytest.fixture
def image(tmp_path):
    write_views(tmp_path, ["a.png"])
    return SourceImage("a.png", tmp_path / "a.png", "c")


def assert_same(first, second):
    for field in dataclasses.fields(first):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name))


def test_what_is_loaded_is_what_was_found(cache, image):
    key = cache.key(image, CAMERA)
    assert not cache.has(key)
    assert cache.load(key) is None
    found = cache.extract(key, image, CAMERA)
    assert cache.has(key)
    assert_same(cache.load(key), found)


def test_descriptors_in_bytes_lose_nothing(cache, image):
    found = cache.extract("k", image, CAMERA).features()
    expected = extract_features(pictures()[0], max_features=400, contrast_threshold=0.013)
    assert len(found) == 400
    np.testing.assert_array_equal(found.descriptors, expected.descriptors)
    np.testing.assert_allclose(found.keypoints, expected.keypoints, atol=2e-5)


def test_a_key_point_takes_147_bytes(cache, image):
    cache.extract("k", image, CAMERA)
    assert (cache.folder / "k.npz").stat().st_size < 400 * 147 + 2000


def test_colors_are_those_of_the_upright_picture(cache, tmp_path):
    turned = np.ascontiguousarray(pictures()[0][::-1, ::-1, ::-1])
    jpeg = cv2.imencode(".jpg", turned, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
    by_180_degrees = struct.pack(">IHHHIHHI", 8, 1, 0x112, 3, 1, 3, 0, 0)
    exif = b"Exif\0\0MM\0*" + by_180_degrees
    segment = b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif
    (tmp_path / "a.jpg").write_bytes(jpeg[:2] + segment + jpeg[2:])
    found = cache.extract("k", SourceImage("a.jpg", tmp_path / "a.jpg", "c"), CAMERA)
    colors = read_arrays(cache.folder / "k.npz")["colors"].astype(int)
    columns, rows = found.pixels.astype(int).T
    errors = np.abs(colors - pictures()[0][rows, columns])
    assert np.median(errors) < 8  # what JPEG leaves; of the picture upside down about 40


def test_the_name_of_an_image_is_not_part_of_its_key(cache, image, tmp_path):
    moved = tmp_path / "other folder" / "é.png"
    write_png(moved, pictures()[0])
    same = SourceImage("é.png", moved, "another name")
    assert cache.key(same, CAMERA) == cache.key(image, CAMERA)


def test_everything_that_key_points_depend_on_is_part_of_the_key(cache, image, tmp_path):
    keys = [cache.key(image, CAMERA)]
    keys.append(cache.key(image, dataclasses.replace(CAMERA, center_longitude_deg=1.0)))
    for change in ({"max_width": 500}, {"max_features": 9}, {"mask_nadir_deg": 5.0}):
        other = FeatureCache(cache.folder, dataclasses.replace(OPTIONS, **change))
        keys.append(other.key(image, CAMERA))
    for brightness in (200, 255):
        mask = tmp_path / f"{brightness}.png"
        write_png(mask, np.full((256, 512, 3), brightness, np.uint8))
        keys.append(cache.key(dataclasses.replace(image, mask=mask), CAMERA))
    changed = pictures()[0].copy()
    changed[0, 0, 0] ^= 1
    write_png(image.path, changed)
    keys.append(cache.key(image, CAMERA))
    assert len(set(keys)) == len(keys)


def test_image_and_mask_do_not_change_places_in_the_key(cache, image, tmp_path):
    other = tmp_path / "b.png"
    write_png(other, pictures()[1])
    key1 = cache.key(dataclasses.replace(image, mask=other), CAMERA)
    key2 = cache.key(dataclasses.replace(image, path=other, mask=image.path), CAMERA)
    assert key1 != key2


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "garbage", "header"])
def test_a_damaged_file_counts_as_missing(cache, image, damage):
    cache.extract("k", image, CAMERA)
    path = cache.folder / "k.npz"
    data = bytearray(path.read_bytes())
    if damage == "flip":
        data[len(data) // 2] ^= 1
    if damage == "header":
        data[60] ^= 64
    changed = {"cut": data[:-100], "empty": b"", "garbage": b"no npz at all"}
    path.write_bytes(changed.get(damage, data))
    assert not cache.has("k")
    assert cache.load("k") is None


def test_masked_pixels_have_no_key_points(cache, image, tmp_path):
    mask = np.full((256, 512, 3), 255, np.uint8)
    mask[:, 300:] = 0
    write_png(tmp_path / "m.png", mask)
    found = cache.extract("k", dataclasses.replace(image, mask=tmp_path / "m.png"), CAMERA)
    assert len(found.pixels) > 100
    assert found.pixels[:, 0].max() < 300


@pytest.mark.parametrize("content", [None, b"", b"\x89PNG\r\n\x1a\n cut"])
def test_an_image_that_cannot_be_read_is_named(cache, image, content):
    key = cache.key(image, CAMERA)
    image.path.unlink() if content is None else image.path.write_bytes(content)
    with pytest.raises(UnreadableImageError, match="a.png"):
        cache.extract(key, image, CAMERA)
    assert not cache.has(key)
    if content is None:
        with pytest.raises(UnreadableImageError, match="a.png"):
            cache.key(image, CAMERA)


def test_a_full_disk_is_no_fault_of_the_image(cache, image, monkeypatch):
    def fail(path, data):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(feature_cache, "write_file", fail)
    with pytest.raises(OSError, match="No space left"):
        cache.extract("k", image, CAMERA)


def test_a_raw_dual_fisheye_frame_is_not_taken_for_a_panorama(cache, tmp_path):
    width, height = SIZES[0]
    v, u = np.mgrid[:height, :height] + 0.5
    inside = np.hypot(u - height / 2, v - height / 2) < 0.48 * height
    lit = np.random.default_rng(0).integers(60, 200, (height, height))
    disc = np.where(inside, lit, 0).astype(np.uint8)
    frame = np.repeat(np.hstack([disc, disc])[:, :, None], 3, axis=2)
    write_png(tmp_path / "raw.png", frame)
    with pytest.raises(UnreadableImageError, match="dual fisheye"):
        cache.extract("k", SourceImage("raw.png", tmp_path / "raw.png", "c"), CAMERA)


def test_a_photograph_in_the_shape_of_a_panorama_is_taken_for_one_only_if_that_is_stated(
    cache, tmp_path
):
    rng = np.random.default_rng(0)
    photograph = cv2.resize(rng.integers(0, 255, (16, 32, 3)).astype(np.uint8), SIZES[0])
    write_png(tmp_path / "a.png", photograph)
    image = SourceImage("a.png", tmp_path / "a.png", "c")
    with pytest.raises(UnreadableImageError, match="left and right ends"):
        cache.extract("k", image, CAMERA)
    assert len(cache.extract("k", dataclasses.replace(image, is_stated=True), CAMERA).pixels)
