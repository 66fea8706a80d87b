# SPDX-License-Identifier: BSD-3-Clause
"""Rigs and frames of COLMAP: which images were taken at one moment, by which cameras.

COLMAP 4 maps frames, each of one rig: a camera alone is a rig of one sensor, and each of its images
a frame. A rig's frame is that of its reference sensor.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from epi360.extras import extra_library
from epi360.interop.colmap_pairs import ColmapPairs
from epi360.interop.match_graph import MatchGraph
from epi360.poses import Pose, pose_from_quaternion

CAMERA = 0  # SensorType of the tables and of binary files


class _Shot(Protocol):
    """What a matched and a posed image share."""

    @property
    def name(self) -> str: ...
    @property
    def camera(self) -> str | None: ...
    @property
    def frame(self) -> str | None: ...


Shot = TypeVar("Shot", bound=_Shot)


def frames_of_images(images: Iterable[Shot], cam_from_rig: Mapping[str, Pose]) -> list[list[Shot]]:
    """Images of each frame, in the order of their first images.

    Parameters
    ----------
    images : iterable of MatchedImage or PosedImage
        One whose camera is on no rig is alone.
    cam_from_rig : mapping of str to Pose
        By the camera's key.

    Raises
    ------
    ValueError
        If a frame has two images of one camera.
    """
    frames: dict[tuple[str, str | None], list[Shot]] = defaultdict(list)
    for image in images:
        shares = image.frame is not None and image.camera in cam_from_rig
        frames[("frame", image.frame) if shares else ("image", image.name)].append(image)
    for shots in frames.values():
        if len({image.camera for image in shots}) < len(shots):
            raise ValueError(f"frame {shots[0].frame!r} must have one image a camera")
    return list(frames.values())


def cameras_of_rigs(
    cameras: Iterable[str], frames: Iterable[list[Shot]], cam_from_rig: Mapping[str, Pose]
) -> list[list[str]]:
    """Cameras of each rig, its reference first: joined by frames, directly or over others.

    Parameters
    ----------
    cameras : iterable of str
        Keys of all.
    frames : iterable of list of MatchedImage or PosedImage
        Of `frames_of_images`.
    cam_from_rig : mapping of str to Pose
        The first one of a rig is its reference.
    """
    joined = {name: {name} for name in cameras}
    for images in frames:
        together = set.union(*(joined[str(image.camera)] for image in images))
        for name in together:
            joined[name] = together
    order = {name: rank for rank, name in enumerate(cam_from_rig)}
    rigs = {id(rig): rig for rig in joined.values()}
    return [sorted(rig, key=lambda name: order.get(name, 0)) for rig in rigs.values()]


def write_rigs(database: Any, graph: MatchGraph, camera_ids: dict[str, int]) -> dict[str, int]:
    """Write the rigs: cameras that share a frame are in one, others alone.

    Parameters
    ----------
    database : pycolmap.Database
        With the cameras.
    graph : MatchGraph
        The first camera of its ``cam_from_rig`` on a rig is its reference.
    camera_ids : dict of str to int
        Of the cameras in the database.

    Returns
    -------
    rig_ids : dict of str to int
        Rig of each camera.
    """
    pycolmap = _pycolmap()
    frames = frames_of_images(graph.images.values(), graph.cam_from_rig)
    rig_ids: dict[str, int] = {}
    for cameras in cameras_of_rigs(graph.cameras, frames, graph.cam_from_rig):
        reference, *others = cameras
        rig = pycolmap.Rig()
        rig.add_ref_sensor(_sensor(camera_ids[reference]))
        for other in others:
            pose = graph.cam_from_rig[other] @ graph.cam_from_rig[reference].inverse()
            rig.add_sensor(_sensor(camera_ids[other]), pycolmap.Rigid3d(pose.matrix()[:3]))
        rig_ids |= dict.fromkeys(cameras, database.write_rig(rig))
    return rig_ids


def write_frames(
    database: Any,
    graph: MatchGraph,
    image_ids: dict[str, int],
    camera_ids: dict[str, int],
    rig_ids: dict[str, int],
) -> None:
    """Write the frames, in the order of their first images.

    Parameters
    ----------
    database : pycolmap.Database
        With the images and rigs.
    graph : MatchGraph
        Its images.
    image_ids, camera_ids, rig_ids : dict of str to int
        Of the images, of the cameras, and the rig of each camera.

    Raises
    ------
    ValueError
        If a frame has two images of one camera.
    """
    pycolmap = _pycolmap()
    for images in frames_of_images(graph.images.values(), graph.cam_from_rig):
        cameras = [str(image.camera) for image in images]
        frame = pycolmap.Frame()
        frame.rig_id = rig_ids[cameras[0]]
        for image, camera in zip(images, cameras, strict=True):
            sensor = _sensor(camera_ids[camera])
            frame.add_data_id(pycolmap.data_t(sensor, image_ids[image.name]))
        database.write_frame(frame)


def read_rigs(pairs: ColmapPairs) -> tuple[dict[str, Pose], dict[str, str]]:
    """Where cameras sit on the rigs of several, and the frames of their images.

    Parameters
    ----------
    pairs : ColmapPairs
        The open database; before COLMAP 3.12 there were no rigs.

    Returns
    -------
    cam_from_rig : dict of str to Pose
        By the camera's key, the identity for reference cameras; those that COLMAP has no pose for
        are left out.
    frames : dict of str to str
        Frame of each image of these rigs, by the image's name.

    Raises
    ------
    ValueError
        If a pose is damaged.
    """
    if not (pairs.has_columns("rigs", "rig_id") and pairs.has_columns("frame_data", "frame_id")):
        return {}, {}
    query = (
        "SELECT ref_sensor_id, NULL AS sensor_from_rig FROM rigs "
        "WHERE ref_sensor_type = ? AND rig_id IN (SELECT rig_id FROM rig_sensors) "
        "UNION ALL SELECT sensor_id, sensor_from_rig FROM rig_sensors "
        "WHERE sensor_type = ? AND sensor_from_rig NOT NULL"
    )
    cam_from_rig = {}
    for camera_id, blob in pairs.rows(query, CAMERA, CAMERA):
        cam_from_rig[str(camera_id)] = _pose(pairs, camera_id, blob)
    query = (
        "SELECT images.name, frame_id FROM frame_data JOIN frames USING (frame_id) "
        "JOIN images ON images.image_id = data_id "
        "WHERE sensor_type = ? AND rig_id IN (SELECT rig_id FROM rig_sensors)"
    )
    return cam_from_rig, {name: str(frame) for name, frame in pairs.rows(query, CAMERA)}


def _pose(pairs: ColmapPairs, camera_id: int, blob: bytes | None) -> Pose:
    """Pose of a sensor's quaternion and translation; the reference sensor has none."""
    if blob is None:
        return Pose(np.eye(3), np.zeros(3))
    what = f"pose of camera {camera_id} on its rig"
    numbers = pairs.array((1, 7, blob), np.float64, what)[0]
    pose = pose_of_sensor(numbers)
    if pose is None:
        raise pairs.error(f"{what} must be a quaternion and a translation, got {numbers.tolist()}")
    return pose


def pose_of_sensor(numbers: NDArray[np.float64]) -> Pose | None:
    """Pose of a quaternion and a translation, seven numbers; None where they are damaged."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(numbers[:4])
    if not (0 < length < np.inf and np.isfinite(numbers).all()):
        return None
    return pose_from_quaternion(numbers[4:], numbers[:4] / length)


def _sensor(camera_id: int) -> Any:
    pycolmap = _pycolmap()
    return pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)


def _pycolmap() -> Any:
    return extra_library("pycolmap", extra="colmap", purpose="COLMAP databases")
