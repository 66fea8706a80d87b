# SPDX-License-Identifier: BSD-3-Clause
"""Errors of the pairs that ``epi360 match`` accepts, against poses that are known.

``python benchmarks/tour_pairs.py PAIRS.csv POSES.csv``; README.md beside this file says more.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from _data import read_poses

from epi360.poses import Pose, pose_from_quaternion, rotation_error_deg, translation_error_deg


def main() -> None:
    """Print every pair with its errors, the worst first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pairs", type=Path, help="table that epi360 match writes")
    parser.add_argument("poses", type=Path, help="table with image, qw..qz and cx_m..cz_m")
    options = parser.parse_args()
    world_from_cam = read_poses(options.poses)
    rows = []
    with options.pairs.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["status"] in ("ok", "refused") and row["tx"]:
                rows.append((*_errors(row, world_from_cam), row))
    rows.sort(key=lambda errors: max(errors[:2]), reverse=True)
    print("rotation deg  direction deg  accepted  inliers  triangles, open  pair")
    for rotation, direction, row in rows:
        triangles = f"{row['num_triangles']}, {row['num_contradicted']}"
        print(
            f"{rotation:12.2f}  {direction:13.2f}  {row['accepted']:8}  {row['num_inliers']:>7}  "
            f"{triangles:15}  {row['image1']} {row['image2']}"
        )
    accepted = [max(errors[:2]) for errors in rows if errors[2]["accepted"] == "yes"]
    counts = ", ".join(
        f"{sum(e <= bound for e in accepted)} within {bound}" for bound in (3, 5, 10)
    )
    print(f"{len(accepted)} accepted pairs, both errors: {counts} degrees")


def _errors(row: dict[str, str], world_from_cam: dict[str, Pose]) -> tuple[float, float]:
    wxyz = np.array([float(row[name]) for name in ("qw", "qx", "qy", "qz")])
    translation = np.array([float(row[name]) for name in ("tx", "ty", "tz")])
    estimate = pose_from_quaternion(translation, wxyz / np.linalg.norm(wxyz))
    truth = world_from_cam[row["image2"]].inverse() @ world_from_cam[row["image1"]]
    return rotation_error_deg(estimate, truth), translation_error_deg(estimate, truth)


if __name__ == "__main__":
    main()
