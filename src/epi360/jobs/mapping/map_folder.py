# SPDX-License-Identifier: BSD-3-Clause
"""A folder of images to a COLMAP model: our verified pairs, COLMAP's mapper."""

from __future__ import annotations

import os
import shutil
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from epi360.cameras.upright import is_full_panorama
from epi360.extras import extra_library
from epi360.features import read_image
from epi360.features.warped_patches import Panorama
from epi360.interop.colmap_cameras import colmap_camera
from epi360.interop.colmap_database import CONFIG_OF_STATUS, write_colmap_database
from epi360.interop.descriptors import DescriptorsOf
from epi360.interop.match_graph import MatchGraph
from epi360.interop.reconstruction import Reconstruction
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.mapping.colmap_mapper import (
    STAGE,
    Mapper,
    MapperOptions,
    mapper_settings,
    turn_upright,
)
from epi360.jobs.mapping.composed_poses import composed_poses
from epi360.jobs.mapping.map_attempts import RULES, Attempt, map_by_attempts
from epi360.jobs.mapping.map_pairs import without_doubtful
from epi360.jobs.mapping.mapped_models import TRANSFORMS, MappedModel, read_models, write_transforms
from epi360.jobs.mapping.sequence_start import has_one_camera, may_be_sequence, track_sequence
from epi360.jobs.matching.match_folder import (
    MatchOptions,
    MatchRun,
    match_images,
    open_match_output,
)
from epi360.jobs.matching.match_result import Colors, descriptors_of, load_matches_and_colors
from epi360.jobs.pairs.pair_selection import Pair, trajectory_pairs, ways_of
from epi360.poses import Pose
from epi360.progress import Progress, no_progress
from epi360.runs.made_from import fingerprint, read_record, write_record
from epi360.runs.whole_files import whole_folder

DATABASE, MODELS, RECORD = "database.db", "sparse", "mapping.json"
_PANORAMAS_IN_MEMORY = 128  # of 2 MB
TRACKED_POSES = "the poses of the odometry"


@dataclass(frozen=True)
class MapOptions:
    """How a folder is mapped."""

    match: MatchOptions = field(default_factory=MatchOptions)  # its seed is also the mapper's
    mapper: Mapper = "incremental"  # one image after the other; "global": all at once
    refine_cameras: bool = False  # focal length and distortion; panoramas have none
    # None: one per core. The last digits of the result then change from run to run; with 1, the
    # same matches give the same bits.
    mapper_threads: int | None = None
    # A sequence starts from the poses of the odometry, see `map_images`; only before the
    # incremental mapper, because whoever asks for the global one wants that.
    track: bool = True
    # In the database, so that COLMAP can match new images with the map: 128 bytes a key point.
    descriptors: bool = True

    def __post_init__(self) -> None:
        """Check the values."""
        if self.mapper not in ("incremental", "global"):
            raise ValueError(f"mapper must be incremental or global, got {self.mapper!r}")
        if self.mapper_threads is not None and self.mapper_threads < 1:
            raise ValueError(f"mapper_threads must be 1 or more, got {self.mapper_threads}")


@dataclass(frozen=True, eq=False)
class MapRun:
    """What `map_images` found."""

    matched: MatchRun
    models: tuple[MappedModel, ...]  # the largest first; each has its own world and scale
    unregistered: Mapping[str, str]  # image without a pose in the first model, and the reason
    num_images: int
    seconds: Mapping[str, float]  # wall time of the "matching" of this run and of the "mapping"
    remarks: tuple[str, ...]  # sentences about what could not be written
    attempts: tuple[Attempt, ...] = ()  # ways of mapping that were tried, in order
    track: dict[str, Any] | None = None  # of a sequence: `SequenceStart.summary`
    was_mapped: bool = False  # an earlier run mapped the same pairs: its models and its time


def map_images(
    images: ImageSet,
    output: str | os.PathLike[str],
    options: MapOptions | None = None,
    *,
    initial: Reconstruction | None = None,
    video: Path | None = None,
    mask: Path | None = None,
    restart: bool = False,
    progress: Progress = no_progress,
) -> MapRun:
    """Match the images of a folder and map them with COLMAP.

    If the mapper finds no start, or leaves more than one image in twenty out, others are tried and
    the result with most images is kept, see `map_by_attempts`. With ``initial``, whose images have
    the names of ours, its poses are tried before all: the matches are triangulated there and poses
    and points adjusted. Images may be missing in it, its scale is free, and its points are not
    used.

    A sequence starts from the poses that the odometry gives it, and with ``pairs="auto"`` it is
    matched in `trajectory_pairs`. The images are a sequence if they are frames of ``video``, whose
    other frames are then followed as well, with ``mask``; with ``"sequential"`` among ``pairs``;
    and with ``"auto"`` if their names differ in a number only and most images can be tracked.

    ``output`` gets what `match_images` writes, ``database.db``, the models ``sparse/0``,
    ``sparse/1``, ... and ``transforms.json`` of the first, its paths relative to the images. Down
    is +y in the models, by the mean of the cameras' y axes, except if there is ``initial``. With
    ``restart``, pairs that were matched with other options are thrown away instead of refusing
    them.

    Cameras and rigs stay as they are given. Pairs go in with their inliers and poses where the
    verdict is ok, planar_ambiguous or pure_rotation: inliers of all three are right matches.
    Ambiguous pairs join no groups of images that others do not join, as rooms may have the same
    carpet. A pair that two or more triangles contradict, or that `check_graph` refuses, stays out:
    a few of them lead COLMAP's mapper astray. What was matched is not matched again, and what was
    mapped from the same matches with the same options is not mapped again.

    Raises
    ------
    ValueError
        If ``output`` has a COLMAP database or model that this function did not make, COLMAP lacks
        the model of a camera, or as `match_images`.
    OSError
        If it cannot be written.
    ImportError
        If pycolmap is missing.
    """
    options = options or MapOptions()
    extra_library("pycolmap", extra="colmap", purpose="maps")  # before hours of matching
    for camera in images.cameras.values():
        colmap_camera(camera)  # COLMAP has no double sphere
    output = Path(output)
    record = _read_record(output)
    # A folder that only looked like a sequence is mapped without a word, as it always was.
    was_asked = video is not None or "sequential" in ways_of(options.match.pairs)
    given = None if initial is None else _poses_of(images, initial)
    tracked = None
    if given is None and _is_tried_as_sequence(images, options, video):
        open_match_output(output, options.match, restart=restart)
        tracked = track_sequence(
            images,
            output,
            video=video,
            mask=mask,
            mask_nadir_deg=options.match.mask_nadir_deg,
            seed=options.match.seed,
            progress=progress,
        )
    start = time.perf_counter()
    first_pairs: list[Pair] = []
    if tracked is not None and tracked.cam_from_world and options.match.pairs == "auto":
        first_pairs = trajectory_pairs(images.images, tracked.cam_from_world, tracked.depth)
    matched = match_images(
        images, output, options.match, first_pairs=first_pairs, restart=restart, progress=progress
    )
    graph, colors = load_matches_and_colors(output)
    graph = without_doubtful(graph, matched)
    matching_s = time.perf_counter() - start
    seed = options.match.seed % 2**31  # COLMAP takes no others
    mapper = MapperOptions(options.mapper, options.refine_cameras, options.mapper_threads, seed)
    poses = given or ({} if tracked is None else tracked.cam_from_world)
    made_from = _fingerprint(graph, mapper, poses)
    was_mapped = record.get("fingerprint") == made_from and _has_models(output, record)
    descriptors = descriptors_of(output) if options.descriptors else _no_descriptors
    if was_mapped:
        progress(STAGE, len(graph.images), len(graph.images))
        if record.get("descriptors") != options.descriptors or not (output / DATABASE).is_file():
            _write_database(output / DATABASE, graph, descriptors)
    else:
        how = "the given poses" if given else TRACKED_POSES
        made = _map(
            images, graph, matched, colors, output, mapper, (how, poses), descriptors, progress
        )
        record = {"fingerprint": made_from, **made}
    record["descriptors"] = options.descriptors
    record["track"] = None if tracked is None else tracked.summary()
    record["pairs"] = matched.how
    write_record(output / RECORD, record)
    models = read_models(output / MODELS, record["mean_error_px"], graph)
    remarks = write_transforms(images, output, models, options.match.mask_nadir_deg)
    return MapRun(
        matched,
        models,
        _reasons(images, matched, models, record["unconfirmed"]),
        len(images.images),
        {
            **({"tracking": tracked.seconds} if tracked is not None and poses else {}),
            "matching": matching_s,
            "mapping": record["seconds"],
        },
        remarks,
        tuple(Attempt(**attempt) for attempt in record["attempts"]),
        record["track"] if was_asked or poses else None,
        was_mapped,
    )


def _no_descriptors(name: str) -> None:
    return None


def _write_database(path: Path, graph: MatchGraph, descriptors: DescriptorsOf) -> None:
    path.unlink(missing_ok=True)
    write_colmap_database(path, graph, descriptors=descriptors)


def _is_tried_as_sequence(images: ImageSet, options: MapOptions, video: Path | None) -> bool:
    if not options.track or options.mapper != "incremental" or not has_one_camera(images):
        return False
    pairs = options.match.pairs
    return (
        video is not None
        or "sequential" in ways_of(pairs)
        or (pairs == "auto" and may_be_sequence(images))
    )


def _poses_of(images: ImageSet, initial: Reconstruction) -> dict[str, Pose]:
    """Poses of ours that are known; ValueError if there are none."""
    names = {image.name for image in images.images}
    known = {
        image.name: image.cam_from_world
        for image in initial.images
        if image.name in names and np.isfinite(image.cam_from_world.matrix()).all()
    }
    if not known:
        raise ValueError(
            f"initial must have poses of the images, got {len(initial.images)} other ones"
        )
    return known


def _read_record(output: Path) -> dict[str, Any]:
    """Record of an earlier run; ValueError where its files are somebody else's."""
    record = read_record(output / RECORD, remedy=f"delete it with {DATABASE} and {MODELS}")
    if record is not None:
        return record
    for name in (DATABASE, MODELS):
        if (output / name).exists():
            raise ValueError(
                f"{output / name} was made by something else and would be replaced; "
                "name another output folder"
            )
    return {}


def _has_models(output: Path, record: Mapping[str, Any]) -> bool:
    """Whether nobody has deleted a model since."""
    numbers = range(len(record["mean_error_px"]))
    return all((output / MODELS / str(number)).is_dir() for number in numbers)


def _fingerprint(graph: MatchGraph, options: MapperOptions, poses: Mapping[str, Pose]) -> str:
    """Hash of everything that the models depend on."""
    pieces: list[object] = [(RULES, mapper_settings(options), graph.cameras)]
    for name, pose in poses.items():
        pieces += [name, pose.matrix()]
    for camera, pose in graph.cam_from_rig.items():
        pieces += [camera, pose.matrix()]
    for image in graph.images.values():
        pieces += [(image.name, image.camera, image.frame), image.keypoints]
    for pair in graph.pairs:
        pieces.append((pair.image1, pair.image2))
        if pair.geometry is not None:
            pieces += [pair.geometry.status, pair.geometry.inliers]
            pieces.append(pair.geometry.cam2_from_cam1.matrix())
    return fingerprint(*pieces)


def _map(
    images: ImageSet,
    graph: MatchGraph,
    matched: MatchRun,
    colors: Colors,
    output: Path,
    options: MapperOptions,
    initial: tuple[str, Mapping[str, Pose]],
    descriptors: DescriptorsOf,
    progress: Progress,
) -> dict[str, Any]:
    """Write database and models; returns what the record says of them."""
    start = time.perf_counter()
    write_record(output / RECORD, {})  # from here on database and models are ours
    (output / TRANSFORMS).unlink(missing_ok=True)
    _write_database(output / DATABASE, graph, descriptors)
    mapped = map_by_attempts(
        output / DATABASE,
        options,
        graph,
        matched.verdicts,
        colors=colors,
        initial=initial,
        compose=partial(composed_poses, graph, matched.verdicts, _panoramas(images)),
        progress=progress,
    )
    if initial[0] == TRACKED_POSES:  # the world of poses that the caller gave is theirs
        for model in mapped.models:
            turn_upright(model)
    shutil.rmtree(output / MODELS, ignore_errors=True)
    if mapped.models:
        with whole_folder(output / MODELS) as temporary:
            for number, model in enumerate(mapped.models):
                (temporary / str(number)).mkdir()
                model.write_binary(temporary / str(number))
    return {
        "seconds": time.perf_counter() - start,
        "mean_error_px": [model.compute_mean_reprojection_error() for model in mapped.models],
        "attempts": [vars(attempt) for attempt in mapped.attempts],
        "unconfirmed": list(mapped.unconfirmed),
    }


def _panoramas(images: ImageSet) -> Callable[[str], Panorama | None]:
    """Pictures by name, None of what is no full panorama or cannot be read any more."""
    image_of = {image.name: image for image in images.images}

    @lru_cache(_PANORAMAS_IN_MEMORY)
    def panorama_of(name: str) -> Panorama | None:
        image = image_of[name]
        if not is_full_panorama(images.cameras[image.camera]):
            return None
        try:
            return Panorama.of(read_image(image.path))
        except (OSError, ValueError):
            return None

    return panorama_of


def _reasons(
    images: ImageSet,
    matched: MatchRun,
    models: tuple[MappedModel, ...],
    unconfirmed: Collection[str],
) -> dict[str, str]:
    """Why each image without a pose in the first model has none."""
    model_of = {
        image.name: number
        for number, model in reversed(list(enumerate(models)))
        for image in model.reconstruction.images
    }
    tried: dict[str, Counter[str]] = {image.name: Counter() for image in images.images}
    for pair in matched.verdicts:
        status = "contradicted by other pairs" if pair.contradicted else pair.status
        status = pair.refused.partition(",")[0] or status
        for name in (pair.image1, pair.image2):
            tried[name][status] += 1
    reasons = {}
    for name, statuses in tried.items():
        number = model_of.get(name)
        if number == 0:
            continue
        if name in matched.unreadable:
            reasons[name] = matched.unreadable[name]
        elif number is None and name in unconfirmed:
            reasons[name] = "too few points and pairs confirm the place that was found"
        elif number is not None:
            reasons[name] = f"is in {MODELS}/{number}, which does not connect to {MODELS}/0"
        elif not CONFIG_OF_STATUS.keys() & statuses:
            counts = ", ".join(f"{count} {status}" for status, count in statuses.most_common())
            reasons[name] = f"no accepted pair ({counts or 'none tried'})"
        else:
            reasons[name] = "has accepted pairs, but COLMAP's mapper could not place it"
    return reasons
