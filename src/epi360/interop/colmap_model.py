# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP's sparse models: folders of cameras, rigs, frames, images and points, binary or text."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.interop.checks import pose_of_numbers
from epi360.interop.colmap_model_bytes import model_files
from epi360.interop.colmap_model_files import (
    PIXEL,
    ImageEntry,
    PointEntry,
    read_model_files,
    read_rig_files,
)
from epi360.interop.colmap_model_rigs import poses_and_frames
from epi360.interop.reconstruction import Observations, PosedImage, Reconstruction
from epi360.runs.whole_files import PathLike, whole_paths


def read_colmap_model(folder: PathLike) -> Reconstruction:
    """Return the reconstruction of a folder with ``cameras``, ``images`` and ``points3D``.

    The files are .bin or .txt; those of rigs and frames may be missing. A text file may call its
    panoramas SPHERICAL or SPHERE. Cameras, and frames of rigs with several cameras, are named by
    their id. Images and points are in the order of their ids. The pose of a camera is relative to
    the reference sensor of its own rig.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist or holds no model.
    ValueError
        If a file is damaged, or a camera has a model that epi360 lacks.
    """
    folder = Path(folder)
    cameras, images, points = read_model_files(folder)
    rigs = read_rig_files(folder)
    try:
        cam_from_rig, frames = poses_and_frames(*rigs)
        return Reconstruction(
            cameras,
            tuple(replace(_posed(image), frame=frames.get(image.id)) for image in images),
            _positions(points),
            np.array([point.color for point in points], np.uint8).reshape(-1, 3),
            _observations(images, np.array([point.id for point in points], np.int64)),
            cam_from_rig,
        )
    except ValueError as error:
        raise ValueError(f"COLMAP model {folder}: {error}") from None


def write_colmap_model(
    folder: PathLike, reconstruction: Reconstruction, *, text: bool = False
) -> None:
    """Write cameras, rigs, frames, images and points of a reconstruction, all files or none.

    The folder is made if it does not exist; a model in it is replaced. ``text`` writes .txt files
    instead of .bin files. Images that share a ``frame`` become a frame of a rig if their cameras
    are in ``cam_from_rig`` and their poses agree with it to 1e-9. Every other image is a frame of
    its own, and every other camera a rig of its own. A frame whose name is a number has it as its
    id; other ids are 1, 2, ... in the order of the reconstruction. Only key points with an
    observation are written.

    Raises
    ------
    ValueError
        If there is no image, an image has no camera or no pose, an image name in a text file has a
        space, COLMAP lacks the model of a camera, a frame has two images of one camera, or the
        folder holds a model of the other kind.
    OSError
        If the folder cannot be written.
    """
    folder = Path(folder)
    other = "bin" if text else "txt"
    if (folder / f"images.{other}").exists():
        raise ValueError(f"folder {folder} has a COLMAP model in .{other} already; take another")
    files = model_files(reconstruction, text=text)
    folder.mkdir(parents=True, exist_ok=True)
    with whole_paths(*(folder / name for name in files)) as temporaries:
        for temporary, (name, data) in zip(temporaries, files.items(), strict=True):
            try:
                temporary.write_bytes(data)
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(folder / name)) from None


def _posed(image: ImageEntry) -> PosedImage:
    if not (np.isfinite(image.pose[4:]).all() and np.isfinite(image.pixels["pixel"]).all()):
        raise ValueError(f"translation and key points of image {image.name} must be finite")
    pose = pose_of_numbers(image.pose, f"image {image.name} must have a rotation")
    return PosedImage(image.name, image.camera, pose)


def _positions(points: list[PointEntry]) -> NDArray[np.float64]:
    positions = np.array([point.xyz for point in points]).reshape(-1, 3)
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if len(bad):
        raise ValueError(f"point {points[bad[0]].id} must be finite")
    return positions


def _observations(images: list[ImageEntry], point_ids: NDArray[np.int64]) -> Observations | None:
    """Key points with a point; ``point_ids`` are sorted."""
    seen = [image.pixels[image.pixels["point"] >= 0] for image in images]
    table = np.concatenate(seen) if seen else np.zeros(0, PIXEL)
    if not len(table):
        return None
    rows = np.searchsorted(point_ids, table["point"])
    if not np.isin(table["point"], point_ids).all():
        raise ValueError("images have key points of points that are not there")
    indices = np.repeat(np.arange(len(seen)), [len(pixels) for pixels in seen])
    return Observations(rows, indices, np.array(table["pixel"]))
