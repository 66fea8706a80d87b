# SPDX-License-Identifier: BSD-3-Clause
"""Rays through hand-made solids: distances that can be checked on paper, and laws of any scene."""

import numpy as np
import pytest

from epi360.poses import rotation_from_vector
from epi360_scenes import raycast

ROOM_HALVES = np.array([3.0, 1.35, 2.5])
ROOM_CENTER = np.array([0.0, -1.35, 0.0])
HALF_FLOAT = 2e-6  # ranges are single precision, of some metres


def directions_around(seed, num=400):
    vectors = np.random.default_rng(seed).normal(size=(num, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def room_with(centers=(), halves=(), yaws=(), ball_centers=(), ball_radii=()):
    """A room of 6 x 2.7 x 5 m with boxes and ellipsoids in it."""
    num = len(centers)
    return raycast.Solids(
        box_centers=np.array([ROOM_CENTER, *centers], dtype=float),
        box_halves=np.array([ROOM_HALVES, *halves], dtype=float),
        box_yaws=np.array([0.0, *yaws]),
        box_shadows=np.ones(num + 1, dtype=bool),
        ellipsoid_centers=np.array(ball_centers, dtype=float).reshape(-1, 3),
        ellipsoid_radii=np.array(ball_radii, dtype=float).reshape(-1, 3),
    )


def random_room(seed):
    rng = np.random.default_rng(seed)
    low, high = (-2.5, -2.2, -2.0), (2.5, -0.5, 2.0)
    return room_with(
        rng.uniform(low, high, (6, 3)), rng.uniform(0.15, 0.5, (6, 3)), rng.uniform(-3, 3, 6),
        rng.uniform(low, high, (4, 3)), rng.uniform(0.15, 0.5, (4, 3)),
    )  # fmt: skip


def free_place(solids, seed):
    """The place farthest from all surfaces, among 500 random ones."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(ROOM_CENTER - ROOM_HALVES, ROOM_CENTER + ROOM_HALVES, (500, 3))
    return places[np.argmax(solids.distances(places))]


def test_the_range_of_a_wall_is_its_distance_over_the_cosine():
    origin = np.array([0.5, -1.0, -0.2])
    directions = directions_around(0)
    with np.errstate(divide="ignore"):
        to_high = (ROOM_CENTER + ROOM_HALVES - origin) / directions
        to_low = (ROOM_CENTER - ROOM_HALVES - origin) / directions
    expected = np.maximum(to_high, to_low).min(axis=1)
    ranges, solid = raycast.nearest_hits(room_with(), origin, directions)
    np.testing.assert_allclose(ranges, expected, atol=HALF_FLOAT, rtol=1e-6)
    assert (solid == 0).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_hit_lies_on_the_surface_of_the_solid_that_is_named(seed):
    solids = random_room(seed)
    origin, directions = free_place(solids, seed), directions_around(seed, 4000)
    ranges, solid = raycast.nearest_hits(solids, origin, directions)
    points = origin + ranges[:, None].astype(float) * directions
    num_boxes = len(solids.box_centers)
    for index in np.unique(solid):
        on_it = points[solid == index]
        if index < num_boxes:
            turn = rotation_from_vector([0.0, -solids.box_yaws[index], 0.0])
            local = np.abs((on_it - solids.box_centers[index]) @ turn.T)
            excess = (local - solids.box_halves[index]).max(axis=1)
            np.testing.assert_allclose(excess, 0.0, atol=1e-5)
        else:
            k = index - num_boxes
            scaled = (on_it - solids.ellipsoid_centers[k]) / solids.ellipsoid_radii[k]
            np.testing.assert_allclose(np.linalg.norm(scaled, axis=1), 1.0, atol=1e-4)
    assert len(np.unique(solid)) >= 4  # the room and three of the ten in it


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_nearer_than_the_distance_to_the_surfaces_says(seed):
    solids = random_room(seed)
    origin = free_place(solids, seed)
    ranges, _ = raycast.nearest_hits(solids, origin, directions_around(seed, 2000))
    nearest = float(solids.distances(origin[None])[0])
    assert nearest > 0.2
    assert ranges.min() >= nearest - HALF_FLOAT


@pytest.mark.parametrize("seed", range(5))
def test_distances_change_no_faster_than_the_place(seed):
    solids = random_room(seed)
    rng = np.random.default_rng(seed)
    places = rng.uniform(ROOM_CENTER - ROOM_HALVES, ROOM_CENTER + ROOM_HALVES, (500, 3))
    steps = rng.normal(scale=0.05, size=places.shape)
    changes = np.abs(solids.distances(places + steps) - solids.distances(places))
    assert (changes <= np.linalg.norm(steps, axis=1) + 1e-12).all()


def test_distances_to_a_turned_box_are_those_on_paper():
    # A box of 1 m, turned by 45 degrees: its edge is sqrt(1/2) from its centre, its top 0.5.
    solids = room_with([(0.0, -1.35, 0.0)], [(0.5, 0.5, 0.5)], [np.pi / 4])
    places = np.array([(1.2, -1.35, 0.0), (0.0, -2.2, 0.0), (0.0, -1.35, 0.0), (2.9, -1.35, 0.0)])
    expected = [1.2 - np.sqrt(0.5), 0.35, -0.5, 0.1]
    np.testing.assert_allclose(solids.distances(places), expected, atol=1e-12)


def test_turning_a_box_by_a_quarter_is_swapping_its_sides():
    origin, directions = np.array([-2.0, -1.2, -1.5]), directions_around(3)
    turned = room_with([(0.4, -1.0, 0.3)], [(0.2, 0.5, 0.9)], [np.pi / 2])
    swapped = room_with([(0.4, -1.0, 0.3)], [(0.9, 0.5, 0.2)], [0.0])
    (ranges, solid), (expected, solid_of_swapped) = (
        raycast.nearest_hits(solids, origin, directions) for solids in (turned, swapped)
    )
    np.testing.assert_allclose(ranges, expected, atol=1e-5)
    np.testing.assert_array_equal(solid, solid_of_swapped)
    assert (solid == 1).sum() > 3


def test_an_ellipsoid_is_met_at_its_near_side_or_not_at_all():
    centers, radii = np.array([[2.0, 0.0, 0.0]]), np.array([[0.5, 1.0, 0.25]])
    ahead, off_centre, beside, behind = [1, 0, 0], [1, 0.25, 0], [0, 1, 0], [-1, 0, 0]
    directions = np.array([ahead, off_centre, beside, behind], dtype=float).T
    directions[:, 1] /= np.linalg.norm(directions[:, 1])
    ranges = raycast.ellipsoid_ranges(centers, radii, np.zeros(3), directions)[0]
    assert ranges[0] == pytest.approx(1.5, abs=1e-12)
    assert np.isinf(ranges[2:]).all()
    x, y, _ = ranges[1] * directions[:, 1]
    assert ((x - 2.0) / 0.5) ** 2 + y**2 == pytest.approx(1.0, abs=1e-12)
    assert x < 2.0


def test_a_ray_from_inside_a_box_is_free_or_stopped_as_asked():
    solids = room_with([(0.0, -1.0, 0.0), (2.0, -1.0, 0.0)], [(0.5, 0.5, 0.5)] * 2, [0.0, 0.0])
    boxes = np.array([1, 2])
    origins = np.array([[0.0], [-1.0], [0.0]], np.float32)
    directions = np.array([[1, 0, 0], [-1, 0, 0]], np.float32).T
    free = raycast.free_ranges(solids, boxes, origins, directions, inside_stops=False)
    np.testing.assert_allclose(free, [1.5, np.inf], atol=HALF_FLOAT)
    stopped = raycast.free_ranges(solids, boxes, origins, directions, inside_stops=True)
    np.testing.assert_array_equal(stopped, [0.0, 0.0])


def test_without_boxes_every_ray_is_free():
    directions = directions_around(1, 7).T.astype(np.float32)
    none = np.empty(0, np.intp)
    origins = np.zeros((3, 1), np.float32)
    free = raycast.free_ranges(room_with(), none, origins, directions, inside_stops=True)
    assert np.isinf(free).all() and free.shape == (7,)


@pytest.mark.parametrize("half_angle_deg", [3.0, 20.0, 70.0])
def test_every_solid_that_a_bundle_meets_is_in_its_cone(half_angle_deg):
    num_met = num_left_out = 0
    for seed in range(20):
        solids = random_room(seed)
        origin, around = free_place(solids, seed), directions_around(seed, 4000)
        solid = raycast.nearest_hits(solids, origin, around)[1]  # all around: nothing left out
        axis = around[np.argmax(solid > 0)]  # towards some solid
        in_bundle = around @ axis > np.cos(np.radians(half_angle_deg))
        boxes, ellipsoids = solids.in_cone(origin, around[in_bundle])
        named = {*boxes, *(ellipsoids + len(solids.box_centers))}
        met = set(solid[in_bundle]) - {0}
        assert met <= named
        num_met, num_left_out = num_met + len(met), num_left_out + 10 - len(named)
    assert num_met >= 20 and num_left_out > 20
