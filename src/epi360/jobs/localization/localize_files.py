# SPDX-License-Identifier: BSD-3-Clause
"""Many new images in one map, with results that are kept."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from epi360.cameras import Camera
from epi360.jobs.folder.masks import MaskSource
from epi360.jobs.localization.kept_results import KeptResults
from epi360.jobs.localization.localization_result import LocalizationOptions, LocalizationResult
from epi360.jobs.localization.localize import localize_image
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.progress import Progress, no_progress
from epi360.runs.input_files import open_input


@dataclass(frozen=True)
class LocalizedFiles:
    """Results by the names of images, why others could not be used, and how many were kept."""

    results: dict[str, LocalizationResult] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    num_kept: int = 0


def localize_files(
    files: Mapping[str, Path],
    world: LocalizationMap,
    *,
    camera: Camera | Mapping[str, Camera] | None = None,
    mask: Path | None = None,
    options: LocalizationOptions = LocalizationOptions(),  # noqa: B008 - frozen
    keep: Path | None = None,
    progress: Progress = no_progress,
) -> LocalizedFiles:
    """Localize images by name; one that cannot be read costs itself, not the others.

    There may be one camera, or one for each name.
    A folder ``keep`` gets the result of each image and gives those that are done and unchanged.
    """
    masks = MaskSource(mask)
    mask_of = {name: masks.mask_of(name) for name in files}
    masks.check_used(list(mask_of.values()))
    kept = None if keep is None else KeptResults(keep, world, options)
    localize = partial(localize_image, world=world, options=options)
    results: dict[str, LocalizationResult] = {}
    reasons: dict[str, str] = {}
    for number, (name, path) in enumerate(files.items()):
        progress("localizing images", number, len(files))
        own = camera[name] if isinstance(camera, Mapping) else camera
        make = partial(localize, path, camera=own, mask=mask_of[name])
        try:
            _check_opens(path, mask_of[name])
            if kept is None:
                results[name] = make()
            else:
                results[name] = kept.result(name, path, mask_of[name], own, make)
        except ValueError as error:
            if len(files) == 1:
                raise
            reasons[name] = str(error)
    progress("localizing images", len(files), len(files))
    if kept is not None:
        with suppress(OSError):  # they only save time
            kept.save_digests()
    return LocalizedFiles(results, reasons, 0 if kept is None else kept.num_used)


def _check_opens(image: Path, mask: Path | None) -> None:
    """Raise ``ValueError`` for a file that cannot be opened: only those of results end the run."""
    for path in (image,) if mask is None else (image, mask):
        try:
            open_input(path).close()
        except OSError as error:
            raise ValueError(f"{path} cannot be opened: {error.strerror}") from None
