# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories as the TUM RGB-D benchmark writes them: ``timestamp tx ty tz qx qy qz qw``.

A row is the pose world_from_cam, with the camera's axes x right, y down, z forward, and the time in
seconds. Source: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats.
"""

import re
import warnings
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any

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
    images = tuple(
        PosedImage(cells[0], None, pose_from_quaternion(position, wxyz).inverse(), float(time))
        for cells, time, position, wxyz in zip(
            table.cells, times, translations, quaternions_wxyz, strict=True
        )
    )
    try:
        return Reconstruction({}, images)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def write_tum_trajectory(path: PathLike, reconstruction: Reconstruction) -> None:
    """Write the poses of the images as a trajectory, in the order of their times.

    Cameras, points and names are left out. If any image has no time stamp, the rows count from 0 in
    place of the time, in the natural order of the names: frame2 before frame10. A warning says so
    where the numbers in the names have gaps, because row k is then not frame k. A file that exists
    is replaced.

    Raises
    ------
    ValueError
        If an image has no pose, or two have the same time stamp.
    OSError
        If the file cannot be written.
    """
    timed = all(image.timestamp_s is not None for image in reconstruction.images)
    images = sorted(reconstruction.images, key=_place)
    if timed:
        images.sort(key=lambda image: image.timestamp_s or 0.0)
    else:
        _warn_of_gaps([image.name for image in images])
    by_stamp: dict[float | None, str] = {}
    for image in images if timed else ():
        other = by_stamp.setdefault(image.timestamp_s, image.name)
        if other != image.name:
            raise ValueError(
                f"images {other} and {image.name} have the same time stamp; a trajectory is that "
                "of one camera"
            )
    lines = ["# " + " ".join(COLUMNS)]
    for index, image in enumerate(images):
        world_from_cam = checks.known_pose(image).inverse()
        w, x, y, z = world_from_cam.quaternion_wxyz
        numbers = (image.timestamp_s if timed else index, *world_from_cam.translation, x, y, z, w)
        # The fewest digits that read back to the same number; an index has no decimal point.
        lines.append(" ".join(repr(n if isinstance(n, int) else float(n or 0.0)) for n in numbers))
    write_file(path, ("\n".join(lines) + "\n").encode())


def _warn_of_gaps(names: list[str]) -> None:
    """Warn where frames are missing between two names by the numbers before their extensions."""
    found = [_NUMBERED.fullmatch(name) for name in names]
    if len(names) < 3 or not all(found) or len({(m[1], m[3]) for m in found if m}) > 1:
        return
    numbers = [int(match[2]) for match in found if match]
    steps = [after - before for before, after in pairwise(numbers)]
    if len(set(steps)) == 1:
        return
    first = next(index for index, step in enumerate(steps) if step != min(steps))
    warnings.warn(
        f"the images have no times, so rows count from 0, but frames are missing between "
        f"{names[first]} and {names[first + 1]}: row k is not frame k",
        UserWarning,
        stacklevel=3,
    )


def _place(image: PosedImage) -> Any:
    """Sort key: folder by folder, as files lie on a disk."""
    return [natural_order(Path(part)) for part in PurePosixPath(image.name).parts]
