# SPDX-License-Identifier: BSD-3-Clause
"""What the readers and writers of reconstructions check, with errors that name the place."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.calibration import fields
from epi360.interop.reconstruction import PosedImage
from epi360.poses import Pose

# Matrices of single precision, multiplied a few times, are off by 1e-6; scaled ones by far more.
ROTATION_TOLERANCE = 1e-3


def read_json(path: Path, what: str) -> Any:
    """Content of a JSON file; ``what`` says what is expected to be in it."""
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} does not exist; it must be {what}") from None
    except (ValueError, RecursionError) as error:  # also what is no text
        raise ValueError(f"{path} must be JSON, {what}: {error}") from None
    except OSError:
        raise ValueError(f"{path} must be a file, {what}; it cannot be read") from None


def mapping(value: Any, name: str) -> Mapping[str, Any]:
    """Value, which must be a JSON object."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a mapping, got {fields.shortened(value)}")
    return value


def finite_array(value: Any, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    """Value as an array of this shape of finite numbers."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.full(1, np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        size = " x ".join(map(str, shape))
        raise ValueError(f"{name} must be {size} finite numbers, got {fields.shortened(value)}")
    return array


def pose_of_matrix(value: Any, name: str) -> Pose:
    """Pose of a 3 x 4 or 4 x 4 matrix of limited precision."""
    rows = 4 if isinstance(value, list) and len(value) == 4 else 3
    matrix = finite_array(value, (rows, 4), name)
    if rows == 4 and not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=1e-9):
        raise ValueError(f"the last row of {name} must be (0, 0, 0, 1), got {matrix[3].tolist()}")
    left, scales, right = np.linalg.svd(matrix[:3, :3])
    if np.abs(scales - 1).max() > ROTATION_TOLERANCE or np.linalg.det(left @ right) < 0:
        raise ValueError(
            f"{name} must hold a rotation, got a matrix with determinant "
            f"{np.linalg.det(matrix[:3, :3]):.4g} and scales {np.round(scales, 4).tolist()}"
        )
    return Pose(left @ right, matrix[:3, 3])


def known_pose(image: PosedImage) -> Pose:
    """Pose of an image that is to be written; ``ValueError`` where it is NaN."""
    pose = image.cam_from_world
    if np.isnan(pose.rotation).any() or np.isnan(pose.translation).any():
        raise ValueError(f"image {image.name} has no pose; leave it out of the reconstruction")
    return pose


def known_camera(image: PosedImage, what: str) -> str:
    """Name of an image's camera; ``ValueError`` where it has none but the format needs one."""
    if image.camera is None:
        raise ValueError(f"{what} needs the camera of image {image.name}; give one (--camera)")
    return image.camera
