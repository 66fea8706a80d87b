# SPDX-License-Identifier: BSD-3-Clause
"""The cameras that ``--camera FILE`` or ``--camera FILE:NAME`` names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from epi360.cameras import Camera, load_cameras, load_rig
from epi360.poses import Pose


@dataclass(frozen=True, eq=False)
class GivenCameras:
    """Cameras of a calibration file.

    Attributes
    ----------
    source : str
        As it was given.
    cameras : mapping of str to Camera
        By name; one where the source names it.
    cam_from_rig : mapping of str to Pose
        Where they sit on their rig; empty: one camera, or the file does not say.
    """

    source: str
    cameras: Mapping[str, Camera]
    cam_from_rig: Mapping[str, Pose] = field(default_factory=dict)

    def only(self) -> Camera:
        """Return the one camera.

        Raises
        ------
        ValueError
            If there are several.
        """
        if len(self.cameras) > 1:
            known = ", ".join(self.cameras)
            raise ValueError(f"{self.source} holds {known}; name one as {self.source}:NAME")
        return next(iter(self.cameras.values()))


def camera_file(source: str) -> tuple[Path, str | None]:
    """File and name of ``FILE`` or ``FILE:NAME``; a file whose name has a colon comes first."""
    file, colon, name = source.rpartition(":")
    if not colon or Path(source).exists():
        return Path(source), None
    return Path(file), name


def read_given_cameras(source: str) -> GivenCameras:
    """Cameras of ``FILE`` or ``FILE:NAME``.

    Parameters
    ----------
    source : str
        A file that `load_cameras` reads, and after a colon the name of one of its cameras.

    Returns
    -------
    given : GivenCameras

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be read or has no camera of that name.
    """
    path, name = camera_file(source)
    cameras = load_cameras(path)
    if name is not None:
        if name not in cameras:
            raise ValueError(f"{path} has no camera {name!r}; it holds {', '.join(cameras)}")
        return GivenCameras(source, {name: cameras[name]})
    if len(cameras) == 1:
        return GivenCameras(source, cameras)
    try:
        return GivenCameras(source, cameras, load_rig(path).cam_from_rig)
    except ValueError:  # several cameras of which the file does not say where they sit
        return GivenCameras(source, cameras)
