# SPDX-License-Identifier: BSD-3-Clause
"""Calibration files of basalt."""

import copy

import numpy as np
import pytest

from epi360.cameras import (
    DoubleSphere,
    ExtendedUnified,
    KannalaBrandt,
    Pinhole,
    UnifiedCamera,
    load_cameras,
)

FOCUS = {"fx": 158.3, "fy": 158.2, "cx": 254.9, "cy": 256.8}
BASALT = {
    "value0": {
        "T_imu_cam": [
            {"px": 0.05, "py": -0.07, "pz": 0.01, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}
        ],
        "intrinsics": [
            {"camera_type": "ds", "intrinsics": {**FOCUS, "xi": -0.17, "alpha": 0.59}},
            {"camera_type": "eucm", "intrinsics": {**FOCUS, "alpha": 0.63, "beta": 1.04}},
            {"camera_type": "kb4", "intrinsics": {**FOCUS, "k1": 0.1, "k2": 0.2, "k3": 0, "k4": 1}},
            {"camera_type": "pinhole", "intrinsics": FOCUS},
            {"camera_type": "ucm", "intrinsics": {**FOCUS, "alpha": 0.6}},
        ],
        "resolution": [[512, 512], [512, 512], [640, 480], [512, 512], [512, 512]],
        "calib_accel_bias": [0.0, 0.0, 0.0],
    }
}


def changed(path, value):
    document = copy.deepcopy(BASALT)
    entry = document
    for key in path[:-1]:
        entry = entry[key]
    entry[path[-1]] = value
    return document


def test_every_model_gets_the_half_pixel(written):
    cameras = load_cameras(written(BASALT, "calibration.json"))
    ucm = cameras.pop("cam4")
    focus = (158.3, 158.2, 254.9 + 0.5, 256.8 + 0.5)
    assert cameras == {
        "cam0": DoubleSphere(512, 512, *focus, -0.17, 0.59),
        "cam1": ExtendedUnified(512, 512, *focus, 0.63, 1.04),
        "cam2": KannalaBrandt(640, 480, *focus, 0.1, 0.2, 0, 1),
        "cam3": Pinhole(512, 512, *focus),
    }
    assert isinstance(ucm, UnifiedCamera) and ucm.xi == pytest.approx(1.5, abs=1e-15)
    assert ucm.fx == pytest.approx(158.3 * 2.5, abs=1e-10) and ucm.cx == 255.4


def test_ucm_projects_by_the_formula_of_basalt(written):
    # u = fx x / (alpha |X| + (1 - alpha) z) + cx, with the first pixel's centre at 0.
    camera = load_cameras(written(BASALT))["cam4"]
    points = np.random.default_rng(0).normal(size=(500, 3))
    x, y, z = points.T
    depths = 0.6 * np.linalg.norm(points, axis=1) + 0.4 * z
    expected = np.column_stack([158.3 * x / depths + 254.9, 158.2 * y / depths + 256.8]) + 0.5
    pixels = camera.pixels_from_bearings(points)
    seen = np.isfinite(pixels[:, 0])
    assert seen.sum() > 200
    np.testing.assert_allclose(pixels[seen], expected[seen], atol=1e-10)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["value0", "intrinsics"], [], "intrinsics must list one camera at least"),
        (["value0", "intrinsics"], {"fx": 1}, "must list one camera at least, got {'fx'"),
        (["value0", "resolution"], [[512, 512]], "must list the sizes of 5 cameras"),
        (["value0", "resolution", 1], [512], "camera cam1: resolution must be 2 numbers"),
        (["value0", "resolution", 1], [512, -1], "camera cam1: height must be a positive integer"),
        (["value0", "intrinsics", 1], 5, "camera cam1: intrinsics must be a mapping, got 5"),
        (["value0", "intrinsics", 1], {}, "cam1: missing keys: camera_type, intrinsics"),
        (["value0", "intrinsics", 1, "camera_type"], "fov", "'fov' is not supported; .* kb4, ucm"),
        (["value0", "intrinsics", 1, "camera_type"], ["ds"], "is not supported"),
        (["value0", "intrinsics", 1, "camera_type"], "ds", "camera cam1: missing keys: xi"),
        (["value0", "intrinsics", 1, "intrinsics"], [1, 2], "intrinsics must be a mapping, got"),
        (["value0", "intrinsics", 0, "intrinsics", "xi"], "a", "xi must be a number, got 'a'"),
        (["value0", "intrinsics", 0, "intrinsics", "xi"], 2, "xi must be between -1 and 1"),
        (["value0", "intrinsics", 4, "intrinsics", "alpha"], 1, r"of ucm must be in \[0, 1\)"),
    ],
)  # fmt: skip
def test_cameras_that_cannot_be_used_say_why(path, value, message, written):
    with pytest.raises(ValueError, match=message) as raised:
        load_cameras(written(changed(path, value), "calibration.json"))
    assert "calibration.json: " in str(raised.value) and "\n" not in str(raised.value)


def test_sizes_are_needed(written):
    document = copy.deepcopy(BASALT)
    del document["value0"]["resolution"]
    with pytest.raises(ValueError, match="missing keys: resolution"):
        load_cameras(written(document))
