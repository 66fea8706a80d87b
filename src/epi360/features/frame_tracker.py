# SPDX-License-Identifier: BSD-3-Clause
"""Points followed from frame to frame over the whole sphere, as odometry needs them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.cameras import Camera
from epi360.features.corner_search import CornerSearch
from epi360.features.images import ImageSource, read_image, read_mask
from epi360.features.lucas_kanade import follow_there_and_back
from epi360.features.patches import Patches, align_patches, no_patches, take_patches
from epi360.features.sphere_cells import even_directions
from epi360.features.tracking_views import tracking_views

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Picture = NDArray[np.uint8]

_NUM_SAMPLES = 4000  # pixels, evenly over the sphere, of which brightness is measured
_SMALL_GAIN = 0.03  # changes of brightness that do no harm
_DARK = 4.0  # mean grey values below this are no exposure that one could make up for
_TURN_DEG = 4.0  # a larger predicted turn is rendered, because the windows do not turn
# A patch is looked for in every fifth frame. After 30 frames the median error in a rendered room is
# 0.40 px of 1024 (0.76 px without patches), and 85 % of the points are left (90 %).
_REFINE_EVERY = 5
_FARTHEST_REFINEMENT_PX = 1.5
_UNLIKE = 0.4  # a patch that looks more different is taken anew where Lucas-Kanade is
_OCCLUDED = 0.6  # a point whose patch looks more different is lost


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
    patches: Patches

    def chosen(self, mask: Mask) -> _Points:
        return _Points(
            self.ids[mask],
            self.bearings[mask],
            self.age[mask],
            self.error[mask],
            self.patches[mask],
        )


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
        Weakest new corner, relative to the strongest one of the frame.
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
        quality_level: float = 0.01,
        forward_backward_px: float = 0.5,
        window_px: int = 11,
        pyramid_levels: int = 3,
    ) -> None:
        for name, value, least in (
            ("max_points", max_points, 1),
            ("window_px", window_px, 3),
            ("pyramid_levels", pyramid_levels, 0),
        ):
            if value < least:
                raise ValueError(f"{name} must be at least {least}, got {value}")
        for name, number in (
            ("quality_level", quality_level),
            ("forward_backward_px", forward_backward_px),
        ):
            if not number > 0:
                raise ValueError(f"{name} must be positive, got {number}")
        if not 0 < min_distance_deg < 90:
            raise ValueError(f"min_distance_deg must be in (0, 90), got {min_distance_deg}")
        self.camera = camera
        self._max_points = max_points
        self._forward_backward_px = forward_backward_px
        self._window_px = window_px
        self._levels = pyramid_levels
        self._usable = camera.field_of_view_mask()
        if mask is not None:
            self._usable = self._usable & read_mask(mask, (camera.height, camera.width))
        self._views = tracking_views(camera, self._usable)
        self._sample_pixels, share = self._even_pixels()
        self._sample_bearings = camera.bearings_from_pixels(self._sample_pixels.T + 0.5)
        self._search = CornerSearch(
            self._views,
            max_points / share,
            float(np.radians(min_distance_deg)),
            quality_level,
            window_px,
        )
        none = np.empty(0, np.int64)
        self._points = _Points(none, np.empty((0, 3)), none, np.empty(0), no_patches(0))
        self._num_frames = 0
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
            raise ValueError(f"rotation must be finite, of shape (3, 3), got {turn.tolist()}")
        now = self._seen(self._grey(image))
        before = self._previous
        if before is not None:
            self._points = self._followed(before, now, turn)
            self._points = self._refined(now)
            self._points = self._points.chosen(self._search.thinned(self._points.bearings))
        self._points = self._replenished(now)
        self._num_frames += 1
        self._previous = now
        return self._frame(before, now)

    def begin_anew(self, ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Give all points of the last frame new identities; returns those of ``ids``.

        Where a frame shows another place than the one before, they are not the same points.
        """
        rows = np.searchsorted(self._points.ids, ids)
        fresh = self.new_identities(len(self._points.ids))
        self._points = replace(self._points, ids=fresh)
        return np.asarray(fresh[rows])

    def new_identities(self, count: int) -> NDArray[np.int64]:
        """Return identities that no point has or will get."""
        fresh = np.arange(self._next_id, self._next_id + count)
        self._next_id += count
        return fresh

    def _frame(self, before: _Seen | None, now: _Seen) -> TrackedFrame:
        points = self._points
        change = np.nan if before is None else np.median(np.abs(now.samples - before.samples))
        return TrackedFrame(
            ids=points.ids,
            pixels=self.camera.pixels_from_bearings(points.bearings),
            bearings=points.bearings.copy(),
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
        gain = self._exposure_gain(before, now, turn)
        for view, old, new in zip(self._views, before.pictures, now.pictures, strict=True):
            guess = view.points_from_bearings(predicted)
            index = np.flatnonzero(view.owns(predicted) & np.isfinite(guess).all(axis=1))
            if len(index) == 0:
                continue
            guess = guess[index]
            if render:
                old = view.turned_picture(before.grey, turn)
            if gain != 1.0:
                old = np.asarray(cv2.convertScaleAbs(old, alpha=gain), dtype=np.uint8)
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
        near = missed_px <= self._forward_backward_px
        followed = _Points(points.ids, bearings, points.age + 1, missed_px, points.patches)
        return followed.chosen(self._is_usable(bearings) & near)

    def _exposure_gain(self, before: _Seen, now: _Seen, turn: Array) -> float:
        """By which factor what both frames show is brighter now; 1 for small changes."""
        mean_before, mean_now = before.samples.mean(), now.samples.mean()
        if min(mean_before, mean_now) < _DARK:
            return 1.0
        if abs(mean_now / mean_before - 1) >= _SMALL_GAIN and not np.array_equal(turn, np.eye(3)):
            # What left a field of view with the turn must not count.
            pixels = self.camera.pixels_from_bearings(self._sample_bearings @ turn)
            columns, rows = pixels.T
            shown = np.isfinite(columns)
            inside = np.floor([columns[shown], rows[shown]]).astype(np.intp)
            columns, rows = np.minimum(inside, [[self.camera.width - 1], [self.camera.height - 1]])
            if shown.any():
                mean_before, mean_now = before.grey[rows, columns].mean(), now.samples[shown].mean()
        gain = float(mean_now / max(mean_before, 1.0))
        return 1.0 if abs(gain - 1) < _SMALL_GAIN else gain

    def _is_usable(self, bearings: Array) -> Mask:
        """Which bearings lie in the image and on the mask."""
        pixels = self.camera.pixels_from_bearings(bearings)
        usable: Mask = np.asarray(np.isfinite(pixels[:, 0]))
        columns, rows = pixels[usable].astype(np.intp).T
        columns = np.minimum(columns, self.camera.width - 1)
        rows = np.minimum(rows, self.camera.height - 1)
        usable[usable] = self._usable[rows, columns]
        return usable

    def _refined(self, now: _Seen) -> _Points:
        """Points of which some are moved to where the patches first taken of them fit best."""
        points = self._points
        due = (points.ids + self._num_frames) % _REFINE_EVERY == 0
        bearings, patches, hidden = points.bearings.copy(), points.patches, np.zeros(len(due), bool)
        for number, view in enumerate(self._views):
            index = np.flatnonzero(due & view.owns(bearings))
            if len(index) == 0:
                continue
            picture = now.pictures[number].astype(np.float32)
            start = view.points_from_bearings(bearings[index]).astype(np.float32)
            places, shapes, unlike = align_patches(picture, patches[index], start)
            here = patches.views[index] == number
            near = np.hypot(*(places - start).T) <= _FARTHEST_REFINEMENT_PX
            found = here & near & (unlike < _UNLIKE)
            patches.shapes[index[found]] = shapes[found]
            bearings[index[found]] = view.bearings_from_points(places[found])
            patches[index[~found]] = take_patches(picture, start[~found], number)
            hidden[index] = here & np.isfinite(unlike) & (unlike > _OCCLUDED)
        return replace(points, bearings=bearings).chosen(~hidden & self._is_usable(bearings))

    def _replenished(self, now: _Seen) -> _Points:
        """Points and the strongest new corners in the cells that hold few."""
        points = self._points
        wanted = self._max_points - len(points.ids)
        bearings = self._search.new_bearings(now.pictures, points.bearings, wanted)
        count = len(bearings)
        ids = np.arange(self._next_id, self._next_id + count)
        self._next_id += count
        return _Points(
            np.concatenate([points.ids, ids]),
            np.concatenate([points.bearings, bearings]),
            np.concatenate([points.age, np.zeros(count, np.int64)]),
            np.concatenate([points.error, np.zeros(count)]),
            points.patches.joined(self._patches(now, bearings)),
        )

    def _patches(self, now: _Seen, bearings: Array) -> Patches:
        patches = no_patches(len(bearings))
        for number, view in enumerate(self._views):
            own = view.owns(bearings)
            if own.any():
                places = view.points_from_bearings(bearings[own]).astype(np.float32)
                picture = now.pictures[number].astype(np.float32)
                patches[own] = take_patches(picture, places, number)
        return patches
