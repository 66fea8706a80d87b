# SPDX-License-Identifier: BSD-3-Clause
"""What `pair` and `match` make of corridors with equal doors, where the next door looks the same.

``python benchmarks/corridors.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _summary import text_table

from epi360.cameras import Equirectangular
from epi360.features.picture_writing import encode_picture
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching.match_folder import match_images
from epi360.poses import Pose, poses_agree
from epi360.runs.whole_files import write_file
from epi360.synthetic.landmarks import rotation_from_heading
from epi360.two_view import relative_pose_of_images
from epi360_scenes.corridor import HALF_LENGTH_M, corridor_of_equal_doors
from epi360_scenes.photographs import photographed

WIDTH, NUM_PANORAMAS = 1536, 8
STEPS_M, ASIDE_M, HEIGHT_M, MOST_TILT_DEG = (0.8, 3.0), 0.15, (1.4, 1.6), 1.0
NEAR_M, FARTHEST_M = 2.0, 6.0
RIGHT_DEG = 10.0
FLOORS = {"textured floor": False, "plain floor": True}


@dataclass(frozen=True)
class Walk:
    """Panoramas along a corridor, in a folder, with their poses by name."""

    name: str
    folder: Path
    poses: dict[str, Pose]

    def pairs(self) -> Iterator[tuple[str, str, float]]:
        """Names of two panoramas that lie near enough, and how many metres they lie apart."""
        for first, second in itertools.combinations(self.poses, 2):
            between = self.poses[first].translation - self.poses[second].translation
            if (apart_m := float(np.linalg.norm(between))) <= FARTHEST_M:
                yield first, second, apart_m

    def verdict(self, first: str, second: str, found: Pose | None) -> str:
        """What an accepted pose of the second in the frame of the first is; None: there is none."""
        if found is None:
            return "not accepted"
        truth = self.poses[second].inverse() @ self.poses[first]
        return "right" if poses_agree(found, truth, RIGHT_DEG, RIGHT_DEG) else "wrong"


def main() -> int:
    """Print what is accepted of pairs and of folders."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seed", type=int, default=0, help="of the first corridor (0)")
    parser.add_argument("--corridors", type=int, default=6, help="of each kind of floor (6)")
    parser.add_argument("--photographed", action="store_true", help="as some camera takes them")
    parser.add_argument("--pictures", type=Path, help="keep what is rendered in this folder")
    options = parser.parse_args()
    counts: dict[tuple[str, str], Counter[str]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        rendered = options.pictures or Path(temporary)
        for floor, number in itertools.product(FLOORS, range(options.corridors)):
            seed = options.seed + number
            walk = rendered_walk(rendered, floor, seed, photos=options.photographed)
            print(f"{walk.name}: {len(walk.poses)} panoramas", flush=True)
            for what, verdict in (*of_pairs(walk), *of_folder(walk, Path(temporary) / "work")):
                counts.setdefault((floor, what), Counter())[verdict] += 1
    columns = ("right", "wrong", "not accepted")
    rows = [("corridors", "", *columns)]
    rows += [(*key, *(str(counts[key][column]) for column in columns)) for key in counts]
    print(text_table(rows))
    return 0


def rendered_walk(folder: Path, floor: str, seed: int, *, photos: bool) -> Walk:
    """Panoramas along the corridor of a seed; those that the folder has are not made again."""
    name = f"{floor} {seed}{' photographed' if photos else ''}"
    pictures = folder / name.replace(" ", "_")
    pictures.mkdir(parents=True, exist_ok=True)
    rng = np.random.Generator(np.random.PCG64([seed, 6]))
    steps = rng.uniform(*STEPS_M, NUM_PANORAMAS)
    along = np.cumsum(steps) - steps.sum() / 2 + rng.uniform(-2.0, 2.0)
    poses = {}
    for number, z in enumerate(np.clip(along, 1.0 - HALF_LENGTH_M, HALF_LENGTH_M - 1.0)):
        position = np.array([rng.normal(0.0, ASIDE_M), -rng.uniform(*HEIGHT_M), z])
        pitch, roll = np.radians(rng.uniform(-MOST_TILT_DEG, MOST_TILT_DEG, 2))
        heading = rotation_from_heading(np.array([pitch, rng.uniform(-np.pi, np.pi), roll]))
        poses[f"{number:02d}.jpg"] = Pose(heading, position)
    if not all((pictures / each).is_file() for each in poses):
        room = corridor_of_equal_doors(seed, plain_floor=FLOORS[floor])
        for number, (file, pose) in enumerate(poses.items()):
            image = room.render(Equirectangular(WIDTH, WIDTH // 2), pose).image
            own = np.random.Generator(np.random.PCG64([seed, 7, number]))
            content = photographed(image, own) if photos else encode_picture(image, ".jpg")
            write_file(pictures / file, content)
    return Walk(name, pictures, poses)


def of_pairs(walk: Walk) -> Iterator[tuple[str, str]]:
    """What pairs are, and what `pair` makes of each."""
    for first, second, apart_m in walk.pairs():
        result = relative_pose_of_images(walk.folder / first, walk.folder / second)
        what = f"pairs, {'up to' if apart_m <= NEAR_M else 'more than'} {NEAR_M:g} m"
        found = result.cam2_from_cam1 if result.success else None
        yield what, walk.verdict(first, second, found)


def of_folder(walk: Walk, work: Path) -> Iterator[tuple[str, str]]:
    """Every pair of the folder, the far ones too."""
    run = match_images(find_images(walk.folder), work / walk.folder.name)
    for pair in run.verdicts:
        found = pair.cam2_from_cam1 if pair.accepted else None
        yield "folders", walk.verdict(pair.image1, pair.image2, found)


if __name__ == "__main__":
    raise SystemExit(main())
