# SPDX-License-Identifier: BSD-3-Clause
"""A folder of images to a COLMAP model: our verified pairs, COLMAP's mapper."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from epi360.cameras.upright import is_full_panorama
from epi360.extras import extra_library
from epi360.features.warped_patches import Panorama, remembered
from epi360.interop.colmap_database import CONFIG_OF_STATUS, write_colmap_database
from epi360.interop.match_graph import MatchGraph
from epi360.interop.nerfstudio import POINTS_FILE
from epi360.interop.reconstruction import Reconstruction
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.folder.panoramas import read_panorama
from epi360.jobs.mapping.colmap_mapper import (
    STAGE,
    Mapper,
    MapperOptions,
    mapper_settings,
    turn_upright,
)
from epi360.jobs.mapping.composed_poses import ComposedPoses, composed_poses
from epi360.jobs.mapping.guided_matches import with_guided
from epi360.jobs.mapping.lone_branches import Branch, lone_branches
from epi360.jobs.mapping.map_attempts import RULES, Attempt, map_by_attempts
from epi360.jobs.mapping.map_pairs import without_doubtful
from epi360.jobs.mapping.mapped_models import (
    MODELS,
    TRANSFORMS,
    MappedModel,
    read_models,
    write_transforms_of,
)
from epi360.jobs.mapping.past_gap import cut_where_the_place_repeats
from epi360.jobs.mapping.sequence_start import (
    BY_PAIRS,
    BY_TRACKS,
    SequenceStart,
    has_one_camera,
    may_be_sequence,
    track_sequence,
)
from epi360.jobs.mapping.unmapped_images import that_colmap_takes, why_unmapped
from epi360.jobs.matching.agreed_cameras import said_of_cameras
from epi360.jobs.matching.match_folder import (
    MatchOptions,
    MatchRun,
    match_images,
    open_match_output,
)
from epi360.jobs.matching.match_result import Colors, descriptors_of, load_matches_and_colors
from epi360.jobs.pairs.pair_selection import Pair, trajectory_pairs, ways_of
from epi360.jobs.threads import num_cores
from epi360.poses import Pose
from epi360.progress import Progress, no_progress
from epi360.runs.made_from import fingerprint, read_record, write_record
from epi360.runs.whole_files import whole_folder

_PAST_GAP = (
    "Frames seem to be missing before {names}: where a place repeats itself, as a corridor with "
    "equal doors does, what comes then may be placed wrongly. The frames were not followed, but "
    "matched as other images are."
)
_CUT = (
    "Frames seem to be missing before {names}, and the place repeats itself, as a corridor with "
    "equal doors does: nothing tells which of its parts comes then, so that images before and "
    "after are not joined. --no-track joins them, at the risk of putting one part upon another."
)
_MOST_NAMED = 3  # frames of a remark
DATABASE, RECORD = "database.db", "mapping.json"
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
    # Ways of mapping that were tried, in order; none if no pair shows a translation.
    attempts: tuple[Attempt, ...] = ()
    track: dict[str, Any] | None = None  # of a sequence: `SequenceStart.summary`
    was_mapped: bool = False  # an earlier run mapped the same pairs: its models and its time
    branches: tuple[Branch, ...] = ()  # of the first model, that one pair alone joins to the rest


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

    Panoramas stay as they are given, and so do the places of lenses on a rig. The angles of a lens
    may change, where the tracks of a sequence agree on that, see `agreed_camera`, or pairs of
    images, see `match_images`; then a sequence is tracked once more by the changed lens. Pairs go
    in with their inliers and poses where the verdict is ok, planar_ambiguous or pure_rotation:
    inliers of all three are right matches. Ambiguous pairs join no groups of images that others do
    not join, as rooms may have the same carpet. A pair that two or more triangles contradict, or
    that `check_graph` refuses, stays out: a few of them lead COLMAP's mapper astray. If no pair
    shows a translation, as of a camera that only turned, there are no models, and no mapper runs.
    What was matched is not matched again, and what was mapped from the same matches with the same
    options is not mapped again.

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
    extra_library("pycolmap", extra="colmap", purpose="maps")
    images, lacking = that_colmap_takes(images)  # before hours of matching
    output = Path(output)
    record = _read_record(output)
    given = None if initial is None else _poses_of(images, initial)
    track = partial(
        track_sequence,
        output=output,
        video=video,
        mask=mask,
        mask_nadir_deg=options.match.mask_nadir_deg,
        seed=options.match.seed,
        keep_cameras=options.match.keep_cameras,
        num_threads=options.match.num_threads,
        progress=progress,
    )
    is_sequence = given is None and _is_tried_as_sequence(images, options, video)
    found = _match(images, output, options.match, track if is_sequence else None, restart, progress)
    images, matched, tracked = found.images, found.run, found.tracked
    graph, colors = load_matches_and_colors(output)
    graph = without_doubtful(graph, matched)
    cut = None
    if tracked is not None and tracked.past_gaps:
        panorama_of = _panoramas(images, options.match.mask_nadir_deg)
        cut = cut_where_the_place_repeats(graph, matched.verdicts, tracked.past_gaps, panorama_of)
        graph = cut or graph
    poses = given or ({} if tracked is None else tracked.cam_from_world)
    work = _Work(images, graph, matched, colors, output, options, progress)
    how = "the given poses" if given else TRACKED_POSES
    record, models, was_mapped = work.mapped(record, how, poses)
    record["track"] = None if tracked is None else tracked.summary()
    record["pairs"] = matched.how
    write_record(output / RECORD, record)
    remarks = write_transforms_of(images, output, models, options.match.mask_nadir_deg)
    if tracked is not None and tracked.past_gaps and models:
        said = _PAST_GAP if cut is None else _CUT
        names = " and ".join(tracked.past_gaps[:_MOST_NAMED])
        more = len(tracked.past_gaps) - _MOST_NAMED
        names += f", and {more} more" if more > 0 else ""
        remarks = (*remarks, said.format(names=names))
    # A folder that only looked like a sequence is mapped without a word, as it always was.
    was_asked = video is not None or "sequential" in ways_of(options.match.pairs)
    tracking = {"tracking": tracked.seconds} if tracked is not None and poses else {}
    return MapRun(
        matched,
        models,
        {**lacking, **why_unmapped(images, matched, models, record["unconfirmed"])},
        len(images.images) + len(lacking),
        {**tracking, "matching": found.seconds, "mapping": record["seconds"]},
        remarks,
        tuple(Attempt(**attempt) for attempt in record["attempts"]),
        record["track"] if was_asked or poses else None,
        was_mapped,
        _branches(graph, models),
    )


@dataclass(frozen=True, eq=False)
class _Matched:
    """Images with the cameras that they turned out to have, and their pairs."""

    images: ImageSet
    run: MatchRun
    tracked: SequenceStart | None  # None if they were not followed
    seconds: float  # of the matching


def _match(
    images: ImageSet,
    output: Path,
    options: MatchOptions,
    track: Callable[..., SequenceStart] | None,
    restart: bool,
    progress: Progress,
) -> _Matched:
    """Match images; those of a sequence, for which there is ``track``, along their way.

    Where tracks or pairs say that cameras are others, the way is found once more by these.
    """
    given, tracked, by_tracks = images.cameras, None, False
    if track is not None:
        open_match_output(output, options, restart=restart)
        tracked = track(images)
        by_tracks = tracked.lens is not None
        if tracked.lens is not None:
            own = {images.images[0].camera: tracked.lens}  # a sequence has one camera
            images = replace(images, cameras={**images.cameras, **own})
            tracked = track(images, keep_cameras=True, record=BY_TRACKS)
    start = time.perf_counter()
    run = match_images(
        images,
        output,
        replace(options, keep_panoramas=True),  # of a part of one COLMAP has no camera
        first_pairs=_first_pairs(images, options, tracked),
        restart=restart,
        progress=progress,
    )
    if run.agreed:
        images = replace(images, cameras=dict(run.cameras))
        if track is not None and tracked is not None and tracked.cam_from_world:
            tracked = track(images, keep_cameras=True, record=BY_PAIRS)
    seconds = time.perf_counter() - start
    if images.cameras != given:
        agreed = said_of_cameras(given, images.cameras)
        run = replace(run, agreed=agreed, with_agreed="tracked" if by_tracks else "matched")
    return _Matched(images, run, tracked, seconds)


def _first_pairs(
    images: ImageSet, options: MatchOptions, tracked: SequenceStart | None
) -> list[Pair]:
    """Pairs of a sequence whose way is known."""
    if tracked is None or not tracked.cam_from_world or options.pairs != "auto":
        return []
    return trajectory_pairs(images.images, tracked.cam_from_world, tracked.depth)


@dataclass(frozen=True, eq=False)
class _Work:
    """Matched images, and how they are mapped."""

    images: ImageSet
    graph: MatchGraph
    matched: MatchRun
    colors: Colors
    output: Path
    options: MapOptions
    progress: Progress

    def mapped(
        self, record: Mapping[str, Any], how: str, poses: Mapping[str, Pose]
    ) -> tuple[dict[str, Any], tuple[MappedModel, ...], bool]:
        """Map, unless an earlier run has; the record of it, the models, and whether it was there.

        ``poses`` are tried first, and ``how`` says in words where they come from.
        """
        made_from = _fingerprint(self.graph, self._mapper, poses)
        before = self._models_of(record) if record.get("fingerprint") == made_from else None
        if before is not None:
            count = len(self.graph.images)
            self.progress(STAGE, count, count)
            has_them = record.get("descriptors") == self.options.descriptors
            if not has_them or not (self.output / DATABASE).is_file():
                self._write_database()
            return {**record, "descriptors": self.options.descriptors}, before, True
        made = self._map(how, poses)
        models = read_models(self.output / MODELS, made["mean_error_px"], self.graph)
        made = {"fingerprint": made_from, **made, "descriptors": self.options.descriptors}
        return made, models, False

    def _models_of(self, record: Mapping[str, Any]) -> tuple[MappedModel, ...] | None:
        """The models of an earlier run; None where somebody has deleted or damaged one since."""
        try:
            return read_models(self.output / MODELS, record["mean_error_px"], self.graph)
        except (OSError, ValueError):
            return None

    @cached_property
    def _with_guided(self) -> MatchGraph:
        """The graph that is mapped, which has more inliers where pairs have few."""
        noise_deg = {(told.image1, told.image2): told.noise_deg for told in self.matched.verdicts}
        num_threads = self.options.match.num_threads or num_cores()
        descriptors = descriptors_of(self.output)
        return with_guided(self.graph, noise_deg, descriptors, num_threads, self.progress)

    @property
    def _mapper(self) -> MapperOptions:
        given = self.options
        seed = given.match.seed % 2**31  # COLMAP takes no others
        return MapperOptions(given.mapper, given.refine_cameras, given.mapper_threads, seed)

    def _write_database(self) -> None:
        path = self.output / DATABASE
        path.unlink(missing_ok=True)
        wanted = descriptors_of(self.output) if self.options.descriptors else _no_descriptors
        write_colmap_database(path, self._with_guided, descriptors=wanted)

    def _map(self, how: str, poses: Mapping[str, Pose]) -> dict[str, Any]:
        """Write database and models; returns what the record says of them."""
        start = time.perf_counter()
        write_record(self.output / RECORD, {})  # from here on database and models are ours
        for name in (TRANSFORMS, POINTS_FILE):
            (self.output / name).unlink(missing_ok=True)
        self._write_database()
        mapped = map_by_attempts(
            self.output / DATABASE,
            self._mapper,
            self._with_guided,
            self.matched.verdicts,
            colors=self.colors,
            initial=(how, poses),
            compose=self._composed,
            progress=self.progress,
        )
        if how == TRACKED_POSES:  # the world of poses that the caller gave is theirs
            for model in mapped.models:
                turn_upright(model)
        shutil.rmtree(self.output / MODELS, ignore_errors=True)
        if mapped.models:
            with whole_folder(self.output / MODELS) as temporary:
                for number, model in enumerate(mapped.models):
                    (temporary / str(number)).mkdir()
                    model.write_binary(temporary / str(number))
        return {
            "seconds": time.perf_counter() - start,
            "mean_error_px": [model.compute_mean_reprojection_error() for model in mapped.models],
            "attempts": [vars(attempt) for attempt in mapped.attempts],
            "unconfirmed": list(mapped.unconfirmed),
        }

    def _composed(self) -> ComposedPoses:
        return composed_poses(
            self.graph,
            self.matched.verdicts,
            _panoramas(self.images, self.options.match.mask_nadir_deg),
            progress=self.progress,
        )


def _branches(graph: MatchGraph, models: Sequence[MappedModel]) -> tuple[Branch, ...]:
    """Images of the first model that hang on one pair."""
    placed = [image.name for image in models[0].reconstruction.images] if models else []
    frames = {name: graph.images[name].frame for name in placed}
    frame_of = {name: name if frame is None else frame for name, frame in frames.items()}
    mapped = (
        (pair.image1, pair.image2)
        for pair in graph.pairs
        if pair.geometry is not None and pair.geometry.status in CONFIG_OF_STATUS
    )
    return lone_branches(mapped, frame_of)


def _no_descriptors(name: str) -> None:
    return None


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


def _panoramas(images: ImageSet, mask_nadir_deg: float) -> Callable[[str], Panorama | None]:
    """Pictures by name, None of what is no full panorama or cannot be read any more."""
    image_of = {image.name: image for image in images.images}

    @remembered
    def panorama_of(name: str) -> Panorama | None:
        image = image_of[name]
        camera = images.cameras[image.camera]
        if not is_full_panorama(camera):
            return None
        try:
            return read_panorama(image, camera, mask_nadir_deg)
        except (OSError, ValueError):
            return None

    return panorama_of
