# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a table, and poses between two of them."""

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose, rotation_from_vector, vector_from_rotation


def interpolate_pose(before: Pose, after: Pose, share: float) -> Pose:
    """Pose between two: linear in the translation, at constant turning speed in the rotation."""
    # Spherical linear interpolation (Shoemake, SIGGRAPH 1985), written with rotation vectors.
    turn = vector_from_rotation(before.rotation.T @ after.rotation)
    rotation = before.rotation @ rotation_from_vector(share * turn)
    translation = (1 - share) * before.translation + share * after.translation
    return Pose(rotation, translation)


def poses_at_times(
    known_ns: NDArray[np.int64],
    world_from_body: list[Pose],
    wanted_ns: NDArray[np.int64],
    max_gap_ns: int,
) -> list[Pose | None]:
    """Pose at each wanted time, None if the known poses around it are too far from each other."""
    poses: list[Pose | None] = []
    for time in wanted_ns:
        after = int(np.searchsorted(known_ns, time))
        if after < len(known_ns) and known_ns[after] == time:
            poses.append(world_from_body[after])
        elif 0 < after < len(known_ns) and known_ns[after] - known_ns[after - 1] <= max_gap_ns:
            share = (time - known_ns[after - 1]) / (known_ns[after] - known_ns[after - 1])
            pair = world_from_body[after - 1], world_from_body[after]
            poses.append(interpolate_pose(*pair, float(share)))
        else:
            poses.append(None)
    return poses
