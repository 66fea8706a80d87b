# SPDX-License-Identifier: BSD-3-Clause
"""Pictures and figures to the content of image files: every picture that is written passes here.

pycolmap's wheels for Linux (seen in 4.2.1) hold a zlib of their own. If they are loaded before the
system's zlib, the two get mixed, and whatever compresses afterwards ends the process: Python's own
``zlib.compress``, PNG files written by Pillow or OpenCV, PDF files. `import epi360` loads zlib
first. For those who imported pycolmap before epi360, another process compresses.
"""

from __future__ import annotations

import ctypes
import io
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
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
    """Whether the system's zlib was loaded after pycolmap, by the order of the linker's list."""
    if sys.platform != "linux" or "pycolmap" not in sys.modules:
        return False
    paths = list(_loaded_libraries())
    core = [index for index, path in enumerate(paths) if "/pycolmap/_core" in path]
    zlib = [index for index, path in enumerate(paths) if "/libz.so" in path]
    return bool(core and zlib and core[0] < zlib[0])


class _LinkMap(ctypes.Structure):
    """Head of ``struct link_map`` in <link.h>."""


_LinkMap._fields_ = [
    ("l_addr", ctypes.c_void_p),
    ("l_name", ctypes.c_char_p),
    ("l_ld", ctypes.c_void_p),
    ("l_next", ctypes.POINTER(_LinkMap)),
]


def _loaded_libraries() -> Iterator[str]:
    library = ctypes.cast(ctypes.CDLL(None)._handle, ctypes.POINTER(_LinkMap))
    while library:
        yield os.fsdecode(library.contents.l_name or b"")
        library = library.contents.l_next


def _saved_picture(pixels: NDArray[Any], format: str, options: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format, **options)
    return buffer.getvalue()


def _saved_figure(figure: Figure, suffix: str, options: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=suffix, **options)
    return buffer.getvalue()
