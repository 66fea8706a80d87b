# SPDX-License-Identifier: BSD-3-Clause
"""The corridor of equal doors: what repeats in it, and what does not."""

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.poses import Pose
from epi360_scenes.corridor import HALF_LENGTH_M, PLAIN_FLOORS, corridor_of_equal_doors

CAMERA = Equirectangular(256, 128)


@pytest.fixture(scope="module")
def room():
    return corridor_of_equal_doors(1, plain_floor=True)


def doors(room):
    """Places along the corridor of the faces that show a door, by which side they are on."""
    solids, surfaces = room.solids, room.surfaces
    names = np.array(surfaces.atlas.names)[surfaces.textures].reshape(-1, 6)
    is_door = np.isin(names, ["door", "paneldoor", "walnut"]).any(axis=1)
    is_door &= np.isclose(solids.box_halves[:, 1] * 2, 2.05) & (solids.box_halves[:, 0] > 0.4)
    centers = solids.box_centers[is_door]
    return {side: np.sort(centers[np.sign(centers[:, 0]) == side, 2]) for side in (-1, 1)}


def seen_from(room, z):
    return room.render(CAMERA, Pose(np.eye(3), np.array([0.0, -1.5, z]))).image.astype(float)


def test_doors_are_equally_far_apart(room):
    for places in doors(room).values():
        distances = np.diff(places)
        assert len(distances) > 4
        np.testing.assert_allclose(distances, distances[0])
        assert 3.0 <= distances[0] <= 4.2


def test_the_next_door_looks_like_this_one_and_the_wall_between_does_not(room):
    places = doors(room)[1]
    here, next_one = places[len(places) // 2 : len(places) // 2 + 2]
    facing = (slice(40, 96), slice(168, 216))  # a door to the east, without its number
    at_door, at_next, between = (
        seen_from(room, z)[facing] for z in (here, next_one, (here + next_one) / 2)
    )
    assert np.abs(at_door - at_next).mean() < 3.0
    assert np.abs(at_door - between).mean() > 15.0


def test_ends_differ(room):
    ends = [seen_from(room, sign * (HALF_LENGTH_M - 2.0)) for sign in (-1, 1)]
    ahead, behind = ends[1][40:88, 104:152], np.roll(ends[0], 128, axis=1)[40:88, 104:152]
    assert np.abs(ahead - behind).mean() > 15.0


def test_a_seed_gives_the_same_corridor_and_another_one_another(room):
    again, other = (corridor_of_equal_doors(seed, plain_floor=True) for seed in (1, 2))
    np.testing.assert_array_equal(again.solids.box_centers, room.solids.box_centers)
    assert (
        other.solids.box_centers.shape != room.solids.box_centers.shape
        or (other.solids.box_centers != room.solids.box_centers).any()
    )


@pytest.mark.parametrize("plain_floor", [True, False])
def test_the_floor_is_plain_if_asked(plain_floor):
    names = corridor_of_equal_doors(3, plain_floor=plain_floor).surfaces.atlas.names
    kinds = {name.partition("#")[0] for name in names}
    assert bool(kinds & set(PLAIN_FLOORS)) == plain_floor
