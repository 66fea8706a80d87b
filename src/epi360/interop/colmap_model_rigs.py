# SPDX-License-Identifier: BSD-3-Clause
"""Rigs and frames of COLMAP's sparse models.

A frame has one pose, from which the poses of its images follow. An image is never moved for that:
if its pose does not agree with the others of its frame, it gets a frame of its own.
"""

import re
from collections.abc import Mapping
from itertools import count
from typing import NamedTuple

import numpy as np

from epi360.interop.checks import pose_of_numbers
from epi360.interop.colmap_model_files import FrameEntry, RigEntry
from epi360.interop.colmap_rigs import cameras_of_rigs, frames_of_images
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.poses import Pose

# Largest difference of a rotation's elements, and of a translation relative to max(1, its length).
MAX_DIFFERENCE = 1e-9
Frames = list[list[PosedImage]]


class Rig(NamedTuple):
    """Ids of the cameras, the reference first; the others have poses as in `pose_numbers`."""

    id: int
    camera_ids: list[int]
    poses: list[list[float]]


class Frame(NamedTuple):
    """Pose of the rig as in `pose_numbers`; (camera id, image id) of each image."""

    id: int
    rig_id: int
    pose: list[float]
    data: list[tuple[int, int]]


def pose_numbers(pose: Pose) -> list[float]:
    """Return quaternion, w first, and translation of a pose."""
    return [*pose.quaternion_wxyz.tolist(), *pose.translation.tolist()]


def poses_and_frames(
    rigs: list[RigEntry], frames: list[FrameEntry]
) -> tuple[dict[str, Pose], dict[int, str]]:
    """Return the poses on rigs of several cameras, and the frame of each image of these rigs."""
    cam_from_rig: dict[str, Pose] = {}
    shared = {rig.id for rig in rigs if len(rig.cam_from_rig) > 1}
    for rig in rigs:
        for camera, numbers in rig.cam_from_rig.items() if rig.id in shared else ():
            if camera in cam_from_rig:
                raise ValueError(f"camera {camera} must be on one rig, it is on two")
            what = f"camera {camera} must have a pose on its rig"
            cam_from_rig[camera] = pose_of_numbers(numbers, what)
    names = {
        image_id: str(frame.id)
        for frame in frames
        if frame.rig_id in shared
        for image_id in frame.image_ids
    }
    return cam_from_rig, names


def keeps_rigs(reconstruction: Reconstruction) -> bool:
    """Return whether a model can hold all of the rigs: frames agree and join their cameras."""
    cam_from_rig = reconstruction.cam_from_rig
    on_rigs = [image for image in reconstruction.images if image.camera in cam_from_rig]
    frames = frames_of_images(on_rigs, cam_from_rig)
    agreeing = _agreeing_frames(frames, cam_from_rig)
    rigs = cameras_of_rigs(reconstruction.cameras, agreeing, cam_from_rig)
    alone = {rig[0] for rig in rigs if len(rig) == 1}
    return len(agreeing) == len(frames) and not alone.intersection(cam_from_rig)


def rigs_and_frames(reconstruction: Reconstruction) -> tuple[list[Rig], list[Frame]]:
    """Return rigs and frames; a frame whose name is a number has it as its id."""
    cam_from_rig = reconstruction.cam_from_rig
    camera_ids = {name: number for number, name in enumerate(reconstruction.cameras, start=1)}
    image_ids = {image.name: number for number, image in enumerate(reconstruction.images, start=1)}
    images_by_frame = _agreeing_frames(
        frames_of_images(reconstruction.images, cam_from_rig), cam_from_rig
    )
    rigs: list[Rig] = []
    rig_ids: dict[str, int] = {}
    cam_from_reference: dict[str, Pose] = {}
    cameras_by_rig = cameras_of_rigs(reconstruction.cameras, images_by_frame, cam_from_rig)
    for rig_id, (reference, *others) in enumerate(cameras_by_rig, start=1):
        cam_from_reference[reference] = Pose(np.eye(3), np.zeros(3))
        for name in others:
            cam_from_reference[name] = cam_from_rig[name] @ cam_from_rig[reference].inverse()
        cameras = [reference, *others]
        rig_ids |= dict.fromkeys(cameras, rig_id)
        poses = [pose_numbers(cam_from_reference[name]) for name in others]
        rigs.append(Rig(rig_id, [camera_ids[name] for name in cameras], poses))
    frames = []
    frame_ids = _frame_ids(images_by_frame, cam_from_rig)
    for frame_id, images in zip(frame_ids, images_by_frame, strict=True):
        camera = str(images[0].camera)
        pose = cam_from_reference[camera].inverse() @ images[0].cam_from_world
        data = [(camera_ids[str(image.camera)], image_ids[image.name]) for image in images]
        frames.append(Frame(frame_id, rig_ids[camera], pose_numbers(pose), sorted(data)))
    return rigs, frames


def _agreeing_frames(frames: Frames, cam_from_rig: Mapping[str, Pose]) -> Frames:
    """Frames of the most images that agree; every other image becomes a frame of its own."""
    agreeing: Frames = []
    for images in frames:
        largest = images[:1]
        for first in images:
            others = [image for image in images if image is not first]
            group = [first, *(image for image in others if _agrees(first, image, cam_from_rig))]
            largest = max(largest, group, key=len)
            if len(largest) == len(images):
                break
        alone = [[image] for image in images if all(image is not other for other in largest)]
        agreeing += [largest, *alone]
    return agreeing


def _agrees(first: PosedImage, other: PosedImage, cam_from_rig: Mapping[str, Pose]) -> bool:
    other_from_first = cam_from_rig[str(other.camera)] @ cam_from_rig[str(first.camera)].inverse()
    expected, pose = other_from_first @ first.cam_from_world, other.cam_from_world
    rotation = np.abs(expected.rotation - pose.rotation).max()
    translation = np.abs(expected.translation - pose.translation).max()
    length = max(1.0, float(np.linalg.norm(pose.translation)))
    return bool(rotation <= MAX_DIFFERENCE and translation <= MAX_DIFFERENCE * length)


def _frame_ids(frames: Frames, cam_from_rig: Mapping[str, Pose]) -> list[int]:
    """Ids of the frames: the number that is the name, else one that no frame has."""
    names = [images[0].frame or "" if images[0].camera in cam_from_rig else "" for images in frames]
    numbers = [int(name) if re.fullmatch("[1-9][0-9]{0,8}", name) else None for name in names]
    used = set(numbers)
    free = (number for number in count(1) if number not in used)
    ids: dict[int, None] = {}  # a set that keeps its order
    for number in numbers:
        ids[next(free) if number is None or number in ids else number] = None
    return list(ids)
