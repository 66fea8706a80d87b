# SPDX-License-Identifier: BSD-3-Clause
"""A model that begins with known poses, as odometry gives them, in place of COLMAP's search."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from epi360.extras import extra_library
from epi360.interop.colmap_rigs import quiet
from epi360.jobs.mapping.colmap_mapper import MapperOptions, incremental_options, num_threads
from epi360.poses import Pose

# Limit of the reprojection error and most steps of the adjustment, one round after the other:
# poses that are a few pixels off still find their points, and then the usual limit holds.
_ROUNDS = ((16.0, 8), (4.0, 50))
# Share of the cost by which the last step must lower it. 30 frames of a street take 1.5 s of
# processor time with it, 6 s with COLMAP's limit of zero, with the same errors.
_TOLERANCE = 1e-6


def model_from_poses(
    database: Path, cam_from_world: Mapping[str, Pose], options: MapperOptions
) -> Any:
    """COLMAP model of the images of a database that have a pose: points, then adjusted poses.

    The verified matches of the database are triangulated where the poses say, and poses and points
    are adjusted; then again, with the usual limit of the error. In a rig, the first image of a
    frame that has a pose places the frame.
    """
    pycolmap = extra_library("pycolmap", extra="colmap", purpose="maps")
    with quiet(pycolmap), TemporaryDirectory() as scratch:
        pycolmap.set_random_seed(options.seed)
        model = _posed_images(pycolmap, database, cam_from_world)
        for limit_px, num_steps in _ROUNDS:
            chosen = incremental_options(pycolmap, options)
            chosen.mapper.filter_max_reproj_error = limit_px
            chosen.ba_global_max_num_iterations = 1  # of the points alone; all are adjusted below
            for name in ("merge_max_reproj_error", "complete_max_reproj_error"):
                setattr(chosen.triangulation, name, limit_px)
            model = pycolmap.triangulate_points(
                model, str(database), scratch, scratch, clear_points=True, options=chosen
            )
            adjust_model(pycolmap, model, options, num_steps)
    return model


def adjust_model(
    pycolmap: Any, model: Any, options: MapperOptions, num_steps: int = _ROUNDS[-1][1]
) -> None:
    """Adjust the poses and points of a model, robust to wrong matches."""
    if model.num_points3D() == 0 or model.num_reg_frames() < 2:
        return
    chosen = pycolmap.BundleAdjustmentOptions()
    chosen.refine_focal_length = chosen.refine_extra_params = options.refine_cameras
    chosen.refine_sensor_from_rig = chosen.print_summary = False
    chosen.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    chosen.ceres.solver_options.num_threads = num_threads(options)
    chosen.ceres.solver_options.max_num_iterations = num_steps
    chosen.ceres.solver_options.function_tolerance = _TOLERANCE
    held = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        held.add_image(image_id)
    held.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    # pycolmap.bundle_adjustment would print, however quiet its log is.
    pycolmap.create_default_bundle_adjuster(chosen, held, model).solve()
    model.update_point_3d_errors()


def _posed_images(pycolmap: Any, database: Path, cam_from_world: Mapping[str, Pose]) -> Any:
    """Images of a database, those with a pose registered, without points."""
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as opened:
        for camera in opened.read_all_cameras():
            model.add_camera(camera)
        for rig in opened.read_all_rigs():
            model.add_rig(rig)
        for frame in opened.read_all_frames():
            model.add_frame(frame)
        for image in opened.read_all_images():
            model.add_image(image)
    for image in list(model.images.values()):
        frame = model.frame(image.frame_id)
        if image.name in cam_from_world and not frame.has_pose():
            pose = cam_from_world[image.name]
            placed = pycolmap.Rigid3d(pycolmap.Rotation3d(pose.rotation), pose.translation)
            frame.set_cam_from_world(image.camera_id, placed)
            model.register_frame(frame.frame_id)
    return model
