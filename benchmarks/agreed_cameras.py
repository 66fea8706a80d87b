# SPDX-License-Identifier: BSD-3-Clause
"""What `match` makes of folders whose cameras are not what they are taken for.

``python benchmarks/agreed_cameras.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from _homes import rendered_homes
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular, KannalaBrandt
from epi360.features import read_image
from epi360.features.picture_writing import encode_picture
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching.folder_verdicts import JudgedPairs
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.jobs.matching.verify_pairs import verify_pairs, without_geometries
from epi360.poses import Pose, rotation_error_deg, translation_error_deg
from epi360_scenes.paths import handheld_path
from epi360_scenes.room import scene

Picture = NDArray[np.uint8]
Truth = Callable[[str, str], Pose]

WIDTH = 1536  # of the panoramas of homes
RIGHT_DEG = 10.0
LENS = KannalaBrandt(800, 800, 250.0, 250.0, 402.0, 397.0, 0.02, -0.008, max_angle_deg=95.0)
NUM_FRAMES, STEP_M, TURN_DEG = 20, 0.35, 15.0


@dataclass(frozen=True)
class Folder:
    """Pictures, what they show, the camera that took them, and the one that they are taken for."""

    name: str
    pictures: Path
    truth: Truth
    camera: Camera
    taken_for: Camera


def main() -> int:
    """Print rows for each folder: kept, agreed on, and by the right camera.

    With ``--matches`` also what `verify_pairs` makes of the same matches, as of another program,
    without and with other cameras.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seed", type=int, default=0, help="of the first home and film (0)")
    parser.add_argument("--homes", type=int, default=1, help="level ones, and tilted ones (1)")
    parser.add_argument("--films", type=int, default=2, help="through a fisheye lens (2)")
    parser.add_argument("--pictures", type=Path, help="keep what is rendered in this folder")
    parser.add_argument(
        "--matches", action="store_true", help="also judge the matches as those of others"
    )
    options = parser.parse_args()
    ways = ("kept", "agreed", "right", *(("judged", "changed") if options.matches else ()))
    print(
        f"{'folder':36} {'cameras':8} {'accepted':>8} {'right':>6} {'wrong':>6} {'R, t error':>14}"
    )
    with tempfile.TemporaryDirectory() as temporary:
        rendered = options.pictures or Path(temporary)
        for folder in _folders(rendered, options.seed, options.homes, options.films):
            for how in ways:
                print(_row(folder, how, Path(temporary) / "work"), flush=True)
    return 0


def _folders(rendered: Path, seed: int, num_homes: int, num_films: int) -> Iterator[Folder]:
    for home in rendered_homes(rendered, seed, num_homes, WIDTH, photographed=True):
        tour = home.tour
        names = [one.name for one in tour.panoramas]
        whole = Equirectangular(WIDTH, WIDTH // 2)
        for kind, left in CUTS.items():
            pictures = rendered / f"{home.name} {kind}"
            _write_cut(tour.folder, names, pictures, left)
            camera = replace(
                whole,
                horizontal_fov_deg=left.around,
                vertical_fov_deg=left.high,
                center_latitude_deg=90.0 - left.high / 2.0,
            )
            name = f"{home.kind} home {seed + home.home}, {kind}"
            yield Folder(name, pictures, tour.cam2_from_cam1, camera, whole)
    for number in range(seed, seed + num_films):
        pictures = rendered / f"film_{number}"
        poses = _write_film(pictures, number)
        for kind, factor, keeps_curve in LENSES:
            yield Folder(
                f"film {number}, lens {kind}",
                pictures,
                _truth_of(poses),
                LENS,
                _other_lens(factor, keeps_curve=keeps_curve),
            )


@dataclass(frozen=True)
class Left:
    """Degrees that are left of a panorama, around and from the zenith down."""

    around: float = 360.0
    high: float = 180.0


CUTS = {
    "whole": Left(),
    "350° around": Left(around=350.0),
    "lowest 9° cut off": Left(high=171.0),
    "lowest 18° cut off": Left(high=162.0),
}
LENSES = (
    ("right", 1.0, True),
    ("focal length −5 %", 0.95, True),
    ("focal length +10 %", 1.1, True),
    ("focal length +20 %", 1.2, True),
    ("without its curve", 1.0, False),
)


def _other_lens(factor: float, *, keeps_curve: bool) -> KannalaBrandt:
    edge = min((LENS.max_angle_deg or 180.0) / factor, 180.0)
    lens = replace(LENS, fx=factor * LENS.fx, fy=factor * LENS.fy, max_angle_deg=edge)
    return lens if keeps_curve else replace(lens, k1=0.0, k2=0.0)


def _write_cut(whole: Path, names: list[str], folder: Path, left: Left) -> None:
    """The same panoramas with less around or below, stretched back to their size."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        picture = read_image(whole / name)
        height, width = picture.shape[:2]
        aside = round(width * (1.0 - left.around / 360.0) / 2.0)
        part = picture[: round(height * left.high / 180.0), aside : width - aside]
        if part.shape != picture.shape:
            part = cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA)
        (folder / name).write_bytes(encode_picture(np.ascontiguousarray(part), ".jpg"))


def _write_film(folder: Path, seed: int) -> list[Pose]:
    room = scene("living_room", seed)
    poses = handheld_path(
        room, num_frames=NUM_FRAMES, step_m=STEP_M, max_turn_deg=TURN_DEG, seed=seed
    )
    folder.mkdir(parents=True, exist_ok=True)
    for number, world_from_cam in enumerate(poses):
        path = folder / f"{number}.png"
        if not path.is_file():
            path.write_bytes(encode_picture(room.render(LENS, world_from_cam).image, ".png"))
    return poses


def _truth_of(world_from_cam: list[Pose]) -> Truth:
    def truth(name1: str, name2: str) -> Pose:
        first, second = (world_from_cam[int(Path(name).stem)] for name in (name1, name2))
        return second.inverse() @ first

    return truth


def _row(folder: Folder, how: str, work: Path) -> str:
    camera = folder.camera if how == "right" else folder.taken_for
    work.mkdir(exist_ok=True)
    file = work / "camera.json"
    file.write_text(json.dumps({"model": type(camera).__name__, **asdict(camera)}))
    images = find_images(folder.pictures, camera=str(file))
    options = MatchOptions(keep_cameras=how != "agreed")
    with tempfile.TemporaryDirectory(dir=work) as output:
        run: JudgedPairs = match_images(images, output, options)
        if how in ("judged", "changed"):
            given = without_geometries(load_matches(output))
            run = verify_pairs(given, pictures=folder.pictures, change_cameras=how == "changed")
    errors = _errors_deg(run, folder.truth)
    num_right = int((errors.max(axis=1, initial=0.0) < RIGHT_DEG).sum())
    rotation, direction = np.median(errors, axis=0) if len(errors) else (np.nan, np.nan)
    return (
        f"{folder.name:36} {how:8} {len(errors):8} {num_right:6} {len(errors) - num_right:6} "
        f"{rotation:6.2f}, {direction:6.2f} {'; '.join(run.agreed)}"
    )


def _errors_deg(run: JudgedPairs, truth: Truth) -> NDArray[np.float64]:
    errors = []
    for each in run.verdicts:
        if each.accepted:
            poses = each.cam2_from_cam1, truth(each.image1, each.image2)
            errors.append([rotation_error_deg(*poses), translation_error_deg(*poses)])
    return np.array(errors).reshape(-1, 2)


if __name__ == "__main__":
    raise SystemExit(main())
