# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP's mappers on a database of ours, with options that suit panoramas and known cameras."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from epi360.extras import extra_library
from epi360.interop.colmap_rigs import quiet
from epi360.interop.upright_world import mean_down, upright_from_world
from epi360.progress import Progress, no_progress

Mapper = Literal["incremental", "global"]
STAGE = "mapping images"
_SMALLEST_MODEL = 3  # images; COLMAP's 10 would drop a room of a tour
# A verified pair has at least so many inliers. With COLMAP's 30, 3 of the 17 panoramas of a real
# tour get a pose; with 15, 14 of them do, in four models. Where images are dense nothing changes.
_MIN_INLIERS = 15


@dataclass(frozen=True)
class MapperOptions:
    """How COLMAP maps: images one by one or all at once, with refined cameras or given ones."""

    mapper: Mapper = "incremental"
    refine_cameras: bool = False
    num_threads: int | None = 1  # None: one per core
    seed: int = 0
    small_angles: bool = False  # points under a tenth of a degree count; incremental only


def run_mapper(
    database: Path,
    options: MapperOptions,
    *,
    colors: Mapping[str, NDArray[np.uint8]],
    start: Path | None = None,
    progress: Progress = no_progress,
) -> list[Any]:
    """Models that COLMAP finds in a database with verified pairs, the one with most images first.

    The incremental mapper adds images to the model in the folder ``start`` if there is one.

    ``colors`` are the RGB values (N, 3) of the key points by the image's name. ``progress`` is told
    after each image of the incremental mapper; the global one says nothing before its end. Each
    model has at least two images that are not all in a larger one; there may be none.
    """
    pycolmap = extra_library("pycolmap", extra="colmap", purpose="maps")
    num_images, placed = len(colors), 0
    going_on = {} if start is None else {"input_path": str(start)}

    def one_more() -> None:
        nonlocal placed
        placed = min(placed + 1, num_images - 1)
        progress(STAGE, placed, num_images)

    progress(STAGE, 0, num_images)
    with quiet(pycolmap), TemporaryDirectory() as scratch:
        pycolmap.set_random_seed(options.seed)
        # COLMAP gets a folder without images: it would decode each of them for the colors of the
        # points, and not turn those that have an orientation tag.
        paths = (str(database), scratch, scratch)
        if options.mapper == "global":
            found = pycolmap.global_mapping(*paths, _global_options(pycolmap, options))
        else:
            chosen = incremental_options(pycolmap, options)
            found = pycolmap.incremental_mapping(
                *paths, chosen, next_image_callback=one_more, **going_on
            )
    progress(STAGE, num_images, num_images)
    models = _distinct(model for _, model in sorted(found.items()))
    for model in models:
        color_points(model, colors)
    return models


def _distinct(models: Iterable[Any]) -> list[Any]:
    """Models of two images or more, the largest first, without those that lie within another."""
    kept: list[Any] = []
    images: list[set[int]] = []
    for model in sorted(models, key=lambda model: model.num_reg_images(), reverse=True):
        own = set(model.reg_image_ids())
        if len(own) > 1 and not any(own <= other for other in images):
            kept.append(model)
            images.append(own)
    return kept


def color_points(model: Any, colors: Mapping[str, NDArray[np.uint8]]) -> None:
    """Give each point the mean color of the key points that see it."""
    colors_of = {image_id: colors[image.name] for image_id, image in model.images.items()}
    for point in model.points3D.values():
        seen = [colors_of[each.image_id][each.point2D_idx] for each in point.track.elements]
        point.color = np.round(np.mean(seen, axis=0)).astype(np.uint8)


def turn_upright(model: Any) -> None:
    """Turn the world of a model so that down, as its cameras have it, is +y."""
    pycolmap = extra_library("pycolmap", extra="colmap", purpose="maps")
    frames = [model.frames[frame_id] for frame_id in model.reg_frame_ids()]
    down = mean_down(frame.rig_from_world.rotation.matrix() for frame in frames)
    turn = pycolmap.Rotation3d(upright_from_world(down).rotation)
    model.transform(pycolmap.Sim3d(1.0, turn, np.zeros(3)))


def mapper_settings(options: MapperOptions) -> str:
    """Every setting of the mapper as text: equal text and input give equal models."""
    pycolmap = extra_library("pycolmap", extra="colmap", purpose="maps")
    build = _global_options if options.mapper == "global" else incremental_options
    return f"pycolmap {pycolmap.__version__}\n{build(pycolmap, options).summary()}"


def incremental_options(pycolmap: Any, options: MapperOptions) -> Any:
    """COLMAP's options of the incremental mapper."""
    chosen = pycolmap.IncrementalPipelineOptions()
    chosen.min_model_size = _SMALLEST_MODEL
    chosen.random_seed = options.seed
    chosen.num_threads = num_threads(options)
    # All images are adjusted when there are 40 % more of them, not 10 %, and once each time: 30
    # frames of a street in 157 pairs take 11 s of processor time, with all images adjusted twice
    # 14 s. Errors of that street and of a walk stay the same to 0.002 % of the path.
    chosen.ba_global_frames_ratio = chosen.ba_global_points_ratio = 1.4
    chosen.ba_global_max_refinements = chosen.ba_local_max_refinements = 1
    chosen.extract_colors = False  # ours are there
    chosen.ba_refine_focal_length = options.refine_cameras
    chosen.ba_refine_extra_params = options.refine_cameras
    chosen.ba_refine_sensor_from_rig = False
    chosen.mapper.abs_pose_min_num_inliers = _MIN_INLIERS
    # Two images alone have no other points, nor has most of a tour. Three sequences with known
    # poses get 1.6 times the points and the same errors, in a tenth to a third more time.
    chosen.triangulation.ignore_two_view_tracks = False
    chosen.mapper.abs_pose_refine_focal_length = options.refine_cameras
    chosen.mapper.abs_pose_refine_extra_params = options.refine_cameras
    if options.small_angles:
        chosen.mapper.init_min_tri_angle = 1.0
        chosen.mapper.init_max_forward_motion = 1.0
        chosen.mapper.ba_local_min_tri_angle = 0.5
        chosen.mapper.filter_min_tri_angle = chosen.triangulation.min_angle = 0.1
    return chosen


def num_threads(options: MapperOptions) -> int:
    """Threads in COLMAP's words."""
    return -1 if options.num_threads is None else options.num_threads


def _global_options(pycolmap: Any, options: MapperOptions) -> Any:
    chosen = pycolmap.GlobalPipelineOptions()
    chosen.min_model_size = _SMALLEST_MODEL
    chosen.random_seed = options.seed
    chosen.num_threads = num_threads(options)
    # The poses of the pairs are ours: COLMAP need not find them again.
    chosen.decompose_relative_pose = False
    chosen.mapper.refine_sensor_from_rig = False
    adjustment = chosen.mapper.bundle_adjustment
    adjustment.refine_focal_length = options.refine_cameras
    adjustment.refine_extra_params = options.refine_cameras
    adjustment.refine_sensor_from_rig = False
    chosen.mapper.rotation_averaging.refine_sensor_from_rig = False
    chosen.mapper.global_positioning.refine_sensor_from_rig = False
    return chosen
