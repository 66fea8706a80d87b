# SPDX-License-Identifier: BSD-3-Clause
"""The elements with which a visitor says more about two pictures."""

from typing import Any

from nicegui import ui

from epi360_demo.pair_choices import (
    CAMERA_KINDS,
    FIELDS_OF_VIEW,
    LARGEST_NADIR_DEG,
    LARGEST_THRESHOLD_DEG,
    LARGEST_UPRIGHT_DEG,
    PairChoices,
    choices_from,
)

_LENS_HTML = (
    '<label class="slot lens" data-slot="lens"><input type="file" accept=".yaml,.yml,.json,.txt" '
    'aria-label="The calibration file"><span class="words" data-empty="Drop the calibration file '
    'here, or choose it">Drop the calibration file here, or choose it</span></label>'
    '<p class="soft">Kalibr, basalt, COLMAP, OpenSfM, or our own YAML.</p>'
)
_ACROSS = {
    "fisheye": "Across the shorter side; an equidistant lens",
    "flat": "Across the width of the picture",
}


class PairOptions:
    """Options under a fold; made where the page is being built."""

    def __init__(self) -> None:
        with ui.expansion("Options: camera, upright, mask, threshold").classes("options"):
            with ui.element("div").classes("fields"):
                self._add_camera()
                self._add_upright()
                self._nadir = _number(
                    "Mask at the bottom (degrees)", "Around straight down: a tripod",
                    value=0, min=0, max=LARGEST_NADIR_DEG, step=1,
                )  # fmt: skip
                self._threshold = _number(
                    "Inlier threshold (degrees)", "Empty: from the noise of the matches",
                    min=0.001, max=LARGEST_THRESHOLD_DEG, step=0.01,
                )  # fmt: skip
            ui.label("Examples bring their own camera.").classes("soft")

    def choices(self) -> PairChoices:
        """Return what is chosen; `RefusedError` where a value cannot be used."""
        upright = self._upright_deg.value if self._upright.value else None
        return choices_from(
            {
                "camera": self._camera.value,
                "fov_deg": self._fov.value,
                "camera_names": self._names.value or "",
                "upright_deg": upright,
                "mask_nadir_deg": self._nadir.value or 0.0,
                "threshold_deg": self._threshold.value,
            }
        )

    def _add_camera(self) -> None:
        kinds = {str(kind): label for kind, label in CAMERA_KINDS.items()}
        self._camera = ui.select(
            kinds, value="panorama", label="Camera of both pictures",
            on_change=lambda event: self._show_camera(str(event.value)),
        )  # fmt: skip
        self._fov = _number("Field of view (degrees)", _ACROSS["fisheye"], step=1)
        self._lens = ui.html(_LENS_HTML, sanitize=False)
        self._names = ui.input("Name of the camera in the file").props(
            'hint="Of both pictures, or two names: cam0, cam1"'
        )
        self._show_camera("panorama")

    def _show_camera(self, kind: str) -> None:
        has_fov = kind in FIELDS_OF_VIEW
        self._fov.set_visibility(has_fov)
        if has_fov:
            self._fov.min, self._fov.max, value = FIELDS_OF_VIEW[kind]
            self._fov.set_value(value)
            self._fov.props["hint"] = _ACROSS[kind]
            self._fov.update()
        self._lens.set_visibility(kind == "lens")
        self._names.set_visibility(kind == "lens")

    def _add_upright(self) -> None:
        with ui.element("div").classes("upright"):
            self._upright = ui.switch("Both panoramas stand upright")
            self._upright_deg = ui.number(
                "to so many degrees", value=1, min=0.01, max=LARGEST_UPRIGHT_DEG, step=0.5
            ).bind_visibility_from(self._upright, "value")


def _number(label: str, hint: str, **bounds: Any) -> ui.number:
    """Return a field with a word on what it means."""
    return ui.number(label, **bounds).props(f'hint="{hint}"')
