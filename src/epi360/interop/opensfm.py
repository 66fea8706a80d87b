# SPDX-License-Identifier: BSD-3-Clause
"""OpenSfM's reconstruction.json, alone or in a project's folder.

It is a list of reconstructions, each with cameras (as in camera_models.json), shots and points. A
shot holds cam_from_world as axis times angle and translation, with the axes x right, y down, z
forward. The observations are not in this file but in tracks.csv. Frames and models are described in
https://opensfm.org/docs/geometry.html, the keys in opensfm/io.py of mapillary/OpenSfM. In a folder,
its commands export_ply, undistort and bundle also ask for camera_models.json, tracks.csv and, for
each image, exif/NAME.exif; compute_statistics for reference_lla.json.
"""

import json
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular, KannalaBrandt
from epi360.cameras.base import FocalCamera
from epi360.cameras.calibration import fields
from epi360.cameras.calibration.opensfm import read as cameras_from_document
from epi360.interop import checks
from epi360.interop.opensfm_pictures import (
    IMAGE_LIST,
    find_pictures,
    image_list_of,
    link_picture,
    missing_links,
    names_in_list,
    paths_of_pictures,
    shot_name,
)
from epi360.interop.opensfm_tracks import read_tracks, tracks_of
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.poses import Pose, rotation_from_vector, vector_from_rotation
from epi360.runs.inside import inside
from epi360.runs.whole_files import PathLike, whole_paths, write_file

WHAT = "a reconstruction.json of OpenSfM"
RECONSTRUCTION, CAMERA_MODELS, TRACKS = "reconstruction.json", "camera_models.json", "tracks.csv"
CONFIG, REFERENCE = "config.yaml", "reference_lla.json"
# Without these, bundle turns the world so that z is up, and refines calibrations.
KEEP_THE_MODEL = b"align_method: naive\noptimize_camera_parameters: no\n"


def read_opensfm(path: PathLike) -> Reconstruction:
    """Return the largest reconstruction of a ``reconstruction.json``, or of a project's folder.

    If it holds several reconstructions, which have no common frame, a warning says how many shots
    are left out; another one names what has no place here: rigs, GPS. Images have the names of the
    shots, with the folders that a project's ``image_list.txt`` gives them. Their time stamps are
    ``capture_time`` in seconds, or None if all of these are 0. The observations are those of
    ``tracks.csv`` if a folder is given that has it, else there are none.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If it is not such a file, a camera has a model that `load_cameras` does not read, or a pose,
        point or track is incomplete or not finite.
    """
    folder = Path(path)
    path = folder / RECONSTRUCTION if folder.is_dir() else folder
    document = checks.read_json(path, WHAT)
    try:
        chosen = _largest(document)
        cameras = cameras_from_document(chosen["cameras"])
        images = tuple(_image(name, shot) for name, shot in chosen["shots"].items())
        if not any(image.timestamp_s for image in images):  # OpenSfM writes 0 for an unknown time
            images = tuple(replace(image, timestamp_s=None) for image in images)
        entries = checks.mapping(chosen.get("points", {}), "points")
        points, colors = _points(entries)
        reconstruction = Reconstruction(cameras, images, points, colors)
        left_out = _left_out(chosen)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    if path != folder and (folder / TRACKS).is_file():
        rows = {name: row for row, name in enumerate(entries)}
        seen = read_tracks(folder / TRACKS, reconstruction, rows)
        reconstruction = replace(reconstruction, observations=seen)
    if path != folder:
        reconstruction = _renamed(reconstruction, names_in_list(folder))
    if left_out:
        warnings.warn(f"{path}: its {' and '.join(left_out)} are left out", stacklevel=2)
    parts = document if isinstance(document, list) else [document]
    num_shots = sum(len(part["shots"]) for part in parts)
    if len(images) < num_shots:
        warnings.warn(
            f"{path} holds {len(parts)} reconstructions without a common frame: took the "
            f"largest, {len(images)} of {num_shots} shots",
            stacklevel=2,
        )
    return reconstruction


def write_opensfm(path: PathLike, reconstruction: Reconstruction) -> None:
    """Write cameras, poses and points, but no observations, as a ``reconstruction.json``.

    `Equirectangular` becomes ``spherical``, `Pinhole` and `UnifiedCamera` with xi = 0 become
    ``brown``, and `KannalaBrandt` becomes ``fisheye_opencv``, which has no ``max_angle_deg``.

    Raises
    ------
    ValueError
        If an image has no camera or no pose, or OpenSfM has no model for a camera.
    OSError
        If the file cannot be written.
    """
    write_file(path, _json_of(_document(reconstruction)))


def write_opensfm_folder(
    folder: PathLike, reconstruction: Reconstruction, *, images: PathLike | None = None
) -> None:
    """Write a reconstruction as the folder of an OpenSfM project, with its observations.

    It gets ``reconstruction.json``, ``camera_models.json``, ``tracks.csv``, ``exif/``,
    ``reference_lla.json`` (zeros), ``config.yaml``, which asks ``bundle`` to keep world and
    calibration, and ``image_list.txt``: the pictures are in ``images/``. With ``images``, the
    folder that the names start from, links to them are put there. OpenSfM's names have no folders,
    which stand in the list alone; where two images have one name, ``a/b.jpg`` becomes ``a_b.jpg``.
    The folder is made if it does not exist; these files are replaced. An observation counts as good
    to one pixel.

    Raises
    ------
    FileNotFoundError
        If ``images`` lacks one of the pictures.
    FileExistsError
        If another picture lies where a link is to be put.
    ValueError
        As `write_opensfm`, or if the name of an image leads out of the folder or has a tab or line
        break, which tracks.csv cannot hold.
    OSError
        If a file cannot be written.
    """
    folder = Path(folder)
    names = [image.name for image in reconstruction.images]
    for name in names:
        inside(folder, name)
    paths = paths_of_pictures(names)
    pictures = {} if images is None else find_pictures(images, names)
    links = missing_links(folder, {paths[name]: picture for name, picture in pictures.items()})
    reconstruction = _renamed(reconstruction, {name: shot_name(paths[name]) for name in names})
    document = _document(reconstruction)
    contents = {
        IMAGE_LIST: image_list_of(list(paths.values())),
        RECONSTRUCTION: _json_of(document),
        CAMERA_MODELS: _json_of(document[0]["cameras"]),
        TRACKS: tracks_of(reconstruction),
        CONFIG: KEEP_THE_MODEL,
        REFERENCE: _json_of({"latitude": 0.0, "longitude": 0.0, "altitude": 0.0}),
    }
    exif = {inside(folder / "exif", f"{each.name}.exif"): each for each in reconstruction.images}
    for path, image in exif.items():
        camera = document[0]["cameras"][image.camera]
        size = {key: camera[key] for key in ("projection_type", "width", "height")}
        time = {"capture_time": image.timestamp_s or 0.0, "orientation": 1, "gps": {}}
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, _json_of({"camera": image.camera, **size, **time}))
    with whole_paths(*(folder / name for name in contents), make_folder=True) as temporaries:
        for temporary, content in zip(temporaries, contents.values(), strict=True):
            temporary.write_bytes(content)
    for link, picture in links.items():
        link_picture(link, picture)


def _renamed(reconstruction: Reconstruction, new_names: Mapping[str, str]) -> Reconstruction:
    images = tuple(
        replace(image, name=new_names.get(image.name, image.name))
        for image in reconstruction.images
    )
    return replace(reconstruction, images=images)


def _json_of(document: Any) -> bytes:
    return json.dumps(document, ensure_ascii=False).encode()


def _document(reconstruction: Reconstruction) -> list[dict[str, Any]]:
    cameras = {
        name: _entry_of_camera(name, camera) for name, camera in reconstruction.cameras.items()
    }
    colors = reconstruction.colors.astype(float).tolist()
    points = zip(reconstruction.points.tolist(), colors, strict=True)
    return [
        {
            "cameras": cameras,
            "shots": {image.name: _entry_of_image(image) for image in reconstruction.images},
            "points": {
                str(index): {"coordinates": point, "color": color}
                for index, (point, color) in enumerate(points)
            },
        }
    ]


def _largest(document: Any) -> Mapping[str, Any]:
    if isinstance(document, Mapping) and "shots" in document:
        document = [document]  # one reconstruction that somebody took out of its list
    if not isinstance(document, list) or not document:
        raise ValueError(f"{WHAT} must be a list of reconstructions, with one at least")
    for number, part in enumerate(document):
        fields.check_has(checks.mapping(part, f"reconstruction {number}"), ("cameras", "shots"))
        checks.mapping(part["shots"], f"shots of reconstruction {number}")
    largest: Mapping[str, Any] = max(document, key=lambda part: len(part["shots"]))
    return largest


def _left_out(chosen: Mapping[str, Any]) -> list[str]:
    """What a reconstruction holds that has no place in ours, in words."""
    rigs = checks.mapping(chosen.get("rig_instances", {}), "rig_instances").values()
    shots_of_rigs = [rig.get("rig_camera_ids") for rig in rigs if isinstance(rig, Mapping)]
    has_rigs = any(isinstance(shots, Mapping) and len(shots) > 1 for shots in shots_of_rigs)
    origin = checks.mapping(chosen.get("reference_lla", {}), "reference_lla")
    positions = [shot.get("gps_position") for shot in chosen["shots"].values()]
    has_gps = any(isinstance(position, list) and any(position) for position in positions)
    has_gps = has_gps or any(origin.values())
    return ["rigs"] * has_rigs + ["GPS positions and their origin"] * has_gps


def _image(name: str, shot: Any) -> PosedImage:
    try:
        fields.check_has(checks.mapping(shot, "it"), ("rotation", "translation", "camera"))
        rotation = checks.finite_array(shot["rotation"], (3,), "rotation")
        translation = checks.finite_array(shot["translation"], (3,), "translation")
        time = shot.get("capture_time")
        if time is not None:
            time = float(checks.finite_array([time], (1,), "capture_time")[0])
        pose = Pose(rotation_from_vector(rotation), translation)
    except ValueError as error:
        raise ValueError(f"shot {name}: {error}") from None
    return PosedImage(name, str(shot["camera"]), pose, time)


def _points(entries: Mapping[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Coordinates (P, 3) and colors (P, 3), checked together: there may be millions."""
    try:
        rows = [(*entry["coordinates"], *entry["color"]) for entry in entries.values()]
        table = np.array(rows, dtype=np.float64).reshape(-1, 6)
        good = len(table) == len(rows) and bool(np.isfinite(table).all())
    except (TypeError, KeyError, ValueError, OverflowError):
        good = False
    if not good:
        raise ValueError(f"point {_bad_point(entries)} must hold coordinates and color, 3 numbers")
    return table[:, :3].copy(), np.clip(np.round(table[:, 3:]), 0, 255).astype(np.uint8)


def _bad_point(entries: Mapping[str, Any]) -> str:
    for name, entry in entries.items():
        try:
            checks.finite_array(entry["coordinates"], (3,), name)
            checks.finite_array(entry["color"], (3,), name)
        except (TypeError, KeyError, ValueError):
            return name
    raise AssertionError("all points are good")


def _entry_of_image(image: PosedImage) -> dict[str, Any]:
    pose = checks.known_pose(image)
    entry: dict[str, Any] = {
        "rotation": vector_from_rotation(pose.rotation).tolist(),
        "translation": pose.translation.tolist(),
        "camera": checks.known_camera(image, "OpenSfM"),
    }
    if image.timestamp_s is not None:
        entry["capture_time"] = image.timestamp_s
    return entry


def _entry_of_camera(name: str, camera: Camera) -> dict[str, Any]:
    """Entry that `load_cameras` reads back; its unit is the larger side of the image."""
    size = {"width": camera.width, "height": camera.height}
    if isinstance(camera, Equirectangular):
        # In OpenSfM the width is 360 degrees about +z, and pixels are square.
        if camera != Equirectangular(
            **size, vertical_fov_deg=min(180, 360 * camera.height / camera.width)
        ):
            raise ValueError(
                f"camera {name}: OpenSfM has only whole panoramas, 360 degrees wide with square "
                "pixels; paste the part into a whole one"
            )
        return {"projection_type": "spherical", **size}
    lens = checks.lens_coefficients(name, camera, "OpenSfM")
    assert isinstance(camera, FocalCamera)  # all others have been refused
    is_fisheye = isinstance(camera, KannalaBrandt)
    if not is_fisheye:
        lens = dict.fromkeys(("k1", "k2", "k3", "p1", "p2"), 0.0) | lens
    side = max(camera.width, camera.height)
    return {
        "projection_type": "fisheye_opencv" if is_fisheye else "brown",
        **size,
        "focal_x": camera.fx / side,
        "focal_y": camera.fy / side,
        "c_x": (camera.cx - camera.width / 2) / side,
        "c_y": (camera.cy - camera.height / 2) / side,
        **lens,
    }
