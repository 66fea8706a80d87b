# SPDX-License-Identifier: BSD-3-Clause
"""Any picture in, 8-bit RGB out, or one sentence that says why not."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from real_data import is_picture

from epi360.cameras import Equirectangular, Pinhole
from epi360.features.image_cameras import find_camera
from epi360.features.images import (
    looks_like_dual_fisheye,
    looks_like_photograph,
    looks_like_two_eyes,
    nadir_mask,
    read_image,
    read_mask,
    read_masked_image,
    read_transparent_image,
    require_panorama,
)
from epi360.poses import Pose
from epi360_scenes.room import demo_pair, scene


def random_image(height=32, width=64, channels=3, dtype=np.uint8, seed=0):
    top = np.iinfo(dtype).max
    shape = (height, width, channels) if channels > 1 else (height, width)
    return np.random.default_rng(seed).integers(0, top, shape, dtype=dtype, endpoint=True)


def encode(pixels, extension):
    ok, data = cv2.imencode(extension, pixels)
    assert ok
    return data.tobytes()


def write(path, data):
    path.write_bytes(data)
    return path


def with_orientation(jpeg, orientation):
    """Insert an EXIF segment of one entry (tag 0x0112) after the start of a JPEG."""
    exif = b"Exif\0\0MM\0*\0\0\0\x08" + struct.pack(">HHHIHHI", 1, 0x112, 3, 1, orientation, 0, 0)
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.mark.parametrize("extension", [".png", ".tiff", ".bmp"])
def test_a_lossless_file_comes_back_as_rgb(tmp_path, extension):
    rgb = random_image()
    path = write(tmp_path / f"a{extension}", encode(rgb[:, :, ::-1], extension))
    np.testing.assert_array_equal(read_image(path), rgb)
    np.testing.assert_array_equal(read_image(str(path)), rgb)


@pytest.mark.parametrize("extension", [".jpg", ".webp"])
def test_a_lossy_file_comes_back_as_rgb_in_the_right_order(tmp_path, extension):
    rgb = np.full((16, 32, 3), (200, 100, 30), dtype=np.uint8)
    image = read_image(write(tmp_path / f"a{extension}", encode(rgb[:, :, ::-1], extension)))
    np.testing.assert_allclose(image.astype(int), rgb, atol=4)  # compression


def test_a_path_may_hold_any_letters(tmp_path):
    rgb = random_image()
    folder = tmp_path / "Ärger 全景 ñ"
    folder.mkdir()
    path = write(folder / "пано.png", encode(rgb[:, :, ::-1], ".png"))
    np.testing.assert_array_equal(read_image(path), rgb)


def test_sixteen_bits_become_eight_by_257(tmp_path):
    deep = random_image(dtype=np.uint16)
    expected = np.round(deep / 257).astype(np.uint8)
    path = write(tmp_path / "a.png", encode(deep[:, :, ::-1], ".png"))
    np.testing.assert_array_equal(read_image(path), expected)
    np.testing.assert_array_equal(read_image(deep), expected)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_grey_file_fills_three_channels(tmp_path, dtype):
    grey = random_image(channels=1, dtype=dtype)
    image = read_image(write(tmp_path / "a.png", encode(grey, ".png")))
    np.testing.assert_array_equal(image, read_image(grey))
    assert image.shape == (32, 64, 3)


def test_transparent_pixels_of_a_file_are_blended_with_black(tmp_path):
    rgba = np.full((2, 3, 4), (200, 100, 50, 255), dtype=np.uint8)
    rgba[:, 1, 3], rgba[:, 2, 3] = 51, 0
    path = write(tmp_path / "a.png", encode(cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA), ".png"))
    expected = [[200, 100, 50], [40, 20, 10], [0, 0, 0]]
    np.testing.assert_array_equal(read_image(path), [expected, expected])
    np.testing.assert_array_equal(read_image(rgba), [expected, expected])


def test_transparent_pixels_and_their_edges_are_not_used(tmp_path):
    rgba = np.full((64, 800, 4), (200, 100, 50, 255), dtype=np.uint8)
    rgba[40:, :, 3] = 0
    rgba[39, :, 3] = 100
    rgba[:30, :, 3] = 254  # as of a picture that was made softer
    path = write(tmp_path / "a.png", encode(cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA), ".png"))
    mask = np.zeros((64, 800), bool)
    mask[:, 400:] = True
    for source in (path, rgba):
        picture, usable = read_masked_image(source)
        np.testing.assert_array_equal(picture, read_image(source))
        assert usable[:37].all() and not usable[37:].any()
        masked = read_masked_image(source, mask)[1]
        assert masked[:37, 400:].all() and not masked[37:].any() and not masked[:, :400].any()
        _, transparent = read_transparent_image(source)
        np.testing.assert_array_equal(transparent, rgba[:, :, 3] < 128)


@pytest.mark.parametrize("alpha", [(255, 255), (0, 0), (254, 255), (0, 100)])
def test_one_transparency_of_all_pixels_says_nothing(alpha):
    rgba = np.full((64, 80, 4), (200, 100, 50, alpha[0]), dtype=np.uint8)
    rgba[::2, :, 3] = alpha[1]
    assert read_masked_image(rgba)[1] is None and read_transparent_image(rgba)[1] is None
    assert read_masked_image(rgba[:, :, :3])[1] is None


@pytest.mark.parametrize(("orientation", "quarter_turns"), [(1, 0), (6, -1), (3, 2), (8, 1)])
def test_the_orientation_tag_is_applied(tmp_path, orientation, quarter_turns):
    pixels = np.zeros((16, 32, 3), dtype=np.uint8)
    pixels[:8, :16] = 255
    jpeg = with_orientation(encode(pixels, ".jpg"), orientation)
    image = read_image(write(tmp_path / "a.jpg", jpeg))
    np.testing.assert_allclose(image.astype(int), np.rot90(pixels, quarter_turns), atol=12)


@pytest.mark.parametrize(("orientation", "quarter_turns"), [(1, 0), (6, -1), (3, 2), (8, 1)])
@pytest.mark.parametrize("mode", ["RGB", "RGBA"])
def test_the_orientation_tag_of_a_png_is_applied(tmp_path, mode, orientation, quarter_turns):
    pixels = random_image()
    tag = Image.Exif()
    tag[0x112] = orientation
    Image.fromarray(pixels).convert(mode).save(tmp_path / "a.png", exif=tag)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), np.rot90(pixels, quarter_turns))


def test_arrays_of_every_type_become_the_same_picture():
    levels = np.array([[0, 51, 255]], dtype=np.uint8)
    expected = np.repeat(levels[:, :, None], 3, axis=2)
    for array in (
        levels,
        levels[:, :, None],
        expected,
        np.dstack([expected, np.full_like(levels, 255)]),
        levels.astype(np.uint16) * 257,
        levels / 255,
        (levels / 255).astype(np.float32),
        expected[::-1, :, ::-1],
    ):
        np.testing.assert_array_equal(read_image(array), expected)
    np.testing.assert_array_equal(read_image(levels > 51), np.where(expected > 51, 255, 0))


def test_an_rgb_array_is_not_copied():
    image = random_image()
    assert np.shares_memory(read_image(image), image)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((4, 4, 2), np.uint8), r"left must have shape .* got \(4, 4, 2\)"),
        (np.zeros(7, np.uint8), r"left must have shape .* got \(7,\)"),
        (np.zeros((0, 5, 3), np.uint8), r"left must have shape .* got \(0, 5, 3\)"),
        (np.zeros((4, 8), np.int64), "left must be uint8, uint16, bool, or float.* got int64"),
        (np.zeros((4, 8), complex), "left must be uint8.* got complex128"),
        (np.full((4, 8), np.nan), "left of floats must lie in .* without NaN"),
        (np.full((4, 8), 255.0), "left of floats must lie in .* divide by 255"),
        (np.full((4, 8), np.inf), "left of floats must lie in"),
        (None, "left must have shape"),
        (np.full((4, 8), 4095, np.uint16), "left has 16 bits, of which the largest value is 4095"),
        (
            np.ma.zeros((4, 8), np.uint8),
            "left must be a plain array; give what is hidden as a mask",
        ),
    ],
)
def test_an_array_that_is_no_picture_is_refused(array, message):
    with pytest.raises(ValueError, match=message):
        read_image(array, name="left")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"image1 .*none\.jpg does not exist"):
        read_image(tmp_path / "none.jpg", name="image1")


@pytest.mark.parametrize(
    ("file_name", "content", "message"),
    [
        ("a.jpg", b"", "is empty"),
        ("a.jpg", b"dear diary, today", "is not a JPEG, PNG, TIFF, WebP or BMP image"),
        ("a.avi", b"RIFF\0\0\0\0AVI LIST", "is not a JPEG"),
        ("a.insp", b"\xff\xd8\xff\xe0", "raw dual fisheye file; export a stitched panorama first"),
        ("a.INSV", b"....ftyp", "raw dual fisheye video"),
        ("a.360", b"....ftyp", "raw 360 video"),
        ("a.dng", b"II*\0", "camera raw file"),
        ("a.bmp", b"BM" + bytes(60), "damaged image file"),
        ("a.png", b"\x89PNG\r\n\x1a\n" + png_chunk(b"IEND", b""), "truncated PNG"),
    ],
)
def test_a_file_that_is_no_picture_is_refused_in_one_sentence(
    tmp_path, file_name, content, message
):
    with pytest.raises(ValueError, match=message) as error:
        read_image(write(tmp_path / file_name, content))
    assert "\n" not in str(error.value) and file_name in str(error.value)


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(ValueError, match="is a folder"):
        read_image(tmp_path)


@pytest.mark.parametrize("extension", [".png", ".jpg", ".webp"])
@pytest.mark.parametrize("share", [0.01, 0.3, 0.7, 0.99])
def test_a_truncated_file_is_refused_without_a_word_from_opencv(tmp_path, capfd, extension, share):
    data = encode(random_image(64, 128), extension)
    path = write(tmp_path / f"a{extension}", data[: max(20, int(share * len(data)))])
    with pytest.raises(ValueError, match="truncated .* file"):
        read_image(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("place", [0.5, 1.0])
def test_a_png_with_a_flipped_bit_is_refused(tmp_path, capfd, place):
    data = bytearray(encode(random_image(), ".png"))
    data[int(place * (len(data) - 1))] ^= 4
    with pytest.raises(ValueError, match="damaged PNG .*checksum"):
        read_image(write(tmp_path / "a.png", bytes(data)))
    assert capfd.readouterr() == ("", "")


def test_a_progressive_jpeg_with_a_thumbnail_and_a_trailer_is_complete(tmp_path):
    pixels = random_image()
    ok, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    jpeg = data.tobytes()
    thumbnail = encode(pixels[:8, :8], ".jpg")
    segment = b"\xff\xe2" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    path = write(tmp_path / "a.jpg", jpeg[:2] + segment + jpeg[2:] + b"\0ftypmp42 motion" * 100)
    np.testing.assert_array_equal(read_image(path), cv2.imdecode(data, 1)[:, :, ::-1])
    with pytest.raises(ValueError, match="truncated JPEG"):  # though the thumbnail has an end
        read_image(write(path, jpeg[:2] + segment + jpeg[2:-100]))


@pytest.mark.parametrize("extension", [".png", ".jpg", ".tiff"])
def test_more_pixels_than_the_limit_are_refused(tmp_path, extension):
    path = write(tmp_path / f"a{extension}", encode(random_image(), extension))
    assert read_image(path, max_pixels=2048).shape == (32, 64, 3)
    with pytest.raises(ValueError, match="64x32 = 2048 pixels, more than the limit of 2047"):
        read_image(path, max_pixels=2047)


def test_a_small_file_that_claims_a_huge_picture_is_not_decoded(tmp_path, capfd):
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0))
    content = png_chunk(b"IDAT", zlib.compress(bytes(1000))) + png_chunk(b"IEND", b"")
    bomb = b"\x89PNG\r\n\x1a\n" + header + content
    path = write(tmp_path / "a.png", bomb)
    with pytest.raises(ValueError, match="60000x60000"):
        read_image(path)
    with pytest.raises(ValueError, match="OPENCV_IO_MAX_IMAGE_PIXELS"):
        read_image(path, max_pixels=2**40)
    assert capfd.readouterr() == ("", "")


def test_a_tiff_that_claims_a_huge_picture_is_not_decoded(tmp_path, capfd):
    tags = struct.pack("<HHII", 256, 4, 1, 60000) + struct.pack("<HHII", 257, 4, 1, 60000)
    path = write(tmp_path / "a.tiff", b"II*\0" + struct.pack("<IH", 8, 2) + tags + bytes(4))
    with pytest.raises(ValueError, match="60000x60000 = 3600000000 pixels, more than the limit"):
        read_image(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.uint16, np.float32])
def test_a_mask_uses_what_is_brighter_than_half(dtype):
    use = np.random.default_rng(0).random((8, 16)) > 0.5
    top = 1 if dtype in (bool, np.float32) else np.iinfo(dtype).max
    mask = read_mask(np.where(use, 0.9 * top if dtype is not bool else 1, 0).astype(dtype), (8, 16))
    assert mask.dtype == np.bool_
    np.testing.assert_array_equal(mask, use)


def test_a_mask_of_another_size_is_refused_with_both_sizes(tmp_path):
    path = write(tmp_path / "mask.png", encode(np.full((8, 16), 255, np.uint8), ".png"))
    np.testing.assert_array_equal(read_mask(path, (8, 16)), np.ones((8, 16), bool))
    with pytest.raises(ValueError, match=r"mask2 must .* 64x32, got 16x8; resize"):
        read_mask(path, (32, 64), name="mask2")


@pytest.mark.parametrize("array", [np.zeros((8, 16), bool), np.ones((8, 16), np.uint8)])
def test_a_mask_that_uses_nothing_is_refused(array):
    with pytest.raises(ValueError, match="mask has no pixel above half.*white"):
        read_mask(array, (8, 16))


def test_the_nadir_mask_cuts_a_cap_of_the_given_radius():
    camera = Equirectangular(width=72, height=36)  # 5 degrees a pixel
    mask = nadir_mask(camera, 20)
    assert mask.shape == (36, 72)
    np.testing.assert_array_equal(mask[:32], True)
    np.testing.assert_array_equal(mask[32:], False)
    assert nadir_mask(camera, 0).all()


@pytest.mark.parametrize("degrees", [-1, 180, np.nan])
def test_a_nadir_cap_outside_its_range_is_refused(degrees):
    with pytest.raises(ValueError, match="mask_nadir_deg must be in"):
        nadir_mask(Equirectangular(width=8, height=4), degrees)


def smooth_panorama(seed=0, height=256):
    noise = np.random.default_rng(seed).uniform(0, 255, (8, 16, 3)).astype(np.float32)
    return cv2.resize(noise, (2 * height, height), interpolation=cv2.INTER_CUBIC).clip(0, 255)


def dual_fisheye(panorama, fov_deg=190, scale=1.0, offset=(0.0, 0.0), vignetting=0.3, seed=0):
    """Two equidistant renders back to back on noisy black, compressed as JPEG."""
    size = len(panorama)
    axis = (np.arange(size) + 0.5) * 2 / size - 1
    halves = []
    for side in (1, -1):
        x, y = np.meshgrid(axis - side * offset[0], axis - offset[1])
        radius = np.hypot(x, y) / scale
        polar, around = radius * np.radians(fov_deg / 2), np.arctan2(y, x)
        ray = (np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar))
        lon = np.arctan2(side * ray[0], side * ray[2])
        lat = np.arcsin(np.clip(-ray[1], -1, 1))
        columns = (lon / (2 * np.pi) + 0.5) * 2 * size - 0.5
        rows = (0.5 - lat / np.pi) * size - 0.5
        half = cv2.remap(
            panorama.astype(np.float32),
            columns.astype(np.float32),
            rows.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        half *= (1 - vignetting * radius**4).clip(0, 1)[:, :, None]
        half[radius > 1] = 0
        halves.append(half)
    frame = np.hstack(halves) + np.random.default_rng(seed).normal(4, 2, (size, 2 * size, 1))
    jpeg = encode(frame.clip(0, 255).astype(np.uint8), ".jpg")
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)


FRAMES = {
    "touching circles": {},
    "wider lenses": {"fov_deg": 203},
    "small circles": {"scale": 0.86},
    "circles cut by the frame": {"scale": 1.06},
    "off centre": {"scale": 0.95, "offset": (0.05, -0.04)},
    "dark rims": {"vignetting": 0.7},
}


@pytest.mark.parametrize("options", FRAMES.values(), ids=FRAMES.keys())
def test_a_raw_dual_fisheye_frame_is_recognised(options):
    for seed in range(3):
        assert looks_like_dual_fisheye(dual_fisheye(smooth_panorama(seed), seed=seed, **options))


def test_a_raw_dual_fisheye_frame_is_refused_with_the_remedy():
    with pytest.raises(ValueError, match="b.jpg looks like a raw dual fisheye.* export a stitched"):
        require_panorama(dual_fisheye(smooth_panorama()), "b.jpg")


def cut_panorama(picture, rows, columns):
    """Part of a panorama that somebody has stretched to the shape of a whole one."""
    return cv2.resize(picture[rows, columns], picture.shape[1::-1], interpolation=cv2.INTER_AREA)


def photograph(picture):
    """What a camera of 70 degrees sees in a panorama, in the shape of one."""
    camera, lens = Equirectangular(*picture.shape[1::-1]), Pinhole(512, 256, 365, 365, 256, 128)
    u, v = np.meshgrid(np.arange(512) + 0.5, np.arange(256) + 0.5)
    rays = lens.bearings_from_pixels(np.stack([u, v], axis=-1).reshape(-1, 2))
    pixels = camera.pixels_from_bearings(rays).reshape(256, 512, 2).astype(np.float32) - 0.5
    return cv2.remap(picture, pixels, None, cv2.INTER_LINEAR)


@pytest.fixture(scope="module")
def panorama():
    return demo_pair().image1


def test_a_photograph_in_the_shape_of_a_panorama_is_refused(panorama):
    picture = photograph(panorama)
    assert looks_like_photograph(picture)
    with pytest.raises(ValueError, match="c.jpg has the shape of a panorama, but its left and"):
        require_panorama(picture, "c.jpg")


def test_panoramas_of_which_something_was_cut_are_no_photographs(panorama):
    everything = np.s_[:]
    for parts in (
        (everything, everything),
        (np.s_[: int(0.8 * len(panorama))], everything),
        (everything, np.s_[: int(0.9 * panorama.shape[1])]),
        (np.s_[60:-60], everything),
    ):
        assert not looks_like_photograph(cut_panorama(panorama, *parts))


@pytest.fixture(scope="module")
def vr180():
    """Both eyes of a camera in a room, the hemisphere in front of each."""
    room, camera = scene("living_room", 5), Equirectangular(512, 256)
    pose = room.sample_pose(np.random.default_rng(5))
    centers = [pose.translation + pose.rotation @ [x, 0.0, 0.0] for x in (-0.0325, 0.0325)]
    eyes = [room.render(camera, Pose(pose.rotation, center)).image for center in centers]
    return np.hstack([eye[:, 128:384] for eye in eyes])


def test_two_eyes_side_by_side_are_refused_with_the_remedy(vr180):
    assert looks_like_two_eyes(vr180)
    with pytest.raises(ValueError, match="d.jpg shows the same twice.* horizontal_fov_deg 180"):
        require_panorama(vr180, "d.jpg")
    require_panorama(vr180, "d.jpg", is_stated=True)


def test_the_same_in_front_and_behind_are_not_two_eyes(panorama):
    half = cv2.resize(panorama, (256, 256), interpolation=cv2.INTER_AREA)
    assert not looks_like_two_eyes(np.hstack([half, half]))


def test_two_parts_of_a_panorama_side_by_side_are_not_two_eyes(panorama):
    width = panorama.shape[1]
    parts = [panorama[:, : width // 2], panorama[:, width // 4 : 3 * width // 4]]
    assert not looks_like_two_eyes(np.hstack(parts))


def test_no_real_panorama_is_taken_for_a_photograph_or_two_eyes(data_dir: Path):
    paths = [path for ext in ("jpg", "png") for path in data_dir.rglob(f"*.{ext}")]
    num_panoramas = 0
    for path in filter(is_picture, paths):
        image = read_image(path)
        if image.shape[1] == 2 * len(image):
            num_panoramas += 1
            assert not looks_like_photograph(image), path
            assert not looks_like_two_eyes(image), path
    assert num_panoramas > 0


@pytest.mark.parametrize("change", [0.2, 0.5])
def test_a_panorama_whose_ends_are_not_equally_bright_is_one(panorama, change):
    slope = np.linspace(1.0 - change, 1.0 + change, panorama.shape[1])[:, None]
    brighter = np.clip(0.6 * panorama * slope, 0, 255).astype(np.uint8)
    assert not looks_like_photograph(brighter)
    brighter[:, -2:] = 255  # a white border
    assert not looks_like_photograph(brighter)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((64, 128, 3), np.uint8),
        np.full((64, 128, 3), 255, np.uint8),
        np.pad(np.full((40, 128, 3), 200, np.uint8), ((12, 12), (0, 0), (0, 0))),
        np.pad(np.full((40, 104, 3), 200, np.uint8), ((12, 12), (12, 12), (0, 0))),
        smooth_panorama().astype(np.uint8)[:, :256],
    ],
    ids=["black", "white", "dark ceiling and floor", "black frame", "square"],
)
def test_other_dark_borders_are_no_dual_fisheye(image):
    assert not looks_like_dual_fisheye(image)


def test_no_real_panorama_is_taken_for_a_dual_fisheye(data_dir: Path):
    paths = [path for ext in ("jpg", "png") for path in data_dir.rglob(f"*.{ext}")]
    # Neighbouring frames of a clip are alike: every tenth says as much.
    paths = [path for path in paths if path.parent.name != "frames" or path.stem.endswith("5")]
    num_panoramas = 0
    for path in filter(is_picture, paths):
        image = read_image(path)
        if image.shape[1] != 2 * len(image):
            continue
        num_panoramas += 1
        fourth = image[::4, ::4]
        for darker in (image, fourth // 4, (255 * (fourth / 255) ** 2.2).astype(np.uint8)):
            assert not looks_like_dual_fisheye(darker)
            quarter = darker.shape[1] // 4
            assert not looks_like_dual_fisheye(np.roll(darker, quarter, axis=1))
    assert num_panoramas > 0


def test_dual_fisheye_frames_of_real_panoramas_are_recognised(data_dir: Path):
    paths = sorted(path for path in data_dir.glob("theta_flat/images/*.jpg") if is_picture(path))
    assert paths
    for path in paths:
        panorama = cv2.resize(read_image(path), (512, 256), interpolation=cv2.INTER_AREA)
        assert looks_like_dual_fisheye(dual_fisheye(panorama))


def test_the_camera_of_a_panorama_makes_none_of_a_raw_frame():
    frame = dual_fisheye(smooth_panorama())
    camera = Equirectangular(frame.shape[1], frame.shape[0])
    with pytest.raises(ValueError, match="image1 looks like a raw dual fisheye frame"):
        find_camera(frame, frame, camera, "image1")
    photograph = cut_panorama(smooth_panorama().astype(np.uint8), slice(50, 200), slice(100, 400))
    assert find_camera(photograph, photograph, camera, "image1") == camera  # somebody says so
