# SPDX-License-Identifier: BSD-3-Clause
"""Values of a parsed calibration file, checked: numbers, keys, one camera an entry."""

import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from epi360.cameras.base import Camera
from epi360.poses import Pose, pose_from_quaternion

OPENCV_TO_CONTINUOUS = 0.5  # OpenCV, Kalibr and basalt put the centre of the first pixel at 0
QUATERNION_TOLERANCE = 1e-3  # four digits in a file are enough

SHORT = reprlib.Repr()
SHORT.maxlevel, SHORT.maxstring, SHORT.maxother = 2, 60, 60

T = TypeVar("T")
Model = Callable[..., Camera]  # a camera class, called with what the file says


def each(entries: Any, read: Callable[[Mapping[str, Any]], T]) -> dict[str, T]:
    """Return what ``read`` makes of each entry of a mapping; its errors name the camera."""
    if not isinstance(entries, Mapping) or not entries:
        raise ValueError("cameras must be a mapping of names to cameras, with one at least")
    cameras: dict[str, T] = {}
    for name, entry in entries.items():
        if not isinstance(entry, Mapping):
            raise ValueError(f"camera {name} must be a mapping, got {shortened(entry)}")
        try:
            cameras[str(name)] = read(entry)
        except ValueError as error:
            raise ValueError(f"camera {name}: {error}") from None
    return cameras


def check_has(entry: Mapping[str, Any], needed: Iterable[str]) -> None:
    """Raise ``ValueError`` unless the entry has all of these keys."""
    missing = [key for key in needed if key not in entry]
    if missing:
        raise ValueError(f"missing keys: {', '.join(missing)}")


def numbers(values: Any, count: int, name: str) -> list[Any]:
    """Return ``count`` values of a list; the camera refuses those that are no numbers."""
    if not isinstance(values, list) or len(values) != count:
        raise ValueError(f"{name} must be {count} numbers, got {shortened(values)}")
    return [number(value) for value in values]


def real_numbers(values: Any, count: int, name: str) -> list[float]:
    """Return ``count`` values of a list as floats."""
    return [real_number(value, name) for value in numbers(values, count, name)]


def square_matrix(rows: Any, size: int, name: str) -> list[list[float]]:
    """Return a matrix that is given as a list of rows."""
    if not isinstance(rows, list) or len(rows) != size:
        raise ValueError(f"{name} must be {size} rows of {size} numbers, got {shortened(rows)}")
    return [real_numbers(row, size, f"a row of {name}") for row in rows]


def real_number(value: Any, name: str) -> float:
    """Return a value as a float."""
    converted = number(value)
    if isinstance(converted, bool) or not isinstance(converted, int | float):
        raise ValueError(f"{name} must be a number, got {shortened(value)}")
    try:
        return float(converted)
    except OverflowError:
        raise ValueError(f"{name} must be a finite number, got {shortened(value)}") from None


def number(value: Any) -> Any:
    """Return a number that stands as text: YAML takes 1e-3 for text, as it has no point."""
    if not isinstance(value, str):
        return value
    try:
        return int(value) if value.isdecimal() else float(value)
    except ValueError:
        return value  # the camera refuses it and names the parameter


def pose_of_numbers(wxyz: list[float], translation: list[float], name: str) -> Pose:
    """Return the pose of a unit quaternion with few digits and a translation."""
    quaternion = np.array(wxyz)
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1) < QUATERNION_TOLERANCE:
        raise ValueError(f"{name} must have length 1, got {shortened(wxyz)} of length {length:.6g}")
    return pose_from_quaternion(np.array(translation), quaternion / length)


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Name the file in a ``ValueError``, in one line whatever names the file has."""
    try:
        yield
    except ValueError as error:
        raise ValueError(" ".join(f"calibration file {path}: {error}".split())) from None


def unsupported(what: str, supported: str) -> ValueError:
    """Return the error for a model that no camera of ours is equal to."""
    return ValueError(f"{what} is not supported; supported: {supported}")


def shortened(value: Any) -> str:
    """Return a short text of a value for an error message, however large the value is."""
    return SHORT.repr(value)
