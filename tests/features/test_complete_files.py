# SPDX-License-Identifier: BSD-3-Clause
"""Damaged pictures are refused, whole ones never."""

import io
import random

import cv2
import numpy as np
import pytest
from PIL import Image

from epi360.features import read_image


def picture(width=256, height=128):
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (20, 40, 3), np.uint8)
    smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return cv2.add(smooth, rng.integers(0, 20, smooth.shape, np.uint8))


def encoded(pixels, kind, **options):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()


def zeroed(data, place, length):
    return data[:place] + bytes(length) + data[place + length :]


def replaced(data, place, length):
    return data[:place] + random.Random(place).randbytes(length) + data[place + length :]


def shortened(data, place, length):
    return data[:place] + data[place + length :]


def cut_before_the_end_marker(data, place, length):
    return data[:place] + data[-2:]


@pytest.mark.parametrize(
    "damage", [zeroed, replaced, shortened, cut_before_the_end_marker], ids=lambda f: f.__name__
)
@pytest.mark.parametrize("place", [0.3, 0.5, 0.7])
def test_a_jpeg_with_more_or_less_data_than_its_pixels_need_is_refused(damage, place, tmp_path):
    data = encoded(picture(), "JPEG", quality=90)
    path = tmp_path / "a.jpg"
    path.write_bytes(damage(data, int(place * len(data)), 200))
    with pytest.raises(ValueError, match=r"a\.jpg is a (damaged|truncated) JPEG file"):
        read_image(path)


@pytest.mark.parametrize("damage", [zeroed, replaced], ids=lambda f: f.__name__)
@pytest.mark.parametrize("place", [0.2, 0.5, 0.8])
def test_a_damaged_tiff_is_refused(damage, place, tmp_path):
    data = encoded(picture(), "TIFF", compression="tiff_lzw")
    path = tmp_path / "a.tif"
    path.write_bytes(damage(data, int(place * len(data)), 100))
    with pytest.raises(ValueError, match=r"a\.tif is a damaged TIFF file"):
        read_image(path)


@pytest.mark.parametrize("size", [(8, 8), (17, 9), (333, 127), (256, 128)])
@pytest.mark.parametrize("quality", [5, 75, 100])
@pytest.mark.parametrize(
    "options",
    [{}, {"subsampling": 0}, {"subsampling": 2}, {"optimize": True}, {"progressive": True},
     {"restart_marker_rows": 1}, {"restart_marker_blocks": 1}],
    ids=str,
)  # fmt: skip
def test_a_whole_jpeg_is_read(size, quality, options, tmp_path):
    path = tmp_path / "a.jpg"
    for pixels in (picture(*size), picture(*size)[..., 0], np.zeros((*size[::-1], 3), np.uint8)):
        data = encoded(pixels, "JPEG", quality=quality, **options)
        # Cameras append their own data, and some fill up what they have written.
        for written in (data, data + b"\xff\xd9 more", data[:-2] + bytes(200) + data[-2:]):
            path.write_bytes(written)
            assert read_image(path).shape[:2] == size[::-1]


@pytest.mark.parametrize("compression", ["raw", "tiff_lzw", "tiff_adobe_deflate", "packbits"])
def test_a_whole_tiff_is_read(compression, tmp_path):
    path = tmp_path / "a.tif"
    for pixels in (picture(), picture()[..., 0]):
        path.write_bytes(encoded(pixels, "TIFF", compression=compression))
        assert read_image(path).shape == (128, 256, 3)
    deep = picture().astype(np.uint16) * 257
    path.write_bytes(cv2.imencode(".tiff", deep)[1].tobytes())
    assert read_image(path).shape == (128, 256, 3)
