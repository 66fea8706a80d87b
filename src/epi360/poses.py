# SPDX-License-Identifier: BSD-3-Clause
"""Rigid transforms between camera frames, and the angles between two of them.

A pose is named for what it maps: ``cam2_from_cam1`` takes x1 to x2 = R x1 + t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

_LARGEST = 1e100  # of a vector's numbers: their squares are numbers
ROTATION_TOLERANCE = 1e-6  # a rotation read from a file with seven digits still passes


@dataclass(frozen=True, eq=False)
class Pose:
    """Rigid transform x_a = R x_b + t, named ``a_from_b``.

    Two views do not determine the length of the translation, which is then one. Numbers that the
    data do not determine are NaN. Compare two poses with `rotation_error_deg` and
    `translation_error_deg`; ``==`` only asks whether they are the same object.

    Parameters
    ----------
    rotation : array_like, shape (3, 3)
        Rotation matrix, orthonormal to 1e-6 with determinant +1, or NaN.
    translation : array_like, shape (3,)
        Position of the origin of b in the frame a; finite or NaN.

    Raises
    ------
    ValueError
        If a shape is wrong, a number is infinite or the matrix is not a rotation.
    """

    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    __array_ufunc__ = None  # pose @ array is a TypeError, not NumPy's guess

    def __post_init__(self) -> None:
        rotation = _checked(self.rotation, (3, 3), "rotation")
        translation = _checked(self.translation, (3,), "translation")
        _check_is_rotation(rotation)
        for name, array in (("rotation", rotation), ("translation", translation)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @classmethod
    def nan(cls) -> Pose:
        """Return a pose of NaN, which an estimate without an answer has."""
        return cls(np.full((3, 3), np.nan), np.full(3, np.nan))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> Pose:
        """Return the pose of a matrix ``[R | t]``, with or without the last row (0, 0, 0, 1).

        Raises
        ------
        ValueError
            If the shape or the last row is wrong, or R is not a rotation.
        """
        array = np.asarray(matrix, dtype=np.float64)
        if array.shape not in ((3, 4), (4, 4)):
            raise ValueError(f"matrix must have shape (3, 4) or (4, 4), got {array.shape}")
        if array.shape == (4, 4) and not np.allclose(array[3], (0, 0, 0, 1), rtol=0, atol=1e-9):
            raise ValueError(f"the last row of matrix must be (0, 0, 0, 1), got {array[3]}")
        return cls(array[:3, :3], array[:3, 3])

    def matrix(self) -> NDArray[np.float64]:
        """Return the transformation matrix, shape (4, 4), with the last row (0, 0, 0, 1)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.translation
        return matrix

    def inverse(self) -> Pose:
        """Return the pose ``b_from_a`` of this ``a_from_b``."""
        return Pose(self.rotation.T, -(self.rotation.T @ self.translation))

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose ``a_from_c`` of this ``a_from_b`` and the other's ``b_from_c``."""
        if not isinstance(other, Pose):
            raise TypeError(
                f"pose @ other must have two poses, got {type(other).__name__}; points (N, 3) are "
                "moved by points @ pose.rotation.T + pose.translation"
            )
        translation = self.rotation @ other.translation + self.translation
        return Pose(self.rotation @ other.rotation, translation)

    @property
    def quaternion_wxyz(self) -> NDArray[np.float64]:
        """Unit quaternion (w, x, y, z) of the rotation with w >= 0, shape (4,)."""
        return _quaternion_from_rotation(self.rotation)


def pose_from_quaternion(translation: NDArray[np.float64], wxyz: NDArray[np.float64]) -> Pose:
    """Return the pose whose rotation is given as a unit quaternion, the scalar first.

    ``ValueError`` if the quaternion does not have unit length, or a number is infinite.
    """
    w, x, y, z = wxyz
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return Pose(np.array(rotation), translation)


def rotation_from_vector(vector: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation (3, 3) about a vector by its length in radians."""
    axis_angle = _checked(vector, (3,), "vector")
    if (np.abs(axis_angle) > _LARGEST).any():
        raise ValueError(
            f"rotation vector must be at most {_LARGEST:g} long, got {axis_angle.tolist()}"
        )
    x, y, z = axis_angle
    half_turns = float(np.linalg.norm(axis_angle)) / (2 * np.pi)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Rodrigues' formula with (1 - cos a) / a^2 = sinc(a / 2)^2 / 2, exact down to a zero angle.
    squared = np.sinc(half_turns) ** 2
    return np.asarray(np.eye(3) + np.sinc(2 * half_turns) * cross + 0.5 * squared * cross @ cross)


def vector_from_rotation(rotation: ArrayLike) -> NDArray[np.float64]:
    """Return axis times angle (3,) of a rotation, in radians; its length is in [0, pi]."""
    matrix = _checked(rotation, (3, 3), "rotation")
    _check_is_rotation(matrix)
    w, *axis = _quaternion_from_rotation(matrix)
    sine = float(np.linalg.norm(axis))
    factor = 2 * np.arctan2(sine, w) / sine if sine != 0 else 2.0
    return np.asarray(axis) * factor


def rotation_error_deg(a: Pose | ArrayLike, b: Pose | ArrayLike) -> float:
    """Return the angle in [0, 180] degrees of the rotation that takes one rotation to another.

    Parameters
    ----------
    a, b : Pose or array_like of shape (3, 3)
        Two poses, or their rotations. The angle is NaN if either is NaN.

    Raises
    ------
    ValueError
        If an array is not a rotation matrix.
    """
    rotation_a, rotation_b = (
        pose if isinstance(pose, Pose) else Pose(_checked(pose, (3, 3), name), np.zeros(3))
        for pose, name in ((a, "a"), (b, "b"))
    )
    difference = rotation_a.rotation.T @ rotation_b.rotation
    sine = 0.5 * float(np.linalg.norm((difference - difference.T)[[2, 0, 1], [1, 2, 0]]))
    cosine = 0.5 * (float(np.trace(difference)) - 1.0)
    return float(np.degrees(np.arctan2(sine, cosine)))


def translation_error_deg(a: Pose | ArrayLike, b: Pose | ArrayLike) -> float:
    """Return the angle in [0, 180] degrees between the directions of two translations.

    Parameters
    ----------
    a, b : Pose or array_like of shape (3,)
        Two poses, or their translations of any length. The angle is NaN if either is NaN, or zero
        and so without a direction.

    Raises
    ------
    ValueError
        If an array has another shape, or an infinite number in it.
    """
    translation_a, translation_b = (
        _unit(pose.translation if isinstance(pose, Pose) else _checked(pose, (3,), name))
        for pose, name in ((a, "a"), (b, "b"))
    )
    sine = float(np.linalg.norm(np.cross(translation_a, translation_b)))
    return float(np.degrees(np.arctan2(sine, float(translation_a @ translation_b))))


def angles_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles in radians between vectors (..., 3) of any length, with all digits near 0 and pi."""
    sines = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.arctan2(sines, np.sum(a * b, axis=-1)))


def angles_of_units(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same between unit vectors, in half the time (Kahan 2006)."""
    sides = (np.linalg.norm(each, axis=-1) for each in (a - b, a + b))
    return np.asarray(2.0 * np.arctan2(*sides))


def poses_agree(a: Pose, b: Pose, rotation_deg: float, translation_deg: float) -> bool:
    """Whether two poses differ by less than these angles in rotation and direction; NaN does not.

    See `rotation_error_deg` and `translation_error_deg`.
    """
    return rotation_error_deg(a, b) < rotation_deg and translation_error_deg(a, b) < translation_deg


def checked_pose(pose: object, name: str = "cam2_from_cam1") -> Pose:
    """Return a pose, or raise ``ValueError`` if it is something else."""
    if not isinstance(pose, Pose):
        raise ValueError(f"{name} must be a Pose, got {pose!r}")
    return pose


def _checked(array: ArrayLike, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    copy = np.array(array, dtype=np.float64)
    if copy.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {copy.shape}")
    if np.isinf(copy).any():
        raise ValueError(f"{name} must be finite or NaN, got {copy.tolist()}")
    return copy


def _check_is_rotation(matrix: NDArray[np.float64]) -> None:
    # Python's own numbers: NumPy's calls take three times as long for so few.
    x, y, z = rows = matrix.tolist()
    if any(value != value for row in rows for value in row):
        return
    products = (_dot(x, x) - 1, _dot(y, y) - 1, _dot(z, z) - 1, _dot(x, y), _dot(y, z), _dot(z, x))
    deviation = max(map(abs, products))
    if deviation > ROTATION_TOLERANCE:
        raise ValueError(
            f"rotation must be orthonormal to {ROTATION_TOLERANCE:g}, R R^T is off by "
            f"{deviation:.3g}; build it from a quaternion, or from U V^T of its SVD"
        )
    normal = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    if _dot(normal, z) < 0:
        raise ValueError("rotation must have determinant +1, got -1: a reflection")


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    largest = float(np.abs(vector).max())
    scaled = vector / largest if largest > 0 else np.full(3, np.nan)  # no over- or underflow
    return scaled / float(np.linalg.norm(scaled))


def _quaternion_from_rotation(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (w, x, y, z) with unit length and w >= 0 (Shepperd 1978)."""
    R = rotation
    # Four times the outer product q q^T. Each row is q times one of its numbers; take the largest.
    outer = np.array([
        [1 + R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
        [R[2, 1] - R[1, 2], 1 + R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]],
        [R[0, 2] - R[2, 0], R[0, 1] + R[1, 0], 1 - R[0, 0] + R[1, 1] - R[2, 2], R[1, 2] + R[2, 1]],
        [R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], 1 - R[0, 0] - R[1, 1] + R[2, 2]],
    ])  # fmt: skip
    row = outer[int(np.argmax(np.diag(outer)))]
    quaternion: NDArray[np.float64] = row / float(np.linalg.norm(row))
    return -quaternion if quaternion[0] < 0 else quaternion
