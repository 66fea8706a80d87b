# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts on image pairs of whole tours, photographed and rendered, and on learned matches."""

from __future__ import annotations

import itertools
import math
import shutil
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from _data import Matches, load_set, read_poses
from _homes import OneTour, rendered_homes
from _methods import Pycolmap
from _trust_records import LISTED, ZIND, Judged, errors_of, found_pose

from epi360 import estimate_relative_pose
from epi360.cameras import Equirectangular
from epi360.estimation import RelativePoseResult
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.result import pose_sigmas_deg
from epi360.interop import MatchedImage, MatchedPair, MatchGraph
from epi360.jobs.folder.image_set import ImageSet, find_images
from epi360.jobs.matching.match_folder import (
    MatchOptions,
    PairVerdict,
    load_matches,
    match_images,
)
from epi360.jobs.matching.verify_pairs import verify_pairs, without_geometries
from epi360.jobs.records.match_store import Verdict
from epi360.poses import Pose
from epi360_scenes.lenses import CAMERA, tour_through_lens
from epi360_scenes.tours import Panorama, Tour

OURS = "epi360"
FOLDER = f"{OURS}, folder"  # given matches, judged together
# COLMAP's default of 4 px first; it asks for 15 inliers by default.
PEER_GATES_PX = (4.0, 2.0, 1.0)
RATIOS = (0.95, 0.9, 0.8)
LEARNED_WIDTH = 2048  # of the panoramas that the learned features were found in
DOWN = np.array([0.0, 1.0, 0.0])
TruthOf = Callable[[str, str], Pose]
MADE = ("pairs", "level-*", "some-*", "implied")  # folders of estimates in an output of `match`


@dataclass(frozen=True)
class Plan:
    """What is run, and where."""

    data: Path
    out: Path
    num_homes: int
    tour_width: int
    photographed: bool
    lens_deg: float | None  # of what a fisheye lens shows of homes
    seed: int
    jobs: int
    with_peer: bool


@dataclass(frozen=True)
class GivenPair:
    """Matches of one pair, and its true pose."""

    set: str
    pair: str
    matches: Matches
    truth: Pose
    overlap: float = math.nan
    relation: str = ""


def zind_verdicts(plan: Plan) -> Iterator[Judged]:
    """All pairs of the photographed tour, or of what a lens shows of it, by `match_images`."""
    folder = plan.data / ZIND
    one = _through_lens(plan, _photographed(folder))
    # Through a lens, they have other names: it may show little of what a listed pair shares.
    listed = {frozenset((pair.path1.name, pair.path2.name)) for pair in load_set(folder).pairs}
    truth_of = one.tour.cam2_from_cam1
    for run in _folder_verdicts(plan, one.name, one.tour.folder, truth_of, one.camera):
        is_listed = frozenset(run.pair.split(" ")) in listed
        yield replace(run, set=one.kind, relation=LISTED if is_listed else "")


def _photographed(folder: Path) -> OneTour:
    """The photographed tour as if it were a rendered home; rooms and overlaps are not known."""
    world_from_cam = read_poses(folder / "poses.csv")
    panoramas = tuple(Panorama(name, "", "", pose) for name, pose in world_from_cam.items())
    overlaps = dict.fromkeys(itertools.combinations(world_from_cam, 2), math.nan)
    return OneTour(ZIND, ZIND, 0, Tour(folder / "panos", True, panoramas, overlaps))


def tour_verdicts(plan: Plan) -> Iterator[Judged]:
    """All pairs within rendered homes, level ones and tilted ones."""
    for one in tours(plan):
        tour = one.tour
        truth_of = tour.cam2_from_cam1
        for run in _folder_verdicts(plan, one.name, tour.folder, truth_of, one.camera):
            name = "photographed" if plan.photographed else "tours"
            yield of_tour(run, f"{name}, {one.kind}", one.home, tour)


def given_verdicts(plan: Plan) -> Iterator[Judged]:
    """All pairs of rendered homes, from matches that `verify_pairs` is given.

    They are the ones of `match_images`, without its verdicts.
    """
    for one in tours(plan):
        tour = one.tour
        output = plan.out / "match" / one.name
        match_images(
            images_of(tour.folder, one.camera),
            output,
            MatchOptions(pairs="exhaustive", seed=plan.seed, num_threads=plan.jobs),
            restart=True,
        )
        graph = load_matches(output, by_others=False)
        found = [
            *_alone(plan, _peer_tasks(one.name, output, tour.cam2_from_cam1)),
            *_given_verdicts(plan, one.name, graph, tour.folder, tour.cam2_from_cam1),
        ]
        yield from (of_tour(run, f"given, {one.kind}", one.home, tour) for run in found)


def tours(plan: Plan) -> Iterator[OneTour]:
    """Rendered homes, as they are or photographed, or what a lens shows of them."""
    homes = rendered_homes(
        plan.out / "tours",
        plan.seed,
        plan.num_homes,
        plan.tour_width,
        photographed=plan.photographed,
    )
    return (_through_lens(plan, one) for one in homes)


def _through_lens(plan: Plan, one: OneTour) -> OneTour:
    """The home as the lens of the plan shows it, if it has one."""
    if plan.lens_deg is None:
        return one
    name = f"lens_{plan.lens_deg:g}_{one.name}"
    folder = plan.out / "tours" / name
    tour = tour_through_lens(one.tour, folder, plan.lens_deg, plan.seed + one.home)
    kind = f"{one.kind} at {plan.lens_deg:g}°"
    return replace(one, name=name, kind=kind, tour=tour, camera=folder / CAMERA)


def images_of(folder: Path, camera: Path | None) -> ImageSet:
    return find_images(folder, camera=None if camera is None else str(camera))


def _alone(plan: Plan, tasks: Iterable[GivenPair]) -> Iterator[Judged]:
    """Verdicts on each pair by its matches alone."""
    with ProcessPoolExecutor(plan.jobs) as pool:
        judge = partial(_judge_alone, has_gravity=False, seed=plan.seed)
        for run in pool.map(judge, list(tasks), chunksize=8):
            yield replace(run, method=f"{OURS}, pair alone")


def _given_verdicts(
    plan: Plan, name: str, graph: MatchGraph, pictures: Path, truth_of: TruthOf
) -> Iterator[Judged]:
    """Verdicts on given matches: judged together, and with their pictures too."""
    unverified = without_geometries(graph)
    for method, folder in ((f"{FOLDER}, no pictures", None), (FOLDER, pictures)):
        found = verify_pairs(unverified, pictures=folder, seed=plan.seed, num_threads=plan.jobs)
        yield from judged_ones(name, method, found.verdicts, truth_of)


def judged_ones(
    name: str, method: str, verdicts: Iterable[PairVerdict], truth_of: TruthOf
) -> Iterator[Judged]:
    """Verdicts on the pairs of a folder beside their true poses."""
    for verdict in verdicts:
        yield Judged(
            name,
            method,
            f"{verdict.image1} {verdict.image2}",
            verdict.status,
            verdict.accepted,
            verdict.probability,
            verdict.num_inliers,
            *errors_of(_found_pose(verdict), truth_of(verdict.image1, verdict.image2)),
            verdict.rotation_sigma_deg,
            verdict.translation_sigma_deg,
            pose=_found_pose(verdict),
        )


def of_tour(run: Judged, kind: str, home: int, tour: Tour) -> Judged:
    """A verdict with what is known of two panoramas of a home."""
    name1, name2 = sorted(run.pair.split(" "), key=[one.name for one in tour.panoramas].index)
    return replace(
        run,
        set=kind,
        pair=f"home {home} {run.pair}",
        overlap=tour.overlaps[name1, name2],
        relation=tour.relation(name1, name2),
    )


def _folder_verdicts(
    plan: Plan, name: str, folder: Path, truth_of: TruthOf, camera: Path | None = None
) -> Iterator[Judged]:
    """Verdicts of `match_images` on all pairs of a folder, and of COLMAP on the same matches."""
    output = plan.out / "match" / name
    for made in MADE:  # key points may stay
        for part in output.glob(made):
            shutil.rmtree(part, ignore_errors=True)
    run = match_images(
        images_of(folder, camera),
        output,
        MatchOptions(pairs="exhaustive", seed=plan.seed, num_threads=plan.jobs),
        restart=True,
    )
    yield from judged_ones(name, OURS, run.verdicts, truth_of)
    if plan.with_peer:
        yield from _peer_verdicts(plan, _peer_tasks(name, output, truth_of))


def _found_pose(verdict: Verdict) -> Pose:
    """The pose, or the one that was refused though it is more probable than not."""
    return verdict.cam2_from_cam1 if verdict.status != "too_few_inliers" else verdict.doubted


def _peer_tasks(name: str, output: Path, truth_of: TruthOf) -> Iterator[GivenPair]:
    graph = load_matches(output)
    for pair in graph.pairs:
        image1, image2 = (graph.images[one] for one in (pair.image1, pair.image2))
        yield GivenPair(
            name,
            f"{pair.image1} {pair.image2}",
            Matches(
                graph.cameras[image1.camera],
                graph.cameras[image2.camera],
                image1.keypoints[pair.matches[:, 0]],
                image2.keypoints[pair.matches[:, 1]],
            ),
            truth_of(pair.image1, pair.image2),
        )


def learned_verdicts(plan: Plan) -> Iterator[Judged]:
    """Matches of a learned feature at several ratios, with gravity and without."""
    folder = plan.data / "learned_matches"
    world_from_cam = read_poses(plan.data / ZIND / "poses.csv")
    panoramas = plan.data / ZIND / "panos"
    camera = Equirectangular(LEARNED_WIDTH, LEARNED_WIDTH // 2)

    def truth_of(name1: str, name2: str) -> Pose:
        return world_from_cam[name2].inverse() @ world_from_cam[name1]

    with np.load(folder / "bearings.npz") as bearings, np.load(folder / "matches.npz") as matches:
        seen = {name: bearings[name].astype(np.float64) for name in bearings.files}
        images = {
            name: MatchedImage(name, "panorama", camera.pixels_from_bearings(each))
            for name, each in seen.items()
        }
        for ratio in RATIOS:
            tasks, pairs = [], []
            for key in [key for key in matches.files if key.endswith("|indices")]:
                name1, name2, _ = key.split("|")
                kept = matches[key][matches[f"{name1}|{name2}|similarity_ratio"][:, 1] < ratio]
                both = seen[name1][kept[:, 0]], seen[name2][kept[:, 1]]
                pixels = [camera.pixels_from_bearings(each) for each in both]
                truth = truth_of(name1, name2)
                found = Matches(camera, camera, pixels[0], pixels[1])
                tasks.append(GivenPair(f"learned {ratio:g}", f"{name1} {name2}", found, truth))
                pairs.append(MatchedPair(name1, name2, kept))
            yield from given_pair_verdicts(plan, tasks, gravities=(False, True))
            graph = MatchGraph({"panorama": camera}, images, tuple(pairs))
            yield from _given_verdicts(plan, f"learned {ratio:g}", graph, panoramas, truth_of)


def given_pair_verdicts(
    plan: Plan, tasks: list[GivenPair], *, gravities: tuple[bool, ...] = (False,)
) -> Iterator[Judged]:
    """Verdicts on each pair by its matches, with gravity or without, and those of COLMAP."""
    with ProcessPoolExecutor(plan.jobs) as pool:
        for has_gravity in gravities:
            judge = partial(_judge_alone, has_gravity=has_gravity, seed=plan.seed)
            yield from pool.map(judge, tasks, chunksize=8)
    if plan.with_peer:
        yield from _peer_verdicts(plan, tasks)


def _judge_alone(task: GivenPair, *, has_gravity: bool, seed: int) -> Judged:
    matches = task.matches
    result = estimate_relative_pose(
        matches.camera1.bearings_from_pixels(matches.keypoints1),
        matches.camera2.bearings_from_pixels(matches.keypoints2),
        gravity1=DOWN if has_gravity else None,
        gravity2=DOWN if has_gravity else None,
        options=IMAGE_OPTIONS,
        seed=seed,
    )
    method = f"{OURS}, gravity" if has_gravity else OURS
    return judged_result(task.set, method, task.pair, result, task.truth)


def judged_result(
    set_name: str, method: str, pair: str, result: RelativePoseResult, truth: Pose
) -> Judged:
    """What became of one pair, beside its true pose."""
    pose = found_pose(result)
    return Judged(
        set_name,
        method,
        pair,
        result.status,
        result.success,
        result.probability,
        result.num_inliers,
        *errors_of(pose, truth),
        *pose_sigmas_deg(result),
        pose=pose,
    )


def _peer_verdicts(plan: Plan, tasks: Iterable[GivenPair]) -> Iterator[Judged]:
    """COLMAP at each gate on the same matches."""
    listed = list(tasks)
    with ProcessPoolExecutor(plan.jobs) as pool:
        for gate in PEER_GATES_PX:
            judge = partial(_judge_peer, gate_px=gate, seed=plan.seed)
            yield from pool.map(judge, listed, chunksize=8)


def _judge_peer(task: GivenPair, *, gate_px: float, seed: int) -> Judged:
    peer = Pycolmap(Path(), max_error_px=gate_px)
    found = peer.from_matches(task.matches, seed)
    return Judged(
        task.set,
        f"pycolmap {gate_px:g} px",
        task.pair,
        found.status,
        found.accepted,
        math.nan,
        found.num_inliers,
        *errors_of(found.cam2_from_cam1, task.truth),
        pose=found.cam2_from_cam1,
    )
