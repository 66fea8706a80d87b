# SPDX-License-Identifier: BSD-3-Clause
"""What the readers and writers of reconstructions check, with errors that name the place."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, KannalaBrandt, Pinhole, UnifiedCamera
from epi360.cameras.calibration import fields
from epi360.interop.match_graph import MatchedImage
from epi360.interop.reconstruction import PosedImage
from epi360.poses import Pose, pose_from_quaternion
from epi360.runs.input_files import read_text

# Products of a few matrices of single precision are off by 1e-6; scaled matrices by far more.
ROTATION_TOLERANCE = 1e-3
LENS_COEFFICIENTS: dict[type[Camera], tuple[str, ...]] = {
    Pinhole: (),
    UnifiedCamera: ("k1", "k2", "p1", "p2"),
    KannalaBrandt: ("k1", "k2", "k3", "k4"),
}


def read_json(path: Path, what: str) -> Any:
    """Return the content of a JSON file; ``what`` says what it should be."""
    try:
        return json.loads(read_text(path))
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} does not exist; it must be {what}") from None
    except (ValueError, RecursionError) as error:  # ValueError also for bytes that are no text
        raise ValueError(f"{path} must be JSON, {what}: {error}") from None
    except OSError:
        raise ValueError(f"{path} must be a file, {what}; it cannot be read") from None


def mapping(value: Any, name: str) -> Mapping[str, Any]:
    """Return a value that must be a JSON object."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a mapping, got {fields.shortened(value)}")
    return value


def finite_array(value: Any, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    """Return a value as an array of this shape, with finite numbers."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.full(1, np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        size = " x ".join(map(str, shape))
        raise ValueError(f"{name} must be {size} finite numbers, got {fields.shortened(value)}")
    return array


def pose_of_matrix(value: Any, name: str) -> Pose:
    """Return the pose of a 3 x 4 or 4 x 4 matrix with few digits."""
    rows = 4 if isinstance(value, list) and len(value) == 4 else 3
    matrix = finite_array(value, (rows, 4), name)
    if rows == 4 and not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=1e-9):
        raise ValueError(f"the last row of {name} must be (0, 0, 0, 1), got {matrix[3].tolist()}")
    left, scales, right = np.linalg.svd(matrix[:3, :3])
    if np.abs(scales - 1).max() > ROTATION_TOLERANCE or np.linalg.det(left @ right) < 0:
        with np.errstate(over="ignore"):
            determinant = np.linalg.det(matrix[:3, :3])
        raise ValueError(
            f"{name} must hold a rotation, got a matrix with determinant {determinant:.4g} "
            f"and scales {[float(f'{scale:.4g}') for scale in scales]}"
        )
    return Pose(left @ right, matrix[:3, 3])


def pose_of_numbers(numbers: Sequence[float] | NDArray[np.float64], expected: str) -> Pose:
    """Return the pose of a quaternion of any length, w first, and a translation."""
    wxyz, translation = np.array(numbers[:4]), np.array(numbers[4:])
    with np.errstate(over="ignore", invalid="ignore"):  # damaged files hold signalling NaN
        length = np.linalg.norm(wxyz)
    if not (0 < length < np.inf and np.isfinite(translation).all()):
        raise ValueError(f"{expected}, got {[*wxyz.tolist(), *translation.tolist()]}")
    return pose_from_quaternion(translation, wxyz / length)


def known_pose(image: PosedImage) -> Pose:
    """Return the pose of an image that is to be written; raise ``ValueError`` if it is NaN."""
    pose = image.cam_from_world
    if np.isnan(pose.rotation).any() or np.isnan(pose.translation).any():
        raise ValueError(f"image {image.name} has no pose; leave it out of the reconstruction")
    return pose


def known_camera(image: MatchedImage | PosedImage, what: str) -> str:
    """Return the name of an image's camera; raise ``ValueError`` if it has none."""
    if image.camera is None:
        raise ValueError(f"{what} needs the camera of image {image.name}; give one (--camera)")
    return image.camera


def lens_coefficients(name: str, camera: Camera, tool: str) -> dict[str, float]:
    """Return the coefficients of a lens that OpenSfM and nerfstudio have, none of a pinhole."""
    if type(camera) not in LENS_COEFFICIENTS or getattr(camera, "xi", 0) != 0:
        raise ValueError(
            f"camera {name}: {tool} has no {type(camera).__name__} model; it has panoramas, "
            "pinholes with distortion (Pinhole, UnifiedCamera with xi = 0) and KannalaBrandt"
        )
    return {key: getattr(camera, key) for key in LENS_COEFFICIENTS[type(camera)]}
