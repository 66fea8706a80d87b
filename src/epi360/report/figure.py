# SPDX-License-Identifier: BSD-3-Clause
"""One picture of an image pair: matches, epipoles and epipolar great circles."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.estimation.result import ImagePairResult, pose_sigmas_deg
from epi360.features.picture_writing import encode_figure
from epi360.report.curves import (
    cameras_of_pose,
    epipolar_curve,
    shown_residuals_deg,
    spread_matches,
)
from epi360.report.files import check_figure_name, check_writable
from epi360.report.text import (
    CONVENTION,
    STATUS_SENTENCES,
    describe_direction,
    describe_explanations,
    rotation_axis_angle,
)
from epi360.runs.whole_files import PathLike, write_file

Array = NDArray[np.float64]

MAX_IMAGE_WIDTH = 2048
MAX_DRAWN_MATCHES = 4000  # of each kind: more only cover each other and slow the drawing
NUM_CURVES = 8
# Hues that stay apart on grey, also for most colour-blind readers (Okabe & Ito 2008, brightened).
CURVE_COLOURS = (
    "#ff4b33", "#33b5ff", "#ffd21f", "#ff7ad9", "#00d69a", "#ff9c1a", "#b79aff", "#d8ff3e",
)  # fmt: skip
RESIDUAL_COLOURS = "cool"  # bright at both ends: the images under it are grey and dark
DPI = 100
# Inches: the whole width, then the strips around the images.
WIDTH_IN, MARGIN_IN, COLOUR_BAR_IN = 14.0, 0.12, 1.0
TEXT_COLUMNS = 165  # that fit below the title
TITLE_IN, LABEL_IN, LEGEND_IN = 0.86, 0.28, 0.34
STROKE = [withStroke(linewidth=3.0, foreground="black")]
EPIPOLE_STYLES: tuple[dict[str, Any], ...] = (
    {"marker": "*", "markersize": 20, "markerfacecolor": "white", "markeredgecolor": "black"},
    {"marker": "o", "markersize": 11, "markerfacecolor": "none", "markeredgecolor": "white",
     "markeredgewidth": 2.2},
)  # fmt: skip


@dataclass(frozen=True)
class _View:
    name: str
    other: str
    image: NDArray[np.uint8]
    camera: Camera
    keypoints: Array
    bearings: Array
    curve_normals: Array
    epipole: Array


def draw_pair(
    image1: NDArray[np.uint8],
    image2: NDArray[np.uint8],
    camera1: Camera,
    camera2: Camera,
    result: ImagePairResult,
    path: PathLike | None = None,
) -> Figure:
    """Both images with the matches, the epipoles and some epipolar great circles.

    Inliers are coloured by residual, outliers are faint crosses. A few inliers are numbered;
    the curve of the same colour in the other image is where each must lie. Without a translation
    (pure rotation, failure) there are no curves and the title says why. The figure is independent
    of pyplot, so that it needs no closing.

    Parameters
    ----------
    image1, image2 : ndarray, shape (H, W, 3), uint8
        RGB images of the size of their cameras.
    camera1, camera2, result
        Cameras of the images, and the estimate of any status with key points in their pixels.
    path : str or path, optional
        Where to write the picture, 1400 px wide; the extension names the format.

    Raises
    ------
    ValueError
        If an image is not of its camera's size, or `path` cannot be written.
    """
    for name, image, camera in (("image1", image1, camera1), ("image2", image2, camera2)):
        if image.shape != (camera.height, camera.width, 3):
            size = (camera.height, camera.width, 3)
            raise ValueError(f"{name} must have the shape {size} of its camera, got {image.shape}")
    if path is not None:
        check_figure_name(path)
        check_writable(path)
    cameras = cameras_of_pose(result, (camera1, camera2))
    views = _views((image1, image2), cameras, result)
    residuals_deg = shown_residuals_deg(result)
    figure, axes, colour_bar_axes = _layout(views)
    points = None
    for view, view_axes in zip(views, axes, strict=True):
        _draw_image(view_axes, view)
        points = _draw_matches(view_axes, view, result.inlier_mask, residuals_deg)
    _draw_curves(axes, views, result)
    _draw_epipoles(axes, views)
    _draw_colour_bar(figure, colour_bar_axes, points)
    _draw_title_and_legend(figure, result)
    if path is not None:
        suffix = Path(path).suffix.lower().removeprefix(".")
        # Level 1 instead of 6 halves the time of a PNG for a tenth more bytes.
        options = {"pil_kwargs": {"compress_level": 1}} if suffix == "png" else {}
        write_file(path, encode_figure(figure, suffix, dpi=DPI, **options))
    return figure


def _views(
    images: Sequence[NDArray[np.uint8]], cameras: Sequence[Camera], result: ImagePairResult
) -> tuple[_View, _View]:
    pose = result.cam2_from_cam1
    bearings1 = cameras[0].bearings_from_pixels(result.keypoints1)
    bearings2 = cameras[1].bearings_from_pixels(result.keypoints2)
    # b2^T E b1 = 0: E b1 is the normal of match i's epipolar plane in frame 2, E^T b2 in frame 1.
    # The other camera's centre is -R^T t in frame 1 and t in frame 2.
    return (
        _View(
            "view 1", "camera 2", images[0], cameras[0], result.keypoints1, bearings1,
            bearings2 @ result.E, -pose.rotation.T @ pose.translation,
        ),
        _View(
            "view 2", "camera 1", images[1], cameras[1], result.keypoints2, bearings2,
            bearings1 @ result.E.T, pose.translation,
        ),
    )  # fmt: skip


def _layout(views: Sequence[_View]) -> tuple[Figure, list[Axes], Axes]:
    """Figure with the two images stacked if they are panoramas, else beside each other."""
    aspects = [view.camera.width / view.camera.height for view in views]
    stacked = min(aspects) >= 1.9
    room = WIDTH_IN - MARGIN_IN - COLOUR_BAR_IN
    width = room if stacked else (room - MARGIN_IN) / 2
    heights = [width / aspect for aspect in aspects]
    body = sum(heights) + 2 * LABEL_IN if stacked else max(heights) + LABEL_IN
    height = TITLE_IN + body + LEGEND_IN
    figure = Figure(figsize=(WIDTH_IN, height), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)

    def add(left: float, top: float, box_width: float, box_height: float) -> Axes:
        bottom = height - top - box_height
        box = (left / WIDTH_IN, bottom / height, box_width / WIDTH_IN, box_height / height)
        return figure.add_axes(box)

    top1 = TITLE_IN + LABEL_IN
    top2 = top1 + heights[0] + LABEL_IN if stacked else top1
    left2 = MARGIN_IN if stacked else 2 * MARGIN_IN + width
    axes = [add(MARGIN_IN, top1, width, heights[0]), add(left2, top2, width, heights[1])]
    return figure, axes, add(MARGIN_IN + room + 0.12, top1, 0.16, body - LABEL_IN)


def _draw_image(axes: Axes, view: _View) -> None:
    """Image almost in grey, so that colour belongs to the matches; axes in its pixels."""
    width, height = view.camera.width, view.camera.height
    image = view.image
    if width > MAX_IMAGE_WIDTH:
        size = (MAX_IMAGE_WIDTH, max(1, round(height * MAX_IMAGE_WIDTH / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    faded = cv2.addWeighted(image, 0.3, cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), 0.5, 0.0)
    axes.imshow(faded, extent=(0, width, height, 0), aspect="auto", interpolation="antialiased")
    axes.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    axes.set_title(view.name, loc="left", fontsize=11, pad=4, fontweight="bold")


def _draw_matches(
    axes: Axes, view: _View, inlier_mask: NDArray[np.bool_], residuals_deg: Array
) -> PathCollection | None:
    """Outliers as faint crosses, inliers coloured by residual, the worst on top."""
    outliers = _thinned(np.flatnonzero(~inlier_mask))
    x, y = view.keypoints[outliers].T
    axes.scatter(x, y, marker="x", s=14, c="#ff9980", linewidths=0.8, alpha=0.5)
    inliers = _thinned(np.flatnonzero(inlier_mask))
    if not len(inliers):
        return None
    size = np.abs(residuals_deg[inliers])
    order = np.argsort(size)
    x, y = view.keypoints[inliers[order]].T
    style: dict[str, Any] = {
        "s": float(np.clip(9000.0 / len(order), 6.0, 18.0)),  # smaller where there are thousands
        "linewidths": 0.4,
        "edgecolors": "black",
    }
    if not np.isfinite(size).any():  # without a pose
        axes.scatter(x, y, color=mpl.colormaps[RESIDUAL_COLOURS](0.3), **style)
        return None
    limit = float(np.nanpercentile(size, 98))
    return axes.scatter(
        x, y, c=size[order], cmap=RESIDUAL_COLOURS, vmin=0.0, vmax=max(limit, 1e-6), **style
    )


def _draw_curves(axes: Sequence[Axes], views: Sequence[_View], result: ImagePairResult) -> None:
    chosen = spread_matches(
        views[0].bearings, views[0].curve_normals, result.inlier_mask, NUM_CURVES
    )
    for number, (index, colour) in enumerate(zip(chosen, CURVE_COLOURS, strict=False), start=1):
        for view_axes, view in zip(axes, views, strict=True):
            if np.isfinite(view.curve_normals[index]).all():
                curve = epipolar_curve(view.camera, view.curve_normals[index], view.bearings[index])
                view_axes.plot(*curve.T, color=colour, linewidth=1.3, alpha=0.9, zorder=3)
            x, y = view.keypoints[index]
            view_axes.plot(
                x, y, "o", markersize=9, markerfacecolor="none", markeredgecolor=colour,
                markeredgewidth=2.0, zorder=5, path_effects=STROKE,
            )  # fmt: skip
            right = x < 0.97 * view.camera.width
            view_axes.annotate(
                str(number), (x, y), xytext=(8 if right else -8, 5), textcoords="offset points",
                ha="left" if right else "right", color=colour, fontsize=12, fontweight="bold",
                path_effects=STROKE, zorder=6,
            )  # fmt: skip


def _draw_epipoles(axes: Sequence[Axes], views: Sequence[_View]) -> None:
    """Where the other camera stands (star) and the point opposite to it (ring)."""
    for view_axes, view in zip(axes, views, strict=True):
        if not np.isfinite(view.epipole).all():
            continue
        pixels = view.camera.pixels_from_bearings(np.stack([view.epipole, -view.epipole]))
        for pixel, style in zip(pixels, EPIPOLE_STYLES, strict=True):
            if ((pixel >= 0) & (pixel <= (view.camera.width, view.camera.height))).all():
                view_axes.plot(*pixel, zorder=7, clip_on=False, path_effects=STROKE, **style)
        where = describe_direction(view.epipole).replace(" deg", "°")
        view_axes.set_title(f"{view.other} is at {where}", loc="right", fontsize=10, pad=4)


def _draw_colour_bar(figure: Figure, axes: Axes, points: PathCollection | None) -> None:
    if points is None or not np.isfinite(np.asarray(points.get_array())).any():
        axes.set_axis_off()
        return
    colour_bar = figure.colorbar(points, cax=axes, extend="max", extendfrac=0.02)
    colour_bar.locator = MaxNLocator(6)
    colour_bar.set_label("residual of the inliers (degrees)", fontsize=10)
    colour_bar.ax.tick_params(labelsize=9)


def _draw_title_and_legend(figure: Figure, result: ImagePairResult) -> None:
    height = figure.get_figheight()
    title, detail = _title(result)
    place: dict[str, Any] = {"ha": "left", "va": "top", "x": MARGIN_IN / WIDTH_IN}
    figure.text(y=1 - 0.12 / height, s=title, fontsize=15, fontweight="bold", **place)
    figure.text(y=1 - 0.45 / height, s=detail, fontsize=10.5, color="#444444", **place)
    handles = _legend_handles(result)
    figure.legend(
        handles=handles, loc="lower left", ncols=len(handles), fontsize=10, frameon=False,
        bbox_to_anchor=(0.0, -0.02 / height), handletextpad=0.4, columnspacing=1.8,
    )  # fmt: skip


def _title(result: ImagePairResult) -> tuple[str, str]:
    pose = result.cam2_from_cam1
    axis, angle = rotation_axis_angle(pose.rotation)
    rotation_sigma, translation_sigma = pose_sigmas_deg(result)
    rotation = f"rotation {angle:.2f}°{_sigma(rotation_sigma)}"
    if np.isfinite(axis).all():
        rotation += " about ({:.2f}, {:.2f}, {:.2f})".format(*axis)
    translation = "t = ({:.3f}, {:.3f}, {:.3f})".format(*pose.translation)
    detail = f"{result.num_inliers} of {result.num_matches} matches are inliers"
    if np.isfinite(result.noise_deg):
        detail += f", noise {result.noise_deg:.3f}° per axis and view"
    title = f"{rotation},  {translation}{_sigma(translation_sigma)}"
    if result.success:
        return title, f"{detail};  {CONVENTION}"
    if result.status == "pure_rotation":
        title = f"{rotation}, no translation and so no epipoles"
    elif not np.isfinite(pose.translation).all():
        title = "no pose"
    explained = describe_explanations(result.explanations)
    why = STATUS_SENTENCES[result.status] + (f"; explained by {explained}" if explained else "")
    reason = textwrap.fill(f"{detail}; {why}", TEXT_COLUMNS)
    return f"{result.status}: {title}", reason


def _sigma(sigma_deg: float) -> str:
    return f" ± {sigma_deg:.2f}°" if np.isfinite(sigma_deg) else ""


def _legend_handles(result: ImagePairResult) -> list[Line2D]:
    has_pose = bool(np.isfinite(result.E).all())

    def handle(marker: str, label: str, **style: Any) -> Line2D:
        return Line2D([], [], linestyle="none", marker=marker, label=label, **style)

    dark = {"markeredgecolor": "black"}
    middle = mpl.colormaps[RESIDUAL_COLOURS](0.3)
    ring = {"markerfacecolor": "none", "markeredgewidth": 2.0}
    handles = [
        handle("o", "inlier", markerfacecolor=middle, markersize=5, **dark),
        handle("x", "outlier", markeredgecolor="#ff9980", markersize=5),
    ]
    if has_pose:
        handles += [
            handle(
                "*", "the other camera (epipole)", markerfacecolor="white", markersize=13, **dark
            ),
            handle("o", "opposite epipole", markersize=8, markeredgecolor="#777777", **ring),
        ]
    if result.num_inliers:
        match = "match with its epipolar great circle" if has_pose else "match"
        label = f"{match}, the same colour in both views"
        handles.append(handle("$1$", label, color=CURVE_COLOURS[0], markersize=7))
    return handles


def _thinned(indices: NDArray[np.intp]) -> NDArray[np.intp]:
    step = -(-len(indices) // MAX_DRAWN_MATCHES)
    return indices[:: max(1, step)]
