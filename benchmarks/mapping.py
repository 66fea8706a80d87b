# SPDX-License-Identifier: BSD-3-Clause
"""A folder of panoramas to a model: `epi360 map` beside plain pycolmap, in one run.

``python benchmarks/mapping.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from _data import data_folder, read_poses
from _machine import fact_lines, load_average, machine_facts
from _picture import add_picture_option, check_picture, panel_of, write_picture
from _summary import markdown_table, text_table

from epi360.cameras import Equirectangular
from epi360.features.picture_writing import encode_picture
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.mapping import map_folder
from epi360.jobs.mapping.composed_poses import ComposedPoses
from epi360.jobs.mapping.map_folder import MapOptions, map_images
from epi360.poses import Pose, rotation_error_deg
from epi360.report.files import check_writable
from epi360.runs.whole_files import write_file
from epi360_scenes import handheld_path, scene
from epi360_scenes.tours import render_tour

PACKAGES = ("epi360", "pycolmap", "numpy", "opencv-python-headless")
ROOM_VIEWS, ROOM_STEP_FRAMES, ROOM_SEED = 12, 10, 3  # 0.4 m apart
# The folder of the images of a real one.
SCENES = {"theta_flat": "images", "living_room": "", "studio": "", "zind_tour": "panos"}
HOME = re.compile(r"home_(level|tilted)_(\d+)")  # rendered ones with twin rooms, by their seeds
FAR_M = 0.3
HEADER = (
    "scene", "method", "registered", "over 0.3 m off", "points", "track", "error px",
    "position rms %", "position max %", "rotation mean deg", "rotation max deg", "matching s",
    "mapping s", "total s", "CPU s",
)  # fmt: skip


@dataclass(frozen=True)
class Sequence360:
    """Panoramas with known poses."""

    name: str
    folder: Path
    world_from_cam: Mapping[str, Pose]


@dataclass(frozen=True)
class Model:
    """What a method makes of a folder: its largest model."""

    world_from_cam: Mapping[str, Pose]
    num_points: int
    mean_track_length: float
    mean_error_px: float
    matching_s: float
    mapping_s: float


@dataclass(frozen=True)
class Run:
    """One method on one scene, measured."""

    scene: str
    method: str
    num_images: int
    num_registered: int
    num_far: int
    num_points: int
    mean_track_length: float
    mean_error_px: float
    position_rms_percent: float
    position_max_percent: float
    rotation_mean_deg: float
    rotation_max_deg: float
    matching_s: float
    mapping_s: float
    total_s: float
    cpu_s: float

    def cells(self) -> list[str]:
        """Row of the table."""
        return [
            self.scene,
            self.method,
            f"{self.num_registered}/{self.num_images}",
            f"{self.num_far}",
            f"{self.num_points}",
            f"{self.mean_track_length:.2f}",
            f"{self.mean_error_px:.3f}",
            f"{self.position_rms_percent:.4f}",
            f"{self.position_max_percent:.4f}",
            f"{self.rotation_mean_deg:.4f}",
            f"{self.rotation_max_deg:.4f}",
            f"{self.matching_s:.1f}",
            f"{self.mapping_s:.1f}",
            f"{self.total_s:.1f}",
            f"{self.cpu_s:.1f}",
        ]


def main() -> int:
    """Run the benchmark as the command line says; exit code 2 for wrong use."""
    options = _parse_options()
    try:
        for path, name in ((options.json, "--json"), (options.markdown, "--markdown")):
            if path is not None:
                check_writable(path, name=name)
        check_picture(options.picture)
        names = options.scenes.split(",")
        if unknown := [name for name in names if name not in SCENES and not HOME.fullmatch(name)]:
            raise ValueError(f"unknown scene {', '.join(unknown)}")
        real = data_folder(options.data) if any(map(SCENES.get, names)) else None
    except ValueError as error:
        print(f"mapping.py: {error}", file=sys.stderr)
        return 2
    facts = machine_facts(PACKAGES)
    print("\n".join(fact_lines(facts)), flush=True)
    methods = {name: METHODS[name] for name in options.methods.split(",")}
    with tempfile.TemporaryDirectory() as scratch:
        scenes = [_load(name, real, Path(scratch), options.width) for name in names]
        runs = [
            _measure(scene, name, methods[name], Path(scratch))
            for scene in scenes
            for repeat in range(options.repeat)
            for name in (list(methods) if repeat % 2 == 0 else list(methods)[::-1])
        ]
    facts["load_average_at_end"] = load_average()
    _report(_medians(runs), runs, facts, options)
    return 0


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Folders of panoramas to models.")
    parser.add_argument("--data", help="folder of the sets; $EPI360_DATA, else ../shared/data")
    scenes = ",".join([*SCENES, "home_level_0"])
    parser.add_argument(
        "--scenes", default=scenes, help="of these, and other home_level_N, home_tilted_N"
    )
    parser.add_argument(
        "--methods", default="epi360,epi360 global,pycolmap", help=f"of {','.join(METHODS)}"
    )
    parser.add_argument("--width", type=int, default=1024, help="of the rendered panoramas")
    parser.add_argument("--repeat", type=int, default=1, help="runs of each; medians are shown")
    parser.add_argument("--json", type=Path, help="file for every figure")
    parser.add_argument("--markdown", type=Path, help="file for the table")
    add_picture_option(parser)
    return parser.parse_args()


def _load(name: str, data: Path | None, scratch: Path, width: int) -> Sequence360:
    if home := HOME.fullmatch(name):
        kind, seed = home.groups()
        tour = render_tour(scratch / name, int(seed), is_level=kind == "level", width=width)
        return Sequence360(name, tour.folder, {o.name: o.world_from_cam for o in tour.panoramas})
    if not SCENES[name]:
        return _render(name, scratch / name, width)
    assert data is not None
    return Sequence360(name, data / name / SCENES[name], read_poses(data / name / "poses.csv"))


def _render(name: str, folder: Path, width: int) -> Sequence360:
    """Walk through a room of the package; the truth is exact."""
    folder.mkdir()
    room, camera = scene(name), Equirectangular(width, width // 2)
    path = handheld_path(room, ROOM_VIEWS * ROOM_STEP_FRAMES, seed=ROOM_SEED)[::ROOM_STEP_FRAMES]
    poses = {f"{number:02d}.jpg": pose for number, pose in enumerate(path)}
    for file, pose in poses.items():
        image = room.render(camera, pose).image
        (folder / file).write_bytes(encode_picture(image, ".jpg", jpeg_quality=93))
    return Sequence360(name, folder, poses)


def _epi360(folder: Path, output: Path, mapper: str = "incremental") -> Model:
    """`epi360 map` with its defaults."""
    run = map_images(find_images(folder), output, MapOptions(mapper=mapper))
    if not run.models:
        return Model({}, 0, np.nan, np.nan, run.seconds["matching"], run.seconds["mapping"])
    best = run.models[0]
    return Model(
        {image.name: image.cam_from_world.inverse() for image in best.reconstruction.images},
        len(best.reconstruction.points),
        best.mean_track_length,
        best.mean_error_px,
        run.seconds["matching"],
        run.seconds["mapping"],
    )


def _epi360_global(folder: Path, output: Path) -> Model:
    """`epi360 map --mapper global`."""
    return _epi360(folder, output, "global")


def _epi360_mappers(folder: Path, output: Path) -> Model:
    """`epi360 map` without the poses of the pairs: COLMAP's mappers alone."""
    with patch.object(map_folder, "composed_poses", lambda *_, **__: ComposedPoses()):
        return _epi360(folder, output)


def _pycolmap(folder: Path, output: Path) -> Model:
    """COLMAP's own three steps with their defaults and its panorama camera."""
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    output.mkdir()
    database = output / "database.db"
    start = time.perf_counter()
    pycolmap.extract_features(
        database,
        folder,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=pycolmap.ImageReaderOptions(camera_model="EQUIRECTANGULAR"),
        device=pycolmap.Device.cpu,
    )
    pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    matched = time.perf_counter()
    models = pycolmap.incremental_mapping(database, folder, output)
    seconds = matched - start, time.perf_counter() - matched
    if not models:
        return Model({}, 0, np.nan, np.nan, *seconds)
    best = max(models.values(), key=lambda model: model.num_reg_images())
    poses = {
        image.name: Pose.from_matrix(image.cam_from_world().matrix()).inverse()
        for image in best.images.values()
        if image.has_pose
    }
    return Model(
        poses,
        best.num_points3D(),
        best.compute_mean_track_length(),
        best.compute_mean_reprojection_error(),
        *seconds,
    )


METHODS: dict[str, Callable[[Path, Path], Model]] = {
    "epi360": _epi360,
    "epi360 global": _epi360_global,
    "epi360 mappers alone": _epi360_mappers,
    "pycolmap": _pycolmap,
}


def _measure(
    scene: Sequence360, name: str, method: Callable[[Path, Path], Model], scratch: Path
) -> Run:
    """One timed run from the files to the model, and its errors."""
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        cpu, start = time.process_time(), time.perf_counter()
        model = method(scene.folder, Path(folder) / "out")
        total_s, cpu_s = time.perf_counter() - start, time.process_time() - cpu
    distances, degrees = aligned_errors(model.world_from_cam, scene.world_from_cam)
    run = Run(
        scene.name,
        name,
        len(scene.world_from_cam),
        len(model.world_from_cam),
        num_far(model.world_from_cam, scene.world_from_cam),
        model.num_points,
        model.mean_track_length,
        model.mean_error_px,
        100 * float(np.sqrt((distances**2).mean())),
        100 * float(distances.max()),
        float(degrees.mean()),
        float(degrees.max()),
        model.matching_s,
        model.mapping_s,
        total_s,
        cpu_s,
    )
    print("  ".join(run.cells()), flush=True)
    return run


def aligned_errors(
    world_from_cam: Mapping[str, Pose], truth: Mapping[str, Pose]
) -> tuple[np.ndarray, np.ndarray]:
    """Position errors as shares of the path's length and rotation errors in degrees.

    After a similarity whose rotation is the mean one of the cameras, since positions near a line
    do not determine it, and whose scale and shift fit the positions.
    """
    names = [name for name in truth if name in world_from_cam]
    if len(names) < 2:
        return np.array([np.nan]), np.array([np.nan])
    pairs = [(truth[name], world_from_cam[name]) for name in names]
    U, _, Vt = np.linalg.svd(sum(true.rotation @ ours.rotation.T for true, ours in pairs))
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    ours = np.array([R @ one.translation for _, one in pairs])
    true = np.array([one.translation for one, _ in pairs])
    path = np.linalg.norm(np.diff(true, axis=0), axis=1).sum()
    ours, true = ours - ours.mean(axis=0), true - true.mean(axis=0)
    scale = (ours * true).sum() / (ours**2).sum()
    degrees = [rotation_error_deg(R @ one.rotation, other.rotation) for other, one in pairs]
    return np.linalg.norm(true - scale * ours, axis=1) / path, np.array(degrees)


def num_far(world_from_cam: Mapping[str, Pose], truth: Mapping[str, Pose]) -> int:
    """Images that lie over 0.3 m from the truth, where most of the others fit it.

    Of the similarities through three images each, the one with the smallest median of the
    distances is taken, and fitted to what lies within three times of it.
    """
    names = [name for name in truth if name in world_from_cam]
    if len(names) < 3:
        return 0
    ours = np.array([world_from_cam[name].translation for name in names])
    true = np.array([truth[name].translation for name in names])
    rng = np.random.default_rng(0)
    some = [rng.choice(len(names), 3, replace=False) for _ in range(300)]
    best = min((_distances(ours, true, rows) for rows in some), key=np.median)
    near = np.flatnonzero(best <= max(3 * np.median(best), 0.05))
    return int(np.sum(_distances(ours, true, near if len(near) >= 3 else some[0]) > FAR_M))


def _distances(ours: np.ndarray, true: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Distances of all places after the similarity that fits those of some rows."""
    centre, true_centre = ours[rows].mean(axis=0), true[rows].mean(axis=0)
    U, S, Vt = np.linalg.svd((true[rows] - true_centre).T @ (ours[rows] - centre))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = (U * signs) @ Vt
    scale = (S * signs).sum() / max(float(((ours[rows] - centre) ** 2).sum()), 1e-12)
    return np.linalg.norm(scale * (ours - centre) @ R.T + true_centre - true, axis=1)


def _medians(runs: Sequence[Run]) -> list[Run]:
    """Median of each figure over the repeats of a scene and method."""
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in runs:
        groups.setdefault((run.scene, run.method), []).append(run)
    return [
        dataclasses.replace(
            same[0],
            **{
                field.name: type(getattr(same[0], field.name))(
                    np.median([getattr(run, field.name) for run in same])
                )
                for field in dataclasses.fields(Run)
                if field.name not in ("scene", "method")
            },
        )
        for same in groups.values()
    ]


def _report(
    medians: Sequence[Run], runs: Sequence[Run], facts: dict[str, Any], options: argparse.Namespace
) -> None:
    rows = [list(HEADER), *(run.cells() for run in medians)]
    print(f"\n{text_table(rows)}")
    if options.json is not None:
        document = {**facts, "runs": [dataclasses.asdict(run) for run in runs]}
        write_file(options.json, json.dumps(document, indent=1).encode())
    if options.markdown is not None:
        lines = "\n".join(f"- {line}" for line in fact_lines(facts))
        write_file(options.markdown, f"{lines}\n\n{markdown_table(rows)}\n".encode())
    fields = (
        ("Images over 0.3 m off", "images", lambda run: float(run.num_far), False),
        ("Images with a pose", "%", lambda run: 100.0 * run.num_registered / run.num_images, False),
        ("Position error, rms", "% of the path", lambda run: run.position_rms_percent, True),
        ("Rotation error, mean", "degrees", lambda run: run.rotation_mean_deg, True),
        ("Processor time", "s, all threads", lambda run: run.cpu_s, False),
        ("Wall time, matching and mapping", "s", lambda run: run.total_s, False),
        ("Points of the model", "points", lambda run: float(run.num_points), False),
    )
    panels = [
        panel_of(title, axis, [(run.scene, run.method, value(run)) for run in medians], powers=log)
        for title, axis, value, log in fields
    ]
    write_picture(options.picture, "A folder of panoramas to a model", panels, facts)


if __name__ == "__main__":
    sys.exit(main())
