# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts on two images alone, and on small folders of homes with rooms that are copies."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from _data import read_poses
from _homes import OneTour
from _trust_pairs import OURS, Plan, images_of, judged_ones, judged_result, of_tour, tours
from _trust_records import ZIND, Judged

from epi360.cameras.calibration import load_camera
from epi360.jobs.matching.match_folder import MatchOptions, match_images
from epi360.poses import Pose
from epi360.two_view import relative_pose_of_images
from epi360_scenes.tours import Panorama, Tour

PAIR, MATCHES_ALONE = f"{OURS} pair", f"{OURS} pair, matches alone"
CLIPS = ("Tram", "Walking_Girl")  # cars and people move along
STEPS = (5, 10, 15, 20, 25)  # frames
FEWEST, MOST = 2, 4  # panoramas in a small folder
MOST_FOLDERS = 6  # of each size and home
SMALL_SIZES, SMALL_FOLDERS = (5, 6, 7, 8, 9, 10, 12, 14), 3  # panoramas drawn; folders of each size


@dataclass(frozen=True)
class _Task:
    """Two files with the true pose."""

    set: str
    pair: str
    paths: tuple[Path, Path]
    truth: Pose
    camera: Path | None = None  # of both, if they are no panoramas


def pair_verdicts(plan: Plan) -> Iterator[Judged]:
    """``epi360 pair`` on all pairs of the photographed tour, and on frames of clips."""
    yield from _looked_at(plan, [*_zind(plan), *_clips(plan)])


def tour_pair_verdicts(plan: Plan) -> Iterator[Judged]:
    """``epi360 pair`` on all pairs within rendered homes."""
    for one in tours(plan):
        tasks = list(_of_home(one))
        for run in _looked_at(plan, tasks):
            yield of_tour(run, run.set, one.home, one.tour)


def few_verdicts(plan: Plan) -> Iterator[Judged]:
    """``epi360 match`` on folders of two to four panoramas of twin rooms of rendered homes."""
    for one in tours(plan):
        for number, group in enumerate(_few(one.tour, plan.seed)):
            yield from _of_folder(plan, one, number, group)


def small_verdicts(plan: Plan) -> Iterator[Judged]:
    """``epi360 match`` on folders of some panoramas that are drawn from rendered homes."""
    for one in tours(plan):
        rng = np.random.default_rng([plan.seed, one.home])
        for number, size in enumerate(np.repeat(SMALL_SIZES, SMALL_FOLDERS)):
            rows = sorted(rng.permutation(len(one.tour.panoramas))[:size].tolist())
            group = tuple(one.tour.panoramas[row] for row in rows)
            yield from _of_folder(plan, one, number, group)


def _zind(plan: Plan) -> Iterator[_Task]:
    folder = plan.data / ZIND
    world_from_cam = read_poses(folder / "poses.csv")
    for name1, name2 in itertools.combinations(sorted(world_from_cam), 2):
        truth = world_from_cam[name2].inverse() @ world_from_cam[name1]
        paths = folder / "panos" / name1, folder / "panos" / name2
        yield _Task(ZIND, f"{name1} {name2}", paths, truth)


def _clips(plan: Plan) -> Iterator[_Task]:
    for clip, step in itertools.product(CLIPS, STEPS):
        folder = plan.data / "video_clips" / clip
        world_from_cam = read_poses(folder / "poses.csv")
        names = sorted(world_from_cam)
        for name1, name2 in zip(names, names[step:], strict=False):
            truth = world_from_cam[name2].inverse() @ world_from_cam[name1]
            paths = folder / "frames" / name1, folder / "frames" / name2
            pair = f"{clip}/{name1} {clip}/{name2}"
            yield _Task(f"{clip}, {step} frames", pair, paths, truth)


def _of_home(one: OneTour) -> Iterator[_Task]:
    for first, second in itertools.combinations(one.tour.panoramas, 2):
        truth = one.tour.cam2_from_cam1(first.name, second.name)
        paths = one.tour.folder / first.name, one.tour.folder / second.name
        pair = f"{first.name} {second.name}"
        yield _Task(f"pairs, {one.kind}", pair, paths, truth, one.camera)


def _looked_at(plan: Plan, tasks: list[_Task]) -> Iterator[Judged]:
    """Verdicts on pairs, and those by their matches alone."""
    with ProcessPoolExecutor(plan.jobs) as pool:
        judge = partial(_judge, seed=plan.seed)
        for both in pool.map(judge, tasks, chunksize=4):
            yield from both


def _judge(task: _Task, *, seed: int) -> tuple[Judged, Judged]:
    camera = None if task.camera is None else load_camera(task.camera)
    result = relative_pose_of_images(*task.paths, camera1=camera, camera2=camera, seed=seed)
    is_compared = bool(np.isfinite(result.place.here))
    looked = judged_result(task.set, PAIR, task.pair, result, task.truth)
    before = replace(
        looked,
        method=MATCHES_ALONE,
        status="ok" if is_compared else result.status,
        accepted=is_compared or result.success,
        probability=result.explanations.found,
    )
    return before, looked


def _few(tour: Tour, seed: int) -> Iterator[tuple[Panorama, ...]]:
    """Some groups of panoramas of twin rooms: one of a room, and the others of its twin."""
    rng = np.random.default_rng(seed)
    by_room = {
        room: list(group)
        for room, group in itertools.groupby(tour.panoramas, key=lambda one: one.room)
    }
    twins = [
        (here, there)
        for here, there in itertools.permutations(by_room.values(), 2)
        if here[0].twins == there[0].twins
    ]
    for count in range(FEWEST, MOST + 1):
        groups = [
            (*many, lone)
            for here, there in twins
            for many in itertools.combinations(here, count - 1)
            for lone in there
        ]
        for row in sorted(rng.permutation(len(groups))[:MOST_FOLDERS].tolist()):
            yield groups[row]


def _of_folder(
    plan: Plan, one: OneTour, number: int, group: tuple[Panorama, ...]
) -> Iterator[Judged]:
    """Verdicts on all pairs of a folder with a few pictures of a home."""
    folder = plan.out / "few" / f"{one.name}_{number}"
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "pictures").mkdir(parents=True)
    for panorama in group:
        shutil.copy(one.tour.folder / panorama.name, folder / "pictures")
    run = match_images(
        images_of(folder / "pictures", one.camera),
        folder / "match",
        MatchOptions(pairs="exhaustive", seed=plan.seed, num_threads=plan.jobs),
    )
    kind = f"folders of {len(group)}, {one.kind}"
    for found in judged_ones(kind, OURS, run.verdicts, one.tour.cam2_from_cam1):
        run_of_home = of_tour(found, kind, one.home, one.tour)
        yield replace(run_of_home, pair=f"folder {number}, {run_of_home.pair}")
