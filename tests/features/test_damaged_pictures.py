# SPDX-License-Identifier: BSD-3-Clause
"""Damage of a picture's file is noticed where the format lets anybody notice it.

`benchmarks/damaged_pictures.py` makes a table of the same with more files.
"""

import struct
import zlib

import numpy as np
import pytest
from damaged_pictures import (
    DAMAGES,
    damaged_files,
    encoded,
    looks_different,
    picture,
    tiff,
    whole_files,
)

from epi360.features import read_image

UNCOMPRESSED = {"BMP", "TIFF raw strips", "TIFF raw tiles"}  # any bytes are a picture
CHECKED = [name for name in whole_files() if name.startswith(("PNG", "TIFF deflate"))]
# Lossless WebP tells little: only what it lost at its end.
OTHERS = sorted(set(whole_files()) - set(CHECKED) - UNCOMPRESSED - {"WebP lossless"})


def accepted(data, damage, count, path):
    """Number of damaged files that are used although they show something else."""
    path.write_bytes(data)
    whole, number = read_image(path), 0
    for damaged in damaged_files(data, damage, count):
        path.write_bytes(damaged)
        try:
            number += looks_different(read_image(path), whole)
        except ValueError as error:
            assert "\n" not in str(error)
    return number


def refusal(data, path):
    path.write_bytes(data)
    with pytest.raises(ValueError) as caught:
        read_image(path)
    return str(caught.value)


@pytest.mark.parametrize("name", whole_files())
@pytest.mark.parametrize("damage", ["cut", "cut, end kept", "zeroed to end"])
def test_what_a_download_or_a_crash_leaves_of_a_picture_is_refused(name, damage, tmp_path):
    if name == "BMP" and damage == "zeroed to end":
        pytest.skip("black is a colour")
    assert accepted(whole_files()[name], damage, 4, tmp_path / "a") == 0


@pytest.mark.parametrize("name", CHECKED)
@pytest.mark.parametrize("damage", DAMAGES)
def test_no_damage_gets_past_a_checksum(name, damage, tmp_path):
    assert accepted(whole_files()[name], damage, 4, tmp_path / "a") == 0


@pytest.mark.parametrize("name", OTHERS)
def test_elsewhere_most_damage_is_noticed(name, tmp_path):
    # 0 to 12 % get through in the long run of the benchmark, and up to 62 % did before.
    data = whole_files()[name]
    number = sum(accepted(data, damage, 4, tmp_path / "a") for damage in DAMAGES)
    assert number <= 8, f"{number} of {4 * len(DAMAGES)}"


@pytest.mark.parametrize("kept", [1, 5, 9])
def test_a_progressive_jpeg_without_some_of_its_scans_is_refused(kept, tmp_path):
    data = encoded(picture(), "JPEG", progressive=True)
    starts = [at for at in range(len(data)) if data[at : at + 2] == b"\xff\xda"]
    tables = data.rfind(b"\xff\xc4", 0, starts[kept])  # of the first scan that is lost
    cut = tables if tables > starts[kept - 1] else starts[kept]
    message = refusal(data[:cut] + b"\xff\xd9", tmp_path / "a.jpg")
    assert message.endswith("is a JPEG file without some of its scans; copy or export it again")


def test_a_jpeg_with_thousands_of_scans_is_refused_before_it_is_decoded(tmp_path):
    data = encoded(picture(), "JPEG", progressive=True)
    start = data.rfind(b"\xff\xda")
    scans = data[:start] + data[start:-2] * 300 + data[-2:]
    assert "is a JPEG file of 309 scans, expected at most 100" in refusal(scans, tmp_path / "a.jpg")


def test_bytes_between_the_segments_of_a_jpeg_do_no_harm(tmp_path):
    data = encoded(picture(), "JPEG")
    path = tmp_path / "a.jpg"
    path.write_bytes(data)
    whole = read_image(path)
    place = data.index(b"\xff\xdb")
    path.write_bytes(data[:place] + bytes(7) + data[place:])
    np.testing.assert_array_equal(read_image(path), whole)
    cut = data[:place] + bytes(7) + data[place:-500] + data[-2:]
    assert "is a damaged JPEG file" in refusal(cut, path)


def test_a_tiff_whose_last_strips_are_behind_its_end_is_refused(tmp_path):
    """Its directory stands in front, as cameras write it."""
    data = tiff(picture(), "raw", (512, 16))
    place = struct.unpack("<I", data[4:8])[0]
    tags = bytearray(data[place:])
    moved = {}
    for at in range(2, 2 + 12 * int.from_bytes(tags[:2], "little"), 12):
        tag, kind, count, value = struct.unpack_from("<HHII", tags, at)
        if count * {3: 2, 4: 4, 7: 1}[kind] > 4:
            struct.pack_into("<I", tags, at + 8, value - place + 8)
        if tag == 273:
            moved = {at: (value - place, count)}
    for start, count in moved.values():
        offsets = struct.unpack_from(f"<{count}I", tags, start)
        struct.pack_into(f"<{count}I", tags, start, *(offset + len(tags) for offset in offsets))
    front = data[:4] + struct.pack("<I", 8) + bytes(tags) + data[8:place]
    path = tmp_path / "a.tif"
    path.write_bytes(front)
    np.testing.assert_array_equal(read_image(path), picture())
    assert "is a truncated TIFF file" in refusal(front[:-20000], path)


def test_strips_that_are_filled_up_to_their_full_height_are_whole(tmp_path):
    path = tmp_path / "a.tif"
    pixels = picture()[:250]  # 250 = 15 x 16 + 10 rows
    filled = np.vstack([pixels, np.zeros((6, 512, 3), np.uint8)])
    for kind in ("tiff_adobe_deflate", "packbits"):
        path.write_bytes(tiff(filled, kind, (512, 16)).replace(*height_tags(256, 250)))
        np.testing.assert_array_equal(read_image(path), pixels)


def height_tags(before, after):
    return [struct.pack("<HHII", 257, 4, 1, height) for height in (before, after)]


def test_a_tiff_whose_strips_all_point_at_one_bomb_is_refused_at_once(tmp_path):
    bomb = zlib.compress(bytes(2**24), 9)
    data = tiff(picture(), "tiff_adobe_deflate", (512, 1))
    place = struct.unpack("<I", data[4:8])[0]
    entries = data[place:]
    at = entries.index(struct.pack("<HH", 273, 4)) + 8
    start = struct.unpack_from("<I", entries, at)[0]
    offsets = struct.pack("<256I", *[len(data)] * 256)
    lengths = struct.pack("<256I", *[len(bomb)] * 256)
    data = data[:start] + offsets + lengths + data[start + 2048 :] + bomb
    assert "is a damaged TIFF file" in refusal(data, tmp_path / "a.tif")
