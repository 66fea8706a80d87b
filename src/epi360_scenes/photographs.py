# SPDX-License-Identifier: BSD-3-Clause
"""What cameras, stitching and life do to panoramas that were rendered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Equirectangular
from epi360.features import read_image
from epi360.features.picture_writing import encode_picture
from epi360.features.resampling import Resampling, pixel_centers
from epi360.runs.whole_files import write_file
from epi360_scenes.tours import Tour

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

RECORD = "photographed_from.txt"  # beside the photographs
# Largest values; each picture has its own, from nearly nothing to these.
MOST_STOPS, MOST_TINT = 0.7, 0.08  # of the exposure, and of each colour
MOST_CONTRAST = 0.3  # logarithm of the exponent of the brightness
MOST_BLUR_DEG, MOST_NOISE = 0.4, 8.0  # standard deviations; the noise in grey values
WORST_JPEG, BEST_JPEG = 50, 92
# Stitched spheres are out of place by this, root mean square, and otherwise so many degrees on.
MOST_STITCHING_DEG, STITCHING_SCALE_DEG, NUM_WAVES = 0.25, 20.0, 12
MEAN_PEOPLE, MEAN_THINGS = 1.0, 3.0  # of which another picture shows nothing there
PEOPLE_DEG, TALL, THINGS_DEG = (8.0, 18.0), 3.0, (3.0, 12.0)  # widths; heights over widths
CLOTH_DEG = 3.0  # between what differs in what they wear


def photograph_tour(tour: Tour, folder: Path, seed: int) -> Tour:
    """The same places, each picture `photographed`; those that the folder holds of them are used.

    Parameters
    ----------
    tour : Tour
    folder : Path
        Gets one JPEG file for each panorama.
    seed : int
        Of what happens to the pictures.

    Returns
    -------
    tour : Tour
        With poses and overlaps of the rendered one.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    key = f"seed {seed} of {tour.digest()}"
    record = folder / RECORD
    is_of_these = record.is_file() and record.read_text(encoding="utf-8") == key
    for panorama in () if is_of_these else tour.panoramas:
        (folder / panorama.name).unlink(missing_ok=True)
    write_file(record, key.encode())
    for number, panorama in enumerate(tour.panoramas):
        path = folder / panorama.name
        if not path.is_file():
            rng = np.random.Generator(np.random.PCG64([seed, 4, number]))
            write_file(path, photographed(read_image(tour.folder / panorama.name), rng))
    return replace(tour, folder=folder)


def photographed(image: Picture, rng: np.random.Generator) -> bytes:
    """A rendered panorama as some camera might have taken it at another time of the day.

    Parameters
    ----------
    image : ndarray, shape (H, W, 3), uint8
        A full panorama.
    rng : Generator
        Says how bright, sharp and noisy it is, how badly it is stitched, and what has come.

    Returns
    -------
    content : bytes
        Of a JPEG file.
    """
    picture = _stitched(image, rng).astype(np.float64)
    for _ in range(rng.poisson(MEAN_THINGS)):
        _cover(picture, rng, *rng.uniform(*THINGS_DEG, 2))
    for _ in range(rng.poisson(MEAN_PEOPLE)):
        width_deg = rng.uniform(*PEOPLE_DEG)
        _cover(picture, rng, width_deg, TALL * width_deg)
    light = _blurred(picture, rng.uniform(0.0, MOST_BLUR_DEG)).clip(0.0, 255.0) / 255.0
    gain = 2.0 ** rng.uniform(-MOST_STOPS, MOST_STOPS)
    tint = 1.0 + rng.uniform(-MOST_TINT, MOST_TINT, 3)
    exponent = np.exp(rng.uniform(-MOST_CONTRAST, MOST_CONTRAST))
    exposed = 255.0 * np.clip(gain * tint * light**exponent, 0.0, 1.0)
    noise = rng.normal(0.0, rng.uniform(0.0, MOST_NOISE), image.shape)
    pixels = np.clip(np.round(exposed + noise), 0, 255).astype(np.uint8)
    quality = int(rng.integers(WORST_JPEG, BEST_JPEG, endpoint=True))
    return encode_picture(pixels, ".jpg", jpeg_quality=quality)


def _stitched(image: Picture, rng: np.random.Generator) -> Picture:
    """The picture with everything a little out of place, what is close together alike."""
    height, width = image.shape[:2]
    camera = Equirectangular(width, height)
    rays = camera.bearings_from_pixels(pixel_centers(width, height))
    rms_rad = np.radians(rng.uniform(0.0, MOST_STITCHING_DEG))
    waves = rng.normal(0.0, 1.0 / np.radians(STITCHING_SCALE_DEG), (NUM_WAVES, 3))
    phases = rng.uniform(0.0, 2 * np.pi, NUM_WAVES)
    amplitudes = rng.normal(0.0, rms_rad * np.sqrt(2.0 / NUM_WAVES), (NUM_WAVES, 3))
    turns = np.sin(rays @ waves.T + phases) @ amplitudes
    return Resampling(camera, [rays + np.cross(turns, rays)], (height, width)).picture(image)


def _cover(picture: Array, rng: np.random.Generator, width_deg: float, height_deg: float) -> None:
    """Put an ellipse with a pattern of its own into a picture, at the horizon or below."""
    height, width = picture.shape[:2]
    half_width, half_height = np.radians([width_deg / 2, height_deg / 2])
    longitude = rng.uniform(-np.pi, np.pi)
    below = half_height * rng.uniform(0.2, 1.5)
    columns, rows = pixel_centers(width, height).T.reshape(2, height, width)
    across = (columns / width - 0.5) * 2 * np.pi - longitude
    across = np.cos(below) * ((across + np.pi) % (2 * np.pi) - np.pi)
    down = (rows / height - 0.5) * np.pi - below
    covered = np.hypot(across / half_width, down / half_height) < 1.0
    color, spread = rng.uniform(20.0, 220.0, 3), rng.uniform(5.0, 40.0)
    coarse = rng.normal(0.0, spread, (round(180 / CLOTH_DEG), round(360 / CLOTH_DEG)))
    pattern = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    picture[covered] = color + pattern[covered][:, None]


def _blurred(picture: Array, sigma_deg: float) -> Array:
    sigma_px = sigma_deg * picture.shape[1] / 360
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), max(sigma_px, 0.1)))
