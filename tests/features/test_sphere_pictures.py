# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of all cameras on one sphere."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from epi360.cameras import DoubleSphere, Equirectangular, KannalaBrandt, Pinhole
from epi360.features.sphere_cells import even_directions
from epi360.features.sphere_pictures import SpherePicture, share_seen
from epi360.features.warped_patches import WIDTH, Panorama
from epi360.poses import rotation_from_vector
from epi360_scenes.lenses import Lens

SPHERE = Equirectangular(512, 256)
ROTATION = rotation_from_vector([0.2, 0.7, 0.1])  # of a lens in its panorama
DIRECTIONS = even_directions(4000)


@cache
def panorama():
    """Smooth noise, without a seam or poles that stand out."""
    points = SPHERE.bearings_from_pixels(np.indices((256, 512))[::-1].reshape(2, -1).T + 0.5)
    waves = np.random.default_rng(0).normal(0.0, 6.0, (30, 3))
    values = np.sin(points @ waves.T).sum(axis=1).reshape(256, 512)
    return np.clip(values * 12 + 140, 60, 255).astype(np.uint8)


def values_at(grey, directions):
    u, v = SPHERE.pixels_from_bearings(directions).astype(int).T
    return grey[np.minimum(v, 255), u % 512]


def lens_of(lens_deg, *, size=400):
    """A lens whose circle touches the sides of a picture of that size."""
    return Lens.of(lens_deg, round(360.0 / lens_deg * size), ROTATION)


def seen_from(lens_deg, *, size=400, mask=None, surround=None):
    """What such a lens shows; its camera does not say where it ends if a ``surround`` does."""
    lens = lens_of(lens_deg, size=size)
    grey, camera = lens.picture(panorama()), lens.camera
    if surround is not None:
        noise = np.random.default_rng(1).normal(*surround, grey.shape)
        grey = np.where(camera.field_of_view_mask(), grey, np.clip(noise, 0, 255)).astype(np.uint8)
        camera = replace(camera, max_angle_deg=None)
    return SpherePicture.of(grey, camera, mask, SPHERE)


@pytest.mark.parametrize("size", [400, 1200])
@pytest.mark.parametrize("lens_deg", [120.0, 200.0])
def test_a_lens_shows_on_its_sphere_what_the_panorama_has_there(lens_deg, size):
    picture = seen_from(lens_deg, size=size)
    seen = values_at(picture.seen, DIRECTIONS)
    expected = values_at(panorama(), DIRECTIONS @ ROTATION.T).astype(float)
    errors = np.abs(values_at(picture.grey, DIRECTIONS) - expected)[seen]
    assert np.median(errors) < 3.0 and np.quantile(errors, 0.99) < 12.0


@pytest.mark.parametrize("lens_deg", [120.0, 200.0])
@pytest.mark.parametrize("surround", [None, (0, 0), (8, 2), (16, 2), (24, 4)])
def test_a_lens_is_seen_up_to_its_edge_whether_the_camera_or_the_black_says_so(lens_deg, surround):
    picture = seen_from(lens_deg, surround=surround)
    angles = np.degrees(np.arccos(DIRECTIONS[:, 2]))
    seen = values_at(picture.seen, DIRECTIONS)
    assert seen[angles < lens_deg / 2 - 3].all()
    assert not seen[angles > lens_deg / 2].any()


@pytest.mark.parametrize(
    "camera",
    [
        DoubleSphere(600, 500, 190.0, 200.0, 310.0, 240.0, -0.2, 0.6),
        KannalaBrandt(900, 500, 260.0, 240.0, 440.0, 260.0, 0.01, -0.02, 0.0, 0.0, 88.0),
        Pinhole(800, 600, 260.0, 250.0, 410.0, 290.0),
    ],
)
def test_any_camera_shows_a_thing_where_it_is(camera):
    """Each pixel has a grey value that says in which direction it looks."""
    rows, columns = np.indices((camera.height, camera.width))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]) + 0.5
    bearings = np.nan_to_num(camera.bearings_from_pixels(pixels))
    axis = np.array([0.48, 0.6, 0.64])
    grey = (128 + 100 * (bearings @ axis)).reshape(rows.shape).round().astype(np.uint8)
    picture = SpherePicture.of(grey, camera, None, SPHERE)
    seen = values_at(picture.seen, DIRECTIONS)
    assert seen.mean() == pytest.approx(share_seen(camera), abs=0.02)
    errors = values_at(picture.grey, DIRECTIONS)[seen] - (128 + 100 * (DIRECTIONS[seen] @ axis))
    assert np.quantile(np.abs(errors), 0.99) < 2.0


def test_what_a_mask_leaves_out_is_not_seen():
    mask = np.ones((400, 400), dtype=bool)
    mask[:, :200] = False
    picture = seen_from(180.0, mask=mask)
    seen = values_at(picture.seen, DIRECTIONS)
    is_left = DIRECTIONS[:, 0] < -0.02
    assert not seen[is_left].any()
    assert seen[(DIRECTIONS[:, 0] > 0.05) & (DIRECTIONS[:, 2] > 0.05)].all()


def test_dark_things_inside_a_picture_are_seen():
    camera = Equirectangular(400, 100, 360.0, 90.0)
    grey = np.full((100, 400), 100, np.uint8)
    grey[40:60, 180:220] = 0
    assert SpherePicture.of(grey, camera, None, SPHERE).seen[128, 256]


@pytest.mark.parametrize(
    ("camera", "share"),
    [
        (Equirectangular(800, 400), 1.0),
        (Equirectangular(800, 200, 360.0, 90.0), np.sin(np.radians(45.0))),
        (lens_of(180.0).camera, 0.5),
        (lens_of(120.0).camera, 0.25),
        (Pinhole(400, 400, 200.0, 200.0, 200.0, 200.0), 1 / 6),
    ],
)
def test_the_share_of_the_sphere_that_a_camera_sees(camera, share):
    assert share_seen(camera) == pytest.approx(share, abs=0.005)


def test_the_part_of_a_panorama_is_what_is_left_of_the_whole():
    colours = cv2.cvtColor(panorama(), cv2.COLOR_GRAY2RGB)
    part = Panorama.seen_by(Equirectangular(512, 128, 360.0, 90.0), colours[64:192])
    whole = Panorama.of(colours)
    inside = np.s_[WIDTH // 8 + 4 : 3 * WIDTH // 8 - 4]
    assert part.usable[inside].all() and not part.usable[: WIDTH // 8 - 1].any()
    differences = part.levels[0][inside].astype(float) - whole.levels[0][inside]
    assert np.abs(differences).mean() < 1.5


def test_straight_down_does_not_count_if_it_is_masked():
    camera = lens_of(200.0).camera
    picture = np.full((camera.height, camera.width, 3), 90, np.uint8)
    down = np.array([[0.0, 1.0, 0.1], [0.0, 0.0, 1.0]])
    counts = Panorama.seen_by(camera, picture, mask_nadir_deg=30.0).counts_at(down)
    assert counts.tolist() == [False, True]
