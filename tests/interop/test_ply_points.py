# SPDX-License-Identifier: BSD-3-Clause
"""PLY files of points that are damaged."""

import numpy as np
import pytest

from epi360.interop.ply import read_ply_points

HEADER = (
    "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
    "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
)
ROWS = "1 2 3 4 5 6\n7 8 9 255 0 1\n"


def test_points_and_colors_are_read(tmp_path):
    path = tmp_path / "points.ply"
    path.write_text(HEADER + ROWS)
    points, colors = read_ply_points(path)
    np.testing.assert_array_equal(points, [[1, 2, 3], [7, 8, 9]])
    np.testing.assert_array_equal(colors, [[4, 5, 6], [255, 0, 1]])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("vertex 2", "vertex -1", "must be a number of rows of plain numbers"),
        ("vertex 2", "vertex", "its header is damaged"),
        ("uchar red", "byte red", "its header is damaged"),
        ("float x", "list uchar float x", "must be a number of rows of plain numbers"),
        ("255 0 1", "256 0 1", "must hold colors from 0 to 255"),
        ("255 0 1", "nan 0 1", "must hold colors from 0 to 255"),
        ("7 8 9", "7 8 inf", "must hold finite points"),
    ],
)
def test_what_is_no_list_of_points_is_refused(tmp_path, old, new, message):
    path = tmp_path / "points.ply"
    path.write_text((HEADER + ROWS).replace(old, new))
    with pytest.raises(ValueError, match=f"points.ply must .*{message}|points.ply {message}"):
        read_ply_points(path)
