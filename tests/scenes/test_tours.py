# SPDX-License-Identifier: BSD-3-Clause
import json

import cv2
import numpy as np
import pytest

from epi360_scenes.home import twin_home
from epi360_scenes.tours import CLEARANCE_M, render_tour

WIDTH = 96


@pytest.fixture(scope="module")
def home():
    return twin_home(0)


@pytest.fixture(scope="module")
def level(tmp_path_factory):
    return render_tour(tmp_path_factory.mktemp("level"), 0, is_level=True, width=WIDTH)


@pytest.fixture(scope="module")
def tilted(tmp_path_factory):
    return render_tour(tmp_path_factory.mktemp("tilted"), 0, is_level=False, width=WIDTH)


def tilt_deg(panorama):
    down = panorama.world_from_cam.rotation[1, 1]
    return np.degrees(np.arccos(np.clip(down, -1, 1)))


def rooms_of_kind(home, kind, side):
    return [room for room in home.rooms if (room.kind, room.side) == (kind, side)]


def boxes_in_room(home, room):
    """Centres of a room's boxes in its own frame, and names of the textures of their faces."""
    number = home.rooms.index(room)
    rows = np.flatnonzero(home.owners[: len(home.solids.box_centers)] == number)
    offset = home.solids.box_centers[rows] - np.array([room.place.x, 0.0, room.place.z])
    turn = np.round(np.cos(room.place.yaw))
    faces = home.surfaces.textures[6 * rows[:, None] + np.arange(6)]
    return offset * [turn, 1, turn], np.asarray(home.surfaces.atlas.names)[faces]


def test_twins_have_the_same_floor_and_furniture_but_other_pictures(home):
    first, second = rooms_of_kind(home, "bedroom", 1)
    (places1, names1), (places2, names2) = (boxes_in_room(home, r) for r in (first, second))
    shared = [
        any((names2[k] == names).all() and np.linalg.norm(places2[k] - place) < 0.05
            for k in range(len(places2)))
        for place, names in zip(places1, names1, strict=True)
    ]  # fmt: skip
    assert np.mean(shared) > 0.6
    versions1, versions2 = ({n for n in names.ravel() if "#" in n} for names in (names1, names2))
    assert versions1 - versions2 and versions2 - versions1


def test_neighbours_see_each_other_through_their_door(level):
    rooms = {one.name: one.room for one in level.panoramas}
    through = [s for (a, b), s in level.overlaps.items() if rooms[a] != rooms[b]]
    assert max(through) > 0.3
    assert np.median(through) < 0.05


def test_level_tours_stand_upright_at_one_height(level):
    assert max(tilt_deg(one) for one in level.panoramas) <= 0.5
    heights = [one.world_from_cam.translation[1] for one in level.panoramas]
    assert np.ptp(heights) == 0.0


def test_tilted_tours_lean_and_vary_in_height(tilted):
    tilts = [tilt_deg(one) for one in tilted.panoramas]
    assert max(tilts) <= np.degrees(np.arccos(np.cos(np.radians(20)) ** 2)) + 1e-6
    assert np.median(tilts) > 5
    assert np.ptp([one.world_from_cam.translation[1] for one in tilted.panoramas]) > 0.4


def test_cameras_stand_clear_of_everything(level, home):
    places = np.array([one.world_from_cam.translation for one in level.panoramas])
    assert home.solids.distances(places).min() >= CLEARANCE_M


def test_every_picture_shows_the_same_badge_at_its_own_nadir(tilted):
    pictures = np.array([cv2.imread(str(tilted.folder / one.name)) for one in tilted.panoramas])
    # Exposures differ: colours are compared as shares.
    nadir, floor = (
        rows / rows.sum(axis=-1, keepdims=True)
        for rows in (pictures[:, -1].mean(axis=1), pictures[:, WIDTH * 3 // 8].mean(axis=1))
    )
    assert np.ptp(nadir, axis=0).max() < np.ptp(floor, axis=0).max() / 2


def test_the_share_that_two_views_see_is_largest_within_a_room(level):
    shares = {"one room": [], "other": []}
    for names, share in level.overlaps.items():
        shares.setdefault(level.relation(*names), []).append(share)
    assert np.median(shares["one room"]) > 0.4 > np.median(shares["other"])
    assert np.median(shares["twins"]) < 0.1


def test_a_tour_is_read_back_and_made_again_for_other_options(level):
    again = render_tour(level.folder, 0, is_level=True, width=WIDTH)
    assert again.overlaps == level.overlaps
    for one, other in zip(level.panoramas, again.panoramas, strict=True):
        np.testing.assert_array_equal(one.world_from_cam.matrix(), other.world_from_cam.matrix())
    key = json.loads((level.folder / "tour.json").read_text())["key"]
    assert (key["seed"], key["is_level"], key["width"]) == (0, True, WIDTH)


def test_the_pose_of_a_pair_leads_from_view_1_to_view_2(level):
    first, second = level.panoramas[:2]
    cam2_from_cam1 = level.cam2_from_cam1(first.name, second.name)
    expected = first.world_from_cam.matrix()
    np.testing.assert_allclose(
        (second.world_from_cam @ cam2_from_cam1).matrix(), expected, atol=1e-12
    )
