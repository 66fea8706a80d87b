# SPDX-License-Identifier: BSD-3-Clause
"""Small charts of a pair as SVG that takes its colours from the page."""

import numpy as np
from numpy.typing import NDArray

from epi360.report.svg_axes import Axes, chart

Array = NDArray[np.float64]

_BINS = 40
_GATES_SHOWN = 3.0  # the histogram ends at so many times the gate
_BANDS = np.arange(-90.0, 91.0, 15.0)
_MAX_DOTS = 1500


def residual_histogram(
    residuals_deg: Array, inlier_mask: NDArray[np.bool_], gate_deg: float
) -> str:
    """Return counts of the residuals, matches that agree below and the others above them."""
    size = np.abs(residuals_deg)
    known = np.isfinite(size)
    if not known.any():
        return ""
    top = _GATES_SHOWN * gate_deg if np.isfinite(gate_deg) else float(size[known].max())
    edges = np.linspace(0.0, max(top, 1e-6), _BINS + 1)
    agree = np.histogram(size[known & inlier_mask], edges)[0]
    others = np.histogram(size[known & ~inlier_mask], edges)[0]
    axes = Axes(edges[-1], 1.08 * max(int((agree + others).max()), 1))
    parts = [axes.frame("residual (degrees)", "matches")]
    for i, (below, above) in enumerate(zip(agree, others, strict=True)):
        parts.append(axes.bar(edges[i], edges[i + 1], 0, int(below), "good"))
        parts.append(axes.bar(edges[i], edges[i + 1], int(below), int(below + above), "poor"))
    if np.isfinite(gate_deg):
        parts.append(axes.vertical(gate_deg, "gate"))
    return chart(parts, "Histogram of the residuals")


def residuals_by_latitude(latitudes_deg: Array, residuals_deg: Array) -> str:
    """Return residuals over the latitude in view 1, with the median of each 15 degrees."""
    size = np.abs(residuals_deg)
    known = np.isfinite(size) & np.isfinite(latitudes_deg)
    if not known.any():
        return ""
    latitudes, size = latitudes_deg[known], size[known]
    axes = Axes(90.0, 1.08 * float(size.max()) or 1.0, x_min=-90.0)
    parts = [axes.frame("latitude in view 1 (degrees, up is positive)", "residual (degrees)")]
    step = -(-len(size) // _MAX_DOTS)
    dots = "".join(
        f"M{axes.x(x):.1f} {axes.y(y):.1f}h.01"
        for x, y in zip(latitudes[::step], size[::step], strict=True)
    )
    parts.append(f'<path class="dots" d="{dots}"/>')
    for low, high in zip(_BANDS[:-1], _BANDS[1:], strict=True):
        inside = (latitudes >= low) & (latitudes < high)
        if inside.any():
            median = float(np.median(size[inside]))
            y = axes.y(median)
            title = (
                f"{inside.sum()} matches between {low:.0f}° and {high:.0f}°: median {median:.3f}°"
            )
            parts.append(
                f'<path class="median" d="M{axes.x(low):.1f} {y:.1f}H{axes.x(high):.1f}">'
                f"<title>{title}</title></path>"
            )
    return chart(parts, "Residuals by latitude")
