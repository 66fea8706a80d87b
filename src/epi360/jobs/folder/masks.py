# SPDX-License-Identifier: BSD-3-Clause
"""Which mask belongs to which image."""

from __future__ import annotations

import unicodedata
import warnings
from pathlib import Path

from epi360.features.image_headers import read_image_header
from epi360.image_folders import IMAGE_SUFFIXES
from epi360.jobs.folder.folder_files import files_below
from epi360.runs.input_files import check_is_file


class MaskSource:
    """One mask for all images, or a folder with a file per image.

    In a folder the mask of ``a/b.jpg`` is ``a/b`` with any suffix of an image, or ``a/b.jpg.png``
    as COLMAP has it. Without a path there are no masks.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._masks: dict[str, Path] | None = None
        self._sizes: dict[Path, tuple[int, int] | None] = {}
        if path is not None and not path.exists():
            raise FileNotFoundError(f"mask {path} does not exist")
        if path is not None:
            check_is_file(path)
        if path is not None and path.is_dir():
            self._masks = {}
            for name, mask in files_below(path):
                if mask.suffix.lower() in IMAGE_SUFFIXES:
                    self._masks.setdefault(_key(_without_suffix(name)), mask)

    def files(self) -> list[Path]:
        """All masks."""
        if self._masks is not None:
            return list(self._masks.values())
        return [] if self._path is None else [self._path]

    def mask_of(self, name: str) -> Path | None:
        """Mask of an image by its name; None: it has none."""
        if self._masks is None:
            return self._path
        by_colmap = self._masks.get(_key(name))
        return by_colmap or self._masks.get(_key(_without_suffix(name)))

    def size_of(self, mask: Path) -> tuple[int, int] | None:
        """Width and height that the header of a mask states; None where it states none."""
        if mask not in self._sizes:
            try:
                self._sizes[mask] = read_image_header(mask).size
            except (OSError, ValueError):  # whoever reads the mask says why
                self._sizes[mask] = None
        return self._sizes[mask]

    def wrong_size(self, mask: Path, size: tuple[int, int]) -> str:
        """Rest of a sentence about an image of this size whose mask has another; else empty."""
        found = self.size_of(mask)
        if found is None or found == size:
            return ""
        return (
            f"is {size[0]}x{size[1]} but its mask {mask} is {found[0]}x{found[1]}; a mask must "
            "have the size of its image"
        )

    def check_used(self, masks: list[Path | None]) -> None:
        """Raise ``ValueError`` where a folder of masks was given and no image has one.

        Where some have none, a warning says so.
        """
        if self._masks is None:
            return
        named = "the mask of a/b.jpg is a/b.png or a/b.jpg.png"
        if not any(masks):
            raise ValueError(f"mask folder {self._path} has no mask for any of the images; {named}")
        num_without, num_left = masks.count(None), len({*self._masks.values()} - {*masks})
        if num_without:
            left = f", and {num_left} masks there belong to no image; {named}" if num_left else ""
            warnings.warn(
                f"{num_without} of {len(masks)} images have no mask in {self._path}"
                f"{left or '; they are used whole'}",
                stacklevel=2,
            )


def _without_suffix(name: str) -> str:
    return name[: len(name) - len(Path(name).suffix)]


def _key(name: str) -> str:
    """Name by which two folders compare: file systems write accents as one character or two."""
    return unicodedata.normalize("NFC", name)
