# SPDX-License-Identifier: BSD-3-Clause
"""Where the features of a map's images come from, and those of new images to match them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.features import Features, ImageSource
from epi360.features.detection import FAINT_CONTRAST_THRESHOLD, find_keypoints, usable_rows
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
from epi360.jobs.folder.feature_cache import EXTRACTION_VERSION, keypoints_in_file
from epi360.runs.inside import inside
from epi360.runs.made_from import read_record

Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]
GIVE_IMAGES = "give the folder of its images (--images)"
_REMEDY = "run epi360 map with this --output again"


@dataclass(frozen=True)
class ExtractionSettings:
    """How key points of new images are found; for a map of ours as its own were."""

    max_width: int = 2048
    max_features: int = 10000
    mask_nadir_deg: float = 0.0


class FeatureSource(Protocol):
    """Features of the images of a map by name, and of new ones."""

    are_of_the_points: bool  # the points of the model were made from these key points

    @property
    def remedy(self) -> str:
        """What to do where features of many images of the map are missing."""

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map; None if there are none."""

    def made_from(self, names: Sequence[str]) -> object:
        """What changes when the features of these images of the map do; its text is compared."""

    def of_new(
        self,
        picture: Picture,
        camera: Camera,
        usable: Mask | None,
        nadir_deg: float,
        path: str | None = None,
    ) -> Features:
        """Features of a new image, whose file may lie at a path."""


@dataclass(frozen=True)
class _Extracting:
    """New images are searched by us."""

    settings: ExtractionSettings

    @property
    def remedy(self) -> str:
        """What gives the features that are missing."""
        return GIVE_IMAGES

    def of_new(
        self,
        picture: Picture,
        camera: Camera,
        usable: Mask | None,
        nadir_deg: float,
        path: str | None = None,
    ) -> Features:
        return _extracted(picture, camera, usable, self.settings, nadir_deg)


@dataclass(frozen=True)
class MatchedFolder(_Extracting):
    """The output of `epi360 match` and `epi360 map`."""

    folder: Path
    keys: Mapping[str, str]
    are_of_the_points = True

    def made_from(self, names: Sequence[str]) -> object:
        """Return hashes of images and options, by which the features are kept."""
        return [self.keys.get(name) for name in names]

    @classmethod
    def opened(cls, output: Path) -> MatchedFolder:
        """Read which key points the images of an output have, and how they were found."""
        index = read_record(output / "images.json", remedy=_REMEDY) or {}
        made = (read_record(output / "epi360-match.json", remedy=_REMEDY) or {}).get("options", {})
        try:
            keys = {image["name"]: image["key"] for image in index["images"]}
            settings = ExtractionSettings(
                int(made["max_width"]), int(made["max_features"]), float(made["mask_nadir_deg"])
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{output / 'images.json'} is damaged: {error}; {_REMEDY}") from None
        return cls(settings, output / "features", keys)

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map; None if there are none."""
        if name not in self.keys:
            return None
        path = inside(self.folder, f"{self.keys[name]}.npz")
        found = keypoints_in_file(path)
        if found is None:
            raise ValueError(f"the features of {name} in {path} are missing or damaged; {_REMEDY}")
        return found.features()


@dataclass(frozen=True)
class DatabaseFile(_Extracting):
    """Descriptors of a COLMAP database; SIFT only, because new images get ours."""

    pairs: ColmapPairs
    are_of_the_points = True

    def made_from(self, names: Sequence[str]) -> object:
        """State of the database."""
        return _state(Path(self.pairs.path))

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
    remedy = GIVE_IMAGES

    def made_from(self, names: Sequence[str]) -> object:
        """State of the file."""
        return _state(self.path)

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map; None if there are none."""
        with opened(self.path) as file:
            return self._read(file, name) if name in file else None

    def of_new(
        self,
        picture: Picture,
        camera: Camera,
        usable: Mask | None,
        nadir_deg: float,
        path: str | None = None,
    ) -> Features:
        """Features of a new image, by the end of its path."""
        if path is None:
            raise ValueError(f"{self.path} has features by the names of files, got an array")
        with opened(self.path) as file:
            found = self._read(file, self._name_in(file, Path(path).as_posix()))
        return found.chosen(usable_rows(found.keypoints, camera, usable, nadir_deg))

    def _name_in(self, file: Any, path: str) -> str:
        names = image_names(file, self.path)
        fitting = [name for name in names if path == name or path.endswith(f"/{name}")]
        if not fitting:
            raise ValueError(f"{self.path} has no features of {path}")
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

    @property
    def remedy(self) -> str:
        """What is wrong with the folder."""
        return f"{self.folder} is not the folder of its images, or lacks some (--images)"

    def made_from(self, names: Sequence[str]) -> object:
        """State of the pictures, and how they are searched."""
        rules = (EXTRACTION_VERSION, cv2.__version__, self.settings)
        return rules, [_state(inside(self.folder, name)) for name in names]

    def of_map(self, name: str, camera: Camera) -> Features | None:
        """Features of an image of the map; None if there are none."""
        path = inside(self.folder, name)
        return _extracted(path, camera, None, self.settings, 0.0) if path.is_file() else None


def _state(path: Path) -> list[int]:
    """Size and times of change of a file, none if it is missing."""
    try:
        status = path.stat()
    except OSError:
        return []
    return [status.st_size, status.st_mtime_ns, status.st_ctime_ns]


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
