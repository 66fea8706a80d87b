# SPDX-License-Identifier: BSD-3-Clause
"""Pictures and figures to the content of image files: every picture that is written passes here.

pycolmap's wheels for Linux (seen in 4.2.1) hold a zlib of their own. If they are loaded before the
system's zlib, the two get mixed, and whatever compresses afterwards ends the process: Python's own
``zlib.compress``, PNG files written by Pillow or OpenCV, PDF files. `import epi360` loads zlib
first. For those who imported pycolmap before epi360, another process compresses.
"""

from __future__ import annotations

import io
import pickle
import subprocess
import sys
import zlib  # noqa: F401 - its place in sys.modules is asked for
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Pillow's own default of 75 is coarser than OpenCV's of 95, which pictures were written with.
JPEG_QUALITY = 95
_FORMATS = {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG", ".tiff": "TIFF", ".webp": "WEBP"}
_COMPRESSED = ("png", "pdf", "svg")  # with zlib; an SVG file holds its pictures as PNG
_CHILD = (
    "import sys, pickle; read = sys.stdin.buffer; sys.path[:] = pickle.load(read);"
    "import epi360; function, arguments = pickle.load(read);"
    "sys.stdout.buffer.write(function(*arguments))"
)


def encode_picture(pixels: NDArray[Any], suffix: str, *, jpeg_quality: int = JPEG_QUALITY) -> bytes:
    """Content of an image file of RGB or grey bytes, a boolean mask, or a float32 depth (TIFF)."""
    format = _FORMATS[suffix.lower()]
    if pixels.dtype == np.bool_:
        pixels = pixels.astype(np.uint8) * np.uint8(255)
    options: dict[str, dict[str, Any]] = {
        "JPEG": {"quality": jpeg_quality},
        "PNG": {"compress_level": 1},  # a third of the default's time, a fifth more bytes
        "TIFF": {"compression": "tiff_lzw"},
        "WEBP": {"lossless": True},
    }
    pixels = np.ascontiguousarray(pixels)
    return _compressed(format.lower(), _saved_picture, pixels, format, options[format])


def encode_figure(figure: Figure, suffix: str, **options: Any) -> bytes:
    """Content of a file of a matplotlib figure; the options are those of ``savefig``."""
    return _compressed(suffix, _saved_figure, figure, suffix, options)


def _compressed(kind: str, save: Callable[..., bytes], *arguments: Any) -> bytes:
    if kind not in _COMPRESSED or not _zlib_is_broken():
        return save(*arguments)
    work = pickle.dumps(sys.path) + pickle.dumps((save, arguments))
    child = subprocess.run([sys.executable, "-c", _CHILD], input=work, capture_output=True)
    if child.returncode:
        reason = child.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise RuntimeError(f"the process that compresses a {kind} file failed: {reason}")
    return child.stdout


def _zlib_is_broken() -> bool:
    """Whether pycolmap came before zlib, which some Python interpreters have built in."""
    if sys.platform != "linux" or "zlib" in sys.builtin_module_names:
        return False
    names = list(sys.modules)  # in the order of loading
    return "pycolmap" in names and names.index("pycolmap") < names.index("zlib")


def _saved_picture(pixels: NDArray[Any], format: str, options: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format, **options)
    return buffer.getvalue()


def _saved_figure(figure: Figure, suffix: str, options: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=suffix, **options)
    return buffer.getvalue()
