# SPDX-License-Identifier: BSD-3-Clause
"""What `pair` and `match` make of offices with equal desks, where the next desk looks like this.

And `verify_pairs` of the same matches without the pictures.

``python benchmarks/offices.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from _summary import text_table
from corridors import Walk, of_folder, of_pairs

from epi360.cameras import Equirectangular
from epi360.features.picture_writing import encode_picture
from epi360.jobs.matching.match_folder import load_matches
from epi360.jobs.matching.verify_pairs import verify_pairs, without_geometries
from epi360.poses import Pose
from epi360.runs.whole_files import write_file
from epi360_scenes.office import office_of_equal_desks

WIDTH, NUM_PANORAMAS = 1024, 8
STEPS_M, CLEARANCE_M = (0.8, 1.8), 0.35  # to the nearest panorama before, and to furniture


def main() -> int:
    """Print what is accepted of pairs and of folders."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seed", type=int, default=0, help="of the first office (0)")
    parser.add_argument("--offices", type=int, default=6, help="how many (6)")
    parser.add_argument("--pictures", type=Path, help="keep what is rendered in this folder")
    options = parser.parse_args()
    counts: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        for seed in range(options.seed, options.seed + options.offices):
            walk = rendered_office(options.pictures or Path(temporary), seed)
            print(f"{walk.name}: {len(walk.poses)} panoramas", flush=True)
            work = Path(temporary) / "work"
            judged = (*of_pairs(walk), *of_folder(walk, work), *of_matches(walk, work))
            for what, verdict in judged:
                counts.setdefault(what, Counter())[verdict] += 1
    columns = ("right", "wrong", "not accepted")
    rows = [("offices", *columns)]
    rows += [(key, *(str(counts[key][column]) for column in columns)) for key in counts]
    print(text_table(rows))
    return 0


def rendered_office(folder: Path, seed: int) -> Walk:
    """Panoramas of the office of a seed; those that the folder has are not made again."""
    room, rng = office_of_equal_desks(seed), np.random.Generator(np.random.PCG64([seed, 9]))
    taken = [room.sample_pose(rng, clearance_m=CLEARANCE_M)]
    while len(taken) < NUM_PANORAMAS:
        pose = room.sample_pose(rng, clearance_m=CLEARANCE_M)
        away = [np.linalg.norm(pose.translation - other.translation) for other in taken]
        if STEPS_M[0] < min(away) < STEPS_M[1]:
            taken.append(pose)
    poses: dict[str, Pose] = {f"{number:02d}.jpg": pose for number, pose in enumerate(taken)}
    pictures = folder / f"office_{seed}"
    pictures.mkdir(parents=True, exist_ok=True)
    for file, pose in poses.items():
        if not (pictures / file).is_file():
            image = room.render(Equirectangular(WIDTH, WIDTH // 2), pose).image
            write_file(pictures / file, encode_picture(image, ".jpg"))
    return Walk(f"office {seed}", pictures, poses)


def of_matches(walk: Walk, work: Path) -> Iterator[tuple[str, str]]:
    """The matches of all pairs of the folder, of which there are no pictures."""
    graph = without_geometries(load_matches(work / walk.folder.name))
    for pair in verify_pairs(graph).verdicts:
        found = pair.cam2_from_cam1 if pair.accepted else None
        yield "matches alone", walk.verdict(pair.image1, pair.image2, found)


if __name__ == "__main__":
    raise SystemExit(main())
