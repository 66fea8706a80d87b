# SPDX-License-Identifier: BSD-3-Clause
"""nerfstudio's transforms.json.

``transform_matrix`` maps from the camera to the world, with OpenGL axes in the camera: x right, y
up, z backward. cx and cy are continuous pixels like ours. An ``EQUIRECTANGULAR`` pixel has the
angle theta = -pi (u - cx) / fl_x about the vertical, the angle phi = pi (1/2 + (v - cy) / fl_y)
from straight up, and the direction (-sin theta sin phi, cos phi, -cos theta sin phi). A whole
panorama has fl_x = cx = W / 2, fl_y = H and cy = H / 2. ``applied_transform`` maps the original
world to the saved one, whose z axis points up.

Source: https://docs.nerf.studio/quickstart/data_conventions.html and nerfstudio's cameras.py and
nerfstudio_dataparser.py.
"""

import json
import os
import posixpath
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular, KannalaBrandt, Pinhole, UnifiedCamera
from epi360.cameras.base import FocalCamera, checked_size
from epi360.cameras.calibration import fields
from epi360.interop import checks
from epi360.interop.ply import read_ply_points, write_ply_points
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.interop.upright_world import down_in_world, moved, upright_from_world
from epi360.poses import Pose
from epi360.runs.inside import inside
from epi360.runs.whole_files import PathLike, write_file

WHAT = "a transforms.json of nerfstudio"
_IMAGES = "images"  # nerfstudio's own name of the folder
POINTS_FILE = "sparse_pc.ply"
# What nerfstudio's reader of COLMAP models does with a world in which y points down.
Z_UP_FROM_Y_DOWN = Pose(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.zeros(3))
OPENCV_FROM_OPENGL = Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))  # its own inverse
PERSPECTIVE = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "RADIAL", "SIMPLE_RADIAL")
SUPPORTED = ("EQUIRECTANGULAR", "OPENCV_FISHEYE", *PERSPECTIVE)
SIZE, FOCUS, DISTORTION = ("w", "h"), ("fl_x", "fl_y", "cx", "cy"), ("k1", "k2", "k3", "k4")
INTRINSICS = ("camera_model", *SIZE, *FOCUS, *DISTORTION, "p1", "p2")


def read_nerfstudio(path: PathLike, *, images: str = _IMAGES) -> Reconstruction:
    """Return the cameras, poses and points of a ``transforms.json``.

    They are in the original world: an ``applied_transform`` is undone. Cameras are called "1", "2",
    ... in the order in which frames use them. The folder ``images`` is left out of the image names
    if every ``file_path`` begins with it; it is named as in the file, or as it is seen from here.

    Raises
    ------
    FileNotFoundError
        If the file, or the file of points that it names, does not exist.
    ValueError
        If it is not such a file, a key is missing, a camera has a model that epi360 lacks, or a
        matrix is not finite or holds no rotation.
    """
    path = Path(path)
    document = checks.read_json(path, WHAT)
    try:
        document = checks.mapping(document, "it")
        fields.check_has(document, ["frames"])
        if not isinstance(document["frames"], list) or not document["frames"]:
            raise ValueError("frames must be a list, with one frame at least")
        original_from_saved = _original_from_saved(document)
        # By default, the names are the same wherever the program runs.
        folders = [images] if images == _IMAGES else [images, seen_from(path.parent, images)]
        cameras, posed = _frames(document, original_from_saved, folders)
        points, colors = _points(path, document, original_from_saved)
        return Reconstruction(cameras, posed, points, colors)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def write_nerfstudio(
    path: PathLike,
    reconstruction: Reconstruction,
    *,
    images: str = "images",
    masks: Mapping[str, str] | None = None,
) -> None:
    """Write cameras and poses as a ``transforms.json``, and the points as a PLY beside it.

    Files are replaced: ``path`` and, if there are points, `points_file` in its folder.
    Observations and time stamps are left out. The saved world has z up, by the mean of the cameras'
    y axes (of a cube's faces, that of the panorama), and ``orientation_override`` asks nerfstudio
    to leave it so: it would take the faces up and down for cameras too, and tilt a scene that has
    only one of them by 14 degrees. ``applied_transform`` says how the world was turned; where the
    cameras do not agree on a vertical it is the identity, and nerfstudio orients the scene.

    ``images`` is the folder of the images and ``masks`` the path of the mask of each image, by the
    image's name, both relative to the folder of the file. nerfstudio reads masks of one channel, in
    which black pixels are ignored.

    Raises
    ------
    ValueError
        If an image has no camera or no pose, nerfstudio has no model for a camera or would need
        several, or only some of the images have a mask.
    OSError
        If a file cannot be written.
    """
    path = Path(path)
    camera_model, shared, entries = _camera_entries(reconstruction)
    document: dict[str, Any] = {"camera_model": camera_model, **shared}
    down = down_in_world(reconstruction)
    saved_from_world = Pose(np.eye(3), np.zeros(3))
    if down is not None:
        saved_from_world = Z_UP_FROM_Y_DOWN @ upright_from_world(down)
        document["orientation_override"] = "none"
    document["applied_transform"] = saved_from_world.matrix()[:3].tolist()
    saved = moved(reconstruction, saved_from_world)
    if len(saved.points):
        document["ply_file_path"] = points_file(path).name
    document["frames"] = [
        {
            "file_path": posixpath.join(images, image.name),
            "transform_matrix": _world_from_opengl(image).matrix().tolist(),
            **_mask_path(image, masks or {}),
            **({} if shared else entries[str(image.camera)]),
        }
        for image in saved.images
    ]
    if len(saved.points):
        write_ply_points(points_file(path), saved.points, saved.colors)
    write_file(path, json.dumps(document, ensure_ascii=False, indent=1).encode())


def points_file(path: PathLike) -> Path:
    """File of the points beside a ``transforms.json``, ``sparse_pc.ply``.

    Of a NAME.json, of which a folder may hold several, it is ``NAME_sparse_pc.ply``.
    """
    path = Path(path)
    return path.with_name(
        POINTS_FILE if path.stem == "transforms" else f"{path.stem}_{POINTS_FILE}"
    )


def seen_from(folder: Path, images: PathLike) -> str:
    """Path of images, a folder or a file, as a ``transforms.json`` in a folder has it."""
    target = Path(images).resolve()
    try:
        return Path(os.path.relpath(target, folder.resolve())).as_posix()
    except ValueError:  # on another drive
        return target.as_posix()


def _camera_entries(
    reconstruction: Reconstruction,
) -> tuple[str, dict[str, Any], dict[str, dict[str, Any]]]:
    """The model of all cameras, what all frames share, nothing if they differ, and each by name."""
    used = {checks.known_camera(image, "nerfstudio") for image in reconstruction.images}
    entries = {
        name: _entry_of_camera(name, camera)
        for name, camera in reconstruction.cameras.items()
        if name in used
    }
    model = _one_model({entry.pop("camera_model") for entry in entries.values()})
    first = next(iter(entries.values()))
    return model, first if all(entry == first for entry in entries.values()) else {}, entries


def _original_from_saved(document: Mapping[str, Any]) -> Pose:
    if document.get("applied_scale", 1) != 1:
        raise ValueError("applied_scale is not supported: write the poses without it")
    if "applied_transform" not in document:
        return Pose(np.eye(3), np.zeros(3))
    return checks.pose_of_matrix(document["applied_transform"], "applied_transform").inverse()


def _frames(
    document: Mapping[str, Any], original_from_saved: Pose, folders: Iterable[str]
) -> tuple[dict[str, Camera], tuple[PosedImage, ...]]:
    shared = {key: document[key] for key in INTRINSICS if key in document}
    names = _image_names(document["frames"], folders)
    cameras: dict[Camera, str] = {}
    posed = []
    for number, frame in enumerate(document["frames"]):
        try:
            fields.check_has(frame, ["transform_matrix"])
            # What the file says of all frames goes first, as in nerfstudio.
            camera = _camera({key: frame[key] for key in INTRINSICS if key in frame} | shared)
            saved_from_opengl = checks.pose_of_matrix(frame["transform_matrix"], "transform_matrix")
        except ValueError as error:
            raise ValueError(f"frame {number} ({names[number]}): {error}") from None
        world_from_cam = original_from_saved @ saved_from_opengl @ OPENCV_FROM_OPENGL
        name = cameras.setdefault(camera, str(len(cameras) + 1))
        posed.append(PosedImage(names[number], name, world_from_cam.inverse()))
    return {name: camera for camera, name in cameras.items()}, tuple(posed)


def _image_names(frames: list[Any], folders: Iterable[str]) -> list[str]:
    """Paths of the images below the first folder that has all of them; unchanged if none has."""
    paths = []
    for number, frame in enumerate(frames):
        value = checks.mapping(frame, f"frame {number}").get("file_path")
        if not isinstance(value, str) or not value:
            raise ValueError(f"frame {number} must have a file_path, got {fields.shortened(value)}")
        paths.append(posixpath.normpath(value))
    for folder in folders:
        prefix = posixpath.normpath(folder) + "/"
        if all(path.startswith(prefix) for path in paths):
            return [path.removeprefix(prefix) for path in paths]
    return paths


def _camera(entry: Mapping[str, Any]) -> Camera:
    model = entry.get("camera_model", "OPENCV")  # nerfstudio's default
    if model not in SUPPORTED:
        wanted = f"nerfstudio camera_model {fields.shortened(model)}"
        raise fields.unsupported(wanted, ", ".join(SUPPORTED))
    fields.check_has(entry, (*SIZE, *FOCUS))
    # Some writers give 1920.0, of which nerfstudio makes an integer.
    sizes = [fields.real_number(entry[name], name) for name in SIZE]
    width, height = (
        checked_size(int(size) if size.is_integer() else size, name)
        for size, name in zip(sizes, SIZE, strict=True)
    )
    focus = [fields.real_number(entry[name], name) for name in FOCUS]
    lens = {
        name: fields.real_number(entry.get(name, 0.0), name) for name in (*DISTORTION, "p1", "p2")
    }
    if model == "EQUIRECTANGULAR":
        return _panorama(width, height, *focus)
    for name in ("p1", "p2") if model == "OPENCV_FISHEYE" else ("k3", "k4"):
        if lens.pop(name) != 0:
            raise ValueError(f"{model} with {name} = {entry[name]} is not supported")
    if model == "OPENCV_FISHEYE":
        return KannalaBrandt(width, height, *focus, **lens)
    if any(lens.values()):
        fx, fy, cx, cy = focus
        return UnifiedCamera(width, height, fx, fy, cx, cy, 0.0, **lens)
    return Pinhole(width, height, *focus)


def _panorama(
    width: int, height: int, fl_x: float, fl_y: float, cx: float, cy: float
) -> Equirectangular:
    """Whole panorama or a part, with pi / fl_x radians per column and pi / fl_y per row."""
    for name, value in (("fl_x", fl_x), ("fl_y", fl_y)):
        if not value > 0:
            raise ValueError(f"{name} must be positive, got {value}")
    return Equirectangular(
        width,
        height,
        horizontal_fov_deg=180 * width / fl_x,
        vertical_fov_deg=180 * height / fl_y,
        center_longitude_deg=180 * (width / 2 - cx) / fl_x,
        center_latitude_deg=180 * (cy - height / 2) / fl_y,
    )


def _points(
    path: Path, document: Mapping[str, Any], original_from_saved: Pose
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    name = document.get("ply_file_path")
    if name is None:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    if not isinstance(name, str):
        raise ValueError(f"ply_file_path must be a path, got {fields.shortened(name)}")
    saved, colors = read_ply_points(inside(path.parent, name))
    return saved @ original_from_saved.rotation.T + original_from_saved.translation, colors


def _one_model(models: set[str]) -> str:
    if models == {"PINHOLE", "OPENCV"}:
        return "OPENCV"
    if len(models) != 1:
        raise ValueError(
            "nerfstudio has one camera model a file, the reconstruction needs "
            f"{', '.join(sorted(models)) or 'an image'}; write one file for each"
        )
    return next(iter(models))


def _mask_path(image: PosedImage, masks: Mapping[str, str]) -> dict[str, str]:
    if not masks:
        return {}
    if image.name not in masks:
        raise ValueError(
            f"nerfstudio takes masks of all images or of none, image {image.name} has none"
        )
    return {"mask_path": masks[image.name]}


def _world_from_opengl(image: PosedImage) -> Pose:
    return checks.known_pose(image).inverse() @ OPENCV_FROM_OPENGL


def _entry_of_camera(name: str, camera: Camera) -> dict[str, Any]:
    entry: dict[str, Any] = {"w": camera.width, "h": camera.height}
    if isinstance(camera, Equirectangular):
        fl_x = 180 * camera.width / camera.horizontal_fov_deg
        fl_y = 180 * camera.height / camera.vertical_fov_deg
        cx = camera.width / 2 - camera.center_longitude_deg * fl_x / 180
        cy = camera.height / 2 + camera.center_latitude_deg * fl_y / 180
        focus: tuple[float, ...] = (fl_x, fl_y, cx, cy)
        return {"camera_model": "EQUIRECTANGULAR", **entry, **dict(zip(FOCUS, focus, strict=True))}
    lens = checks.lens_coefficients(name, camera, "nerfstudio")
    assert isinstance(camera, FocalCamera)  # all others have been refused
    focus = (camera.fx, camera.fy, camera.cx, camera.cy)
    model = {Pinhole: "PINHOLE", UnifiedCamera: "OPENCV", KannalaBrandt: "OPENCV_FISHEYE"}
    entry |= {"camera_model": model[type(camera)], **dict(zip(FOCUS, focus, strict=True))}
    return entry | lens
