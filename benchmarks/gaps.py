# SPDX-License-Identifier: BSD-3-Clause
"""What the odometry makes of walks of which frames are missing: does the map go on, and where.

With ``--back``, of walks that come back over the gap, or into a copy of the room where they began:
are the maps joined?

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
from epi360.jobs.trajectories import align
from epi360.poses import Pose, rotation_from_vector
from epi360.synthetic.landmarks import rotation_from_heading
from epi360_scenes import furnished_room, handheld_path
from epi360_scenes.corridor import corridor_of_equal_doors
from epi360_scenes.home import Home, twin_home
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
MISSING_BEFORE_RETURN = (30, 45)
NUM_TO_TURN, ASIDE_M = 15, 0.12  # frames in which a walker turns round, and how far beside the way
HEIGHT_M, CLEAR_M = 1.4, 0.35  # of a camera in a bedroom, and its least distance to things
Picture = NDArray[np.uint8]
Walk = tuple[Room, list[Pose]]


def main() -> int:
    """Print how many maps go on rightly, go on elsewhere, or end at a gap."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seed", type=int, default=0, help="of the first place (0)")
    parser.add_argument("--places", type=int, default=2, help="of each kind (2)")
    parser.add_argument("--back", action="store_true", help="walks that come back")
    options = parser.parse_args()
    kinds, columns = (BACK, BACK_COLUMNS) if options.back else (ONWARDS, COLUMNS)
    rows = [["place", "gaps", *columns]]
    for kind, found_in in kinds.items():
        counts: Counter[str] = Counter()
        for seed in range(options.seed, options.seed + options.places):
            counts.update(found_in(seed))
            print(f"{kind} {seed}: {sum(counts.values())} gaps so far", flush=True)
        rows.append([kind, str(sum(counts.values())), *(str(counts[each]) for each in columns)])
    print(text_table(rows))
    return 0


def corridor_walk(seed: int, *, plain_floor: bool) -> Walk:
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


def room_walk(seed: int) -> Walk:
    """A furnished room, and a walk through it."""
    room = furnished_room(seed)
    return room, handheld_path(room, STARTS[-1] + NUM_BEFORE + MISSING[-1], seed)


def _of_walk(walk: Walk, missing: Sequence[int], seed: int) -> list[str]:
    """What becomes of each gap of a walk."""
    scene, poses = walk
    pictures: dict[int, Picture] = {}

    def picture_of(number: int) -> Picture:
        if number not in pictures:
            pictures[number] = _picture(scene, poses[number], (seed, number))
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


def _and_back(walk: Walk, missing: Sequence[int], seed: int) -> list[str]:
    """What becomes of walks with a gap that turn round and come back all the way."""
    scene, poses = walk
    found = []
    for gap in missing:
        after = NUM_BEFORE + gap
        last = after + NUM_AFTER - 1
        there = [poses[number] for number in (*range(NUM_BEFORE), *range(after, last + 1))]
        back = [_beside(poses[last], share, share) for share in np.linspace(0.0, 1.0, NUM_TO_TURN)]
        back += [
            _beside(poses[number], 1.0, 1.0 + 0.3 * np.sin(0.05 * (last - number)))
            for number in range(last - 1, -1, -1)
        ]
        found.append(_joined(scene, [*there, *back], (seed, gap)))
    return found


def _beside(pose: Pose, turned: float, aside: float) -> Pose:
    """A camera that is turned round by such a share, and beside another one."""
    turn = rotation_from_vector([0.0, np.pi * turned, 0.0])
    return Pose(pose.rotation @ turn, pose.translation + np.array([ASIDE_M * aside, 0.0, 0.0]))


def _and_its_copy(kind: str, seed: int) -> list[str]:
    """A walk in a room, and one that comes to the same part of its copy."""
    home = twin_home(seed)
    rooms = [room for room in home.rooms if room.kind == kind]
    sides = [room.side for room in rooms]
    copies = [room for room in rooms if sides.count(room.side) > 1][:2]
    spots = list(itertools.product(np.linspace(-1.5, 1.5, 31), repeat=2))
    least = np.full(len(spots), np.inf)
    for room in copies:
        places = np.array([room.place.to_world((x, -HEIGHT_M, z)) for x, z in spots])
        least = np.minimum(least, home.solids.distances(places))
    free = np.array(spots)[least > CLEAR_M]
    apart = np.linalg.norm(free[:, None] - free, axis=2)
    one_end, other_end = free[list(np.unravel_index(int(apart.argmax()), apart.shape))]
    ways = [
        (copies[0], one_end + share * (other_end - one_end), 0.0)
        for share in np.linspace(0.0, 0.6, NUM_BEFORE)
    ] + [
        (copies[1], other_end + share * (one_end - other_end) + 0.04, 2.0)
        for share in np.linspace(0.0, 0.85, NUM_AFTER)
    ]
    poses = []
    for number, (room, (x, z), heading) in enumerate(ways):
        sway = np.sin(number / 3.0)
        turn = [0.02 * sway, room.place.yaw + heading + 0.01 * number, 0.01]
        place = np.array(room.place.to_world((x, -HEIGHT_M + 0.02 * sway, z)))
        poses.append(Pose(rotation_from_heading(np.array(turn)), place))
    return [_joined(home, poses, (seed, 0))]


def _joined(scene: Room | Home, poses: Sequence[Pose], seed: tuple[int, int]) -> str:
    """What becomes of two maps, one before a gap and one after it."""
    odometry = Odometry(CAMERA)
    for number, pose in enumerate(poses):
        odometry.add_frame(_picture(scene, pose, (*seed, number)))
    odometry.finish()
    trajectory = odometry.trajectory()
    before = np.count_nonzero(trajectory.indices < NUM_BEFORE)
    if min(before, len(trajectory.indices) - before) < FEWEST:
        return "several maps"
    truth = np.array([poses[index].translation for index in trajectory.indices])
    moved = align(trajectory.positions, truth, "sim3").apply(trajectory.positions)
    off = np.linalg.norm(moved - truth, axis=1)
    return "one map, right" if off.max() < OFF_M else "one map, wrong"


def _picture(scene: Room | Home, pose: Pose, seed: Sequence[int]) -> Picture:
    """What a camera sees, with noise."""
    seen = scene.seen_from(pose.translation) if isinstance(scene, Home) else scene
    image = seen.render(CAMERA, pose, supersample=1).image
    noisy = np.round(image + np.random.default_rng(list(seed)).normal(0.0, NOISE, image.shape))
    return np.clip(noisy, 0, 255).astype(np.uint8)


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


def _plain(seed: int) -> Walk:
    return corridor_walk(seed, plain_floor=True)


def _textured(seed: int) -> Walk:
    return corridor_walk(seed, plain_floor=False)


COLUMNS = ("goes on, right", "goes on, wrong", "another map", "lost")
ONWARDS: dict[str, Callable[[int], list[str]]] = {
    "corridor, plain floor": lambda seed: _of_walk(_plain(seed), MISSING, seed),
    "corridor, textured floor": lambda seed: _of_walk(_textured(seed), MISSING, seed),
    "furnished room": lambda seed: _of_walk(room_walk(seed), MISSING_IN_ROOM, seed),
}
BACK_COLUMNS = ("one map, right", "one map, wrong", "several maps")
BACK: dict[str, Callable[[int], list[str]]] = {
    "corridor, plain floor": lambda seed: _and_back(_plain(seed), MISSING_BEFORE_RETURN, seed),
    "corridor, textured floor": lambda seed: _and_back(
        _textured(seed), MISSING_BEFORE_RETURN, seed
    ),
    "furnished room": lambda seed: _and_back(room_walk(seed), MISSING_BEFORE_RETURN, seed),
    "bedroom and its copy": lambda seed: _and_its_copy("bedroom", seed),
    "study and its copy": lambda seed: _and_its_copy("study", seed),
}

if __name__ == "__main__":
    raise SystemExit(main())
