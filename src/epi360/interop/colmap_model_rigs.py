# SPDX-License-Identifier: BSD-3-Clause
"""Rigs and frames of COLMAP's sparse models: https://colmap.github.io/format.html.

A frame has one pose, from which those of its images follow. An image never moves for that: where
its pose does not fit the others of its frame, it gets a frame of its own.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count

import numpy as np

from epi360.interop.colmap_model_files import FrameEntry, RigEntry
from epi360.interop.colmap_rigs import CAMERA, cameras_of_rigs, frames_of_images, pose_of_sensor
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.poses import Pose

MAX_DIFFERENCE = 1e-9  # of a rotation's elements; of a translation, relative where it is above 1
Frames = list[list[PosedImage]]


@dataclass(frozen=True, eq=False)
class _Rig:
    """Camera ids, the reference first, and the poses of the others: quaternion, translation."""

    id: int
    camera_ids: list[int]
    poses: list[list[float]]


@dataclass(frozen=True, eq=False)
class _Frame:
    """Pose of the rig: quaternion, translation; (camera id, image id) of its images."""

    id: int
    rig_id: int
    pose: list[float]
    data: list[tuple[int, int]]


def poses_and_frames(
    rigs: list[RigEntry], frames: list[FrameEntry]
) -> tuple[dict[str, Pose], dict[int, str]]:
    """Where cameras sit on the rigs of several, and the frames of their images.

    Parameters
    ----------
    rigs : list of RigEntry
        Cameras without a pose count as alone.
    frames : list of FrameEntry
        Of these rigs.

    Returns
    -------
    cam_from_rig : dict of str to Pose
        By the camera's key.
    frames : dict of int to str
        Frame of each image of these rigs, by the image's id.

    Raises
    ------
    ValueError
        If a pose is damaged, or a camera is on two rigs.
    """
    cam_from_rig: dict[str, Pose] = {}
    shared = set()
    for rig in rigs:
        poses = {key: pose for key, pose in rig.cam_from_rig.items() if pose is not None}
        if len(poses) < 2:
            continue
        shared.add(rig.id)
        for camera, numbers in poses.items():
            if camera in cam_from_rig:
                raise ValueError(f"camera {camera} must be on one rig, it is on two")
            cam_from_rig[camera] = _pose(camera, numbers)
    of_rigs = [frame for frame in frames if frame.rig_id in shared]
    return cam_from_rig, {image: str(frame.id) for frame in of_rigs for image in frame.image_ids}


def keeps_rigs(reconstruction: Reconstruction) -> bool:
    """Whether a model has a place for all of the rigs: frames that fit and join their cameras.

    Parameters
    ----------
    reconstruction : Reconstruction
        One without rigs has nothing to lose.

    Raises
    ------
    ValueError
        If a frame has two images of one camera.
    """
    cam_from_rig = reconstruction.cam_from_rig
    on_rigs = [image for image in reconstruction.images if image.camera in cam_from_rig]
    frames = frames_of_images(on_rigs, cam_from_rig)
    fitting = _fitting_frames(frames, cam_from_rig)
    rigs = cameras_of_rigs(reconstruction.cameras, fitting, cam_from_rig)
    alone = {rig[0] for rig in rigs if len(rig) == 1}
    return len(fitting) == len(frames) and not alone.intersection(cam_from_rig)


def rig_files(reconstruction: Reconstruction, *, text: bool) -> dict[str, bytes]:
    """Content of the files of rigs and frames, by their names.

    Parameters
    ----------
    reconstruction : Reconstruction
        Every image has a camera and a pose. Ids of cameras, rigs and images are 1, 2, ... in its
        order; a frame whose name is a number has it as its id.
    text : bool
        The text files in place of the binary ones.

    Raises
    ------
    ValueError
        If a frame has two images of one camera.
    """
    rigs, frames = _rigs_and_frames(reconstruction)
    if text:
        lines = {"rigs.txt": _rig_lines(rigs), "frames.txt": _frame_lines(frames)}
        return {name: "".join(content).encode("utf-8") for name, content in lines.items()}
    entries = {"rigs.bin": _rig_bytes(rigs), "frames.bin": _frame_bytes(frames)}
    return {
        name: struct.pack("<Q", len(content)) + b"".join(content)
        for name, content in entries.items()
    }


def _pose(camera: str, numbers: tuple[float, ...]) -> Pose:
    pose = pose_of_sensor(np.array(numbers))
    if pose is None:
        raise ValueError(f"camera {camera} must have a pose on its rig, got {list(numbers)}")
    return pose


def _fitting_frames(frames: Frames, cam_from_rig: Mapping[str, Pose]) -> Frames:
    """Frames whose images fit their first one; images that do not have frames of their own."""
    fitting: Frames = []
    for images in frames:
        best = images[:1]
        for first in images:
            others = [other for other in images if other is not first]
            fit = [first, *(other for other in others if _fits(first, other, cam_from_rig))]
            best = max(best, fit, key=len)
            if len(best) == len(images):
                break
        alone = [[image] for image in images if all(image is not other for other in best)]
        fitting += [best, *alone]
    return fitting


def _fits(first: PosedImage, other: PosedImage, cam_from_rig: Mapping[str, Pose]) -> bool:
    """Whether the pose of another image follows from that of the first and the rig."""
    other_from_first = cam_from_rig[str(other.camera)] @ cam_from_rig[str(first.camera)].inverse()
    expected, pose = other_from_first @ first.cam_from_world, other.cam_from_world
    rotation = np.abs(expected.rotation - pose.rotation).max()
    translation = np.abs(expected.translation - pose.translation).max()
    length = max(1.0, float(np.linalg.norm(pose.translation)))
    return bool(rotation <= MAX_DIFFERENCE and translation <= MAX_DIFFERENCE * length)


def _rigs_and_frames(reconstruction: Reconstruction) -> tuple[list[_Rig], list[_Frame]]:
    cam_from_rig = reconstruction.cam_from_rig
    camera_ids = {name: number for number, name in enumerate(reconstruction.cameras, start=1)}
    image_ids = {image.name: number for number, image in enumerate(reconstruction.images, start=1)}
    together = frames_of_images(reconstruction.images, cam_from_rig)
    fitting = _fitting_frames(together, cam_from_rig)
    rigs: list[_Rig] = []
    rig_ids: dict[str, int] = {}
    cam_from_reference: dict[str, Pose] = {}
    cameras_by_rig = cameras_of_rigs(reconstruction.cameras, fitting, cam_from_rig)
    for rig_id, (reference, *others) in enumerate(cameras_by_rig, start=1):
        cam_from_reference[reference] = Pose(np.eye(3), np.zeros(3))
        for name in others:
            cam_from_reference[name] = cam_from_rig[name] @ cam_from_rig[reference].inverse()
        cameras = [reference, *others]
        rig_ids |= dict.fromkeys(cameras, rig_id)
        poses = [_numbers(cam_from_reference[name]) for name in others]
        rigs.append(_Rig(rig_id, [camera_ids[name] for name in cameras], poses))
    frames = []
    for frame_id, images in zip(_frame_ids(fitting, cam_from_rig), fitting, strict=True):
        camera = str(images[0].camera)
        pose = cam_from_reference[camera].inverse() @ images[0].cam_from_world
        data = [(camera_ids[str(image.camera)], image_ids[image.name]) for image in images]
        frames.append(_Frame(frame_id, rig_ids[camera], _numbers(pose), sorted(data)))
    return rigs, frames


def _frame_ids(frames: Frames, cam_from_rig: Mapping[str, Pose]) -> list[int]:
    """Ids of the frames: the number that is the name, once, else one that is free."""
    names = [images[0].frame or "" if images[0].camera in cam_from_rig else "" for images in frames]
    numbers = [int(name) if re.fullmatch("[1-9][0-9]{0,8}", name) else None for name in names]
    taken = set(numbers)
    free = (number for number in count(1) if number not in taken)
    ids: dict[int, None] = {}  # in order
    for number in numbers:
        ids[next(free) if number is None or number in ids else number] = None
    return list(ids)


def _numbers(pose: Pose) -> list[float]:
    return [*pose.quaternion_wxyz.tolist(), *pose.translation.tolist()]


def _rig_bytes(rigs: list[_Rig]) -> list[bytes]:
    return [
        struct.pack("<IIiI", rig.id, len(rig.camera_ids), CAMERA, rig.camera_ids[0])
        + b"".join(
            struct.pack("<iIB7d", CAMERA, camera_id, 1, *pose)
            for camera_id, pose in zip(rig.camera_ids[1:], rig.poses, strict=True)
        )
        for rig in rigs
    ]


def _frame_bytes(frames: list[_Frame]) -> list[bytes]:
    return [
        struct.pack("<II7dI", frame.id, frame.rig_id, *frame.pose, len(frame.data))
        + b"".join(struct.pack("<iIQ", CAMERA, *ids) for ids in frame.data)
        for frame in frames
    ]


def _rig_lines(rigs: list[_Rig]) -> list[str]:
    lines = ["# RIG_ID NUM_SENSORS REF_SENSOR_TYPE REF_SENSOR_ID SENSORS[] as TYPE ID 1 POSE\n"]
    for rig in rigs:
        words: list[float | str] = [rig.id, len(rig.camera_ids), "CAMERA", rig.camera_ids[0]]
        for camera_id, pose in zip(rig.camera_ids[1:], rig.poses, strict=True):
            words += ["CAMERA", camera_id, 1, *pose]
        lines.append(_line(words))
    return lines


def _frame_lines(frames: list[_Frame]) -> list[str]:
    lines = ["# FRAME_ID RIG_ID QW QX QY QZ TX TY TZ NUM_DATA DATA[] as TYPE SENSOR_ID DATA_ID\n"]
    for frame in frames:
        words: list[float | str] = [frame.id, frame.rig_id, *frame.pose, len(frame.data)]
        for ids in frame.data:
            words += ["CAMERA", *ids]
        lines.append(_line(words))
    return lines


def _line(words: list[float | str]) -> str:
    return " ".join(map(str, words)) + "\n"
