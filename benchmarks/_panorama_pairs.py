# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of panoramas as the fits of what pairs show take them, and the files of what is fitted."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from epi360 import estimate_relative_pose
from epi360.cameras import Equirectangular
from epi360.cameras.resizing import smallest_pixel_deg
from epi360.estimation.image_matches import IMAGE_OPTIONS, MAX_NOISE_PX
from epi360.features import Features, extract_features, match_features, read_image
from epi360.features.warped_patches import Panorama
from epi360.places.shared_points import PosedPair
from epi360.runs.whole_files import write_file


class PanoramaView(NamedTuple):
    """A panorama with its features."""

    camera: Equirectangular
    features: Features
    panorama: Panorama

    @classmethod
    def of(cls, folder: Path, name: str) -> PanoramaView:
        """Read a picture."""
        picture = read_image(folder / name)
        camera = Equirectangular(picture.shape[1], picture.shape[0])
        return cls(camera, extract_features(picture, camera), Panorama.of(picture))


def posed(views: Sequence[PanoramaView], **known: Any) -> PosedPair | None:
    """The pose of two panoramas by their matches alone; None if these do not determine one.

    ``known`` are more arguments of `estimate_relative_pose`.
    """
    matches = match_features(*(view.features for view in views))
    bearings = [
        view.camera.bearings_from_pixels(view.features.keypoints[rows])
        for view, rows in zip(views, matches.T, strict=True)
    ]
    noise_deg = MAX_NOISE_PX * smallest_pixel_deg((views[0].camera, views[1].camera))
    result = estimate_relative_pose(
        *bearings, max_noise_deg=noise_deg, options=IMAGE_OPTIONS, **known
    )
    if not result.success:
        return None
    (rows,) = np.nonzero(result.inlier_mask)
    matches = np.column_stack([rows, rows])
    return PosedPair.of(
        (0, 1), result.cam2_from_cam1, matches, bearings, noise_deg=result.noise_deg
    )


def rounded(values: Any) -> list[float]:
    """Numbers of a fit as they are written."""
    return [round(float(value), 4) for value in values]


def write_fit(path: Path, record: Mapping[str, Any]) -> None:
    """Write JSON with each list of numbers on one line, and say so."""
    text = json.dumps(record, indent=1)
    lines = re.sub(r"\[[^][]*\]", lambda found: " ".join(found[0].split()), text)
    write_file(path, f"{lines}\n".encode())
    print(f"Written: {path}")
