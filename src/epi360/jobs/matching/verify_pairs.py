# SPDX-License-Identifier: BSD-3-Clause
"""Relative poses for the pairs of a match graph that nobody has verified.

Its matches may be of any feature. Each pair is verified by its own matches first; then all of them
are judged together, as those of `match_images` are.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from epi360.interop.match_graph import MatchedPair, MatchGraph, TwoViewGeometry
from epi360.jobs.matching.agreed_cameras import MOST_ROUNDS, CameraSearch
from epi360.jobs.matching.check_keypoints import check_keypoints
from epi360.jobs.matching.folder_verdicts import FolderVerdicts, JudgedPairs, judge_folder
from epi360.jobs.matching.graph_folder import GraphFolder, SharedCameras
from epi360.jobs.records.match_store import Keys
from epi360.jobs.threads import num_cores
from epi360.progress import Progress, no_progress

GIVEN = "matched beforehand"  # how the pairs were chosen


@dataclass(frozen=True, eq=False, kw_only=True)
class VerifiedGraph(JudgedPairs):
    """What `verify_pairs` found.

    All pairs of ``graph`` that have matches have a geometry. ``verdicts`` are those of the pairs
    that had none; ``images`` are those of the ``kept`` pairs, too. The surroundings of
    ``num_comparable`` pairs can be compared, and ``looked_around`` says whether they were.
    """

    graph: MatchGraph
    num_comparable: int
    looked_around: bool


def unverified_pairs(graph: MatchGraph) -> list[MatchedPair]:
    """Pairs with matches and without a geometry."""
    return [pair for pair in graph.pairs if pair.geometry is None and len(pair.matches)]


def num_geometries(graph: MatchGraph) -> int:
    """How many pairs have been verified, by the cameras of the graph."""
    return sum(pair.geometry is not None for pair in graph.pairs)


def without_geometries(graph: MatchGraph) -> MatchGraph:
    """The same images and matches, of which nobody has verified any.

    A pair that has a pose and no matches keeps it, for it cannot be verified again.
    """
    pairs = tuple(
        dataclasses.replace(pair, geometry=None) if len(pair.matches) else pair
        for pair in graph.pairs
    )
    return dataclasses.replace(graph, pairs=pairs)


def verify_pairs(
    graph: MatchGraph,
    *,
    pictures: str | PathLike[str] | None = None,
    seed: int = 0,
    num_threads: int | None = None,
    change_cameras: bool = False,
    keep_panoramas: bool = False,
    progress: Progress = no_progress,
) -> VerifiedGraph:
    """Estimate the poses of the pairs that have none, and judge them together.

    If the poses say that the panoramas are level, see `find_level`, pairs without a pose, and those
    whose pose is tilted, are estimated again with that known. Poses that contradict each other are
    refused, see `check_graph`. With ``pictures``, the folder of the images, the surroundings of the
    pairs are compared where both cameras see enough of them, see `judge_places`, and some get a
    second pose, see `find_second`, or the one that others imply, see `find_implied`. Without them,
    pairs whose other matches agree on another direction are refused, see `find_repeated`. Pairs
    that have a geometry keep it; if it is "ok" and fits its own inliers, they have a say about the
    others, with the errors that are assumed of doubted poses.

    Where accepted pairs agree that the angles of a camera are other ones than the graph says, see
    `CameraSearch`, the result says so. With ``change_cameras`` all pairs are verified once more by
    these, which are those of its graph then, but for panoramas if ``keep_panoramas``. Cameras of
    few images that are equal are taken for one.

    ``progress`` is told of the stages "pictures", "verifying pairs", "level pairs", "places",
    "rival poses", "second poses" and, without pictures, "other directions".

    Raises
    ------
    ValueError
        If an image of such a pair has no camera or key points that are no pixels of it, see
        `check_keypoints`, or a picture has another shape than its camera or cannot be read; or if
        cameras may change and pairs have poses by those that are given.
    FileNotFoundError
        If it is not below ``pictures``.
    """
    num_verified = num_geometries(graph)
    if change_cameras and num_verified:
        raise ValueError(
            f"cameras can change where all pairs are verified by them; {num_verified} have been "
            "by the given ones: verify all again"
        )
    below = None if pictures is None else Path(pictures)
    looks_around = pictures is not None and bool(unverified_pairs(graph))
    shared = SharedCameras(graph)
    search = CameraSearch(
        shared.cameras,
        shared.of_images,
        seed=seed,
        most_rounds=MOST_ROUNDS if change_cameras else 1,
        keep_panoramas=change_cameras and keep_panoramas,
    )
    given = graph
    while True:
        folder = GraphFolder(graph, below, seed, num_threads or num_cores(), progress)
        check_keypoints(graph, folder.names)
        if looks_around and graph is given:  # what is missing is said before the work
            folder.read_pictures()
        finished = folder.verify()
        if not search.goes_on(folder, folder.pairs, finished) or not change_cameras:
            break
        graph = dataclasses.replace(graph, cameras=shared.all_of(search.cameras))
    if looks_around and graph is not given:
        folder.read_pictures()
    judged = judge_folder(
        folder, folder.pairs, finished, looks_around=looks_around, has_pictures=pictures is not None
    )
    found = _geometries(folder, judged)
    pairs = tuple(
        dataclasses.replace(pair, geometry=found.get((pair.image1, pair.image2), pair.geometry))
        for pair in graph.pairs
    )
    return VerifiedGraph(
        images=folder.names,
        verdicts=tuple(v for v in judged.verdicts if (v.image1, v.image2) in found),
        how=GIVEN,
        level=judged.level,
        num_gained=judged.num_gained,
        num_lost=judged.num_lost,
        num_not_compared=judged.num_not_compared,
        agreed=shared.said(search.cameras),
        with_agreed="judged" if change_cameras else "told",
        graph=dataclasses.replace(graph, pairs=pairs),
        kept=folder.kept,
        questioned=_questioned(folder, judged),
        num_comparable=len(folder.comparable),
        looked_around=judged.looked_around,
    )


def _geometries(folder: GraphFolder, judged: FolderVerdicts) -> dict[Keys, TwoViewGeometry]:
    """What became of each pair that had no geometry."""
    found = {}
    kept = set(folder.kept)
    for keys, verdict in zip(judged.keys, judged.verdicts, strict=True):
        assert keys is not None  # all images are readable
        if keys in kept:
            continue
        verified = judged.other_poses.get(keys) or folder.settled(keys, judged.settled[keys])
        inliers = verified.matches[verified.inlier_mask]
        found[keys] = TwoViewGeometry(verdict.status, verdict.cam2_from_cam1, inliers)
    return found


def _questioned(folder: GraphFolder, judged: FolderVerdicts) -> tuple[tuple[str, str], ...]:
    """Pairs that had a pose which the others refuse, or which their own inliers do not fit."""
    told = zip(judged.keys, judged.verdicts, strict=True)
    refused = folder.misfits | {keys for keys, verdict in told if keys and not verdict.accepted}
    return tuple(keys for keys in folder.kept if keys in refused)
