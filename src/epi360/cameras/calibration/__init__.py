# SPDX-License-Identifier: BSD-3-Clause
"""Calibration files to cameras; the content of a file says which format it is."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from epi360.cameras.base import Camera
from epi360.cameras.calibration import (
    basalt,
    colmap,
    colmap_rig,
    fields,
    kalibr,
    opencv,
    opensfm,
    own,
)
from epi360.cameras.calibration.document import read_document
from epi360.cameras.calibration.kalibr import KalibrCamera, load_kalibr_rig

__all__ = ["KalibrCamera", "load_camera", "load_cameras", "load_kalibr_rig"]

Format = tuple[Callable[[Any], bool], Callable[[Any], dict[str, Camera]]]
FORMATS: tuple[Format, ...] = tuple(
    (module.recognizes, module.read)
    for module in (own, kalibr, basalt, colmap, colmap_rig, opensfm, opencv)
)


def load_cameras(path: str | os.PathLike[str]) -> dict[str, Camera]:
    """Return the cameras of a calibration file; its content says which format it is.

    Parameters
    ----------
    path : path-like
        One of

        - our own YAML or JSON: ``{model: KannalaBrandt, width: ..., ...}`` with the parameter names
          of the class, or ``{cameras: {name: {model: ...}}}``;
        - a Kalibr camchain: pinhole (equidistant, radtan or no distortion), omni (radtan or none),
          eucm, ds;
        - a calibration of basalt (JSON): pinhole, kb4, ucm, eucm, ds;
        - COLMAP's ``cameras.txt``: panoramas, pinhole, radial, fisheye, ``OPENCV``,
          ``OPENCV_FISHEYE``, ``EUCM``;
        - COLMAP's ``rig_config.json`` of one rig, as `load_rig` reads it;
        - OpenSfM's ``camera_models.json``: perspective, radial, brown without k3, fisheye,
          fisheye_opencv, spherical;
        - a camera of ROS's camera_calibration or of OpenCV's calibration samples (YAML or JSON):
          plumb_bob without k3, equidistant.

        Principal points of Kalibr, basalt, ROS and OpenCV are moved by 0.5 px to our pixel
        convention.

    Returns
    -------
    cameras : dict of str to Camera
        Cameras by name, in the order of the file. A single unnamed camera is called "camera";
        COLMAP's cameras are named by their id, or in a rig by the folder of their images; basalt's
        are called "cam0", "cam1" and so on.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be read as one of the formats, or uses a model or a parameter that is
        not supported.
    """
    path = Path(path)
    document = read_document(path)
    for recognizes, read in FORMATS:
        if recognizes(document):
            with fields.naming_file(path):
                return read(document)
    raise ValueError(
        f"calibration file {path} has no cameras that epi360 can read; it reads mappings with "
        "'model' or 'cameras', Kalibr camchains, basalt's JSON, COLMAP's cameras.txt and "
        "rig_config.json, OpenSfM's camera_models.json, and cameras of ROS and OpenCV with "
        "'camera_matrix'"
    )


def load_camera(path: str | os.PathLike[str]) -> Camera:
    """Return the one camera of a calibration file, or one of several.

    Parameters
    ----------
    path : path-like
        A file as in `load_cameras`, or ``FILE:NAME`` for the camera of that name.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be read, holds several cameras, or none of that name.
    """
    file, name = camera_file(path)
    cameras = load_cameras(file)
    if name is not None:
        return camera_of_name(file, cameras, name)
    if len(cameras) > 1:
        raise ValueError(
            f"calibration file {file} must hold one camera, got {len(cameras)}: "
            f"{', '.join(cameras)}; name one as {file}:NAME"
        )
    return next(iter(cameras.values()))


def camera_file(source: str | os.PathLike[str]) -> tuple[Path, str | None]:
    """File and name of ``FILE`` or ``FILE:NAME``; a file whose name has a colon comes first."""
    file, colon, name = os.fspath(source).rpartition(":")
    if not colon or Path(source).exists() or not Path(file).exists():
        return Path(source), None
    return Path(file), name


def camera_of_name(file: Path, cameras: Mapping[str, Camera], name: str) -> Camera:
    """Return the camera of a name; ValueError where the file has none of that name."""
    if name not in cameras:
        raise ValueError(f"{file} has no camera {name!r}; it holds {', '.join(cameras)}")
    return cameras[name]
