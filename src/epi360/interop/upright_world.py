# SPDX-License-Identifier: BSD-3-Clause
"""A world whose y axis points down: the one place that says where down is in a reconstruction.

COLMAP takes -y for up, nerfstudio z. Images alone do not say where gravity points, but cameras are
held upright: the mean of their y axes is down, whatever their headings.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from epi360.interop.reconstruction import Reconstruction
from epi360.poses import Pose, rotation_from_vector, vector_from_rotation

DOWN = np.array([0.0, 1.0, 0.0])
# The mean of unit vectors is as long as this if each is 45 degrees from it. A camera that looks
# down and turns has a mean of nearly zero.
SHORTEST_MEAN = 0.7
# A world is left as it is if it is upright to this angle; rounding alone makes about 1e-15.
SMALLEST_TURN_RAD = 1e-9


def down_in_world(reconstruction: Reconstruction) -> NDArray[np.float64] | None:
    """Unit vector (3,) that points down in the world; None if the cameras do not agree on it.

    Cameras of a rig, such as the faces of a cube, say what the frame of their rig says.
    """
    rig_from_cam = {name: each.inverse() for name, each in reconstruction.cam_from_rig.items()}
    upright = Pose(np.eye(3), np.zeros(3))
    return mean_down(
        (rig_from_cam.get(str(image.camera), upright) @ image.cam_from_world).rotation
        for image in reconstruction.images
    )


def mean_down(
    camera_from_world: Iterable[NDArray[np.float64]],
) -> NDArray[np.float64] | None:
    """Mean direction of the y axes of rotations (3, 3), those of NaN left out; None if unclear."""
    axes = np.array([rotation[1] for rotation in camera_from_world]).reshape(-1, 3)
    axes = axes[np.isfinite(axes).all(axis=1)]
    mean = axes.mean(axis=0) if len(axes) else np.zeros(3)
    length = float(np.linalg.norm(mean))
    return mean / length if length >= SHORTEST_MEAN else None


def upright_from_world(down: NDArray[np.float64] | None) -> Pose:
    """Smallest rotation of the world that turns down to +y; the identity if it is not known."""
    if down is None:
        return Pose(np.eye(3), np.zeros(3))
    axis = np.cross(down, DOWN)
    sine = float(np.linalg.norm(axis))
    axis = axis / sine if sine > 0 else np.array([1.0, 0.0, 0.0])
    return Pose(rotation_from_vector(np.arctan2(sine, down @ DOWN) * axis), np.zeros(3))


def made_upright(reconstruction: Reconstruction) -> tuple[Reconstruction, Pose]:
    """Reconstruction in an upright world, and how that was turned from the given one.

    It is the given one, and the turn the identity, if that is upright or the cameras do not agree.
    """
    turn = upright_from_world(down_in_world(reconstruction))
    if np.linalg.norm(vector_from_rotation(turn.rotation)) <= SMALLEST_TURN_RAD:
        return reconstruction, Pose(np.eye(3), np.zeros(3))
    return moved(reconstruction, turn), turn


def moved(reconstruction: Reconstruction, new_from_world: Pose) -> Reconstruction:
    """Reconstruction in another world."""
    world_from_new = new_from_world.inverse()
    images = tuple(
        replace(image, cam_from_world=image.cam_from_world @ world_from_new)
        for image in reconstruction.images
    )
    points = reconstruction.points @ new_from_world.rotation.T + new_from_world.translation
    return replace(reconstruction, images=images, points=points)
