# SPDX-License-Identifier: BSD-3-Clause
"""Results of images in files, so that a run that was stopped goes on from there."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from epi360.cameras import Camera
from epi360.cameras.calibration import own
from epi360.cameras.calibration.own import camera_record
from epi360.extras import package_version
from epi360.jobs.localization.localization_result import LocalizationOptions, LocalizationResult
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.poses import Pose
from epi360.runs.arrays import Arrays, npz_bytes, read_arrays
from epi360.runs.file_digests import FileDigests
from epi360.runs.made_from import fingerprint
from epi360.runs.whole_files import write_file

_DIGESTS = "digests.json"
_POSES = ("cam_from_world", "alternatives")


class KeptResults:
    """A folder with a file for each result, named by a hash of all that it was made from.

    These are the picture, its mask, the camera, the map, the options and the version of epi360.
    """

    def __init__(
        self,
        folder: Path,
        world: LocalizationMap,
        options: LocalizationOptions,
    ) -> None:
        folder.mkdir(exist_ok=True)
        self.num_used = 0
        self._folder = folder
        self._digests = FileDigests(folder / _DIGESTS)
        self._made_from = package_version(), cv2.__version__, world.made_from()
        self._options = options

    def result(
        self,
        name: str,
        image: Path,
        mask: Path | None,
        camera: Camera | None,
        make: Callable[[], LocalizationResult],
    ) -> LocalizationResult:
        """Result of an image: the one that is kept, or a new one."""
        path = self._path_of(name, image, mask, camera)
        found = read_result(path)
        if found is None:
            found = make()
            write_result(path, found)
        else:
            self.num_used += 1
        return found

    def _path_of(self, name: str, image: Path, mask: Path | None, camera: Camera | None) -> Path:
        contents = [b"" if p is None else self._digests.digest_of(p) for p in (image, mask)]
        # The name and the place say which of hloc's features are the image's.
        asked = camera, self._options, name, str(image.absolute())
        key = fingerprint((*self._made_from, *asked), *contents)
        return self._folder / f"result-{key}.npz"

    def save_digests(self) -> None:
        """Remember the hashes of the files, which saves reading them in the next run."""
        self._digests.save()


def write_result(path: Path, result: LocalizationResult) -> None:
    """Keep a result; the file appears whole."""
    arrays: Arrays = {}
    words: dict[str, Any] = {}
    for field in dataclasses.fields(LocalizationResult):
        value = getattr(result, field.name)
        if field.name == "camera":
            words["camera"] = camera_record(value)
        elif field.name in _POSES:
            poses = [value] if isinstance(value, Pose) else value
            arrays[field.name] = np.array([p.matrix()[:3] for p in poses]).reshape(-1, 3, 4)
        elif isinstance(value, np.ndarray):
            arrays[field.name] = value
        else:
            words[field.name] = value
    arrays["words"] = np.array(json.dumps(words))
    write_file(path, npz_bytes(arrays))


def read_result(path: Path) -> LocalizationResult | None:
    """Result in a file, None where it is missing or damaged."""
    arrays = read_arrays(path) if path.is_file() else None
    if arrays is None:
        return None
    try:
        values: dict[str, Any] = json.loads(str(arrays.pop("words")))
        values["camera"] = own.read(values["camera"])["camera"]
        poses = {n: [Pose(m[:, :3], m[:, 3]) for m in arrays.pop(n)] for n in _POSES}
        values |= {"cam_from_world": poses["cam_from_world"][0]}
        values |= {"alternatives": tuple(poses["alternatives"])}
        values |= {n: tuple(values[n]) for n in ("warnings", "map_images")}
        return LocalizationResult(**(values | arrays))
    except (KeyError, IndexError, TypeError, ValueError):
        return None
