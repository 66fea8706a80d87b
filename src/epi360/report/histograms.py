# SPDX-License-Identifier: BSD-3-Clause
"""Histograms of what is known of many pairs, those that are ok below the others."""

import numpy as np
from numpy.typing import NDArray

from epi360.report.svg_axes import Axes, chart

Array = NDArray[np.float64]

_BINS = 40
_TAIL = 0.5  # percent of the pairs at each end that the first and the last bar take in
_MOST_POWERS = 5.0  # of ten; exact matches have sigmas of nearly zero


def histogram(values: Array, is_ok: NDArray[np.bool_], label: str, *, powers: bool = False) -> str:
    """Return counts of the finite values; with ``powers``, over their logarithm."""
    known = np.isfinite(values) & (values > 0 if powers else True)
    if not known.any():
        return ""
    places = np.log10(values[known]) if powers else values[known]
    edges = _edges(places, powers=powers)
    places = np.clip(places, edges[0], edges[-1])
    ok = np.histogram(places[is_ok[known]], edges)[0]
    others = np.histogram(places[~is_ok[known]], edges)[0]
    axes = Axes(edges[-1], 1.08 * max(int((ok + others).max()), 1), x_min=edges[0], powers=powers)
    parts = [axes.frame(label, "pairs")]
    shown = 10.0**edges if powers else edges
    for i, (below, above) in enumerate(zip(ok.tolist(), others.tolist(), strict=True)):
        title = f"{shown[i]:.3g} to {shown[i + 1]:.3g}: {below} ok, {above} not ok"
        parts.append(axes.bar(edges[i], edges[i + 1], 0, below, "good", title))
        parts.append(axes.bar(edges[i], edges[i + 1], below, below + above, "poor", title))
    return chart(parts, f"Histogram of {label}")


def _edges(places: Array, *, powers: bool) -> Array:
    """Return the bins: nearly all values, and what is beyond them at the ends."""
    low, high = np.percentile(places, [_TAIL, 100.0 - _TAIL])
    if not powers:
        low = 0.0
        if np.all(places == np.round(places)):  # counts: bins of whole numbers
            step = max(1.0, np.ceil((high + 1.0) / _BINS))
            return np.arange(0.0, high + 2.0 * step, step)
    else:
        low = max(low, high - _MOST_POWERS)
    if not high - low > 1e-9:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, _BINS + 1)
