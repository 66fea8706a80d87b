# SPDX-License-Identifier: BSD-3-Clause
"""The pose of a new image in an existing model: one of ours, of COLMAP or of hloc."""

from epi360.jobs.localization.localization_result import LocalizationOptions, LocalizationResult
from epi360.jobs.localization.localize import localize_image
from epi360.jobs.localization.map_files import load_map
from epi360.jobs.localization.map_views import LocalizationMap

__all__ = [
    "LocalizationMap", "LocalizationOptions", "LocalizationResult", "load_map", "localize_image",
]  # fmt: skip
