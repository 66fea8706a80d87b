# SPDX-License-Identifier: BSD-3-Clause
"""What a visitor hears about two files: a verdict, or a sentence that says what is wrong."""

import asyncio
import json

import numpy as np
import pytest
from odd_files import (
    TEXT,
    bmp_header,
    broken_jpeg,
    dual_fisheye,
    jpeg,
    noise_picture,
    png_bomb,
    webp_header,
)

from epi360.cameras import KannalaBrandt, Pinhole
from epi360_demo.limits import Limits, RefusedError
from epi360_demo.pair_choices import camera_of, choices_from
from epi360_demo.pair_job import run_pair
from epi360_demo.pictures import check_picture
from epi360_demo.worker_process import WorkerProcess

LENS = """
cameras:
  left: {model: KannalaBrandt, width: 64, height: 32, fx: 20, fy: 20, cx: 32, cy: 16,
         k1: 0, k2: 0, k3: 0, k4: 0}
"""
FULL = Limits().max_pixels
PANORAMA = jpeg(noise_picture())


def request(folder, *contents, choices=None, lens=None, max_pixels=FULL):
    """A request for files of these contents, called a.jpg and b.jpg."""
    pictures = []
    for name, content in zip(("a.jpg", "b.jpg"), contents, strict=True):
        path = folder / f"upload-{name}"
        path.write_bytes(content)
        pictures.append({"path": str(path), "name": name})
    given = None
    if lens is not None:
        (folder / "upload.yaml").write_text(lens)
        given = {"path": str(folder / "upload.yaml"), "name": "my lens.yaml"}
    return {
        "pictures": pictures, "lens": given, "choices": choices or {}, "out": str(folder),
        "max_pixels": max_pixels,
    }  # fmt: skip


def sentence_about(*arguments, **options):
    with pytest.raises(RefusedError) as caught:
        run_pair(request(*arguments, **options), lambda _: None)
    text = str(caught.value)
    assert text.endswith(".") and "upload" not in text and "\n" not in text
    return text


def sentence_on_arrival(folder, content, name="a.jpg"):
    path = folder / f"upload-{name}"
    path.write_bytes(content)
    with pytest.raises(RefusedError) as caught:
        check_picture(path, name, FULL)
    assert "upload" not in str(caught.value)
    return str(caught.value)


def test_a_text_file_is_named_on_arrival(tmp_path):
    text = sentence_on_arrival(tmp_path, TEXT, "notes.txt")
    assert text == "notes.txt is not a JPEG, PNG, TIFF, WebP or BMP image."


def test_a_raw_file_of_a_camera_is_named_by_its_suffix(tmp_path):
    assert "raw dual fisheye file" in sentence_on_arrival(tmp_path, PANORAMA, "a.insp")


@pytest.mark.parametrize(
    "content",
    [png_bomb(), bmp_header(), *(webp_header(kind) for kind in (b"VP8X", b"VP8L", b"VP8 "))],
    ids=["png", "bmp", "webp", "webp-lossless", "webp-simple"],
)
def test_too_many_pixels_are_seen_in_the_header(tmp_path, content):
    text = sentence_on_arrival(tmp_path, content)
    assert "megapixels; this demo takes 100 megapixels at most" in text
    assert len(content) < 30_000


@pytest.mark.parametrize("content", [PANORAMA, bmp_header(64, 32), webp_header(b"VP8X", 64, 32)])
def test_a_picture_of_moderate_size_is_taken(tmp_path, content):
    path = tmp_path / "a"
    path.write_bytes(content)
    check_picture(path, "a", FULL)


def test_a_broken_jpeg_is_called_so(tmp_path):
    text = sentence_about(tmp_path, PANORAMA, broken_jpeg())
    assert text == "b.jpg is a truncated JPEG file; copy or export it again."


def test_a_raw_dual_fisheye_frame_is_recognised(tmp_path):
    text = sentence_about(tmp_path, jpeg(dual_fisheye()), PANORAMA)
    assert text.startswith("a.jpg looks like a raw dual fisheye frame (two circles on black);")


def test_a_picture_that_is_no_panorama_is_told_what_to_choose(tmp_path):
    assert "must be 2:1" in sentence_about(tmp_path, PANORAMA, jpeg(noise_picture(64, 48)))


def test_two_sizes_do_not_fit_one_lens(tmp_path):
    text = sentence_about(
        tmp_path, PANORAMA, jpeg(noise_picture(96, 64)), choices={"camera": "lens"}, lens=LENS
    )
    assert text.startswith("b.jpg is 96x64 but its camera is 64x32")


@pytest.mark.parametrize(
    ("lens", "names", "sentence"),
    [
        (None, "", "Give the calibration file of the lens"),
        ("no: lens", "", "my lens.yaml cannot be used"),
        (LENS, "right", "my lens.yaml has no camera right; it holds left."),
        (LENS + LENS.partition("left")[2].join(["  right", ""]), "", "cameras left, right;"),
    ],
)
def test_a_lens_file_that_does_not_help_is_answered_in_a_sentence(tmp_path, lens, names, sentence):
    choices = {"camera": "lens", "camera_names": names}
    assert sentence in sentence_about(tmp_path, PANORAMA, PANORAMA, choices=choices, lens=lens)


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [
        ({"camera": "fisheye", "fov_deg": 500}, "field of view must be between 60 and 280"),
        ({"camera": "flat"}, "field of view must be between 5 and 150"),
        ({"camera": "submarine"}, "one of the kinds"),
        ({"upright_deg": 90}, "between 0.01 and 45"),
        ({"upright_deg": 1, "camera": "fisheye", "fov_deg": 190}, "Only of a panorama"),
        ({"mask_nadir_deg": -1}, "between 0 and 89"),
        ({"threshold_deg": float("nan")}, "between 0.001 and 30"),
        ({"threshold_deg": "much"}, "between 0.001 and 30"),
    ],
)
def test_options_out_of_their_range_are_answered_in_a_sentence(choices, sentence):
    with pytest.raises(RefusedError, match=sentence):
        choices_from(choices)


def test_the_field_of_view_gives_the_camera():
    fisheye = camera_of(choices_from({"camera": "fisheye", "fov_deg": 190}), 1, 80, 60, None, "")
    assert isinstance(fisheye, KannalaBrandt)
    rim = fisheye.bearings_from_pixels(np.array([[40.0, 0.0], [40.0, 60.0]]))
    np.testing.assert_allclose(np.degrees(np.arccos(rim[:, 2])), 95.0, atol=1e-9)
    flat = camera_of(choices_from({"camera": "flat", "fov_deg": 90}), 1, 80, 60, None, "")
    assert isinstance(flat, Pinhole)
    edge = flat.bearings_from_pixels(np.array([[80.0, 30.0]]))
    np.testing.assert_allclose(edge, [[np.sqrt(0.5), 0.0, np.sqrt(0.5)]], atol=1e-12)


def test_two_pictures_of_noise_get_a_verdict_a_report_and_a_record(tmp_path):
    said = []
    answer = run_pair(request(tmp_path, PANORAMA, PANORAMA[::1]), said.append)
    assert answer["headline"] and answer["sentences"] and said[-1] == "writing the report"
    record = json.loads((tmp_path / "pair.json").read_text())
    assert (record["status"], record["image1"]) == (answer["status"], "a.jpg")
    assert b"a.jpg and b.jpg" in (tmp_path / "report.html").read_bytes()


def test_the_process_refuses_large_pictures_goes_on_and_is_replaced_where_it_ended(tmp_path):
    # The size of a WebP file is not read from its header: OpenCV refuses it.
    from io import BytesIO

    from PIL import Image

    file = BytesIO()
    Image.fromarray(noise_picture(640, 320)).save(file, "WEBP")

    async def story():
        worker = WorkerProcess(Limits(max_pixels=100_000))
        large = request(tmp_path, file.getvalue(), PANORAMA, max_pixels=100_000)
        with pytest.raises(
            RefusedError, match=r"a\.jpg has more pixels than this demo takes, 0\.1"
        ):
            await worker.run(large, lambda _: None)
        small = request(tmp_path, PANORAMA, PANORAMA)
        said = []
        first = await worker.run(small, said.append)
        assert "reading the pictures" in said
        with pytest.raises(RefusedError, match="Something went wrong in the demo itself"):
            await worker.run({}, said.append)
        process = worker._process
        process.kill()
        await process.wait()
        assert await worker.run(small, said.append) == first
        await worker.close()

    asyncio.run(story())
