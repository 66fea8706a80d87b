# SPDX-License-Identifier: BSD-3-Clause
"""Small match graphs with known poses."""

import numpy as np

from epi360.cameras import Equirectangular
from epi360.interop import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.poses import Pose, rotation_from_vector

PANORAMA = Equirectangular(2000, 1000)


def panoramas_of_points(count=5, num_points=200, noise_px=0.3, seed=0, num_shifted=0):
    """Poses cam_from_world, and the graph of all pairs of panoramas that see points all around.

    ``num_shifted`` of them have a copy two metres away, which they are matched with.
    """
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(num_points, 3))
    points *= (rng.uniform(2, 6, num_points) / np.linalg.norm(points, axis=1))[:, None]
    points = np.concatenate([points, points[:num_shifted] + [2.0, 0.0, 0.0]])
    poses = {
        f"pano/ä {index}.jpg": Pose(
            rotation_from_vector(0.5 * rng.normal(size=3)), 0.5 * rng.normal(size=3)
        )
        for index in range(count)
    }
    images = {}
    for name, pose in poses.items():
        pixels = PANORAMA.pixels_from_bearings(points @ pose.rotation.T + pose.translation)
        pixels += noise_px * rng.normal(size=pixels.shape)
        images[name] = MatchedImage(name, "theta", pixels)
    matches = np.column_stack([np.arange(num_points)] * 2)
    matches[:num_shifted, 1] += num_points
    pairs = tuple(
        MatchedPair(
            name1,
            name2,
            matches,
            TwoViewGeometry("ok", relative_pose(poses[name1], poses[name2]), matches),
        )
        for name1 in poses
        for name2 in poses
        if name1 < name2
    )
    return poses, MatchGraph({"theta": PANORAMA}, images, pairs)


def relative_pose(cam1_from_world, cam2_from_world):
    """cam2_from_cam1 with |t| = 1."""
    pose = cam2_from_world @ cam1_from_world.inverse()
    return Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))
