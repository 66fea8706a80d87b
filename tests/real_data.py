# SPDX-License-Identifier: BSD-3-Clause
"""Real pictures and their reference poses, told without our own readers."""

import csv
from pathlib import Path

import numpy as np

from epi360.poses import Pose, pose_from_quaternion


def is_picture(path: Path) -> bool:
    """Whether a file starts as a JPEG or PNG file does."""
    with path.open("rb") as file:
        start = file.read(8)
    return start.startswith(b"\xff\xd8\xff") or start == b"\x89PNG\r\n\x1a\n"


def reference_poses(table: Path) -> dict[str, Pose]:
    """Poses world_from_cam of a poses.csv, by the names of the pictures."""
    poses = {}
    for row in csv.DictReader(table.read_text(encoding="utf-8").splitlines()):
        center, wxyz = (
            np.array([float(row[column]) for column in columns])
            for columns in (("cx", "cy", "cz"), ("qw", "qx", "qy", "qz"))
        )
        poses[Path(row["image"]).name] = pose_from_quaternion(center, wxyz / np.linalg.norm(wxyz))
    return poses
