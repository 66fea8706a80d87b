# SPDX-License-Identifier: BSD-3-Clause
"""A map from above with the images that were localized in it, as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from epi360.interop import Reconstruction
from epi360.poses import Pose
from epi360.report.html_page import escaped

if TYPE_CHECKING:
    from epi360.jobs.localization import LocalizationResult

Array = NDArray[np.float64]

_WIDTH, _MARGIN, _HEIGHTS = 900.0, 34.0, (320.0, 760.0)
_MOST_POINTS, _MOST_CAMERAS = 6000, 2000
_NEAR = (2.0, 98.0)  # percentiles of the points that the plan takes in, beside all cameras
_LONGEST_BAR = 0.25  # of the width


def plan_of(model: Reconstruction, results: Mapping[str, LocalizationResult]) -> str:
    """Return the plan: points and cameras of the map, and a mark for each image with a pose."""
    mapped = [image.cam_from_world for image in model.images]
    placed = {name: each for name, each in results.items() if _has_pose(each)}
    axes = _plan_axes(mapped)
    points = model.points[:: max(1, -(-len(model.points) // _MOST_POINTS))] @ axes.T
    cameras = _centers(mapped[:: max(1, -(-len(mapped) // _MOST_CAMERAS))]) @ axes.T
    marks = _centers([each.cam_from_world for each in placed.values()]) @ axes.T
    page = _Page.around(points, np.concatenate([cameras, marks]))
    numbers = {name: number for number, name in enumerate(results)}
    drawn = [
        _mark(page, place, axes @ each.cam_from_world.rotation[2], each.status, numbers[name], name)
        for (name, each), place in zip(placed.items(), marks, strict=True)
    ]
    return (
        f'<svg class="plan" viewBox="0 0 {_WIDTH:.0f} {page.height:.0f}" role="img" '
        'aria-label="The map from above">'
        f'<path class="points" d="{_dots(page, points)}"/>'
        f'<path class="mapped" d="{_dots(page, cameras)}"/>{"".join(drawn)}{_bar(page)}</svg>'
    )


def _has_pose(result: LocalizationResult) -> bool:
    return bool(np.isfinite(result.cam_from_world.translation).all())


def _centers(poses: Sequence[Pose]) -> Array:
    return np.array([pose.inverse().translation for pose in poses]).reshape(-1, 3)


def _plan_axes(poses: Sequence[Pose]) -> Array:
    """Directions (2, 3) to the right and up the page, by where the cameras have down."""
    down = np.mean([pose.rotation[1] for pose in poses], axis=0)
    down /= max(float(np.linalg.norm(down)), 1e-12)
    across = np.array([1.0, 0.0, 0.0]) if abs(down[0]) < 0.9 else np.array([0.0, 0.0, 1.0])
    right = across - (across @ down) * down
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, down)])


class _Page:
    """Where places of the plan (N, 2) are on the page; up the plan is up the page."""

    def __init__(self, low: Array, high: Array) -> None:
        span = np.maximum(high - low, 1e-9 * max(float(np.abs(high).max()), 1.0))
        inner = _WIDTH - 2.0 * _MARGIN
        self.scale = float(min(inner / span[0], (_HEIGHTS[1] - 2.0 * _MARGIN) / span[1]))
        self.height = max(_HEIGHTS[0], float(span[1]) * self.scale + 2.0 * _MARGIN)
        self._middle = 0.5 * (low + high)

    @classmethod
    def around(cls, points: Array, cameras: Array) -> _Page:
        """A page for most of the points and all cameras."""
        ends = np.percentile(points, _NEAR, axis=0)
        places = np.concatenate([ends, cameras])
        return cls(places.min(axis=0), places.max(axis=0))

    def places(self, plan: Array) -> Array:
        """Return where places are drawn, downwards."""
        away = (np.atleast_2d(plan) - self._middle) * self.scale
        return np.asarray(np.array([_WIDTH, self.height]) / 2.0 + away * [1.0, -1.0])


def _dots(page: _Page, plan: Array) -> str:
    """Return a path of dots: lines without length whose ends are round."""
    places = page.places(plan)
    inside = ((places > 0.0) & (places < [_WIDTH, page.height])).all(axis=1)
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in places[inside])


def _mark(page: _Page, plan: Array, ahead: Array, status: str, number: int, name: str) -> str:
    """Return a dot with a nose in the viewing direction."""
    x, y = page.places(plan)[0]
    heading = np.degrees(np.arctan2(ahead[0], ahead[1]))
    nose = "" if np.hypot(*ahead) < 0.2 else '<path d="M-4.5 -5.5L0 -15L4.5 -5.5Z"/>'
    kind = "good" if status == "ok" else "doubtful"
    title = f"<title>{escaped(name)}: {escaped(status)}</title>"
    return (
        f'<g class="new {kind}" data-image="{number}" '
        f'transform="translate({x:.1f} {y:.1f}) rotate({heading:.0f})">{title}{nose}'
        '<circle r="6"/></g>'
    )


def _bar(page: _Page) -> str:
    """Return a bar of a round length in units of the map."""
    longest = _LONGEST_BAR * _WIDTH / page.scale
    power = 10.0 ** np.floor(np.log10(longest))
    lengths = [step * power for step in (1.0, 2.0, 5.0) if step * power <= longest]
    length = max(lengths, default=power)
    x, y = _MARGIN / 2.0, page.height - 12.0
    unit = "unit" if length == 1.0 else "units"
    return (
        f'<path class="bar" d="M{x} {y - 4}v4h{length * page.scale:.1f}v-4"/>'
        f'<text x="{x + 6}" y="{y - 6}">{length:g} {unit} of the map</text>'
    )
