# SPDX-License-Identifier: BSD-3-Clause
"""One HTML file that opens offline: our styles and scripts, the data, nothing from elsewhere."""

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.extras import package_version
from epi360.features.picture_writing import encode_picture
from epi360.report.webgl import WebGLLibrary

# Nothing is loaded, whatever a file name in the page says: the browser itself refuses.
_POLICY = (
    "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline' blob:; connect-src 'none'; base-uri 'none'; form-action 'none'"
)
_TEMPLATE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>
{style}
</style>
</head>
<body>
<main>
{body}
</main>
<footer>
<p>Made by epi360 {version}. The file holds everything that it shows and loads nothing. {credit}</p>
</footer>
<script type="application/json" id="data">{data}</script>
<script type="application/json" id="webgl">{webgl}</script>
<script>
{script}
</script>
</body>
</html>
"""
# Cells between the samples of a camera's rays; a panorama is sampled by the page itself.
_GRID_CELLS = 64


@dataclass(frozen=True)
class Page:
    """What one page shows: HTML that is safe as it is, data for the scripts, the scripts' names."""

    title: str
    body: str
    data: Mapping[str, Any]
    scripts: Sequence[str]
    webgl: WebGLLibrary | None = None

    def encode(self) -> bytes:
        """Return the content of the file."""
        text = _TEMPLATE.format(
            policy=html.escape(_POLICY),
            title=escaped(self.title),
            style=_package_file("colors.css") + _package_file("report.css"),
            body=self.body,
            version=escaped(package_version()),
            credit=escaped(self.webgl.credit if self.webgl else ""),
            data=embedded_json(self.data),
            webgl=embedded_json(self.webgl.source if self.webgl else None),
            script="\n".join(_package_file(name) for name in self.scripts),
        )
        return text.encode("utf-8", errors="replace")


def escaped(text: object) -> str:
    """Return a text as it stands between tags or in a quoted attribute, on one line."""
    return html.escape(" ".join(str(text).split()), quote=True)


def embedded_json(value: Any) -> str:
    """Return JSON that no content can end early inside a script element."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def packed(values: ArrayLike) -> str:
    """Return numbers as little-endian 32-bit floats in base64; NaN stays NaN."""
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")


def picture_address(image: NDArray[np.uint8], max_size: int, jpeg_quality: int = 80) -> str:
    """Return a data address of an RGB image, shrunk to a largest width or height."""
    content = encode_picture(shrunk(image, max_size), ".jpg", jpeg_quality=jpeg_quality)
    return "data:image/jpeg;base64," + base64.b64encode(content).decode("ascii")


def shrunk(image: NDArray[np.uint8], max_size: int) -> NDArray[np.uint8]:
    """Return an image whose width and height are at most this; a smaller one as it is."""
    height, width = image.shape[:2]
    scale = max_size / max(width, height)
    if scale >= 1.0:
        return image
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def camera_record(camera: Camera) -> dict[str, Any]:
    """Return what the page needs to turn pixels of this camera into rays."""
    record: dict[str, Any] = {"width": camera.width, "height": camera.height}
    if isinstance(camera, Equirectangular):
        angles = (
            camera.horizontal_fov_deg, camera.vertical_fov_deg,
            camera.center_longitude_deg, camera.center_latitude_deg,
        )  # fmt: skip
        return record | {"panorama": [float(np.radians(angle)) for angle in angles]}
    u = np.linspace(0.0, camera.width, _GRID_CELLS + 1)
    v = np.linspace(0.0, camera.height, _GRID_CELLS + 1)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return record | {"cells": _GRID_CELLS, "rays": packed(camera.bearings_from_pixels(pixels))}


def _package_file(name: str) -> str:
    return (files("epi360.report") / "page" / name).read_text(encoding="utf-8")
