# SPDX-License-Identifier: BSD-3-Clause
"""Cameras among points, and what they see of them."""

import numpy as np

from epi360.odometry.window import WindowProblem
from epi360.poses import Pose, rotation_from_vector


def directions(rng, count):
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def random_pose(rng):
    return Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))


def noisy(rng, bearings, noise_rad):
    """Bearings with a normal error in both directions of their tangent plane."""
    moved = bearings + noise_rad * rng.normal(size=bearings.shape)
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


def seen_from(pose, points):
    in_camera = points @ pose.rotation.T + pose.translation
    return in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)


def points_around(rng, count, nearest=2.0, farthest=10.0):
    return directions(rng, count) * rng.uniform(nearest, farthest, (count, 1))


def scene(seed, num_points=200, noise_rad=1e-3, outliers=0.0):
    """A pose, points around it and their bearings, the first of which are wrong."""
    rng = np.random.default_rng(seed)
    pose, points = random_pose(rng), points_around(rng, num_points)
    bearings = noisy(rng, seen_from(pose, points), noise_rad)
    wrong = np.arange(num_points) < outliers * num_points
    bearings[wrong] = directions(rng, wrong.sum())
    return pose, points, bearings


def walk(rng, num_frames, step=0.3):
    """Poses cam_from_world along a line, the camera turned at random."""
    centers = step * np.arange(num_frames)[:, None] * [1.0, 0.1, 0.2]
    centers = centers + 0.02 * rng.normal(size=centers.shape)
    rotations = [rotation_from_vector(0.5 * rng.normal(size=3)) for _ in centers]
    return [Pose(R, -R @ c) for R, c in zip(rotations, centers, strict=True)]


def moved(rng, pose, radians=0.01, distance=0.05):
    step = Pose(rotation_from_vector(radians * rng.normal(size=3)), distance * rng.normal(size=3))
    return step @ pose


def window(seed, *, num_frames=6, num_points=60, noise_rad=1e-3, outliers=0.0, num_fixed=2):
    """A problem that starts a little off its truth, and the true poses and points."""
    rng = np.random.default_rng(seed)
    poses, points = walk(rng, num_frames), points_around(rng, num_points)
    seen = rng.random((num_frames, num_points)) < 0.7
    seen[:, seen.sum(axis=0) < 3] = True
    frame, point = np.nonzero(seen)
    bearings = np.stack([
        seen_from(poses[f], points[p : p + 1])[0] for f, p in zip(frame, point, strict=True)
    ])  # fmt: skip
    bearings = noisy(rng, bearings, noise_rad)
    wrong = rng.random(len(frame)) < outliers
    bearings[wrong] = directions(rng, wrong.sum())
    fixed = np.arange(num_frames) < num_fixed
    start = [pose if held else moved(rng, pose) for pose, held in zip(poses, fixed, strict=True)]
    problem = WindowProblem(
        np.stack([pose.rotation for pose in start]),
        np.stack([pose.translation for pose in start]),
        points + 0.1 * rng.normal(size=points.shape),
        frame, point, bearings, max(noise_rad, 1e-6), fixed,
    )  # fmt: skip
    return problem, poses, points


def worst_center_error(result, poses):
    pairs = zip(result.cam_from_world, poses, strict=True)
    return max(
        float(np.linalg.norm(a.inverse().translation - b.inverse().translation)) for a, b in pairs
    )
