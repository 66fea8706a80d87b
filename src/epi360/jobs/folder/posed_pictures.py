# SPDX-License-Identifier: BSD-3-Clause
"""What other programs read beside a model: ``transforms.json``, and remarks on the pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from epi360.features.image_headers import read_image_header
from epi360.interop.nerfstudio import seen_from, write_nerfstudio
from epi360.interop.reconstruction import Reconstruction

_TURNED = range(2, 9)  # or mirrored; other numbers mean nothing


def write_transforms(
    path: Path,
    model: Reconstruction,
    images: Path,
    masks: Mapping[str, Path | None],
    mask_nadir_deg: float = 0.0,
) -> str:
    """Write a ``transforms.json``; part of a sentence about what it has no place for, or nothing.

    It takes masks of all images or of none. Paths in the file are relative to its folder; names of
    images, also in ``masks``, are below ``images``.

    Raises
    ------
    ValueError
        If nerfstudio has no model for the cameras.
    OSError
        If it cannot be written.
    """
    posed = {image.name for image in model.images}
    files = {name: file for name, file in masks.items() if name in posed and file is not None}
    every = {name: seen_from(path.parent, file) for name, file in files.items()}
    has_all = len(every) == len(posed)
    folder = seen_from(path.parent, images)
    write_nerfstudio(path, model, images=folder, masks=every if has_all else None)
    missing = []
    if every and not has_all:
        missing.append("masks, because some images have none")
    if mask_nadir_deg > 0:
        missing.append("what --mask-nadir-deg masks")
    return f"{path.name} lacks {' and '.join(missing)}" if missing else ""


def remark_on_turned(names: Iterable[str], folder: Path) -> str:
    """Sentence about pictures that a tag turns: cameras are those of the turned pictures."""
    turned = [name for name in names if _is_turned(folder / name)]
    if not turned:
        return ""
    some = turned[0] + (f" and {len(turned) - 1} more" if len(turned) > 1 else "")
    are = "is" if len(turned) == 1 else "are"
    return (
        f"{some} {are} stored turned (Exif), and the models have cameras of pictures that stand "
        "upright: COLMAP and nerfstudio do not turn them; turn the files, or cut cube faces"
    )


def _is_turned(path: Path) -> bool:
    try:
        return read_image_header(path).orientation in _TURNED
    except (OSError, ValueError):
        return False
