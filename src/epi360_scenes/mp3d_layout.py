# SPDX-License-Identifier: BSD-3-Clause
"""Files of a rendered sequence, laid out as 360-MP3D-VO: written whole or not at all.

``rgb/1.png``, ``depth/tiff/1.tiff`` and so on (float32 ranges along the ray in metres, 0: none) and
``frm_ref.txt``: rows ``t tx ty tz qx qy qz qw`` of world_from_cam. Files count from 1, rows from 0;
``rgb/frames.csv`` (image, timestamp_s) gives each picture the time of its row.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from epi360.features.picture_writing import encode_picture
from epi360.poses import Pose
from epi360.runs.whole_files import write_file
from epi360_scenes.rendering import Rendering

POSES_FILE = "frm_ref.txt"
TIMES_FILE = "rgb/frames.csv"


def frame_files(folder: Path, index: int) -> tuple[Path, Path]:
    """Picture and depth files of a frame."""
    number = index + 1
    return folder / "rgb" / f"{number}.png", folder / "depth" / "tiff" / f"{number}.tiff"


def write_frame(folder: Path, index: int, rendering: Rendering) -> None:
    """Write the two files of a frame; missing folders are made."""
    image_file, depth_file = frame_files(folder, index)
    depth = np.ascontiguousarray(rendering.depth, dtype=np.float32)
    write_whole(depth_file, encode_picture(depth, ".tiff"))
    write_whole(image_file, encode_picture(rendering.image, ".png"))


def poses_text(world_from_cam: Sequence[Pose]) -> str:
    """Content of ``frm_ref.txt``: one row a pose; the time is the number of the row, from 0."""
    rows = []
    for time, pose in enumerate(world_from_cam):
        w, *xyz = pose.quaternion_wxyz
        rows.append(" ".join(f"{value:.17g}" for value in (time, *pose.translation, *xyz, w)))
    return "".join(f"{row}\n" for row in rows)


def times_text(num_frames: int) -> str:
    """Content of ``rgb/frames.csv``: the time of each picture in ``frm_ref.txt``."""
    rows = [f"{frame_files(Path(), index)[0].name},{index}\n" for index in range(num_frames)]
    return "image,timestamp_s\n" + "".join(rows)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file under a temporary name beside it and rename: readers never see half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, data)
