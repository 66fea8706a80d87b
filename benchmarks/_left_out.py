# SPDX-License-Identifier: BSD-3-Clause
"""A model without some of its images, and true poses in the world of a model."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping

import numpy as np

from epi360.interop.reconstruction import Observations, Reconstruction
from epi360.jobs.localization.point_errors import world_rays
from epi360.odometry.points import triangulate_tracks
from epi360.poses import Pose


def model_without(model: Reconstruction, names: Collection[str]) -> Reconstruction:
    """Model whose points are triangulated again from what the other images see of them."""
    seen = model.observations
    kept = [k for k, image in enumerate(model.images) if image.name not in names]
    number_of = np.full(len(model.images), -1)
    number_of[kept] = np.arange(len(kept))
    rows = np.flatnonzero(number_of[seen.images] >= 0)
    images = [model.images[k] for k in kept]
    indices, tracks, pixels = number_of[seen.images[rows]], seen.points[rows], seen.pixels[rows]
    kept_model = dataclasses.replace(
        model, images=tuple(images), observations=Observations(tracks, indices, pixels)
    )
    return triangulated(kept_model, len(model.points))


def triangulated(model: Reconstruction, num_points: int) -> Reconstruction:
    """Model with the points of its observations from their rays; bad ones are left out."""
    seen = model.observations
    rays, centers = np.empty((len(seen.points), 3)), np.empty((len(seen.points), 3))
    for number, image in enumerate(model.images):
        own = np.flatnonzero(seen.images == number)
        camera = model.cameras[str(image.camera)]
        rays[own] = world_rays(camera, image.cam_from_world, seen.pixels[own])
        centers[own] = image.cam_from_world.inverse().translation
    found = triangulate_tracks(centers, rays, seen.points, num_points)
    good = found.in_front & (found.residual_rad < 0.01) & (found.parallax_rad > 0.005)
    new_row = np.cumsum(good) - 1
    used = good[seen.points]
    colors = model.colors if len(model.colors) else np.zeros((num_points, 3), np.uint8)
    return dataclasses.replace(
        model,
        points=found.points[good],
        colors=colors[good],
        observations=Observations(new_row[seen.points[used]], seen.images[used], seen.pixels[used]),
    )


def poses_in_world(
    truth: Mapping[str, Pose], model: Reconstruction, without: Collection[str]
) -> tuple[dict[str, Pose], float]:
    """True ``cam_from_world`` in the world of the model, and the model's unit in that of the truth.

    The similarity is fitted to the other images: rotation and scale by their poses.
    """
    common = [i for i in model.images if i.name in truth and i.name not in without]
    ours = np.array([i.cam_from_world.inverse().translation for i in common])
    true = np.array([truth[i.name].inverse().translation for i in common])
    turn = sum(
        i.cam_from_world.inverse().rotation @ truth[i.name].rotation for i in common
    )  # model_from_true
    U, _, Vt = np.linalg.svd(turn)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    a, b = ours - ours.mean(0), (true - true.mean(0)) @ R.T
    scale = float((a * b).sum() / (b * b).sum())
    shift = ours.mean(0) - scale * R @ true.mean(0)
    moved = {}
    for name, pose in truth.items():
        center = scale * R @ pose.inverse().translation + shift
        rotation = pose.rotation @ R.T
        moved[name] = Pose(rotation, -rotation @ center)
    return moved, 1.0 / scale
