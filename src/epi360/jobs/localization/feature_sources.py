# SPDX-License-Identifier: BSD-3-Clause
"""Where the features of a map's images come from, and those of new images to match them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from epi360.cameras import Camera
from epi360.features import Features, ImageSource
from epi360.features.detection import FAINT_CONTRAST_THRESHOLD, find_keypoints
from epi360.interop.colmap_database import read_descriptors
from epi360.interop.colmap_pairs import ColmapPairs
from epi360.interop.descriptors import is_sift_bytes, unit_descriptors
from epi360.interop.hloc_layout import (
    HLOC_TO_CONTINUOUS,
    dataset,
    image_names,
    opened,
    own_group,
    reading,
)
from epi360.jobs.feature_cache import keypoints_in_file
from epi360.runs.inside import inside
from epi360.runs.made_from import read_record


@dataclass(frozen=True)
class ExtractionSettings:
    """How key points of new images are found; for a map of ours as its own were."""

    max_width: int = 2048
    max_features: int = 10000
    mask_nadir_deg: float = 0.0


class FeatureSource(Protocol):
    """Features of the images of a map by name, and of new ones."""

    are_of_the_points: bool  # the points of the model were made from these key points

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map; None if there are none."""

    def of_new(
        self, image: ImageSource, camera: Camera, mask: ImageSource | None, nadir_deg: float
    ) -> Features:
        """Features of a new image."""


@dataclass(frozen=True)
class _Extracting:
    """New images are searched by us."""

    settings: ExtractionSettings

    def of_new(
        self, image: ImageSource, camera: Camera, mask: ImageSource | None, nadir_deg: float
    ) -> Features:
        return _extracted(image, camera, mask, self.settings, nadir_deg)


@dataclass(frozen=True)
class MatchedFolder(_Extracting):
    """The output of `epi360 match` and `epi360 map`."""

    folder: Path
    keys: Mapping[str, str]
    are_of_the_points = True

    @classmethod
    def opened(cls, output: Path) -> MatchedFolder:
        """Read which key points the images of an output have, and how they were found."""
        remedy = "run epi360 map with this --output again"
        index = read_record(output / "images.json", remedy=remedy) or {}
        made = (read_record(output / "epi360-match.json", remedy=remedy) or {}).get("options", {})
        try:
            keys = {image["name"]: image["key"] for image in index["images"]}
            settings = ExtractionSettings(
                int(made["max_width"]), int(made["max_features"]), float(made["mask_nadir_deg"])
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{output / 'images.json'} is damaged: {error}; {remedy}") from None
        return cls(settings, output / "features", keys)

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map; None if there are none."""
        if name not in self.keys:
            return None
        found = keypoints_in_file(inside(self.folder, f"{self.keys[name]}.npz"))
        return None if found is None else found.features()


@dataclass(frozen=True)
class DatabaseFile(_Extracting):
    """Descriptors of a COLMAP database; SIFT only, because new images get ours."""

    pairs: ColmapPairs
    are_of_the_points = True

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map; None if there are none."""
        if name not in self.pairs.images:
            return None
        keypoints = self.pairs.keypoints(name)
        descriptors = read_descriptors(self.pairs, name)
        if descriptors is None or not len(descriptors):
            return None
        if not is_sift_bytes(descriptors):
            raise ValueError(
                f"{self.pairs.path} holds descriptors of {descriptors.shape[1]} numbers that are "
                "not SIFT, and epi360 cannot make them for new images; give hloc's file with those "
                "of all images (--features), or the map's images (--images)"
            )
        return Features(keypoints, unit_descriptors(descriptors), np.zeros(len(keypoints)))


@dataclass(frozen=True)
class HlocFile:
    """hloc's features of the map's images and of the new ones, found by their names."""

    path: Path
    are_of_the_points = True

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map; None if there are none."""
        with opened(self.path) as file:
            return self._read(file, name) if name in file else None

    def of_new(
        self, image: ImageSource, camera: Camera, mask: ImageSource | None, nadir_deg: float
    ) -> Features:
        """Features of a new image; a mask is not used."""
        with opened(self.path) as file:
            found = self._read(file, self._name_in(file, image))
        kept = np.ones(len(found), dtype=bool)
        if nadir_deg > 0.0:
            down = camera.bearings_from_pixels(found.keypoints)[:, 1]
            kept = down < np.cos(np.radians(nadir_deg))
        return Features(found.keypoints[kept], found.descriptors[kept], found.sizes_px[kept])

    def _name_in(self, file: Any, image: ImageSource) -> str:
        path = Path(image).as_posix() if isinstance(image, str | Path) else ""
        names = image_names(file, self.path)
        fitting = [name for name in names if path == name or path.endswith(f"/{name}")]
        if not fitting:
            raise ValueError(f"{self.path} has no features of {path or 'the image'}")
        return max(fitting, key=len)

    def _read(self, file: Any, name: str) -> Features:
        with reading(self.path):
            group = file[own_group(file, name, self.path)]
        keypoints = dataset(group, "keypoints", self.path)
        descriptors = dataset(group, "descriptors", self.path)
        if keypoints is None or descriptors is None or descriptors.ndim != 2:
            raise ValueError(f"{self.path}: {name} must have keypoints and descriptors")
        if descriptors.shape[1] != len(keypoints):
            raise ValueError(
                f"{self.path}: descriptors of {name} must have shape (D, {len(keypoints)}), "
                f"got {descriptors.shape}"
            )
        pixels = keypoints[:, :2].astype(np.float64) + HLOC_TO_CONTINUOUS
        try:
            units = unit_descriptors(descriptors.T)
        except ValueError as error:
            raise ValueError(f"{self.path}: {name}: {error}") from None
        return Features(pixels, units, np.zeros(len(pixels)))


@dataclass(frozen=True)
class ImageFolder(_Extracting):
    """Images of the map, searched anew: their features have no points yet."""

    folder: Path
    are_of_the_points = False

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map; None if there are none."""
        path = inside(self.folder, name)
        return _extracted(path, camera, None, self.settings, 0.0) if path.is_file() else None


def _extracted(
    image: ImageSource,
    camera: Camera,
    mask: ImageSource | None,
    settings: ExtractionSettings,
    nadir_deg: float,
) -> Features:
    return find_keypoints(
        image,
        camera,
        mask,
        max_width=settings.max_width,
        max_features=settings.max_features,
        mask_nadir_deg=nadir_deg or settings.mask_nadir_deg,
        contrast_threshold=FAINT_CONTRAST_THRESHOLD,
    ).features()
