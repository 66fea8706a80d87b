# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP's bundle adjustment of the key frames that the odometry found."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from epi360.cameras import Camera
from epi360.extras import extra_library
from epi360.interop import write_colmap_model
from epi360.interop.colmap_rigs import quiet
from epi360.jobs.tracking.track_files import key_frame_model
from epi360.odometry import Odometry
from epi360.poses import Pose


def refine_with_colmap(odometry: Odometry, camera: Camera) -> str:
    """Move key frames and points to where COLMAP adjusts them; returns a sentence about it.

    The camera stays as it is. ``ValueError`` if COLMAP lacks its model.
    """
    pycolmap = extra_library("pycolmap", extra="colmap", purpose="refined maps")
    key_frames, points = odometry.key_frames(), odometry.points()
    names = {each.index: f"{number:06d}" for number, each in enumerate(key_frames)}
    model = key_frame_model(camera, names, key_frames, points)
    with TemporaryDirectory() as scratch, quiet(pycolmap):
        write_colmap_model(Path(scratch), model)
        adjusted = pycolmap.Reconstruction(scratch)
        adjusted.update_point_3d_errors()
        before = adjusted.compute_mean_reprojection_error()
        options = pycolmap.BundleAdjustmentOptions()
        options.refine_focal_length = False
        options.refine_principal_point = False
        options.refine_extra_params = False
        options.refine_sensor_from_rig = False
        options.print_summary = False
        _adjust(pycolmap, adjusted, options)
        adjusted.update_point_3d_errors()
        after = adjusted.compute_mean_reprojection_error()
    poses = {image.name: image.cam_from_world() for image in adjusted.images.values()}
    matrices = [poses[names[each.index]].matrix() for each in key_frames]
    positions = np.array([adjusted.points3D[row + 1].xyz for row in range(len(points.positions))])
    odometry.move_map([Pose.from_matrix(matrix) for matrix in matrices], positions)
    return (
        f"COLMAP's bundle adjustment of {len(key_frames)} key frames: mean reprojection error "
        f"{before:.3f} pixels before, {after:.3f} after"
    )


def _adjust(pycolmap: Any, model: Any, options: Any) -> None:
    """Adjust all images; ``pycolmap.bundle_adjustment`` would print, whatever the log level."""
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
