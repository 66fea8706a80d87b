# SPDX-License-Identifier: BSD-3-Clause
"""Axes of a small SVG chart that takes its colours from the page."""

from collections.abc import Sequence

import numpy as np

_WIDTH, _HEIGHT = 560.0, 260.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 74.0, 14.0, 14.0, 44.0


class Axes:
    """Linear axes of one chart; with ``powers``, x is a logarithm to the base of ten."""

    def __init__(
        self,
        x_max: float,
        y_max: float,
        x_min: float = 0.0,
        y_min: float = 0.0,
        *,
        powers: bool = False,
    ) -> None:
        self._x, self._y, self._powers = (x_min, x_max), (y_min, y_max), powers

    def x(self, value: float) -> float:
        """Return the place across."""
        low, high = self._x
        return float(_LEFT + (value - low) / (high - low) * (_WIDTH - _LEFT - _RIGHT))

    def y(self, value: float) -> float:
        """Return the place down."""
        low, high = self._y
        room = _HEIGHT - _TOP - _BOTTOM
        return float(_HEIGHT - _BOTTOM - (value - low) / (high - low) * room)

    def bar(
        self, left: float, right: float, low: float, high: float, kind: str, title: str = ""
    ) -> str:
        """Return a bar; the pointer over it shows its title."""
        if high <= low:
            return ""
        x, y = self.x(left) + 0.5, self.y(high)
        return (
            f'<rect class="{kind}" x="{x:.1f}" y="{y:.1f}" width="{self.x(right) - x:.1f}" '
            f'height="{self.y(low) - y:.1f}">{f"<title>{title}</title>" if title else ""}</rect>'
        )

    def vertical(self, value: float, label: str) -> str:
        """Return a dashed line with a word beside it."""
        x = self.x(value)
        return (
            f'<path class="mark" d="M{x:.1f} {_TOP}V{_HEIGHT - _BOTTOM}"/>'
            f'<text x="{x + 5:.1f}" y="{_TOP + 11}">{label}</text>'
        )

    def frame(self, x_label: str, y_label: str) -> str:
        """Return the axes with their numbers and names."""
        floor, middle = _HEIGHT - _BOTTOM, (_TOP + _HEIGHT - _BOTTOM) / 2
        parts = [f'<path class="axis" d="M{_LEFT} {_TOP}V{floor}H{_WIDTH - _RIGHT}"/>']
        for value, text in (_power_ticks if self._powers else _round_ticks)(*self._x):
            parts.append(
                f'<text x="{self.x(value):.1f}" y="{floor + 16}" text-anchor="middle">{text}</text>'
            )
        for value, text in _round_ticks(*self._y):
            y = self.y(value)
            parts.append(f'<path class="grid" d="M{_LEFT} {y:.1f}H{_WIDTH - _RIGHT}"/>')
            parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
        parts.append(
            f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{_HEIGHT - 8}" '
            f'text-anchor="middle">{x_label}</text>'
            f'<text transform="translate(17 {middle}) rotate(-90)" text-anchor="middle">'
            f"{y_label}</text>"
        )
        return "".join(parts)


def _round_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Return about five round numbers and how they are written."""
    rough = (high - low) / 5.0
    power = 10.0 ** np.floor(np.log10(rough))
    steps = power * np.array([1.0, 2.0, 3.0, 5.0, 10.0])
    step = float(steps[np.searchsorted(steps, rough * 0.999)])
    first = int(np.ceil(low / step - 1e-9))
    last = int(np.floor(high / step + 1e-9))
    return [(i * step, f"{i * step + 0.0:g}") for i in range(first, last + 1)]


def _power_ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Return powers of ten between two logarithms; with few of them also twice and five times."""
    steps = (1, 2, 5) if high - low < 2.0 else (1,)
    values = [
        step * 10.0**power
        for power in range(int(np.floor(low)), int(np.ceil(high)) + 1)
        for step in steps
    ]
    ticks = [(float(np.log10(value)), f"{value:g}") for value in values]
    return [(place, text) for place, text in ticks if low - 1e-9 <= place <= high + 1e-9]


def chart(parts: Sequence[str], label: str) -> str:
    """Return a chart of its parts; the label is for who cannot see it."""
    return (
        f'<svg class="chart" viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" role="img" '
        f'aria-label="{label}">{"".join(parts)}</svg>'
    )
