# SPDX-License-Identifier: BSD-3-Clause
"""One way after the other to map a database, and the best of what they find."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.upright import is_full_panorama
from epi360.extras import extra_library
from epi360.interop.colmap_database import CONFIG_OF_STATUS
from epi360.interop.colmap_rigs import quiet
from epi360.interop.match_graph import MatchGraph
from epi360.jobs.graph.graph_check import groups_by
from epi360.jobs.mapping.colmap_mapper import MapperOptions, color_points, run_mapper
from epi360.jobs.mapping.composed_poses import ComposedPoses
from epi360.jobs.mapping.given_poses import adjust_model, model_from_poses
from epi360.jobs.mapping.model_check import (
    PlacedImages,
    confirmed_groups,
    confirmed_images,
    judged_images,
)
from epi360.jobs.matching.match_folder import PairVerdict
from epi360.poses import Pose
from epi360.progress import Progress, no_progress

RULES = 6  # of the attempts and the check: other rules, other models
# Another way is tried if more than this share of the images that pairs connect is left out.
_MOST_LEFT_OUT = 0.05
COMPOSED = "the poses of the pairs"
_WITH_TRANSLATION = CONFIG_OF_STATUS.keys() - {"pure_rotation"}
_FEWEST_IMAGES = 3  # that anything else could place


@dataclass(frozen=True)
class Attempt:
    """What one way of mapping has found: images in its largest model, and how long it took.

    ``num_unconfirmed`` images were placed as well, where nothing confirms it; they were taken out.
    """

    how: str
    num_registered: int
    num_unconfirmed: int
    mean_error_px: float | None  # None without a model
    seconds: float
    kept: bool = False


@dataclass(frozen=True, eq=False)
class Mapped:
    """Models of the best attempt, what was tried, and images whose places nothing confirms."""

    models: list[Any]
    attempts: tuple[Attempt, ...]
    unconfirmed: tuple[str, ...]


def map_by_attempts(
    database: Path,
    options: MapperOptions,
    graph: MatchGraph,
    pairs: Sequence[PairVerdict],
    *,
    colors: Mapping[str, NDArray[np.uint8]],
    initial: tuple[str, Mapping[str, Pose]] | None = None,
    compose: Callable[[], ComposedPoses] = ComposedPoses,
    progress: Progress = no_progress,
) -> Mapped:
    """Models of the first way that places nearly all images, or of the one that places most.

    First comes what was asked for: the poses of ``initial``, which come with words for them, or
    else the mapper of the options. Then come the poses that ``compose`` puts together from those of
    the pairs, the other mapper, and the incremental one with small angles between rays. Images that
    anything but the incremental mapper with its usual angles has placed must be confirmed, see
    `confirmed_images`; so must its own panoramas, if it is known how long the translations of pairs
    are. If two ways place equally many, the one that was asked for is kept, and else the one with
    the smaller error. Nothing is tried if there are no poses and no pair shows a translation.
    """
    has_poses = initial is not None and bool(initial[1])
    if not has_poses and not _shows_translation(graph):
        return Mapped([], (), ())
    needed = (1 - _MOST_LEFT_OUT) * _num_connected(graph)
    composed = cache(compose)
    tried: list[Mapped] = []
    for how, is_trusted, find in _ways(
        database, options, graph, colors, initial, composed, progress
    ):
        begun = time.perf_counter()
        models = find()
        # Lengths take a while to find, and a sequence that is tracked needs none.
        is_given = has_poses and not tried
        known = ComposedPoses if is_given else composed
        lost = _without_unconfirmed(models, graph, pairs, known, options, is_trusted=is_trusted)
        error = models[0].compute_mean_reprojection_error() if models else None
        placed = models[0].num_reg_images() if models else 0
        attempt = Attempt(how, placed, len(lost), error, time.perf_counter() - begun)
        tried.append(Mapped(models, (attempt,), tuple(lost)))
        if placed >= needed:
            break
    best = max(range(len(tried)), key=lambda k: (*_rank(tried[k].attempts[0], k == 0), -k))
    attempts = tuple(replace(each.attempts[0], kept=k == best) for k, each in enumerate(tried))
    return replace(tried[best], attempts=attempts)


def _rank(attempt: Attempt, was_asked: bool) -> tuple[int, bool, float]:
    error = np.inf if attempt.mean_error_px is None else attempt.mean_error_px
    return attempt.num_registered, was_asked, -error


def _ways(
    database: Path,
    options: MapperOptions,
    graph: MatchGraph,
    colors: Mapping[str, NDArray[np.uint8]],
    initial: tuple[str, Mapping[str, Pose]] | None,
    composed: Callable[[], ComposedPoses],
    progress: Progress,
) -> Iterator[tuple[str, bool, Callable[[], list[Any]]]]:
    """Each way in words, whether its places are trusted without a check, and how to go it."""
    run = partial(run_mapper, database, colors=colors, progress=progress)
    incremental = replace(options, mapper="incremental")
    mappers = [incremental, replace(options, mapper="global")]
    if options.mapper == "global":
        mappers.reverse()
    start = partial(_from_poses, database, incremental, graph, colors, progress)
    if initial is not None and initial[1]:
        how, poses = initial
        yield how, False, partial(start, poses)
    for number, each in enumerate(mappers):
        yield f"{each.mapper} mapper", each.mapper == "incremental", partial(run, each)
        if number == 0 and (poses := composed().cam_from_world):
            yield COMPOSED, False, partial(start, poses)
    small = replace(incremental, small_angles=True)
    yield "incremental mapper with small angles", False, partial(run, small)


def _from_poses(
    database: Path,
    options: MapperOptions,
    graph: MatchGraph,
    colors: Mapping[str, NDArray[np.uint8]],
    progress: Progress,
    initial: Mapping[str, Pose],
) -> list[Any]:
    """The model of given poses; the incremental mapper adds images that have none."""
    model = model_from_poses(database, initial, options)
    if model.num_points3D() == 0:
        return []
    if model.num_reg_images() < _num_connected(graph):
        with TemporaryDirectory() as folder:
            model.write_binary(folder)
            models = run_mapper(
                database, options, colors=colors, start=Path(folder), progress=progress
            )
        if models and models[0].num_reg_images() > model.num_reg_images():
            return models
    color_points(model, colors)
    return [model]


def _shows_translation(graph: MatchGraph) -> bool:
    """Whether a pair says in which direction the camera moved; COLMAP places nothing without."""
    return any(
        pair.geometry is not None and pair.geometry.status in _WITH_TRANSLATION
        for pair in graph.pairs
    )


def _num_connected(graph: MatchGraph) -> int:
    """Images in the largest part of the graph that pairs hold together; 0 if nothing can be won."""
    used = (
        (pair.image1, pair.image2)
        for pair in graph.pairs
        if pair.geometry is not None and pair.geometry.status in CONFIG_OF_STATUS
    )
    size = max(Counter(groups_by(used).values()).values(), default=0)
    return size if size >= _FEWEST_IMAGES else 0


def _without_unconfirmed(
    models: list[Any],
    graph: MatchGraph,
    pairs: Sequence[PairVerdict],
    composed: Callable[[], ComposedPoses],
    options: MapperOptions,
    *,
    is_trusted: bool,
) -> list[str]:
    """Take images out of models if nothing confirms their places; their names.

    Of a way that is trusted, only panoramas are taken out, only if there are such images in its
    largest model, and only those of them that lengths can judge, see `judged_images`.
    """
    if is_trusted and not all(map(is_full_panorama, graph.cameras.values())):
        return []
    pycolmap = extra_library("pycolmap", extra="colmap", purpose="maps")
    lost: list[str] = []
    for number, model in enumerate(list(models)):
        placed = _placed(model, graph)
        confirmed = confirmed_images(placed, pairs)
        if len(confirmed) < len(placed.cam_from_world):
            known = composed()
            if is_trusted and not known.lengths:
                return []
            confirmed = _confirmed(placed, pairs, known, is_trusted=is_trusted)
        elif is_trusted and number == 0:
            return []
        wrong = [image for image in _registered(model) if image.name not in confirmed]
        lost += [image.name for image in wrong]
        if not confirmed:
            models.remove(model)
        elif wrong:
            for frame in {image.frame_id for image in wrong}:
                model.deregister_frame(frame)
            with quiet(pycolmap):
                adjust_model(pycolmap, model, options)
    models.sort(key=lambda model: -model.num_reg_images())
    kept = {image.name for model in models for image in _registered(model)}
    return sorted(set(lost) - kept)


def _confirmed(
    placed: PlacedImages,
    pairs: Sequence[PairVerdict],
    known: ComposedPoses,
    *,
    is_trusted: bool,
) -> set[str]:
    """Images of a model that stay; of a trusted way also those that nobody can judge."""
    groups = confirmed_groups(placed, pairs, known.lengths)
    if not is_trusted:
        return next(iter(groups), set())
    names = placed.cam_from_world.keys()
    judged = judged_images(names, pairs, known.lengths, known.looked_at)
    return set().union(*groups) | (names - judged)


def _registered(model: Any) -> list[Any]:
    return [model.images[image_id] for image_id in model.reg_image_ids()]


def _placed(model: Any, graph: MatchGraph) -> PlacedImages:
    """What is checked of COLMAP's model."""
    images = _registered(model)
    row_of = {image.image_id: row for row, image in enumerate(images)}
    points = list(model.points3D.values())
    seen = [
        (number, row_of[element.image_id])
        for number, point in enumerate(points)
        for element in point.track.elements
    ]
    point_index, image_index = np.array(seen, dtype=np.int64).reshape(-1, 2).T
    poses = {image.name: _pose(image) for image in images}
    moments = {image.name: graph.images[image.name].frame or image.name for image in images}
    positions = np.array([point.xyz for point in points]).reshape(-1, 3)
    return PlacedImages(poses, moments, positions, point_index, image_index)


def _pose(image: Any) -> Pose:
    return Pose.from_matrix(image.cam_from_world().matrix())
