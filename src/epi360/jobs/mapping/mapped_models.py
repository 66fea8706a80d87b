# SPDX-License-Identifier: BSD-3-Clause
"""Models that COLMAP found, read back, and the file that nerfstudio reads of the first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from epi360.cameras import Camera, KannalaBrandt
from epi360.interop.colmap_model import read_colmap_model
from epi360.interop.match_graph import MatchGraph
from epi360.interop.reconstruction import Reconstruction
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.folder.posed_pictures import remark_on_turned, write_transforms

MODELS, TRANSFORMS = "sparse", "transforms.json"


@dataclass(frozen=True, eq=False)
class MappedModel:
    """One connected model: COLMAP's folder, its content, and the mean reprojection error."""

    folder: Path
    reconstruction: Reconstruction
    mean_error_px: float

    @property
    def mean_track_length(self) -> float:
        """Observations a point; NaN without points."""
        seen = self.reconstruction.observations
        return np.nan if seen is None else len(seen.points) / len(self.reconstruction.points)


def read_models(
    folder: Path, mean_errors_px: Sequence[float], graph: MatchGraph
) -> tuple[MappedModel, ...]:
    """Models ``0``, ``1``, ... of a folder, which were mapped from a graph."""
    return tuple(
        MappedModel(
            folder / str(number),
            with_given_cameras(read_colmap_model(folder / str(number)), graph.cameras),
            error_px,
        )
        for number, error_px in enumerate(mean_errors_px)
    )


def with_given_cameras(model: Reconstruction, cameras: Mapping[str, Camera]) -> Reconstruction:
    """Model whose cameras have their names again, and the limit of a lens that COLMAP lacks."""
    given = dict(enumerate(cameras.items(), start=1))  # as the database numbers them
    names, restored = {}, {}
    for number, camera in model.cameras.items():
        # Images that were localized in the map may have other cameras.
        names[number], original = given.get(int(number), (number, camera))
        if isinstance(camera, KannalaBrandt) and isinstance(original, KannalaBrandt):
            camera = replace(camera, max_angle_deg=original.max_angle_deg)
        restored[names[number]] = camera
    images = tuple(replace(image, camera=names[str(image.camera)]) for image in model.images)
    rig = {names[number]: pose for number, pose in model.cam_from_rig.items()}
    return replace(model, cameras=restored, images=images, cam_from_rig=rig)


def write_transforms_of(
    images: ImageSet, output: Path, models: tuple[MappedModel, ...], mask_nadir_deg: float
) -> tuple[str, ...]:
    """Write ``transforms.json`` of the first model; sentences about what others will miss in it."""
    if not models:
        return ()
    model = models[0].reconstruction
    masks = {image.name: image.mask for image in images.images}
    turned = remark_on_turned([image.name for image in model.images], images.folder)
    try:
        lacks = write_transforms(output / TRANSFORMS, model, images.folder, masks, mask_nadir_deg)
        lacks = lacks and f"{lacks}; the faces that --cubemap cuts have all masks"
    except ValueError as error:
        lacks = f"{TRANSFORMS} was not written: {error}; that of --cubemap has one camera model"
    return tuple(filter(None, (lacks, turned)))
