# SPDX-License-Identifier: BSD-3-Clause
"""What becomes of bearings if a camera's angles are larger or smaller than they should be.

Of a lens these are the angles from its optical axis, of a panorama its longitudes and latitudes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.base import Array, Camera
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.pinhole import Pinhole
from epi360.cameras.unified import UnifiedCamera

Mask = NDArray[np.bool_]
Direction = tuple[int, str]  # number of a camera, or of a view, and what changes

_NEAR_POLE = 1e-6  # cosine of a latitude
_EXPONENTS = np.array([0.0, 2.0, 4.0])  # of an angle, in what the changes of a lens multiply
_SLACK = np.radians(2.0)  # by which what lies at the end of a sphere may be beyond it


class AngleModel(NamedTuple):
    """Which angles of a camera change.

    These are "fixed" (none), "radial", "focal", "curved", "bent" or "panorama". ``longitude`` and
    ``down`` are those of the middle of a panorama, in radians; 0 of a lens.
    """

    angles: str
    longitude: float = 0.0
    down: float = 0.0

    @classmethod
    def of(cls, camera: Camera, *, is_curved: bool = False, is_bent: bool = False) -> AngleModel:
        """If ``is_curved``, the curve of a lens changes, too; if ``is_bent``, also at its edge.

        Or else what changes of a perspective camera is its focal length.
        """
        if isinstance(camera, Equirectangular):
            middle = camera.center_longitude_deg, -camera.center_latitude_deg
            return cls("panorama", *map(math.radians, middle))
        if is_bent or is_curved:
            return cls("bent" if is_bent else "curved")
        return cls("focal" if _is_perspective(camera) else "radial")

    @property
    def directions(self) -> tuple[str, ...]:
        """What each change changes."""
        return _DIRECTIONS[self.angles]


FIXED = AngleModel("fixed")
_DIRECTIONS = {
    "fixed": (),
    "radial": ("radial",),
    "focal": ("focal",),
    "curved": ("radial", "curve"),
    "bent": ("radial", "curve", "edge"),
    "panorama": ("horizontal", "vertical", "middle"),
}


# A small change of a focal length adds so much of an angle a, of its third power and of its fifth
# one: the series of sin a cos a.
_FOCAL_AS_CURVE = {"radial": 1.0, "curve": -2.0 / 3.0, "edge": 2.0 / 15.0}


def _is_perspective(camera: Camera) -> bool:
    return isinstance(camera, Pinhole) or (isinstance(camera, UnifiedCamera) and camera.xi == 0.0)


def with_curves(sizes: Mapping[Direction, float]) -> dict[Direction, float]:
    """The same changes, as those of lenses whose curves may change."""
    others = {each: size for each, size in sizes.items() if each[1] != "focal"}
    focal = {camera: size for (camera, direction), size in sizes.items() if direction == "focal"}
    return others | {
        (camera, direction): factor * size
        for camera, size in focal.items()
        for direction, factor in _FOCAL_AS_CURVE.items()
    }


def models_of(
    cameras: tuple[Camera, Camera], *, is_curved: bool = False, only: int = 0
) -> tuple[tuple[AngleModel, AngleModel], bool]:
    """Models of both views, and whether these share their changes, as those of equal cameras do.

    If ``only`` is 1 or 2, nothing changes in the other view.
    """
    first, second = (AngleModel.of(camera, is_curved=is_curved) for camera in cameras)
    if only:
        return ((first, FIXED) if only == 1 else (FIXED, second)), False
    return (first, second), cameras[0] == cameras[1]


def changes_of(
    models: tuple[AngleModel, AngleModel], is_one_camera: bool
) -> tuple[tuple[tuple[int, str], ...], tuple[slice, slice]]:
    """The view of each change (0: both) and what it changes; and which changes are whose."""
    first, second = (model.directions for model in models)
    if is_one_camera:
        own = slice(0, len(first))
        return tuple((0, name) for name in first), (own, own)
    names = [*((1, name) for name in first), *((2, name) for name in second)]
    return tuple(names), (slice(0, len(first)), slice(len(first), len(names)))


class ChangedBearings(NamedTuple):
    """Bearings (N, 3) with changed angles, and their derivatives.

    By the measured bearings, along two unit tangents, and by the changes: (N, 3, 2) and (N, 3, k).
    """

    bearings: Array
    by_measured: Array
    by_changes: Array


def _out_and_across(bearings: Array) -> tuple[Array, Array]:
    """Unit vectors (N, 3) away from the optical axis, and around it, where bearings lie."""
    x, y, _ = bearings.T
    around, zero = np.arctan2(y, x), np.zeros_like(x)
    cosine, sine = np.cos(around), np.sin(around)
    return np.stack([cosine, sine, zero], axis=1), np.stack([-sine, cosine, zero], axis=1)


class _Radial:
    """Bearings by their angles from the optical axis.

    An angle a (radians) is multiplied by 1 + the first change, if there is one, plus a^2 times the
    second one if the curve of the lens may change, too, plus a^4 times the third one.
    """

    def __init__(self, bearings: Array) -> None:
        x, y, z = bearings.T
        self._angle = np.arctan2(np.hypot(x, y), z)
        self._out, self._across = _out_and_across(bearings)

    def changed(self, changes: Array) -> ChangedBearings:
        """Bearings with other angles."""
        exponents = _EXPONENTS[: len(changes)]
        powers = self._angle[:, None] ** exponents
        factor = 1.0 + powers @ changes
        larger = self._angle * factor
        slope = 1.0 + powers @ ((exponents + 1.0) * changes)
        sine, cosine = np.sin(larger)[:, None], np.cos(larger)[:, None]
        axis = np.array([0.0, 0.0, 1.0])
        away = cosine * self._out - sine * axis
        stretch = factor * np.sinc(larger / np.pi) / np.sinc(self._angle / np.pi)
        return ChangedBearings(
            sine * self._out + cosine * axis,
            np.stack([slope[:, None] * away, stretch[:, None] * self._across], axis=2),
            (self._angle[:, None] * powers)[:, None, :] * away[:, :, None],
        )

    def beyond(self, changes: Array) -> Mask:
        """Which bearings (N,) would lie behind the camera."""
        powers = self._angle[:, None] ** _EXPONENTS[: len(changes)]
        return np.asarray(self._angle * (1.0 + powers @ changes) > np.pi)


class _Focal:
    """Bearings (N, 3) of a perspective camera.

    The tangents of the angles from its axis are multiplied by 1 + the change.
    """

    def __init__(self, bearings: Array) -> None:
        self._bearings = bearings
        self._out, self._across = _out_and_across(bearings)

    def changed(self, changes: Array) -> ChangedBearings:
        """Bearings with another focal length."""
        factor = 1.0 + changes[0]
        x, y, z = self._bearings.T
        longer = np.stack([factor * x, factor * y, z], axis=1)
        lengths = np.linalg.norm(longer, axis=1)[:, None]
        radius, depth = np.hypot(x, y)[:, None], z[:, None]
        away = (depth * self._out - factor * radius * [0.0, 0.0, 1.0]) / lengths
        return ChangedBearings(
            longer / lengths,
            np.stack([factor / lengths**2 * away, factor / lengths * self._across], axis=2),
            (radius * depth / lengths**2 * away)[:, :, None],
        )

    def beyond(self, changes: Array) -> Mask:
        """None: what is before the camera stays there."""
        return np.zeros(len(self._bearings), bool)


class _LongitudesAndLatitudes:
    """Bearings by their longitudes and latitudes from the middle of a panorama."""

    def __init__(self, bearings: Array, model: AngleModel) -> None:
        x, y, z = bearings.T
        self._middle = model.longitude, model.down
        longitudes = np.arctan2(x, z) - self._middle[0]
        self._longitudes = longitudes - 2.0 * np.pi * np.round(longitudes / (2.0 * np.pi))
        self._downwards = np.arctan2(y, np.hypot(x, z))
        self._latitudes = self._downwards - self._middle[1]

    def changed(self, changes: Array) -> ChangedBearings:
        """Bearings whose longitudes and latitudes are multiplied by 1 + change, and then lowered.

        The third change is the angle, in radians, by which all are lower than they seem.
        """
        wider, higher = 1.0 + changes[0], 1.0 + changes[1]
        longitudes = self._middle[0] + wider * self._longitudes
        latitudes = self._lowered(changes)
        sines, cosines = np.sin([longitudes, latitudes]), np.cos([longitudes, latitudes])
        zero = np.zeros_like(longitudes)
        east = np.stack([cosines[0], zero, -sines[0]], axis=1)
        down = np.stack([-sines[1] * sines[0], cosines[1], -sines[1] * cosines[0]], axis=1)
        parallel = cosines[1][:, None] * east
        before = np.maximum(np.cos(self._downwards), _NEAR_POLE)[:, None]
        return ChangedBearings(
            np.stack([cosines[1] * sines[0], sines[1], cosines[1] * cosines[0]], axis=1),
            np.stack([wider * parallel / before, higher * down], axis=2),
            np.stack(
                [self._longitudes[:, None] * parallel, self._latitudes[:, None] * down, down],
                axis=2,
            ),
        )

    def beyond(self, changes: Array) -> Mask:
        """Which bearings (N,) would lie beyond a pole, or more than half way around."""
        longitudes = (1.0 + changes[0]) * self._longitudes
        is_beyond = np.abs(self._lowered(changes)) > np.pi / 2.0 + _SLACK
        return np.asarray(is_beyond | (np.abs(longitudes) > np.pi + _SLACK))

    def _lowered(self, changes: Array) -> Array:
        """Latitudes (N,) downwards, with other angles."""
        return np.asarray(self._middle[1] + (1.0 + changes[1]) * self._latitudes + changes[2])


Angles = _Radial | _Focal | _LongitudesAndLatitudes


def angles_of(model: AngleModel, bearings: Array) -> Angles:
    """Bearings (N, 3) that a camera gave, as what changes with its calibration."""
    if model.angles == "panorama":
        return _LongitudesAndLatitudes(bearings, model)
    if model.angles == "focal":
        return _Focal(bearings)
    return _Radial(bearings)


@dataclass(frozen=True)
class PairOfAngles:
    """The bearings of two views as angles, and which of all changes are whose.

    Equal cameras share theirs. ``names`` has the view of each change (0: both) and its direction.
    """

    names: tuple[tuple[int, str], ...]
    _views: Sequence[Angles]
    columns: tuple[slice, slice]

    @classmethod
    def of(
        cls,
        cameras: tuple[Camera, Camera],
        bearings: tuple[Array, Array],
        *,
        is_curved: bool = False,
        only: int = 0,
    ) -> PairOfAngles:
        """Angles of bearings (N, 3) each, of which those change that `models_of` says."""
        models, is_one = models_of(cameras, is_curved=is_curved, only=only)
        names, columns = changes_of(models, is_one)
        return replace(cls.shared(models, columns, bearings), names=names)

    @classmethod
    def shared(
        cls,
        models: Sequence[AngleModel],
        columns: Sequence[slice],
        bearings: tuple[Array, Array],
    ) -> PairOfAngles:
        """Angles of bearings (N, 3) each; each view has its ``columns`` of all changes."""
        views = [angles_of(*each) for each in zip(models, bearings, strict=True)]
        first, second = columns
        return cls((), views, (first, second))

    def changed(self, changes: Array) -> tuple[ChangedBearings, ChangedBearings]:
        """Both views with changed angles."""
        first, second = (
            view.changed(changes[own]) for view, own in zip(self._views, self.columns, strict=True)
        )
        return first, second

    def share_beyond(self, changes: Array) -> float:
        """The larger share of the bearings of a view that would lie beyond a whole sphere."""
        return max(
            float(np.mean(view.beyond(changes[own]))) if own.stop > own.start else 0.0
            for view, own in zip(self._views, self.columns, strict=True)
        )
