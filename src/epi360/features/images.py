# SPDX-License-Identifier: BSD-3-Clause
"""Pictures and masks: any image file or array in, 8-bit RGB and booleans out, or a clear reason."""

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.features.image_files import MAX_PIXELS, decode_image_file

ImageSource = str | os.PathLike[str] | NDArray[Any]
"""A path or an array, see `read_image`."""

_LARGEST_OF_12_BITS = 4095
# Between the ends of a picture, in units of the difference of columns that lie side by side, and
# along its first and last rows, in grey values. Of 800 panoramas, real and rendered ones, some of
# them cut, none has both; of 120 rendered photographs 90 have.
_LEAST_GAP, _LEAST_BESIDE, _LEAST_CHANGE, _FEWEST_ROWS = 5.0, 0.5, 10.0, 64
_OPAQUE = 128  # from this value of the alpha channel on
_EDGES_PER_WIDTH = 400  # of a picture: so wide are the edges of what is transparent
_NUM_BESIDE = 8  # columns at either end, some of which may be a border
# Two eyes: the size at which they are compared, their largest parallax (in 180 degrees), and their
# correlation, which is over 0.93 in 30 rendered rooms and under 0.7 wherever neither end goes on in
# 1,300 panoramas, real and rendered ones.
_EYE_PX, _MOST_PARALLAX_PX, _EYES_ALIKE = 64, 4, 0.85


def read_image(
    source: ImageSource, *, max_pixels: int = MAX_PIXELS, name: str = "image"
) -> NDArray[np.uint8]:
    """Picture as 8-bit RGB (H, W, 3), upright.

    Parameters
    ----------
    source : str, path or ndarray
        JPEG, PNG, TIFF, WebP or BMP file, or an array of shape (H, W), (H, W, 1), (H, W, 3) RGB
        or (H, W, 4) RGBA of type uint8, uint16, bool, or float in [0, 1]. The result shares its
        memory if it is such an image already.
    max_pixels : int
        Limit on width x height of a file. OpenCV has one of its own, 2**30, which the environment
        variable ``OPENCV_IO_MAX_IMAGE_PIXELS`` changes.
    name : str
        What error messages call the picture.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If the source is no complete picture, is larger than ``max_pixels`` or has another type.

    Notes
    -----
    The orientation tag (EXIF) of a file is applied, but for WebP with transparency. Transparent
    pixels are blended with black; `read_masked_image` says which they are. 16 bits become 8 by
    value / 257, rounded.
    """
    return _read(source, max_pixels, name)[0]


def read_masked_image(
    source: ImageSource,
    mask: ImageSource | None = None,
    *,
    name: str = "image",
    mask_name: str = "mask",
) -> tuple[NDArray[np.uint8], NDArray[np.bool_] | None]:
    """Picture as `read_image` gives it, and the pixels (H, W) of it to use, None for all.

    They are those of the mask, as of `read_mask`, that are not transparent by half and more, nor at
    the edge of what is. Transparency of all pixels says nothing. The errors are those of both
    functions.
    """
    picture, alpha = _read(source, MAX_PIXELS, name)
    usable = None if alpha is None else _away_from_edges(alpha)
    if mask is None:
        return picture, usable
    given = read_mask(mask, picture.shape[:2], name=mask_name)
    return picture, given if usable is None else given & usable


def read_transparent_image(
    source: ImageSource, *, name: str = "image"
) -> tuple[NDArray[np.uint8], NDArray[np.bool_] | None]:
    """Picture as `read_image` gives it, and its pixels (H, W) that are transparent.

    They are so by half and more; None instead if there are none, or all are.
    """
    picture, alpha = _read(source, MAX_PIXELS, name)
    return picture, None if alpha is None else alpha < _OPAQUE


def _read(
    source: ImageSource, max_pixels: int, name: str
) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """Picture, and its alpha channel where that tells pixels apart."""
    if isinstance(source, np.ma.MaskedArray):
        raise ValueError(f"{name} must be a plain array; give what is hidden as a mask of its own")
    if not isinstance(source, str | os.PathLike):
        return _rgb_from_array(np.asarray(source), name)
    path = Path(source)
    image, alpha = _rgb_from_array(decode_image_file(path, max_pixels, name), f"{name} {path}")
    cv2.cvtColor(image, cv2.COLOR_BGR2RGB, dst=image)
    return image, alpha


def _away_from_edges(alpha: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Opaque pixels, but for those beside others: black that is blended in makes corners there."""
    opaque = (alpha >= _OPAQUE).astype(np.uint8)
    margin = max(2, alpha.shape[1] // _EDGES_PER_WIDTH)
    window = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return np.asarray(cv2.erode(opaque, window) > 0)


def read_mask(
    source: ImageSource, shape: tuple[int, int], *, name: str = "mask"
) -> NDArray[np.bool_]:
    """Pixels to use, bool (H, W): those brighter than half of the range.

    Parameters
    ----------
    source : str, path or ndarray
        White = use, black = ignore; any picture that `read_image` takes.
    shape : (int, int)
        Height and width of the image that the mask belongs to.
    name : str
        What error messages call the mask.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If the source is no picture, has another size than the image, or is black throughout.
    """
    if isinstance(source, np.ndarray) and source.dtype == np.bool_ and source.ndim == 2:
        mask = source
    else:
        mask = cv2.cvtColor(read_image(source, name=name), cv2.COLOR_RGB2GRAY) > 127
    if mask.shape != tuple(shape):
        raise ValueError(
            f"{name} must have the size of its image, {shape[1]}x{shape[0]}, got "
            f"{mask.shape[1]}x{mask.shape[0]}; resize it with nearest neighbour"
        )
    if not mask.any():
        raise ValueError(
            f"{name} has no pixel above half of its range, so nothing would be used; "
            "white (255, or True) means use"
        )
    return mask


def shrunk(
    grey: NDArray[np.uint8], max_width: int
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Picture at this width if it is wider, and by what its pixels are multiplied then."""
    height, width = grey.shape
    if width > max_width:
        size = (max_width, max(1, round(height * (max_width / width))))
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    return grey, np.array([width / grey.shape[1], height / grey.shape[0]])


def usable_at(mask: NDArray[np.bool_], pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which pixels (N, 2) a mask (H, W) leaves."""
    height, width = mask.shape
    columns = np.clip(pixels[:, 0].astype(np.intp), 0, width - 1)
    rows = np.clip(pixels[:, 1].astype(np.intp), 0, height - 1)
    return np.asarray(mask[rows, columns])


def nadir_mask(camera: Camera, degrees: float) -> NDArray[np.bool_]:
    """Pixels (H, W) whose centres are farther than an angle from straight down, (0, 1, 0).

    Tripods and their holders stand there in the images of an upright camera. An angle outside
    [0, 180) degrees raises ``ValueError``; 0 ignores nothing.
    """
    if not 0 <= degrees < 180:
        raise ValueError(f"mask_nadir_deg must be in [0, 180), got {degrees}")
    mask = np.ones((camera.height, camera.width), dtype=np.bool_)
    if degrees == 0:
        return mask
    columns = np.arange(camera.width) + 0.5
    rows_per_block = max(1, 2**18 // camera.width)  # all bearings of 5760x2880 would be 400 MB
    for top in range(0, camera.height, rows_per_block):
        block = mask[top : top + rows_per_block]
        rows = np.arange(top, top + len(block)) + 0.5
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        x, y, z = camera.bearings_from_pixels(pixels).T
        inside = np.arctan2(np.hypot(x, z), y) < np.radians(degrees)
        block &= ~inside.reshape(block.shape)
    return mask


def looks_like_dual_fisheye(image: NDArray[np.uint8]) -> bool:
    """Whether an RGB picture is the raw frame of a 360 camera: two discs side by side on black.

    Both halves of such a 2:1 frame have four black corners and end on a circle at the diagonals.
    Dark frames, where no circle is visible, give False.
    """
    if not _is_twice_as_wide(image):
        return False
    small = cv2.resize(image, (256, 128), interpolation=cv2.INTER_AREA).max(axis=2)
    return _is_disc_on_black(small[:, :128]) and _is_disc_on_black(small[:, 128:])


def _is_twice_as_wide(image: NDArray[np.uint8]) -> bool:
    """Whether a picture is twice as wide as high, to two percent."""
    height, width = image.shape[:2]
    return bool(abs(width - 2 * height) <= 0.02 * width)


def looks_like_photograph(image: NDArray[np.uint8]) -> bool:
    """Whether a picture cannot be a full panorama, nor one that was cut in one direction alone.

    The ends of a panorama continue each other, and its first and last rows show one point each. A
    panorama that was cut at the bottom, or at the sides, still has one of the three. How bright a
    picture is may change over its width. One of less than 64 rows may be anything.
    """
    if len(image) < _FEWEST_ROWS:
        return False
    if _goes_on(image[:, -_NUM_BESIDE:], image[:, :_NUM_BESIDE]):
        return False
    return bool(min(_change_along(image[0]), _change_along(image[-1])) > _LEAST_CHANGE)


def looks_like_two_eyes(image: NDArray[np.uint8]) -> bool:
    """Whether a picture in the shape of a panorama shows one scene twice, side by side, as VR180.

    Both halves look the same but for the parallax of two eyes, and neither goes on in the other:
    the two ends of a place that looks the same in front and behind do. One of less than 64 rows
    may be anything.
    """
    if len(image) < _FEWEST_ROWS or not _is_twice_as_wide(image):
        return False
    width = image.shape[1]
    left, right = image[:, : width // 2], image[:, width // 2 :]
    for before, after in ((left, right), (right, left)):
        if _goes_on(before[:, -_NUM_BESIDE:], after[:, :_NUM_BESIDE]):
            return False
    size = (_EYE_PX, _EYE_PX)
    first, second = (
        cv2.resize(cv2.cvtColor(eye, cv2.COLOR_RGB2GRAY), size, interpolation=cv2.INTER_AREA)
        for eye in (left, right)
    )
    part = first[:, _MOST_PARALLAX_PX:-_MOST_PARALLAX_PX]
    alike = cv2.matchTemplate(second, part, cv2.TM_CCOEFF_NORMED)
    return bool(alike.max() > _EYES_ALIKE)


def _goes_on(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> bool:
    """Whether columns (H, N, 3) go on in those after them as smoothly as within themselves."""
    last, first = before.astype(float), after.astype(float)
    gap = first[:, 0] - last[:, -1]
    beside = np.mean([np.abs(np.diff(each, axis=1)).mean() for each in (last, first)])
    jump = np.abs(gap - gap.mean(axis=0)).mean()
    return bool(jump < _LEAST_GAP * (beside + _LEAST_BESIDE))


def _change_along(row: NDArray[np.uint8]) -> float:
    """Standard deviation of the grey values along a row (W, 3), but for a slope."""
    place = np.linspace(-1.0, 1.0, len(row))
    slope = np.polynomial.polynomial.polyfit(place, row, 1)
    return float((row - np.outer(place, slope[1])).std(axis=0).mean())


def require_panorama(
    image: NDArray[np.uint8], name: str = "image", *, is_stated: bool = False
) -> None:
    """Raise ``ValueError`` for what is no panorama, though it has the shape of one.

    The raw frame of a 360 camera is none. Nor are two eyes side by side and a photograph, unless
    its file states (``is_stated``) that it is one.
    """
    if not is_stated and looks_like_photograph(image):
        raise ValueError(
            f"{name} has the shape of a panorama, but its left and right ends do not continue each "
            "other, and neither its first nor its last row shows one point; give its camera"
        )
    if looks_like_dual_fisheye(image):
        raise ValueError(
            f"{name} looks like a raw dual fisheye frame (two circles on black); "
            "export a stitched panorama first"
        )
    if not is_stated and looks_like_two_eyes(image):
        raise ValueError(
            f"{name} shows the same twice, side by side, as the two eyes of VR180 do; cut one half "
            "out, and give its camera, Equirectangular with horizontal_fov_deg 180; if it is a "
            "panorama of a place that looks the same in front and behind, give its camera"
        )


def _is_disc_on_black(half: NDArray[np.uint8]) -> bool:
    """Whether a square picture is one disc of about its own size on black."""
    size = len(half)
    axis = (np.arange(size) + 0.5) * 2 / size - 1
    radius = np.hypot(axis[:, None], axis[None, :])
    corners = half[radius > 1.2]
    black, brightest = np.percentile(corners, (50, 95))  # 5 %: dust, flares, text
    threshold = black + max(4, 2 * (brightest - black))
    if threshold > 40:  # 24 of black and 8 of noise, such as JPEG and glare leave
        return False
    # Along rays near the diagonals, where a disc ends inside the square, the outermost lit pixel
    # of a disc stays at one radius. A dark ceiling or floor ends on a line instead.
    angles = np.radians((np.arange(25, 66, 2)[None, :] + np.arange(0, 360, 90)[:, None]).ravel())
    radii = np.linspace(0.5, 1.2, 71)
    columns = (radii * np.cos(angles)[:, None] + 1) * size / 2
    rows = (radii * np.sin(angles)[:, None] + 1) * size / 2
    lit = half[rows.astype(int).clip(0, size - 1), columns.astype(int).clip(0, size - 1)]
    lit = lit > threshold
    ends = np.where(lit.any(axis=1), radii[lit.shape[1] - 1 - lit[:, ::-1].argmax(axis=1)], 0.0)
    # Seen from a point d off its centre, a disc of radius r ends at r + d.u in direction u.
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    quadrants = np.median(ends.reshape(4, -1), axis=1)
    centre = quadrants @ directions.reshape(4, -1, 2).mean(axis=1) / 2
    disc_radius = quadrants.mean()
    fits = abs(ends - disc_radius - directions @ centre) < 0.06
    return bool(0.78 < disc_radius < 1.15 and np.hypot(*centre) < 0.12 and fits.mean() > 0.7)


def _rgb_from_array(
    array: NDArray[Any], name: str
) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """Three channels of 8 bits, and the fourth where it tells pixels apart."""
    if array.ndim == 2:
        array = array[:, :, None]
    if array.ndim != 3 or array.shape[2] not in (1, 3, 4) or array.size == 0:
        raise ValueError(
            f"{name} must have shape (H, W), (H, W, 3) or (H, W, 4), got {array.shape}"
        )
    pixels = np.ascontiguousarray(_uint8_from_array(array, name))
    if pixels.shape[2] == 1:
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB), dtype=np.uint8), None
    if pixels.shape[2] == 3:
        return pixels, None
    alpha = np.ascontiguousarray(pixels[:, :, 3])
    rgb = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGBA2RGB), dtype=np.uint8)
    if alpha.min() == 255:
        return rgb, None
    cv2.multiply(rgb, cv2.merge([alpha] * 3), dst=rgb, scale=1 / 255)
    return rgb, alpha if alpha.min() < _OPAQUE <= alpha.max() else None


def _uint8_from_array(array: NDArray[Any], name: str) -> NDArray[np.uint8]:
    if array.dtype == np.uint8:
        return array
    if array.dtype == np.bool_:
        return array.astype(np.uint8) * np.uint8(255)
    if array.dtype == np.uint16:
        if 0 < array.max() <= _LARGEST_OF_12_BITS:
            raise ValueError(
                f"{name} has 16 bits, of which the largest value is {array.max()}; multiply it so "
                "that white is 65535, as 12 bits by 16, or 8 bits by 257"
            )
        scale = 1 / 257
    elif np.issubdtype(array.dtype, np.floating):
        low, high = array.min(), array.max()
        if not (low >= 0 and high <= 1):  # also NaN
            raise ValueError(
                f"{name} of floats must lie in [0, 1] without NaN, got {low} to {high}; "
                "divide by 255 if that is its range"
            )
        array, scale = array.astype(np.float32, copy=False), 255.0
    else:
        raise ValueError(
            f"{name} must be uint8, uint16, bool, or float in [0, 1], got {array.dtype}"
        )
    scaled = cv2.convertScaleAbs(np.ascontiguousarray(array), alpha=scale)
    return np.asarray(scaled, dtype=np.uint8).reshape(array.shape)
