# SPDX-License-Identifier: BSD-3-Clause
"""The second tab: sliders, and what the paper's estimators make of them."""

import asyncio
import itertools
import json
import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from nicegui import background_tasks, ui

from epi360_demo.application import Demo
from epi360_demo.limits import RefusedError
from epi360_demo.paper_play import (
    METHODS,
    NUM_DRAWS,
    RANGES,
    Setting,
    draw_errors,
    look,
    medians,
    setting_from,
)

# Name, label, step, and how a value is written; those of S and K are logarithms to base 2.
_SLIDERS: tuple[tuple[str, str, float, Callable[[float], str]], ...] = (
    ("noise_deg", "Noise", 0.1, lambda value: f"{value:.1f}°{_kappa_words(value)}"),
    ("outlier_percent", "Wrong matches", 1, lambda value: f"{value:.0f} %"),
    ("num_points", "Points", 10, lambda value: f"{value:.0f}"),
    ("fov_deg", "Field of view", 5, lambda value: f"{value:.0f}°"),
    ("S", "S", 0.05, lambda value: f"{value:.2f}"),
    ("K", "K", 0.05, lambda value: f"{value:.2f}"),
    ("seed", "Another set of points", 1, lambda value: f"{value:.0f}"),
)
_LOGARITHMIC = ("S", "K")
_SECONDS_AT_REST = 0.2


class PaperTab:
    """The elements of the tab on one open page, and the setting that is worked on."""

    def __init__(self, demo: Demo) -> None:
        self._demo = demo
        self._values: dict[str, Any] = dict(vars(Setting()))
        self._sliders: dict[str, ui.slider] = {}
        self._wanted: Setting | None = None
        self._news = asyncio.Event()
        self._is_working = False
        self._found = 0.0

    def build(self) -> None:
        """Make the elements."""
        self._client = ui.context.client
        ui.html(_WORDS, sanitize=False)
        with ui.element("div").classes("paper"):
            with ui.element("div").classes("sliders"):
                for slider in _SLIDERS:
                    self._add_slider(*slider)
                with ui.element("div").classes("actions"):
                    ui.button("S = K = 1", on_click=lambda: self._set_ratio(0.0)).props("outline")
                    ui.button("Best S and K", on_click=lambda: self._set_ratio(self._found)).props(
                        "outline"
                    )
            ui.html(_pictures_html(), sanitize=False).classes("pictures-of-paper")
            ui.html(_errors_html(), sanitize=False).classes("errors-of-paper")

    def shown(self) -> None:
        """Draw: the tab is open now, and has a size."""
        self._ask()

    def _add_slider(
        self, name: str, label: str, step: float, written: Callable[[float], str]
    ) -> None:
        low, high = RANGES[name]
        value = self._values[name]
        if name in _LOGARITHMIC:
            low, high, value = math.log2(low), math.log2(high), math.log2(value)
        with ui.element("div").classes("slider"):
            with ui.element("div").classes("words"):
                ui.label(label)
                shown = ui.label(written(self._values[name])).classes("value")

            def changed(place: float) -> None:
                self._values[name] = 2.0**place if name in _LOGARITHMIC else place
                shown.set_text(written(self._values[name]))
                self._ask()

            slider = ui.slider(
                min=low, max=high, step=step, value=value,
                on_change=lambda event: changed(event.value),
            )  # fmt: skip
        self._sliders[name] = slider.props(f'aria-label="{label}" id="{name}"')

    def _set_ratio(self, logarithm: float) -> None:
        """Set S and K, whose product is 1, to a logarithm of K / S."""
        half = min(max(logarithm / math.log(2.0) / 2.0, -2.0), 2.0)
        self._sliders["S"].set_value(-half)
        self._sliders["K"].set_value(half)

    def _ask(self) -> None:
        """Work on the latest setting; those in between are left out."""
        try:
            self._wanted = setting_from(self._values)
        except RefusedError:
            return
        self._news.set()
        if not self._is_working:
            self._is_working = True
            background_tasks.create(self._work(), name="paper")

    async def _work(self) -> None:
        try:
            while self._wanted is not None and not self._client.is_deleted:
                setting, self._wanted = self._wanted, None
                self._news.clear()
                async with self._demo.looks:
                    record = await asyncio.to_thread(look, setting)
                self._found = record["found"]
                self._client.run_javascript(f"paper.show({json.dumps(record)})")
                if not await self._moves_on():
                    await self._add_medians(setting)
        finally:
            self._is_working = False

    async def _moves_on(self) -> bool:
        """Whether a slider moves again soon; the medians wait until none does."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._news.wait(), _SECONDS_AT_REST)
            return True
        return False

    async def _add_medians(self, setting: Setting) -> None:
        draws = []
        for draw in range(NUM_DRAWS):
            if self._wanted is not None or self._client.is_deleted:
                return
            async with self._demo.looks:
                draws.append(await asyncio.to_thread(draw_errors, setting, draw))
        rows = json.dumps(medians(draws))
        self._client.run_javascript(f"paper.showMedians({rows}, {NUM_DRAWS})")


_WORDS = (
    "<p>Points with known truth, seen by two cameras, and every estimator of <i>Robust 360-8PA</i> "
    "(Solarte et al., ICRA 2021) on the same matches; the last row is what epi360 does. Move the "
    "sliders. The bars are the errors for the points that are drawn, the marks the medians of "
    f"{NUM_DRAWS} such sets of points.</p>"
)


def _kappa_words(noise_deg: float) -> str:
    """The paper's measure of the same noise."""
    return f", κ = {1.0 / math.radians(noise_deg) ** 2:,.0f}" if noise_deg > 0 else ""


def _pictures_html() -> str:
    rows = "".join(
        f"<tr><th scope=row>{name}</th><td></td><td></td></tr>"
        for name in ("no normalisation", "your S and K", "best S and K")
    )
    return (
        '<figure><canvas class="ball"></canvas><figcaption>The bearings of view 1 on the sphere. '
        "Red: wrong matches. Drag to turn.</figcaption></figure>"
        '<figure><canvas class="ball"></canvas><figcaption>After N = diag(S, S, K), at the same '
        "largest extent: the ovoid.</figcaption></figure>"
        '<figure><canvas class="surface"></canvas><figcaption>The mean residual that S and K lead '
        "to (eq. 14), by rank; dark is low. White dot: your S and K. Dashed: the best K / S, on "
        "which alone it depends.</figcaption></figure>"
        '<table class="sigma8"><thead><tr><th></th><th>σ₈</th><th>σ₈ / σ₁</th></tr></thead>'
        f"<tbody>{rows}</tbody></table>"
    )


def _errors_html() -> str:
    parts = ['<div class="errors"><div class="heading"><span></span><span>Error of the rotation'
             "</span><span>Error of the direction</span></div>"]  # fmt: skip
    for group, methods in itertools.groupby(METHODS, key=lambda method: method.group):
        parts.append(f"<h3>{group}</h3>")
        bar = '<span class="bar"><i></i><s></s><b></b></span>'
        parts += [
            f'<div class="method"><span>{method.name}</span>{bar}{bar}</div>' for method in methods
        ]
    scale = "<span class='scale'><u>0.01°</u><u>0.1°</u><u>1°</u><u>10°</u><u>180°</u></span>"
    parts.append(f'<div class="heading"><span></span>{scale}{scale}</div></div>')
    return "".join(parts)
