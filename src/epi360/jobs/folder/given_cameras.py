# SPDX-License-Identifier: BSD-3-Clause
"""The cameras that ``--camera FILE`` or ``--camera FILE:NAME`` names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from epi360.cameras import Camera, load_cameras, load_rig
from epi360.cameras.calibration import camera_file, camera_of_name
from epi360.poses import Pose
from epi360.runs.input_files import read_text

# Files that have one of these mean to say where cameras sit on a rig.
_POSE_KEYS = ("cam_from_rig", "T_cn_cnm1", "T_cam_imu", "T_imu_cam")


@dataclass(frozen=True, eq=False)
class GivenCameras:
    """Cameras of a calibration file by name, and where they sit on a rig if it says so."""

    source: str
    cameras: Mapping[str, Camera]
    cam_from_rig: Mapping[str, Pose] = field(default_factory=dict)

    def only(self) -> Camera:
        """Return the one camera; ValueError where there are several."""
        if len(self.cameras) > 1:
            known = ", ".join(self.cameras)
            raise ValueError(f"{self.source} holds {known}; name one as {self.source}:NAME")
        return next(iter(self.cameras.values()))

    def name_of(self, image: str) -> str:
        """Name of the camera of an image: the only one, or that of a folder that it lies in.

        ``image`` is its path below the folder of all images. ValueError if no folder has the name
        of a camera.
        """
        if len(self.cameras) == 1:
            return next(iter(self.cameras))
        # COLMAP's rigs have folders in folders, "rig/front"; the longest name says most.
        called = [camera for camera in self.cameras if image.startswith(f"{camera}/")]
        if not called:
            raise ValueError(
                f"image {image} must lie in a sub-folder that is called as its camera, one of "
                f"{', '.join(self.cameras)}; or name one camera for all as {self.source}:NAME"
            )
        return max(called, key=len)


def read_given_cameras(source: str) -> GivenCameras:
    """Cameras of ``FILE`` or ``FILE:NAME``, a file that `load_cameras` reads.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be read, has no camera of that name, or says wrongly or of some cameras
        only where they sit.
    """
    path, name = camera_file(source)
    cameras = load_cameras(path)
    if name is not None:
        return GivenCameras(source, {name: camera_of_name(path, cameras, name)})
    if len(cameras) == 1:
        return GivenCameras(source, cameras)
    try:
        return GivenCameras(source, cameras, load_rig(path).cam_from_rig)
    except ValueError:
        if any(key in read_text(path) for key in _POSE_KEYS):
            raise
        return GivenCameras(source, cameras)  # the file does not say where they sit
