# SPDX-License-Identifier: BSD-3-Clause
"""A folder of images to verified relative poses of its pairs; stopped, it goes on from there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from epi360.cameras import Camera
from epi360.cameras.upright import check_upright
from epi360.features.detection import check_options
from epi360.interop.match_graph import REFUSED
from epi360.jobs.engines import Engine, check_engine
from epi360.jobs.folder.feature_cache import ExtractionOptions, FeatureCache
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.graph.rig_check import RigDoubt, Turn, rig_doubts
from epi360.jobs.matching.agreed_cameras import MOST_ROUNDS, CameraSearch
from epi360.jobs.matching.folder_verdicts import FolderVerdicts, JudgedPairs, judge_folder
from epi360.jobs.matching.kept_verdicts import KeptVerdicts, made_from
from epi360.jobs.matching.match_engines import LocalEngine, MatchEngine
from epi360.jobs.matching.match_job import MatchJob
from epi360.jobs.matching.match_result import load_matches, names_in_index, write_index
from epi360.jobs.matching.more_pairs import more_pairs
from epi360.jobs.matching.pair_verdicts import PairVerdict
from epi360.jobs.matching.pair_work import MatchInputs, PairWork
from epi360.jobs.pairs.pair_selection import (
    NEIGHBORS,
    OVERLAP,
    Pair,
    check_partners,
    dense_pairs,
    is_dense,
    mostly_match,
    said_unused,
    select_pairs,
    ways_of,
)
from epi360.jobs.records.match_store import (
    DIGESTS,
    FEATURES,
    IMPLIED_PAIRS,
    UNREADABLE,
    Keys,
    Verdict,
    open_output,
    write_part,
)
from epi360.jobs.threads import num_cores
from epi360.progress import Progress, no_progress
from epi360.runs.file_digests import FileDigests
from epi360.runs.remote_path import AnyPath, RemotePath, path_of

__all__ = ["MatchOptions", "MatchRun", "PairVerdict", "load_matches", "match_images"]


@dataclass(frozen=True)
class MatchOptions:
    """How images are matched."""

    pairs: str | Path = "auto"  # see `select_pairs`
    overlap: int | None = None  # in a sequence: 10 neighbours that follow an image
    neighbors: int | None = None  # 20 partners of an image by retrieval, and by position
    positions: Path | None = None  # poses for pairs that are near; without them GPS of the images
    radius: float | None = None  # of near pairs, in the unit of the positions; metres of GPS
    # Wider images are searched at this width; key points are in pixels of the originals. At 2048,
    # real pairs 2688 wide have errors as small as at their full width, in half the time.
    max_width: int = 2048
    max_features: int = 10000  # the strongest of each image are kept
    mask_nadir_deg: float = 0.0  # ignored around straight down
    upright_deg: float | None = None  # panoramas that stand upright to so many degrees, one sigma
    keep_cameras: bool = False  # even where pairs agree that their angles are other ones
    keep_panoramas: bool = False  # those of panoramas only
    seed: int = 0
    num_threads: int | None = None  # one per core; the results do not depend on it

    def __post_init__(self) -> None:
        """Check all options."""
        check_options(self.max_width, self.mask_nadir_deg)
        check_upright(self.upright_deg)
        ways = ways_of(self.pairs)
        for name in ("positions", "radius"):
            if getattr(self, name) is not None and "near" not in ways:
                raise ValueError(f'{name} must come with pairs="near", got pairs="{self.pairs}"')
        check_partners(self.pairs, self.partners)
        if self.radius is not None and not 0.0 < self.radius < np.inf:
            raise ValueError(f"radius must be above 0, got {self.radius:g}")
        for name in ("overlap", "neighbors", "max_features", "num_threads"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}")

    @property
    def partners(self) -> dict[str, int | None]:
        """Numbers of partners that were given."""
        return {"overlap": self.overlap, "neighbors": self.neighbors}


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchRun(JudgedPairs):
    """What a run of `match_images` found."""

    folder: AnyPath  # what `load_matches` takes
    num_found: int  # pairs that an earlier run had finished
    # The cameras that the pairs were matched by.
    cameras: Mapping[str, Camera] = field(default_factory=dict)


def match_images(
    images: ImageSet,
    output: str | PathLike[str] | RemotePath,
    options: MatchOptions = MatchOptions(),  # noqa: B008 - frozen
    *,
    first_pairs: Sequence[Pair] = (),
    restart: bool = False,
    progress: Progress = no_progress,
    engine: Engine = "local",
    address: str | None = None,
) -> MatchRun:
    """Verified poses of pairs of images; what an earlier run has finished is used.

    ``output``, a folder or a URL that fsspec understands, keeps key points and pairs. With
    ``restart``, pairs in it that were made with other options are thrown away instead of refusing
    them; features that still fit are kept. ``progress`` is told of the stages "images", "features",
    "retrieval", "pairs", in a level folder "level pairs", and "places", "rival poses" and "second
    poses" where accepted pairs have surroundings to look at.

    With ``pairs="auto"``, 16 to 30 frames of a dense sequence are not matched exhaustively: the
    pairs of `dense_pairs` are looked at first, and suffice where `is_dense` finds that all of them
    match well. So do ``first_pairs``, the `trajectory_pairs` of a sequence, where nearly all match.

    Where accepted pairs agree that the angles of a camera are other ones than were given, see
    `CameraSearch`, all pairs are matched once more by these, unless ``keep_cameras``.

    Every image has one list of key points, strongest first. A pair is matched with the stronger
    ones, those of SIFT at a contrast of 0.02, and with all where that settles nothing or leaves a
    warning, unless it leaves no hope: a pose less probable than 0.05. If the poses say that the
    folder is level, see `find_level`, pairs without a pose, and those whose pose is tilted, are
    estimated again with that known, and then from all key points. An image that cannot be read
    costs its pairs, not the run. In the end the surroundings of accepted and doubted pairs are
    compared, see `judge_places`, and the pairs are held against each other, see `check_graph`. A
    pair that is not accepted gets the pose that its other matches agree on, if its
    surroundings speak for that, see `find_second`, or the pose that two accepted pairs imply, if
    its own matches agree, see `find_implied`.

    The engine is "local" (the threads of this machine) or "ray" (on the cluster of that address, by
    default one that is started on this machine). There, each image and each part of the pairs is a
    task, which writes its file into the output. Both write the same bytes, on any number of
    threads, and one goes on with what the other has left.

    Raises
    ------
    ValueError
        If the pairs file names an unknown image, there are no positions for pairs that are near,
        images that are no panoramas shall be upright, or the output was made with other options or
        by something else.
    OSError
        If the output cannot be written.
    """
    check_engine(engine)
    search = CameraSearch(
        images.cameras,
        [image.camera for image in images.images],
        seed=options.seed,
        most_rounds=0 if options.keep_cameras else MOST_ROUNDS,
        keep_panoramas=options.keep_panoramas,
    )
    folder = path_of(output)
    work = _open_work(images, folder, options, restart=restart)
    found = []  # pairs that were finished before each round; this run finishes some itself
    while True:
        with open_engine(work, engine, address) as opened:
            job = MatchJob(work, opened, progress)
            chosen = _chosen(images, job, options, first_pairs)
            found.append(chosen.num_found)
            if not search.goes_on(job, chosen.pairs, chosen.finished):
                chosen = replace(chosen, num_found=min(found))
                return _judged(images, job, chosen, options, search.told())
        images = replace(images, cameras=search.cameras)
        work = _work(images, folder, options, work.inputs.cache.options)


@dataclass(frozen=True, eq=False)
class _Chosen:
    """Pairs that were chosen, with their verdicts by their own matches."""

    how: str
    pairs: Sequence[Pair]
    finished: Mapping[Keys, Verdict]
    num_found: int
    is_sequence: bool  # neighbours, nearly all of which match


def _judged(
    images: ImageSet,
    job: MatchJob,
    chosen: _Chosen,
    options: MatchOptions,
    agreed: tuple[str, ...],
) -> MatchRun:
    is_upright = options.upright_deg is not None
    looks_around = not chosen.is_sequence  # neighbours in a sequence are of one place
    keys = [job.keys_of(pair) if job.is_readable(pair) else None for pair in chosen.pairs]
    names = [(job.name_of(first), job.name_of(second)) for first, second in chosen.pairs]
    asked = made_from(
        names, keys, chosen.finished, is_upright=is_upright, looks_around=looks_around
    )
    kept = KeptVerdicts(job.output, asked)
    before = kept.read(keys)
    judged = before or judge_folder(
        job, chosen.pairs, chosen.finished, is_upright=is_upright, looks_around=looks_around
    )
    part = _write_index(images, job, judged)
    if before is None and not job.gone:  # this run has seen everything
        kept.write(judged, part)
    return MatchRun(
        folder=job.output,
        how=chosen.how,
        images=tuple(image.name for image in images.images),
        verdicts=judged.verdicts,
        unreadable=job.unreadable,
        gone=job.gone,
        num_found=chosen.num_found,
        level=judged.level,
        num_gained=judged.num_gained,
        num_lost=judged.num_lost,
        num_not_compared=judged.num_not_compared,
        cameras=images.cameras,
        agreed=agreed,
        rig_doubts=_rig_doubts(images, judged.verdicts),
    )


def _rig_doubts(images: ImageSet, verdicts: Sequence[PairVerdict]) -> tuple[RigDoubt, ...]:
    """What the rotations of pairs say against the rig of the images."""
    if not images.cam_from_rig:
        return ()
    moments = {each.name: (each.frame or each.name, each.camera) for each in images.images}
    turns = (
        Turn(
            moments[each.image1],
            moments[each.image2],
            each.cam2_from_cam1.rotation,
            each.rotation_sigma_deg,
        )
        for each in verdicts
        if each.accepted or each.status == "pure_rotation"
    )
    return tuple(rig_doubts(turns, images.cam_from_rig))


def _chosen(
    images: ImageSet, job: MatchJob, options: MatchOptions, first_pairs: Sequence[Pair]
) -> _Chosen:
    """Those of a sequence if these suffice, otherwise what the options say."""
    few = list(first_pairs) or dense_pairs(images.images, options.pairs)
    suffice = mostly_match if first_pairs else is_dense
    finished, num_found = _verified(few, job) if few else ({}, 0)
    unreadable = [Verdict(status=UNREADABLE) for pair in few if not job.is_readable(pair)]
    is_sequence = bool(few) and suffice([*finished.values(), *unreadable])
    if is_sequence:
        how = f"{len(few)} of a {'tracked' if first_pairs else 'dense'} sequence"
        pairs = few
    else:
        more = more_pairs(images, job, options.positions, options.radius, job.progress)
        how, pairs = select_pairs(
            images.images,
            options.pairs,
            options.overlap or OVERLAP,
            options.neighbors or NEIGHBORS,
            more,
            dict(images.skipped),
        )
        num_seen = len(finished)
        finished, num_there = _verified(pairs, job)
        num_found += num_there - num_seen
    chosen_among = () if is_sequence else images.images
    how += said_unused(chosen_among, options.pairs, options.partners)
    return _Chosen(how, pairs, finished, num_found, is_sequence)


def _write_index(images: ImageSet, job: MatchJob, judged: FolderVerdicts) -> str:
    """Keep what is the result, and the pairs that have another pose than their own first one.

    Returns the name of the part with these pairs, "" without any.
    """
    matched, confirmed, refused = [], [], []
    for keys, verdict in zip(judged.keys, judged.verdicts, strict=True):
        names = verdict.image1, verdict.image2
        if keys is not None:
            matched.append(names)
        if verdict.confirmed and verdict.accepted:
            confirmed.append(names)
        if verdict.status == REFUSED:
            refused.append(names)
    kept = [pair for _, pair in sorted(judged.other_poses.items())]
    part = write_part(job.output, kept, IMPLIED_PAIRS) if kept else ""
    keys_of_images = job.readable_keys()
    write_index(job.output, images, keys_of_images, matched, judged.level, confirmed, refused, part)
    return part


def open_match_output(
    output: AnyPath, options: MatchOptions, *, restart: bool
) -> ExtractionOptions:
    """Open the output folder of `match_images`, or refuse it; how key points are found for it."""
    extraction = ExtractionOptions(
        options.max_width, options.max_features, float(options.mask_nadir_deg)
    )
    made_with = {**vars(extraction), "seed": options.seed, "upright": options.upright_deg}
    open_output(output, made_with, restart=restart)
    return extraction


def _open_work(
    images: ImageSet, output: AnyPath, options: MatchOptions, *, restart: bool
) -> PairWork:
    """Open the output folder, or refuse it, and return the work that is done in it."""
    extraction = open_match_output(output, options, restart=restart)
    if not restart:
        _check_images(images, output)
    return _work(images, output, options, extraction)


def _work(
    images: ImageSet, output: AnyPath, options: MatchOptions, extraction: ExtractionOptions
) -> PairWork:
    """The work that is done in the output folder, which is open."""
    inputs = MatchInputs(
        images=dict(enumerate(images.images)),
        cameras=dict(enumerate(images.cameras[image.camera] for image in images.images)),
        keys={},
        output=output,
        cache=FeatureCache(output / FEATURES, extraction, FileDigests(output / DIGESTS)),
        seed=options.seed,
        upright_deg=options.upright_deg,
    )
    return PairWork(inputs, options.num_threads or num_cores())


def _check_images(images: ImageSet, output: AnyPath) -> None:
    """Raise ``ValueError`` where the output is the result of none of these images."""
    before = names_in_index(output)
    if before and before.isdisjoint(image.name for image in images.images):
        raise ValueError(
            f"output {output} is the result of {len(before)} other images, such as {min(before)}; "
            "choose another output, or --restart to replace it"
        )


@contextmanager
def open_engine(work: PairWork, engine: Engine, address: str | None) -> Iterator[MatchEngine]:
    """Engine of this name; a Ray session is closed at the end, see `ray_session`."""
    if engine == "local":
        yield LocalEngine(work)
        return
    from epi360.jobs.matching.match_on_ray import RayEngine
    from epi360.jobs.ray_tasks import import_ray, ray_session

    ray = import_ray("matching on Ray")
    with ExitStack() as sessions:

        def connect() -> Any:
            sessions.enter_context(ray_session(ray, address))
            return ray

        yield RayEngine(work, connect)


def _verified(pairs: Sequence[Pair], job: MatchJob) -> tuple[dict[Keys, Verdict], int]:
    """Verdicts of pairs, and how many were there; the key points are found first."""
    wanted = {index for pair in pairs for index in pair}
    if not wanted <= job.keys.keys():
        job.find_features(sorted(wanted))
    return job.verify(pairs)
