# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories as the TUM RGB-D benchmark writes them: ``timestamp tx ty tz qx qy qz qw``.

A row is the pose world_from_cam, with the camera's axes x right, y down, z forward, and the time in
seconds. Source: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats.
"""

import math
import re
import warnings
from collections import Counter
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from epi360.image_folders import natural_order
from epi360.interop import checks
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.interop.text_tables import read_table
from epi360.poses import pose_from_quaternion
from epi360.runs.whole_files import PathLike, write_file

COLUMNS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_NUMBERED = re.compile(r"(.*?)(\d{1,18})((?:\.\w+)?)")


def read_tum_trajectory(path: PathLike) -> Reconstruction:
    """Return the poses of a trajectory; each image is named by its time stamp.

    "#" begins a comment. There are neither cameras nor points.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If a row does not hold eight finite numbers with a unit quaternion, or two rows have the
        same time.
    """
    path = Path(path)
    table = read_table(path, COLUMNS, None)
    times, translations = table.floats(0, 1)[:, 0], table.floats(1, 4)
    quaternions_wxyz = table.quaternions(4)[:, [3, 0, 1, 2]]
    counts = Counter(times.tolist())
    twice = [cells[0] for cells, time in zip(table.cells, times, strict=True) if counts[time] > 1]
    if twice:
        raise ValueError(f"{path}: the time {twice[0]} is there twice")
    images = tuple(
        PosedImage(cells[0], None, pose_from_quaternion(position, wxyz).inverse(), float(time))
        for cells, time, position, wxyz in zip(
            table.cells, times, translations, quaternions_wxyz, strict=True
        )
    )
    return Reconstruction({}, images)


def write_tum_trajectory(
    path: PathLike, reconstruction: Reconstruction, *, fps: float | None = None
) -> None:
    """Write the poses of the images as a trajectory, in the order of their times.

    Cameras, points and names are left out. If any image has no time stamp, the rows count from 0 in
    place of the time, in the natural order of the names: frame2 before frame10. A warning says so
    where the numbers in the names have gaps, because row k is then not frame k. With ``fps`` their
    times are seconds: so many frames a second, the first at 0; where the numbers in the names have
    gaps, so have the times. A file that exists is replaced.

    Raises
    ------
    ValueError
        If an image has no pose, two have the same time stamp, or ``fps`` is not positive.
    OSError
        If the file cannot be written.
    """
    images, times = _timed(reconstruction, fps)
    if fps is None and any(isinstance(time, int) for time in times):
        _warn_of_gaps([image.name for image in images])
    by_stamp: dict[float, str] = {}
    for image, time in zip(images, times, strict=True):
        other = by_stamp.setdefault(time, image.name)
        if other != image.name:
            raise ValueError(
                f"images {other} and {image.name} have the same time stamp; a trajectory is that "
                "of one camera"
            )
    lines = ["# " + " ".join(COLUMNS)]
    for image, time in zip(images, times, strict=True):
        world_from_cam = checks.known_pose(image).inverse()
        w, x, y, z = world_from_cam.quaternion_wxyz
        numbers = (time, *world_from_cam.translation, x, y, z, w)
        lines.append(" ".join(_digits(number) for number in numbers))
    write_file(path, ("\n".join(lines) + "\n").encode())


def names_path(path: PathLike) -> Path:
    """Return the path of the names that belong to a trajectory: ``poses_names.txt``."""
    return Path(path).with_name(f"{Path(path).stem}_names.txt")


def write_tum_names(
    path: PathLike, reconstruction: Reconstruction, *, fps: float | None = None
) -> None:
    """Write the name of each row of `write_tum_trajectory`, as TUM's ``rgb.txt``: time and name.

    Raises
    ------
    ValueError
        If ``fps`` is not positive.
    OSError
        If the file cannot be written.
    """
    images, times = _timed(reconstruction, fps)
    rows = [f"{_digits(time)} {image.name}" for image, time in zip(images, times, strict=True)]
    write_file(path, ("\n".join(["# timestamp filename", *rows]) + "\n").encode())


def _digits(number: float) -> str:
    """The fewest digits that read back to the same number; an index has no decimal point."""
    return repr(number if isinstance(number, int) else float(number))


def _timed(
    reconstruction: Reconstruction, fps: float | None
) -> tuple[list[PosedImage], list[float]]:
    """Images in the order of their times, and these; integers if they are counted."""
    if fps is not None and not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"fps must be positive, got {fps}")
    images = sorted(reconstruction.images, key=_place)
    stamps = [image.timestamp_s for image in images if image.timestamp_s is not None]
    if len(stamps) == len(images):
        images.sort(key=lambda image: image.timestamp_s or 0.0)
        return images, sorted(stamps)
    if fps is None:
        return images, list(range(len(images)))
    numbers = _frame_numbers([image.name for image in images])
    return images, [number / fps for number in numbers or range(len(images))]


def _frame_numbers(names: list[str]) -> list[int] | None:
    """Frames from the first to each by the numbers in sorted names; None if they do not count.

    Names with every tenth number are frames that follow each other.
    """
    numbers = _numbers(names)
    step = 0 if numbers is None else math.gcd(*(after - numbers[0] for after in numbers))
    return [(number - numbers[0]) // step for number in numbers] if numbers and step else None


def _warn_of_gaps(names: list[str]) -> None:
    """Warn where frames are missing between two names by the numbers before their extensions."""
    numbers = _numbers(names) or []
    steps = [after - before for before, after in pairwise(numbers)]
    if len(set(steps)) <= 1:
        return
    first = next(index for index, step in enumerate(steps) if step != min(steps))
    warnings.warn(
        f"the images have no times, so rows count from 0, but frames are missing between "
        f"{names[first]} and {names[first + 1]}: row k is not frame k",
        UserWarning,
        stacklevel=3,
    )


def _numbers(names: list[str]) -> list[int] | None:
    """Numbers before the extensions of names that differ in nothing else; None if they do."""
    found = [_NUMBERED.fullmatch(name) for name in names]
    if not all(found) or len({(m[1], m[3]) for m in found if m}) > 1:
        return None
    return [int(match[2]) for match in found if match]


def _place(image: PosedImage) -> Any:
    """Sort key: folder by folder, as files lie on a disk."""
    return [natural_order(Path(part)) for part in PurePosixPath(image.name).parts]
