# SPDX-License-Identifier: BSD-3-Clause
"""Rigs and frames of COLMAP: which images were taken at one moment, by which cameras.

Each frame of COLMAP 4 belongs to a rig. A single camera is a rig of one sensor, and each of its
images is a frame. The coordinate frame of a rig is that of its reference sensor.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from epi360.extras import extra_library
from epi360.interop.checks import pose_of_numbers
from epi360.interop.colmap_pairs import ColmapPairs
from epi360.interop.match_graph import MatchedImage, MatchGraph
from epi360.interop.reconstruction import PosedImage
from epi360.poses import Pose

CAMERA = 0  # the SensorType in tables and binary files
Image = TypeVar("Image", MatchedImage, PosedImage)


def frames_of_images(
    images: Iterable[Image], cam_from_rig: Mapping[str, Pose]
) -> list[list[Image]]:
    """Return the images of each frame; one whose camera is on no rig is a frame of its own."""
    frames: dict[tuple[str, str | None], list[Image]] = defaultdict(list)
    for image in images:
        shares = image.frame is not None and image.camera in cam_from_rig
        frames[("frame", image.frame) if shares else ("image", image.name)].append(image)
    for group in frames.values():
        if len({image.camera for image in group}) < len(group):
            raise ValueError(f"frame {group[0].frame!r} must have one image a camera")
    return list(frames.values())


def cameras_of_rigs(
    cameras: Iterable[str], frames: Iterable[list[Image]], cam_from_rig: Mapping[str, Pose]
) -> list[list[str]]:
    """Return the cameras of each rig, which frames join; the first of ``cam_from_rig`` leads."""
    joined = {name: {name} for name in cameras}
    for images in frames:
        rig = set.union(*(joined[str(image.camera)] for image in images))
        for name in rig:
            joined[name] = rig
    order = {name: rank for rank, name in enumerate(cam_from_rig)}
    rigs = {id(rig): rig for rig in joined.values()}
    return [sorted(rig, key=lambda name: order.get(name, 0)) for rig in rigs.values()]


def write_rigs_and_frames(
    database: Any, graph: MatchGraph, image_ids: dict[str, int], camera_ids: dict[str, int]
) -> None:
    """Write the rigs of a graph to a pycolmap database, then the frames in their order."""
    pycolmap = pycolmap_library()
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
    for images in frames:
        cameras = [str(image.camera) for image in images]
        frame = pycolmap.Frame()
        frame.rig_id = rig_ids[cameras[0]]
        for image, camera in zip(images, cameras, strict=True):
            sensor = _sensor(camera_ids[camera])
            frame.add_data_id(pycolmap.data_t(sensor, image_ids[image.name]))
        database.write_frame(frame)


def read_rigs(pairs: ColmapPairs) -> tuple[dict[str, Pose], dict[str, str]]:
    """Return the poses on rigs of several cameras, and the frame of each image of these rigs."""
    # There were no rigs before COLMAP 3.12. A camera without a pose is left out.
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
    """Pose of a sensor on its rig; the reference sensor has no numbers."""
    if blob is None:
        return Pose(np.eye(3), np.zeros(3))
    what = f"pose of camera {camera_id} on its rig"
    numbers = pairs.array((1, 7, blob), np.float64, what)[0]
    try:
        return pose_of_numbers(numbers, f"{what} must be a quaternion and a translation")
    except ValueError as error:
        raise pairs.error(str(error)) from None


def _sensor(camera_id: int) -> Any:
    pycolmap = pycolmap_library()
    return pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id)


def pycolmap_library() -> Any:
    """Return pycolmap, or say how to install it."""
    return extra_library("pycolmap", extra="colmap", purpose="COLMAP databases")


@contextmanager
def quiet(pycolmap: Any) -> Iterator[None]:
    """COLMAP prints nothing: what it returns or raises says whether it failed."""
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level
