# SPDX-License-Identifier: BSD-3-Clause
"""Rigs: cameras that are fixed to each other, and the calibration files that say where they sit."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from epi360.cameras.base import Camera
from epi360.cameras.calibration import basalt, colmap_rig, fields, kalibr, own
from epi360.cameras.calibration.document import read_document
from epi360.poses import Pose

# For each format: whether a file is of it, its cameras, and their poses in any one frame.
Format = tuple[
    Callable[[Any], bool], Callable[[Any], dict[str, Camera]], Callable[[Any], dict[str, Pose]]
]
FORMATS: tuple[Format, ...] = tuple(
    (module.recognizes, module.read, module.poses) for module in (own, kalibr, basalt, colmap_rig)
)


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras that are fixed to each other, and their poses ``cam_from_rig``, both by name.

    The cameras are in the order of the file. The frame of the rig is that of its first camera,
    whose pose is the identity. Translations have the unit of the file, usually metres. Names that
    differ and poses that are NaN raise ``ValueError``.
    """

    cameras: Mapping[str, Camera]
    cam_from_rig: Mapping[str, Pose]

    def __post_init__(self) -> None:
        if self.cameras.keys() != self.cam_from_rig.keys():
            raise ValueError(
                f"cam_from_rig must have the cameras {', '.join(self.cameras)}, "
                f"got {', '.join(self.cam_from_rig) or 'none'}"
            )
        for name, pose in self.cam_from_rig.items():
            if not np.isfinite(pose.matrix()).all():
                raise ValueError(f"camera {name}: the pose on the rig must be finite")


def load_rig(path: str | os.PathLike[str]) -> Rig:
    """Return the cameras of a calibration file and where they sit on their rig.

    Parameters
    ----------
    path : path-like
        One of the following; the cameras have the names that `load_cameras` gives them.

        - our own YAML or JSON with several cameras, each but the first with
          ``cam_from_rig: {rotation: 3 rows, translation: [x, y, z]}`` or ``quaternion_wxyz``
          instead of the rotation;
        - a Kalibr camchain: ``T_cn_cnm1``, or ``T_cam_imu`` if a camera has no ``T_cn_cnm1``;
        - a calibration of basalt: ``T_imu_cam``;
        - COLMAP's ``rig_config.json`` of one rig, with ``camera_model_name`` and ``camera_params``,
          and the ``width`` and ``height`` that COLMAP takes from its database.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be read as one of the formats, says nothing about where a camera sits,
        or uses a model that is not supported.
    """
    path = Path(path)
    document = read_document(path)
    for recognizes, read, poses in FORMATS:
        if recognizes(document):
            with fields.naming_file(path):
                return _rig(read(document), poses(document))
    raise ValueError(
        f"calibration file {path} does not say where cameras sit on a rig; load_rig reads our own "
        "files with cam_from_rig, Kalibr camchains, basalt's JSON and COLMAP's rig_config.json"
    )


def _rig(cameras: dict[str, Camera], cam_from_body: dict[str, Pose]) -> Rig:
    first, *others = cameras
    body_from_first = cam_from_body[first].inverse()
    cam_from_rig = {first: Pose(np.eye(3), np.zeros(3))}  # without rounding
    cam_from_rig |= {name: cam_from_body[name] @ body_from_first for name in others}
    return Rig(cameras, cam_from_rig)
