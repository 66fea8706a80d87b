# SPDX-License-Identifier: BSD-3-Clause
"""Unit spheres and the ovoids that a normalisation makes of them, drawn without perspective."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import Normalize, to_rgba
from numpy.typing import ArrayLike, NDArray

from epi360_paper.plots import BLUE, GREEN, INK, LANDMARK, SOFT, STROKE, VERMILION

Array = NDArray[np.float64]

FACING, AVERTED = 3, 1  # layers: what faces the reader covers what is behind the ball


@dataclass(frozen=True)
class Eye:
    """Where a solid is looked at from, without perspective."""

    # Turn of the line of sight about the vertical: 0 looks along +z, negative from the right.
    azimuth_deg: float = -38.0
    elevation_deg: float = 18.0  # how far the eye looks down

    @property
    def axes(self) -> Array:
        """Rows: the reader's right, down and forward in the camera frame, shape (3, 3)."""
        a, e = np.radians([self.azimuth_deg, self.elevation_deg])
        forward = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        right = np.array([np.cos(a), 0.0, -np.sin(a)])
        return np.stack([right, np.cross(forward, right), forward])

    def project(self, points: Array) -> tuple[Array, Array]:
        """Coordinates on paper, y up, and the depth behind it."""
        seen = points @ self.axes.T
        return seen[..., :2] * (1.0, -1.0), seen[..., 2]


def draw_ovoid(
    axes: Axes,
    bearings: Array,
    normalizer: Array | None = None,
    *,
    colours: Any = LANDMARK,
    norm: Normalize | None = None,
    cmap: str | None = None,
    eye: Eye | None = None,
    center: ArrayLike = (0.0, 0.0, 0.0),
    extent: float | None = 1.3,
    area: float = 26.0,
    axis_length: float = 0.22,
) -> PathCollection:
    """Draw the unit sphere deformed by N with the bearings N q on it (paper eq. 5)."""
    eye = eye or Eye()
    N = np.eye(3) if normalizer is None else normalizer
    place = np.asarray(center, dtype=np.float64)
    axes.set_aspect("equal", anchor="N")
    axes.set_axis_off()
    if extent is not None:
        axes.set(xlim=(-extent, extent), ylim=(-1.04 * extent, 0.96 * extent))  # y points down
    _draw_surface(axes, N, place, eye)
    _draw_frame(axes, N, place, eye, axis_length)
    paper, _ = eye.project(bearings @ N.T + place)
    facing = _faces_reader(bearings, N, eye)
    style: dict[str, Any] = {} if norm is None else {"norm": norm, "cmap": cmap}
    per_point = not isinstance(colours, str) and np.shape(colours)[:1] == (len(bearings),)

    def scatter(mask: NDArray[np.bool_], **more: Any) -> PathCollection:
        chosen = np.asarray(colours)[mask] if per_point else colours
        x, y = paper[mask].T
        return axes.scatter(x, y, c=chosen, **style, **more)

    scatter(~facing, s=0.45 * area, alpha=0.35, linewidths=0.0, zorder=AVERTED)
    return scatter(facing, s=area, linewidths=0.5, edgecolors=INK, zorder=FACING + 1)


def _faces_reader(bearings: Array, N: Array, eye: Eye) -> NDArray[np.bool_]:
    """Whether the surface N q turns to the reader; its normal there is along N^-T q."""
    return np.asarray(bearings @ np.linalg.inv(N) @ eye.axes[2] <= 0.0)


def _draw_surface(axes: Axes, N: Array, center: Array, eye: Eye) -> None:
    outline_normal = np.linalg.solve(N, eye.axes[2])
    outline, _ = eye.project(great_circle(outline_normal) @ N.T + center)
    axes.fill(*outline.T, facecolor="#f4f6f8", edgecolor=SOFT, linewidth=1.2, zorder=0)
    for curve in _graticule():
        paper, _ = eye.project(curve @ N.T + center)
        middle = 0.5 * (curve[1:] + curve[:-1])
        facing = _faces_reader(middle, N, eye)
        segments = np.stack([paper[:-1], paper[1:]], axis=1)
        for mask, colour, layer in ((~facing, 0.28, AVERTED), (facing, 0.85, FACING)):
            lines = LineCollection(
                list(segments[mask]), colors=[to_rgba("#9aa4ae", colour)], linewidths=0.7,
                zorder=layer,
            )  # fmt: skip
            axes.add_collection(lines, autolim=False)


def _draw_frame(axes: Axes, N: Array, center: Array, eye: Eye, length: float) -> None:
    origin, _ = eye.project(center)
    scale = float(np.linalg.norm(N, axis=0).min())
    for name, direction, colour in zip("xyz", np.eye(3), (VERMILION, GREEN, BLUE), strict=True):
        surface = N @ direction
        outwards = length * scale * surface / np.linalg.norm(surface)
        inner, _ = eye.project(center + surface)
        tip, _ = eye.project(center + surface + outwards)
        label, _ = eye.project(center + surface + 1.55 * outwards)
        axes.plot(*np.stack([origin, inner]).T, color=colour, linewidth=1.0, alpha=0.5, zorder=2)
        axes.annotate(
            "", xy=tuple(tip), xytext=tuple(inner), zorder=FACING,
            arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.4,
                        "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        axes.text(
            label[0], label[1], name, color=colour, fontsize=11, fontstyle="italic", ha="center",
            va="center", zorder=FACING + 2, path_effects=STROKE,
        )  # fmt: skip


def great_circle(normal: Array) -> Array:
    """Unit vectors once around the great circle with a normal, shape (181, 3)."""
    unit = normal / np.linalg.norm(normal)
    first = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    first /= np.linalg.norm(first)
    angles = np.linspace(0.0, 2.0 * np.pi, 181)[:, None]
    return np.asarray(np.cos(angles) * first + np.sin(angles) * np.cross(unit, first))


def _graticule() -> list[Array]:
    """Meridians and parallels every 30 degrees about the vertical, as unit vectors."""
    long = np.radians(np.arange(-180, 181, 4))
    lat = np.radians(np.arange(-90, 91, 4.5))
    meridians = [_directions(np.full_like(lat, a), lat) for a in np.radians(range(-180, 180, 30))]
    parallels = [_directions(long, np.full_like(long, e)) for e in np.radians(range(-60, 61, 30))]
    return meridians + parallels


def _directions(longitude: Array, latitude: Array) -> Array:
    """Unit vectors of longitudes and latitudes (paper eq. 2)."""
    c = np.cos(latitude)
    return np.stack([c * np.sin(longitude), -np.sin(latitude), c * np.cos(longitude)], axis=-1)
