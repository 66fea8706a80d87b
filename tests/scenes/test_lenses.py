# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import cv2
import numpy as np
import pytest
from rendered_views import write_png

from epi360 import load_camera
from epi360.poses import Pose
from epi360_scenes.lenses import CAMERA, tour_through_lens
from epi360_scenes.tours import Panorama, Tour

NAMES = ("hall_1.jpg", "hall_2.jpg")


def tour_of(folder, seed):
    rng, panoramas = np.random.default_rng(seed), []
    for number, name in enumerate(NAMES):
        coarse = rng.integers(40, 200, (16, 32, 3), dtype=np.uint8)
        picture = cv2.resize(coarse, (256, 128), interpolation=cv2.INTER_CUBIC)
        write_png(folder / name.replace(".jpg", ".png"), picture)
        panoramas.append(
            Panorama(name.replace(".jpg", ".png"), "hall", "hall", Pose(np.eye(3), [number, 0, 0]))
        )
    overlaps = {(panoramas[0].name, panoramas[1].name): 0.5}
    return Tour(folder, True, tuple(panoramas), overlaps)


@pytest.fixture
def tour(tmp_path):
    return tour_of(tmp_path / "tour", 0)


def contents(tour):
    return {path.name: path.read_bytes() for path in tour.folder.glob("*.png")}


def test_pictures_of_a_lens_have_its_camera_and_the_places_of_the_panoramas(tour, tmp_path):
    seen = tour_through_lens(tour, tmp_path / "lens", 180.0, 3)
    camera = load_camera(tmp_path / "lens" / CAMERA)
    assert camera.width == camera.height == 128 and camera.max_angle_deg == 90.0
    shapes = {cv2.imread(str(seen.folder / one.name)).shape for one in seen.panoramas}
    assert shapes == {(128, 128, 3)}
    for one, whole in zip(seen.panoramas, tour.panoramas, strict=True):
        np.testing.assert_array_equal(
            one.world_from_cam.translation, whole.world_from_cam.translation
        )
        ahead = one.world_from_cam.rotation @ [0.0, 0.0, 1.0]
        assert abs(ahead[1]) <= np.sin(np.radians(10.0))
    assert np.isnan(list(seen.overlaps.values())).all()


def test_pictures_stay_unless_lens_seed_or_panoramas_change(tour, tmp_path):
    folder = tmp_path / "lens"
    first = contents(tour_through_lens(tour, folder, 180.0, 3))
    name, *_ = first
    (folder / "pictures" / name).write_bytes(b"as it was left")
    kept = contents(tour_through_lens(tour, folder, 180.0, 3))
    assert kept == {**first, name: b"as it was left"}
    by_another_seed = contents(tour_through_lens(tour, folder, 180.0, 4))
    assert all(by_another_seed[each] != first[each] for each in first)
    others = replace(tour_of(tmp_path / "others", 1), panoramas=tour.panoramas)
    of_others = contents(tour_through_lens(others, folder, 180.0, 4))
    assert all(of_others[each] != by_another_seed[each] for each in first)
