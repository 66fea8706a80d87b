# SPDX-License-Identifier: BSD-3-Clause
"""What the odometry makes of walks of which frames are missing: does the map go on, and where.

``python benchmarks/gaps.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import itertools
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from _summary import text_table
from numpy.typing import NDArray

from epi360 import Odometry
from epi360.cameras import Equirectangular
from epi360.poses import Pose
from epi360.synthetic.landmarks import rotation_from_heading
from epi360_scenes import furnished_room, handheld_path
from epi360_scenes.corridor import corridor_of_equal_doors
from epi360_scenes.paths import smooth_noise
from epi360_scenes.room import Room

CAMERA = Equirectangular(768, 384)
NOISE = 2.0  # grey values
NUM_BEFORE, NUM_AFTER = 40, 40  # frames on both sides of a gap
STEP_M, FIRST_M = 0.06, -6.0
STARTS, MISSING = (0, 60), (25, 40, 55, 75, 100)  # 1.5 to 6 m of a corridor
MISSING_IN_ROOM = (10, 15, 20, 30)  # 0.4 to 1.2 m: farther, little of a room can be followed
OFF_SHARE, OFF_M = 0.15, 0.15  # of the way over the gap: a pose that is farther off is wrong
FEWEST = 3  # frames, of those after a gap, that decide what became of it
Picture = NDArray[np.uint8]


def main() -> int:
    """Print how many maps go on rightly, go on elsewhere, or end at a gap."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seed", type=int, default=0, help="of the first place (0)")
    parser.add_argument("--places", type=int, default=2, help="of each kind (2)")
    options = parser.parse_args()
    kinds: dict[str, Callable[[int], tuple[Room, list[Pose]]]] = {
        "corridor, plain floor": lambda seed: corridor_walk(seed, plain_floor=True),
        "corridor, textured floor": lambda seed: corridor_walk(seed, plain_floor=False),
        "furnished room": room_walk,
    }
    rows = [("place", "gaps", "goes on, right", "goes on, wrong", "another map", "lost")]
    for kind, walk_of in kinds.items():
        counts: Counter[str] = Counter()
        for seed in range(options.seed, options.seed + options.places):
            room, poses = walk_of(seed)
            missing = MISSING_IN_ROOM if kind == "furnished room" else MISSING
            counts.update(_of_walk(room, poses, missing, seed))
            print(f"{kind} {seed}: {sum(counts.values())} gaps so far", flush=True)
        rows.append((kind, str(sum(counts.values())), *(str(counts[each]) for each in rows[0][2:])))
    print(text_table(rows))
    return 0


def corridor_walk(seed: int, *, plain_floor: bool) -> tuple[Room, list[Pose]]:
    """A corridor with equal doors, and a walk along its middle with a sway, world_from_cam."""
    rng = np.random.default_rng(seed)
    num = STARTS[-1] + NUM_BEFORE + MISSING[-1]
    way = STEP_M * np.arange(num)
    stride = 2 * np.pi * way / 1.4
    places = np.column_stack(
        [
            0.1 * smooth_noise(rng, num, 25) + 0.022 * np.sin(stride / 2),
            -1.5 + 0.018 * np.cos(stride) + 0.03 * smooth_noise(rng, num, 30),
            FIRST_M + way,
        ]
    )
    turns = [(3, 20), (15, 30), (2, 20)]  # degrees, and frames over which they last
    headings = np.column_stack(
        [np.radians(size) * smooth_noise(rng, num, length) for size, length in turns]
    )
    poses = [Pose(rotation_from_heading(h), p) for h, p in zip(headings, places, strict=True)]
    return corridor_of_equal_doors(seed, plain_floor=plain_floor), poses


def room_walk(seed: int) -> tuple[Room, list[Pose]]:
    """A furnished room, and a walk through it."""
    room = furnished_room(seed)
    return room, handheld_path(room, STARTS[-1] + NUM_BEFORE + MISSING[-1], seed)


def _of_walk(room: Room, poses: Sequence[Pose], missing: Sequence[int], seed: int) -> list[str]:
    """What becomes of each gap of a walk."""
    pictures: dict[int, Picture] = {}

    def picture_of(number: int) -> Picture:
        if number not in pictures:
            rng = np.random.default_rng([seed, number])
            image = room.render(CAMERA, poses[number], supersample=1).image
            noisy = np.round(image + rng.normal(0.0, NOISE, image.shape))
            pictures[number] = np.clip(noisy, 0, 255).astype(np.uint8)
        return pictures[number]

    found = []
    for start, gap in itertools.product(STARTS, missing):
        after = start + NUM_BEFORE + gap
        numbers = [
            *range(start, start + NUM_BEFORE),
            *range(after, min(after + NUM_AFTER, len(poses))),
        ]
        if len(numbers) < NUM_BEFORE + NUM_AFTER // 2:
            continue
        odometry = Odometry(CAMERA)
        for number in numbers:
            odometry.add_frame(picture_of(number))
        found.append(_after_gap(odometry, [poses[number] for number in numbers]))
    return found


def _after_gap(odometry: Odometry, truth: Sequence[Pose]) -> str:
    """What the frames after a gap are, in the map of those before it."""
    trajectory = odometry.trajectory()
    pose_of = dict(zip(trajectory.indices.tolist(), trajectory.cam_from_world, strict=True))
    before = [index for index in pose_of if index < NUM_BEFORE]
    after = [index for index in pose_of if index >= NUM_BEFORE]
    if not before or len(after) < FEWEST:
        return "another map" if odometry.num_segments > 1 else "lost"
    if len(before) < FEWEST:  # the longest map is the one that came after
        return "another map"
    first, last = before[0], before[-1]
    walked = np.linalg.norm(_way(truth[first].inverse(), truth[last].inverse()))
    unit = walked / np.linalg.norm(_way(pose_of[first], pose_of[last]))
    wrong = 0
    for index in after:
        true = _way(truth[last].inverse(), truth[index].inverse())
        off = np.linalg.norm(unit * _way(pose_of[last], pose_of[index]) - true)
        wrong += bool(off > OFF_SHARE * np.linalg.norm(true) + OFF_M)
    return "goes on, wrong" if wrong >= FEWEST else "goes on, right"


def _way(first: Pose, second: Pose) -> NDArray[np.float64]:
    """From one camera to another, in the frame of the first; poses are cam_from_world."""
    way: NDArray[np.float64] = (first @ second.inverse()).translation
    return way


if __name__ == "__main__":
    raise SystemExit(main())
