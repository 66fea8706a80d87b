# SPDX-License-Identifier: BSD-3-Clause
"""Sizes and metadata from the headers of image files agree with what decoding gives."""

import io
import struct
import zlib

import cv2
import numpy as np
import pytest

from epi360.features import read_image
from epi360.features.image_headers import ImageHeader, parse_image_header, read_image_header

PACKET = b"<x:xmpmeta xmlns:x='adobe:ns:meta/'/>"


def encoded(extension, width=64, height=32, options=()):
    image = np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)
    return cv2.imencode(extension, image, list(options))[1].tobytes()


def segment(kind, data):
    return b"\xff" + bytes([kind]) + struct.pack(">H", len(data) + 2) + data


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def exif(orientation, order=">"):
    mark = b"MM\0*" if order == ">" else b"II*\0"
    return mark + struct.pack(order + "IHHHIHHI", 8, 1, 0x112, 3, 1, orientation, 0, 0)


@pytest.mark.parametrize("extension", [".jpg", ".png", ".tiff"])
def test_the_size_is_in_the_header(extension):
    assert parse_image_header(io.BytesIO(encoded(extension))).size == (64, 32)


def test_a_progressive_jpeg_has_its_size_in_another_segment():
    data = encoded(".jpg", options=(cv2.IMWRITE_JPEG_PROGRESSIVE, 1))
    assert parse_image_header(io.BytesIO(data)).size == (64, 32)


@pytest.mark.parametrize("extension", [".webp", ".bmp"])
def test_formats_without_a_reader_have_no_size(extension):
    assert parse_image_header(io.BytesIO(encoded(extension))) == ImageHeader()


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_size_of_a_turned_jpeg_is_that_of_the_upright_picture(tmp_path, orientation, order):
    jpeg = encoded(".jpg")
    path = tmp_path / "a.jpg"
    path.write_bytes(jpeg[:2] + segment(0xE1, b"Exif\0\0" + exif(orientation, order)) + jpeg[2:])
    height, width = read_image(path).shape[:2]
    assert read_image_header(path).size == (width, height)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_size_of_a_turned_png_is_that_of_the_upright_picture(tmp_path, orientation):
    png = encoded(".png")
    path = tmp_path / "a.png"
    path.write_bytes(png[:33] + chunk(b"eXIf", exif(orientation)) + png[33:])
    height, width = read_image(path).shape[:2]
    assert read_image_header(path).size == (width, height)


def test_filling_bytes_before_a_jpeg_marker_are_skipped():
    jpeg = encoded(".jpg")
    assert parse_image_header(io.BytesIO(jpeg[:2] + b"\xff\xff" + jpeg[2:])).size == (64, 32)


def test_the_xmp_of_a_jpeg_is_found_behind_other_metadata():
    jpeg = encoded(".jpg")
    xmp = segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + PACKET)
    data = jpeg[:2] + segment(0xE1, b"Exif\0\0" + exif(1) + b"\0" * 60000) + xmp + jpeg[2:]
    assert parse_image_header(io.BytesIO(data)) == ImageHeader((64, 32), PACKET)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("behind_picture", [False, True])
def test_the_xmp_of_a_png_is_found_wherever_it_is(compressed, behind_picture):
    png = encoded(".png")
    text = zlib.compress(PACKET) if compressed else PACKET
    data = b"XML:com.adobe.xmp\0" + bytes([compressed, 0]) + b"en\0XMP\0" + text
    at = len(png) - 12 if behind_picture else 33
    png = png[:at] + chunk(b"iTXt", data) + png[at:]
    assert parse_image_header(io.BytesIO(png)) == ImageHeader((64, 32), PACKET)


def test_a_text_that_unpacks_to_gigabytes_is_not_unpacked():
    bomb = zlib.compress(b" " * 2**24)
    png = encoded(".png")
    data = b"XML:com.adobe.xmp\0\1\0\0\0" + bomb
    png = png[:33] + chunk(b"iTXt", data) + png[33:]
    assert parse_image_header(io.BytesIO(png)) == ImageHeader((64, 32), None)


def test_the_xmp_of_a_tiff_is_found():
    tags = struct.pack("<HHII", 256, 4, 1, 64) + struct.pack("<HHIHH", 257, 3, 1, 32, 0)
    tags += struct.pack("<HHII", 700, 1, len(PACKET), 8 + 2 + 3 * 12)
    data = b"II*\0" + struct.pack("<IH", 8, 3) + tags + PACKET
    assert parse_image_header(io.BytesIO(data)) == ImageHeader((64, 32), PACKET)


@pytest.mark.parametrize("extension", [".jpg", ".png", ".tiff"])
def test_a_cut_header_gives_nothing_rather_than_an_error(extension):
    data = encoded(extension)
    for length in [*range(0, 200), len(data) - 40]:
        header = parse_image_header(io.BytesIO(data[:length]))
        assert header.size in (None, (64, 32))


@pytest.mark.parametrize("extension", [".jpg", ".png", ".tiff"])
def test_a_damaged_header_never_raises_nor_hangs(extension):
    rng = np.random.default_rng(1)
    data = np.frombuffer(encoded(extension), np.uint8)
    sizes = []
    for _ in range(300):
        damaged = data.copy()
        where = rng.integers(2, min(len(data), 400), 6)
        damaged[where] = rng.integers(0, 256, 6)
        sizes.append(parse_image_header(io.BytesIO(damaged.tobytes())).size)
    found = [size for size in sizes if size is not None]
    assert len(found) > 30  # the damage is often behind the size
    assert min(min(size) for size in found) >= 0


def test_a_missing_file_is_an_error_of_the_system(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_image_header(tmp_path / "none.jpg")


def test_a_huge_panorama_is_no_decompression_bomb_for_its_header(recwarn):
    ihdr = chunk(b"IHDR", struct.pack(">IIBBBBB", 23000, 11500, 8, 2, 0, 0, 0))
    png = b"\x89PNG\r\n\x1a\n" + ihdr + chunk(b"IDAT", b"") + chunk(b"IEND", b"")
    assert parse_image_header(io.BytesIO(png)).size == (23000, 11500)
    assert not recwarn.list
