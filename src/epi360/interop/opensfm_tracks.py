# SPDX-License-Identifier: BSD-3-Clause
"""OpenSfM's tracks.csv: which shot sees which point, and where.

After a line with the version, each row of version 2 holds, between tabs: shot, track, index of the
feature in the shot, x, y, scale, red, green, blue, segmentation and instance. Older ones lack the
last two (1), and the scale as well (0, which has no line with a version). x and y are counted from
the middle of the image in units of its larger side; so is the scale, which OpenSfM's bundle
adjustment takes for the standard deviation of x and y; of panoramas for that of the unit bearing,
in radians. Source: tracks_manager.cc, ba_helpers.cc and projection_errors.h of mapillary/OpenSfM.
"""

import math
import re
from collections.abc import Mapping
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.interop.checks import known_camera
from epi360.interop.reconstruction import Observations, Reconstruction
from epi360.runs.input_files import read_text

HEADER = "OPENSFM_TRACKS_VERSION_v"
NUM_CELLS = {"0": 8, "1": 9, "2": 11}  # of each version
UNKNOWN = "-1\t-1"  # segmentation and instance


def read_tracks(
    path: Path, reconstruction: Reconstruction, row_of_point: Mapping[str, int]
) -> Observations | None:
    """Return the observations of points and images that are in a reconstruction.

    ``row_of_point`` has the row of each point by the id of its track. ``FileNotFoundError`` if
    there is no such file, ``ValueError`` with the line if one is no row of tracks.
    """
    lines = read_text(path).split("\n")
    version = lines[0].removeprefix(HEADER).strip() if lines[0].startswith(HEADER) else "0"
    if version not in NUM_CELLS:
        raise ValueError(f"{path} must have version 0, 1 or 2, got {version[:20]!r}")
    image_of = {image.name: index for index, image in enumerate(reconstruction.images)}
    points, images, pixels = [], [], []
    start = int(lines[0].startswith(HEADER))
    for number, line in enumerate(islice(lines, start, None), start + 1):
        cells = line.split("\t")
        if not line:
            continue
        if len(cells) != NUM_CELLS[version]:
            raise _error(path, number, f"{NUM_CELLS[version]} cells between tabs")
        point, image = row_of_point.get(cells[1]), image_of.get(cells[0])
        if point is None or image is None:
            continue  # of tracks without a point, and of images without a pose
        try:
            pixels.append((float(cells[3]), float(cells[4])))
        except ValueError:
            raise _error(path, number, "numbers as x and y") from None
        if not all(map(math.isfinite, pixels[-1])):
            raise _error(path, number, "finite numbers as x and y")
        points.append(point)
        images.append(image)
    if not points:
        return None
    indices = np.array(images, np.int64)
    half, unit = _middles_and_units(reconstruction)
    in_pixels = np.array(pixels) * unit[indices, None] + half[indices]
    return Observations(np.array(points, np.int64), indices, in_pixels)


def tracks_of(reconstruction: Reconstruction) -> bytes:
    """Return the content of a tracks.csv; each point is the track of its number."""
    seen = reconstruction.observations
    lines = [f"{HEADER}2"]
    for image in reconstruction.images:
        if re.search(r"[\t\r\n]", image.name):
            raise ValueError(f"tracks.csv cannot hold a tab or line break, as in {image.name!r}")
    if seen is not None:
        half, unit = _middles_and_units(reconstruction)
        order = np.argsort(seen.images, kind="stable")
        points, images = seen.points[order], seen.images[order]
        normalized = ((seen.pixels[order] - half[images]) / unit[images, None]).tolist()
        first = np.searchsorted(images, np.arange(len(reconstruction.images) + 1))
        names = [image.name for image in reconstruction.images]
        colors = reconstruction.colors[points].tolist()
        cameras = (reconstruction.cameras[str(image.camera)] for image in reconstruction.images)
        one_pixel = [_one_pixel(camera) for camera in cameras]
        for row, (point, image) in enumerate(zip(points.tolist(), images.tolist(), strict=True)):
            (x, y), (red, green, blue) = normalized[row], colors[row]
            feature = row - int(first[image])
            lines.append(
                f"{names[image]}\t{point}\t{feature}\t{x!r}\t{y!r}\t{one_pixel[image]!r}\t"
                f"{red}\t{green}\t{blue}\t{UNKNOWN}"
            )
    return ("\n".join(lines) + "\n").encode()


def _one_pixel(camera: Camera) -> float:
    if isinstance(camera, Equirectangular):
        return math.radians(camera.horizontal_fov_deg) / camera.width
    return 1.0 / max(camera.width, camera.height)


def _middles_and_units(
    reconstruction: Reconstruction,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middle (I, 2) of each image in pixels, and the pixels (I,) of its larger side."""
    cameras: list[Camera] = [
        reconstruction.cameras[known_camera(image, "OpenSfM")] for image in reconstruction.images
    ]
    sizes = np.array([(each.width, each.height) for each in cameras], float).reshape(-1, 2)
    return sizes / 2, sizes.max(axis=1, initial=1.0)


def _error(path: Path, number: int, wanted: str) -> ValueError:
    return ValueError(f"{path}, line {number}: it must hold {wanted}")
