# SPDX-License-Identifier: BSD-3-Clause
"""The paper's normalisation of a pair: the ovoid, and the cost over S and K as map and surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar import SkCost, search_sk
from epi360.report.html_page import packed
from epi360.report.svg_axes import Axes, chart

Array = NDArray[np.float64]

_RATIOS = np.linspace(-3.0, 3.0, 49)  # ln(K / S)
_FEWEST_MATCHES = 8
_MAP_STEPS = 21


@dataclass(frozen=True, eq=False)
class SkSearch:
    """Where the search for S and K ended, and the cost at the ratios of `_RATIOS`."""

    S: float
    K: float
    costs: Array

    @property
    def ranks(self) -> Array:
        """Place of each cost among all, from 0 to 1."""
        # Colours go by rank: next to the highest costs, all others would look the same.
        return np.asarray(np.argsort(np.argsort(self.costs)) / (len(self.costs) - 1.0))

    @property
    def found(self) -> float:
        """Best logarithm of K / S, within what is drawn."""
        return float(np.clip(np.log(self.K / self.S), _RATIOS[0], _RATIOS[-1]))

    def record(self) -> dict[str, Any]:
        """Return what `showSurfaceIn` of the scripts draws."""
        logarithms = np.log(np.maximum(self.costs, 1e-300))
        spread = float(np.ptp(logarithms)) or 1.0
        return {
            "ratios": packed(_RATIOS),
            "heights": packed((logarithms - logarithms.min()) / spread),
            "colours": packed([_linear(_heat_colour(float(rank))) for rank in self.ranks]),
            "found": self.found,
        }

    def html(self) -> str:
        """Return the section: sphere, ovoid, and the map that the surface takes the place of."""
        largest = max(self.S, self.K)
        scales = f"{self.S / largest:.5f},{self.S / largest:.5f},{self.K / largest:.5f}"
        rise = 100.0 * (float(self.costs.max() / self.costs.min()) - 1.0)
        return (
            "<h2>The paper's normalisation</h2><p>Robust 360-8PA stretches the sphere to an ovoid "
            "by N = diag(S, S, K) before the eight-point solution. The essential matrix depends on "
            f"K / S alone; for these matches the best value is {self.K / self.S:.3g}.</p>"
            '<div class="columns three"><figure>'
            '<canvas class="ball ovoid" data-scales="1,1,1"></canvas>'
            "<figcaption>Before: the matches that agree on the unit sphere of view 1.</figcaption>"
            f'</figure><figure><canvas class="ball ovoid" data-scales="{scales}"></canvas>'
            "<figcaption>After: the same directions times N, at the same largest extent."
            f'</figcaption></figure><figure><div class="surface">{self._map()}</div><figcaption>'
            "The paper's cost (eq. 14, the sum of the residuals) over S and K, coloured by rank: "
            f"dark is low. Its highest value here is {_percent(rise)} above the lowest, however "
            "steep it looks. The red line of the surface, or the ring of the flat map, marks the "
            "minimum that was found: where K / S is constant, the cost is too."
            "</figcaption></figure></div>"
        )

    def _map(self) -> str:
        reach = float(_RATIOS[-1]) / 2.0  # of ln S and of ln K
        grid = np.linspace(-reach, reach, _MAP_STEPS)
        half = (grid[1] - grid[0]) / 2.0
        axes = Axes(reach + half, reach + half, x_min=-reach - half, y_min=-reach - half)
        parts = [axes.frame("ln S", "ln K")]
        for x in grid:
            for y in grid:
                height = float(np.interp(y - x, _RATIOS, self.ranks))
                left, top = axes.x(x - half), axes.y(y + half)
                right, bottom = axes.x(x + half), axes.y(y - half)
                parts.append(
                    f'<rect x="{left:.1f}" y="{top:.1f}" width="{right - left + 0.6:.1f}" '
                    f'height="{bottom - top + 0.6:.1f}" fill="{_hex(_heat_colour(height))}"/>'
                )
        x, y = axes.x(-self.found / 2.0), axes.y(self.found / 2.0)
        parts.append(f'<circle class="found" cx="{x:.1f}" cy="{y:.1f}" r="6"/>')
        return chart(parts, "The paper's cost over S and K")


def search_of_pair(bearings1: Array, bearings2: Array) -> SkSearch | None:
    """Search for S and K; None where the matches do not determine the eight-point solution."""
    if len(bearings1) < _FEWEST_MATCHES:
        return None
    try:
        S, K, _, _ = search_sk(bearings1, bearings2)
    except ValueError:
        return None
    cost = SkCost(bearings1, bearings2)
    return SkSearch(S, K, np.array([cost.at(float(u)) for u in _RATIOS]))


def _percent(amount: float) -> str:
    return f"{amount:.2g} %" if amount < 100.0 else f"{amount:,.0f} %"


def _heat_colour(height: float) -> Array:
    """Return a colour from dark blue (low) to pale yellow (high) that also a grey print orders."""
    stops = np.array([[38, 34, 98], [30, 110, 140], [90, 180, 120], [250, 240, 170]], float)
    place = float(np.clip(height, 0.0, 1.0)) * (len(stops) - 1)
    i = min(int(place), len(stops) - 2)
    return np.asarray(stops[i] + (place - i) * (stops[i + 1] - stops[i]))


def _hex(colour: Array) -> str:
    red, green, blue = np.round(colour).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


def _linear(colour: Array) -> Array:
    """Return what WebGL takes for a colour of the screen."""
    return np.asarray((colour / 255.0) ** 2.2)
