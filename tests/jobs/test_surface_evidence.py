# SPDX-License-Identifier: BSD-3-Clause
"""What surfaces of rendered rooms say: of their own pair, of others, and who says the same."""

from functools import cache
from itertools import combinations

import numpy as np
import pytest
from made_surroundings import no_surfaces, surfaces_of

from epi360.cameras import Equirectangular
from epi360.features.warped_patches import Panorama
from epi360.jobs.graph.place_evidence import Surroundings
from epi360.jobs.graph.surface_evidence import (
    HIDDEN,
    OWN,
    UNKNOWN,
    Sibling,
    SurfaceWitnesses,
    surfaces_ratio,
)
from epi360.places.same_place import limited_in_folder
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

CAMERA = Equirectangular(1024, 512)
WORLD_FROM_CAM = [
    Pose(rotation_from_vector([0.0, turn, 0.0]), np.array(place))
    for turn, place in (
        (0.3, (0.1, -1.5, -0.4)),
        (-1.2, (0.5, -1.45, 0.1)),
        (2.0, (-0.3, -1.5, 0.4)),
    )
]
TURNED = Pose(rotation_from_vector([0.0, 0.5, 0.0]), np.zeros(3))


@cache
def renderings():
    room = furnished_room(1)
    return [room.render(CAMERA, pose) for pose in WORLD_FROM_CAM]


def posed_pair(first, second, turn=None):
    """Pair with its true pose, or turned, and with points that agree with the pose."""
    pose = WORLD_FROM_CAM[second].inverse() @ WORLD_FROM_CAM[first]
    pose = Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))
    pose = pose if turn is None else turn @ pose
    rng = np.random.default_rng(first + 10 * second)
    directions = rng.normal(size=(600, 3)) * [1.0, 0.4, 1.0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    u, v = CAMERA.pixels_from_bearings(directions).T.astype(int)
    base = np.linalg.norm(WORLD_FROM_CAM[second].translation - WORLD_FROM_CAM[first].translation)
    points = directions * (renderings()[first].depth[v, u % CAMERA.width] / base)[:, None]
    seen = points @ pose.rotation.T + pose.translation
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    numbers = np.arange(len(directions))
    return PosedPair((first, second), pose, (numbers,) * 2, (directions, seen), 0.05, 0.05, 0.1)


def surroundings(pairs):
    panoramas = [Panorama.of(one.image) for one in renderings()]
    return Surroundings.of(pairs, lambda image: panoramas[image])


@cache
def right_room():
    pairs = [posed_pair(*images) for images in combinations(range(3), 2)]
    known = surroundings(pairs)
    grown = [known.grown(row) for row in range(3)]
    views = {(row, side): both[side] for row, (both, _) in enumerate(grown) for side in (0, 1)}
    return known, grown, SurfaceWitnesses.of(pairs, views)


def test_a_right_pair_speaks_for_itself_and_a_wrong_one_does_not():
    _, grown, _ = right_room()
    wrong = surroundings([posed_pair(0, 1, TURNED)]).grown(0)[1]
    assert min(own.over_others for _, own in grown) > 2.0
    assert min(own.over_copies for _, own in grown) > 1.0
    assert wrong.over_others < -2.0
    assert limited_in_folder(wrong).over_others == 0.0


@pytest.mark.parametrize("row", range(3))
def test_right_pairs_speak_for_each_other(row):
    known, grown, witnesses = right_room()
    evidence = known.with_surfaces(row, known.of_points(row), witnesses, grown[row][1])
    for sightings in evidence.surfaces:
        assert set(sightings.witnesses) <= {0, 1, 2} - {row}
        assert sightings.sources[0] == OWN
        assert sightings.hidden.shape == (len(sightings.cells), len(sightings.sources))
    assert surfaces_ratio(evidence.surfaces, np.ones(3, dtype=bool)) == 1.0  # as much as it may


def test_only_the_first_pairs_are_asked():
    known, grown, witnesses = right_room()
    pairs = known.pairs
    heard = Surroundings.of(pairs, known.panorama_of, num_heard=2)
    some = SurfaceWitnesses.of(pairs, witnesses.views, num_heard=2)
    for row in range(3):
        evidence = heard.with_surfaces(row, heard.of_points(row), some, grown[row][1])
        for sightings in (*evidence.sides, *evidence.surfaces):
            assert set(sightings.witnesses) <= {0, 1} - {row}
            assert set(sightings.sources) <= {OWN, 0, 1}
        assert all(sibling.pair < 2 and sibling.via < 2 for sibling in evidence.siblings)


def test_nobody_is_asked_who_is_not_believed():
    known, grown, witnesses = right_room()
    evidence = known.with_surfaces(0, known.of_points(0), witnesses, grown[0][1])
    believed = np.array([True, False, False])
    assert surfaces_ratio(evidence.surfaces, believed) == 0.0


def test_pairs_of_a_triangle_that_closes_say_the_same():
    known, grown, witnesses = right_room()
    evidence = known.with_surfaces(0, known.of_points(0), witnesses, grown[0][1])
    assert set(evidence.siblings) == {Sibling(1, 2), Sibling(2, 1)}


def test_pairs_of_a_triangle_that_is_open_do_not():
    pairs = [posed_pair(0, 1, TURNED), posed_pair(0, 2), posed_pair(1, 2)]
    known = surroundings(pairs)
    grown = [known.grown(row) for row in range(3)]
    views = {(row, side): both[side] for row, (both, _) in enumerate(grown) for side in (0, 1)}
    witnesses = SurfaceWitnesses.of(pairs, views)
    evidence = known.with_surfaces(0, known.of_points(0), witnesses, grown[0][1])
    assert evidence.siblings == ()


TRUSTED = np.ones(4, dtype=bool)


def test_surfaces_alone_say_only_so_much():
    for ratio, limit in ((-3.8, -1.0), (1.7, 1.0)):
        assert surfaces_ratio((surfaces_of([1], ratio, num=6000),) * 2, TRUSTED) == limit


@pytest.mark.parametrize("hidden", [HIDDEN, UNKNOWN])
def test_surfaces_that_may_be_hidden_say_nothing(hidden):
    assert surfaces_ratio((surfaces_of([1], -3.0, hidden=hidden),) * 2, TRUSTED) == 0.0


def test_surfaces_of_pairs_that_are_not_believed_say_nothing():
    sides = (surfaces_of([1], -3.0),) * 2
    assert surfaces_ratio(sides, TRUSTED) == -1.0
    assert surfaces_ratio(sides, np.array([True, False, True, True])) == 0.0


def test_surfaces_of_one_of_both_views_say_nothing():
    for ratio in (-3.0, 1.7):
        assert surfaces_ratio((surfaces_of([1], ratio), no_surfaces()), TRUSTED) == 0.0
