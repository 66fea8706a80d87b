# SPDX-License-Identifier: BSD-3-Clause
"""Directions on the sphere, places of furniture, ways through a room: truths made by hand."""

import numpy as np
import pytest

from epi360.synthetic import directions
from epi360_scenes import furniture, pieces, walks

WALLS = {"north": (0, -1), "east": (-1, 0), "south": (0, 1), "west": (1, 0)}
Place, Material, Furniture = furniture.Place, furniture.Material, furniture.Furniture


def test_tangents_make_an_orthonormal_frame_also_along_the_axes():
    axes = np.vstack([np.eye(3), -np.eye(3)])
    random = directions.unit(np.random.default_rng(0).normal(size=(50, 3)))
    for each in (axes, random):
        first, second = directions.tangents(each)
        frames = np.stack([each, first, second], axis=1)
        expected = np.broadcast_to(np.eye(3), frames.shape)
        np.testing.assert_allclose(frames @ frames.swapaxes(1, 2), expected, atol=1e-15)
        np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-15)


def test_a_vector_without_length_has_no_direction():
    units = directions.unit(np.array([[0.0, 3.0, 4.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(units[0], [0.0, 0.6, 0.8], atol=1e-15)
    assert np.isnan(units[1]).all()


@pytest.mark.parametrize("half_angle", [0.2, np.pi / 2, np.pi])
def test_a_cap_is_filled_evenly_and_never_left(half_angle):
    found = directions.cap_directions(np.random.default_rng(1), 20_000, half_angle)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    height = 1.0 - np.cos(half_angle)
    depths = (1.0 - found[:, 2]) / height  # by Archimedes uniform in [0, 1]
    assert 0.0 <= depths.min() and depths.max() <= 1.0 + 1e-12
    shares = np.histogram(depths, 10, (0.0, 1.0 + 1e-12))[0] / len(found)
    np.testing.assert_allclose(shares, 0.1, atol=0.01)  # five standard deviations
    np.testing.assert_allclose(found[:, :2].mean(axis=0), 0.0, atol=0.03)


def test_a_place_turns_its_piece_about_the_vertical():
    # Turned by a quarter, what was to the right (x) is behind (-z) and what was in front is right.
    place = Place(1.0, 2.0, np.pi / 2)
    np.testing.assert_allclose(place.to_world((1.0, -0.5, 0.0)), (1.0, -0.5, 1.0), atol=1e-12)
    np.testing.assert_allclose(place.to_world((0.0, -0.5, 1.0)), (2.0, -0.5, 2.0), atol=1e-12)
    assert pieces.floor_at(place, 0.0, 1.0) == pytest.approx((2.0, 2.0), abs=1e-12)


@pytest.mark.parametrize("yaw", [0.0, 0.3, -2.0])
def test_a_place_keeps_distances(yaw):
    place, points = Place(-0.7, 1.1, yaw), np.random.default_rng(2).normal(size=(20, 3))
    moved = np.array([place.to_world(tuple(point)) for point in points])
    expected = np.linalg.norm(points - points[0], axis=1)
    np.testing.assert_allclose(np.linalg.norm(moved - moved[0], axis=1), expected, atol=1e-12)


@pytest.mark.parametrize(("wall", "inward"), WALLS.items())
def test_a_piece_at_a_wall_looks_into_the_room(wall, inward):
    place = pieces.wall_place(wall, 3.0, 2.5)
    foot = np.array(pieces.floor_at(place, 0.0, 0.0))
    ahead = np.array(pieces.floor_at(place, 0.0, 1.0)) - foot
    np.testing.assert_allclose(ahead, inward, atol=1e-12)
    np.testing.assert_allclose(foot, -np.array(inward) * (3.0, 2.5), atol=1e-12)


def test_heights_of_a_piece_count_upwards_from_the_floor():
    room, wood = Furniture(), Material("walnut", 0.8)
    room.box(Place(1.0, 0.0), (-0.2, 0.4), (0.5, 0.9), (0.0, 0.1), wood, faces={2: Material("ash")})
    ((center, half, yaw),) = room.boxes
    np.testing.assert_allclose(center, (1.1, -0.7, 0.05), atol=1e-12)  # y is down
    np.testing.assert_allclose(half, (0.3, 0.2, 0.05), atol=1e-12)
    assert yaw == 0.0
    room.ellipsoid(Place(0.0, 0.0), (0.0, 1.2, 0.0), (0.1, 0.2, 0.3), Material("brass"))
    assert room.ellipsoids == [((0.0, -1.2, 0.0), (0.1, 0.2, 0.3))]
    assert room.textures() == ["ash", "brass", "walnut"]


PIECES = {
    "bookshelf": lambda room, place, rng: pieces.bookshelf(room, place, rng),
    "chair": lambda room, place, rng: pieces.chair(room, place),
    "lamp": lambda room, place, rng: pieces.ceiling_lamp(room, place, 2.7),
    "plant": lambda room, place, rng: pieces.potted_plant(room, place, 0.0, 0.34, rng),
}


@pytest.mark.parametrize("name", PIECES)
def test_a_piece_stands_between_floor_and_ceiling_and_moves_with_its_place(name):
    def built(place):
        room = Furniture()
        PIECES[name](room, place, np.random.default_rng(5))
        centers = [center for center, *_ in (*room.boxes, *room.ellipsoids)]
        heights = [half[1] for _, half, *_ in (*room.boxes, *room.ellipsoids)]
        return np.array(centers), np.array(heights)

    centers, heights = built(Place(0.0, 0.0))
    assert len(centers) >= 1
    assert (centers[:, 1] + heights).max() < 0.02  # nothing below the floor (the y axis is down)
    assert (centers[:, 1] - heights).min() > -2.75
    moved, _ = built(Place(1.0, -2.0))
    np.testing.assert_allclose(moved - centers, np.broadcast_to((1, 0, -2), centers.shape))


BOUNDS = np.array([(-3.0, -2.7, -2.5), (3.0, 0.0, 2.5)])


def room_with_a_pillar(points):
    """Distance to the walls of a room of 6 x 5 m and to a pillar of 0.5 m in its middle."""
    walls = np.minimum(points - BOUNDS[0], BOUNDS[1] - points).min(axis=1)
    return np.minimum(walls, np.hypot(points[:, 0], points[:, 2]) - 0.5)


@pytest.mark.parametrize("seed", range(3))
def test_a_walk_is_long_enough_goes_around_a_pillar_and_stays_at_its_height(seed):
    rng = np.random.default_rng(seed)
    walk = walks.plan_walk(rng, room_with_a_pillar, BOUNDS, 20.0, 1.5, 0.3)
    steps = np.diff(walk, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    assert lengths.sum() >= 20.0
    assert lengths.max() < 2 * walks.CELL_M  # from cell to neighbouring cell
    np.testing.assert_allclose(walk[:, 1], -1.5, atol=1e-12)
    between = walk[:-1, None] + steps[:, None] * np.linspace(0, 1, 5)[:, None]
    assert room_with_a_pillar(between.reshape(-1, 3)).min() > 0.3


def test_where_nobody_can_walk_is_said():
    def narrow(points):
        return np.full(len(points), 0.1)

    with pytest.raises(ValueError, match="no place to walk 1.5 m over its floor"):
        walks.plan_walk(np.random.default_rng(0), narrow, BOUNDS, 5.0, 1.5, 0.3)
