# SPDX-License-Identifier: BSD-3-Clause
"""Points followed from frame to frame over the whole sphere, as odometry needs them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.cameras import Camera
from epi360.features.images import ImageSource, read_image, read_mask
from epi360.features.lucas_kanade import erode_mask, find_corners, follow_there_and_back
from epi360.features.sphere_cells import SphereCells, even_directions
from epi360.features.tracking_views import TrackingView, tracking_views

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Picture = NDArray[np.uint8]

_NUM_SAMPLES = 8000  # pixels, evenly over the sphere, of which brightness is measured
_DARK = 4.0  # mean grey values below this are no exposure that one could make up for
_TILE_PX = 128  # corners are searched in tiles: large temporary arrays take ten times as long
_LEAST_STRENGTH = 2e-4  # of a corner; noise of two grey values stays below it
_TURN_DEG = 4.0  # a larger predicted turn is rendered, because windows do not turn


@dataclass(frozen=True)
class TrackedFrame:
    """The points that one frame shows.

    Attributes
    ----------
    ids : ndarray, shape (N,), int64
        Identity of each point, the same in every frame and never used again; ascending.
    pixels : ndarray, shape (N, 2)
        Continuous pixels of the image.
    bearings : ndarray, shape (N, 3)
        Unit bearing vectors.
    age : ndarray, shape (N,), int64
        Number of frames since the point was found; 0 in its first frame.
    is_new : ndarray, shape (N,), bool
        Whether the point was found in this frame.
    error : ndarray, shape (N,)
        By how many pixels tracking back to the frame before misses the point; 0 if it is new.
    image_change : float
        Median change of the grey values, 0 to 255, since the frame before; 0 for a frozen
        picture and NaN for the first frame.
    brightness : float
        Mean grey value over the sphere, 0 to 255.
    """

    ids: NDArray[np.int64]
    pixels: Array
    bearings: Array
    age: NDArray[np.int64]
    is_new: Mask
    error: Array
    image_change: float
    brightness: float


@dataclass(frozen=True)
class _Points:
    ids: NDArray[np.int64]
    bearings: Array
    age: NDArray[np.int64]
    error: Array

    def chosen(self, mask: Mask) -> _Points:
        return _Points(self.ids[mask], self.bearings[mask], self.age[mask], self.error[mask])


_NO_POINTS = _Points(
    np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.int64), np.empty(0)
)  # fmt: skip


@dataclass(frozen=True)
class _Seen:
    """A frame as the tracker keeps it: the whole and the pictures of its views."""

    grey: Picture
    pictures: list[Picture]
    samples: Array


class FrameTracker:
    """Follow points through a video, frame by frame, anywhere on the sphere.

    Corners are found where the frame has none yet, in cells of equal solid angle, and followed by
    pyramidal Lucas-Kanade. A 360-degree panorama is searched around the horizon, across the seam,
    and in two views of its poles; other images as they are. The tracks do not depend on the number
    of threads.

    Parameters
    ----------
    camera : Camera
        Camera of every frame.
    mask : str, path or ndarray, optional
        White = use; of the camera's size. Points that enter the black part are lost.
    max_points : int
        Most points at a time.
    min_distance_deg : float
        Least angle of a new point to others. Points that come closer than half of it are thinned.
    quality_level : float
        Weakest new corner, relative to the strongest one nearby.
    forward_backward_px : float
        A point is lost when tracking it back misses its start by more.
    window_px : int
        Side of the window that is compared.
    pyramid_levels : int
        Halvings of the image; each doubles the reach.

    Raises
    ------
    ValueError
        If an option is out of its range or the mask does not fit the camera.
    """

    def __init__(
        self,
        camera: Camera,
        mask: ImageSource | None = None,
        *,
        max_points: int = 600,
        min_distance_deg: float = 2.0,
        quality_level: float = 0.02,
        forward_backward_px: float = 0.5,
        window_px: int = 13,
        pyramid_levels: int = 3,
    ) -> None:
        self.camera = camera
        self._max_points = max_points
        self._chord = 2 * np.sin(np.radians(min_distance_deg) / 2)
        self._quality_level = quality_level
        self._forward_backward_px = forward_backward_px
        self._window_px = window_px
        self._levels = pyramid_levels
        self._usable = camera.field_of_view_mask()
        if mask is not None:
            self._usable = self._usable & read_mask(mask, (camera.height, camera.width))
        self._views = tracking_views(camera, self._usable)
        self._searched = [erode_mask(view.usable, window_px) for view in self._views]
        self._sample_pixels, share = self._even_pixels()
        self._cells = SphereCells(max_points / share)
        self._points = _NO_POINTS
        self._next_id = 0
        self._previous: _Seen | None = None

    def track(self, image: ImageSource, rotation: ArrayLike | None = None) -> TrackedFrame:
        """Follow the points into the next frame and find new ones where there are none.

        Parameters
        ----------
        image : path or array
            What ``read_image`` takes, or grey values (H, W) of type uint8.
        rotation : array_like, shape (3, 3), optional
            Predicted rotation from the frame before, ``x_now = rotation @ x_before``; the points
            are searched where it takes them. Default: no rotation.

        Returns
        -------
        frame : TrackedFrame

        Raises
        ------
        ValueError
            If the image has another size than the camera, or the rotation another shape than
            (3, 3).
        """
        turn = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
        if turn.shape != (3, 3) or not np.isfinite(turn).all():
            raise ValueError(f"rotation must be finite, of shape (3, 3), got {turn}")
        now = self._seen(self._grey(image))
        before = self._previous
        if before is not None:
            self._points = self._thinned(self._followed(before, now, turn))
        self._points = self._replenished(now)
        self._previous = now
        return self._frame(before, now)

    def _frame(self, before: _Seen | None, now: _Seen) -> TrackedFrame:
        points = self._points
        change = np.nan if before is None else np.median(np.abs(now.samples - before.samples))
        return TrackedFrame(
            ids=points.ids,
            pixels=self.camera.pixels_from_bearings(points.bearings),
            bearings=points.bearings,
            age=points.age,
            is_new=points.age == 0,
            error=points.error,
            image_change=float(change),
            brightness=float(now.samples.mean()),
        )

    def _grey(self, image: ImageSource) -> Picture:
        if not (isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.ndim == 2):
            image = np.asarray(cv2.cvtColor(read_image(image), cv2.COLOR_RGB2GRAY), np.uint8)
        height, width = image.shape
        if (width, height) != (self.camera.width, self.camera.height):
            raise ValueError(
                f"image must be {self.camera.width}x{self.camera.height} like the camera, got "
                f"{width}x{height}; resize it or track it separately"
            )
        return image

    def _seen(self, grey: Picture) -> _Seen:
        columns, rows = self._sample_pixels
        # A copy, because the caller may use the array again for the next frame.
        kept = grey.copy()
        pictures = [view.picture(kept) for view in self._views]
        return _Seen(kept, pictures, kept[rows, columns].astype(np.float64))

    def _even_pixels(self) -> tuple[NDArray[np.intp], float]:
        """Usable pixels (2, S), evenly over the sphere, and the share of the sphere they cover."""
        pixels = self.camera.pixels_from_bearings(even_directions(_NUM_SAMPLES))
        pixels = np.floor(pixels[np.isfinite(pixels).all(axis=1)]).astype(np.intp)
        columns, rows = pixels.T.clip(0, [[self.camera.width - 1], [self.camera.height - 1]])
        used = self._usable[rows, columns]
        if not used.any():
            raise ValueError("mask must leave more of the image than single pixels")
        return np.stack([columns[used], rows[used]]), float(used.sum() / _NUM_SAMPLES)

    def _followed(self, before: _Seen, now: _Seen, turn: Array) -> _Points:
        """Points of the frame before that are found again, with their new bearings."""
        points = self._points
        predicted = points.bearings @ turn.T
        bearings = np.full_like(predicted, np.nan)
        missed_px = np.full(len(predicted), np.inf)
        angle = np.arctan2(np.linalg.norm(turn - turn.T) / np.sqrt(2), np.trace(turn) - 1)
        render = bool(angle > np.radians(_TURN_DEG))
        gain = _exposure_gain(before.samples, now.samples)
        for view, old, new in zip(self._views, before.pictures, now.pictures, strict=True):
            index = np.flatnonzero(view.owns(predicted))
            if len(index) == 0:
                continue
            if render:
                old = view.turned_picture(before.grey, turn)
            if gain != 1.0:
                old = np.asarray(cv2.convertScaleAbs(old, alpha=gain), dtype=np.uint8)
            guess = view.points_from_bearings(predicted[index])
            start = guess if render else view.points_from_bearings(points.bearings[index])
            start = view.nearest_turn(start, guess)
            end, missed_px[index] = follow_there_and_back(
                old,
                new,
                start.astype(np.float32),
                self._window_px,
                self._levels,
                guess.astype(np.float32),
            )
            bearings[index] = view.bearings_from_points(end)
        kept = (missed_px <= self._forward_backward_px) & self._is_usable(bearings)
        return _Points(points.ids, bearings, points.age + 1, missed_px).chosen(kept)

    def _is_usable(self, bearings: Array) -> Mask:
        """Which bearings lie in the image and on the mask."""
        pixels = self.camera.pixels_from_bearings(bearings)
        usable: Mask = np.isfinite(pixels).all(axis=1)
        columns, rows = pixels[usable].astype(np.intp).T
        columns = np.minimum(columns, self.camera.width - 1)
        rows = np.minimum(rows, self.camera.height - 1)
        usable[usable] = self._usable[rows, columns]
        return usable

    def _thinned(self, points: _Points) -> _Points:
        """Points without the younger of two that came close to each other."""
        near = _near(points.bearings, points.bearings, self._chord / 2)
        # The ids ascend, so that row i is crowded out by the older points before it.
        return points.chosen(~np.tril(near, -1).any(axis=1))

    def _replenished(self, now: _Seen) -> _Points:
        """Points and the strongest new corners in the cells that hold none."""
        points = self._points
        wanted = self._max_points - len(points.ids)
        bearings, strengths = self._corners(now)
        far = ~_near(bearings, points.bearings, self._chord).any(axis=1)
        bearings, strengths = bearings[far], strengths[far]
        chosen = self._chosen(bearings, strengths, points.bearings, wanted)
        count = len(chosen)
        ids = self._next_id + np.arange(count)
        self._next_id += count
        return _Points(
            np.concatenate([points.ids, ids]),
            np.concatenate([points.bearings, bearings[chosen]]),
            np.concatenate([points.age, np.zeros(count, np.int64)]),
            np.concatenate([points.error, np.zeros(count)]),
        )

    def _chosen(
        self, bearings: Array, strengths: Array, taken: Array, wanted: int
    ) -> NDArray[np.intp]:
        """The best corner of each empty cell, strongest first, as many as are wanted."""
        order = np.argsort(-strengths, kind="stable")
        cells = self._cells.indices(bearings[order])
        _, first = np.unique(cells, return_index=True)
        empty = ~np.isin(cells[first], self._cells.indices(taken))
        return order[np.sort(first[empty])][: max(0, wanted)]

    def _corners(self, now: _Seen) -> tuple[Array, Array]:
        """Bearings and strengths of all corners that the frame shows."""
        bearings, strengths = [np.empty((0, 3))], [np.empty(0)]
        for view, picture, usable in zip(self._views, now.pictures, self._searched, strict=True):
            points, strength = _corners_of_tiles(picture, usable, self._quality_level)
            found = view.bearings_from_points(points)
            own = view.owns(found)
            bearings.append(found[own])
            strengths.append(strength[own])
        return np.concatenate(bearings), np.concatenate(strengths)


def _corners_of_tiles(
    picture: Picture, usable: Picture, quality_level: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    height, width = picture.shape
    points, strengths = [np.empty((0, 2), np.float32)], [np.empty(0, np.float32)]
    for top in range(0, height, _TILE_PX):
        for left in range(0, width, _TILE_PX):
            tile = np.s_[top : top + _TILE_PX, left : left + _TILE_PX]
            found, strength = find_corners(picture[tile], usable[tile], quality_level)
            strong = strength > _LEAST_STRENGTH
            points.append(found[strong] + np.float32([left, top]))
            strengths.append(strength[strong])
    return np.concatenate(points), np.concatenate(strengths)


def _near(bearings1: Array, bearings2: Array, chord: float) -> Mask:
    """Which pairs (N, M) of unit vectors are closer than a chord."""
    # A chord of a tenth of a degree still leaves ten digits of the cosine's difference from 1.
    near: Mask = bearings1 @ bearings2.T > 1 - chord**2 / 2
    return near


def _exposure_gain(before: Array, now: Array) -> float:
    """By which factor the frame is brighter than the one before; 1 for small changes."""
    mean_before, mean_now = before.mean(), now.mean()
    if min(mean_before, mean_now) < _DARK or abs(mean_now / mean_before - 1) < 0.02:
        return 1.0
    return float(mean_now / mean_before)
