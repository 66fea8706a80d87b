# SPDX-License-Identifier: BSD-3-Clause
"""Corners are followed with sub-pixel accuracy, across the seam, and dropped when in doubt."""

import cv2
import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.features.tracking import Tracks, track_features

WIDTH, HEIGHT = 512, 256
CAMERA = Equirectangular(width=WIDTH, height=HEIGHT)
IDENTITY = np.eye(3)


def pixel_bearings():
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return CAMERA.bearings_from_pixels(np.stack([columns.ravel(), rows.ravel()], axis=1))


BEARINGS = pixel_bearings()


def panorama(rotation=IDENTITY, seed=0):
    """A smooth texture on the sphere, sum of plane waves, seen by a turned camera: exact."""
    rng = np.random.default_rng(seed)
    wave_numbers = np.geomspace(2, 40, 60)  # coarse waves too: pyramids live on them
    directions = rng.normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    phases = rng.uniform(0, 2 * np.pi, 60)
    angles = BEARINGS @ rotation @ (directions * wave_numbers[:, None]).T + phases
    values = np.sin(angles.astype(np.float32)) @ wave_numbers**-0.5
    return (128 + 40 * values).clip(0, 255).round().astype(np.uint8).reshape(HEIGHT, WIDTH)


def rotation_about(axis, degrees):
    return cv2.Rodrigues(np.radians(degrees) * np.asarray(axis, float))[0]


def wrapped_difference(pixels2, pixels1):
    difference = pixels2 - pixels1
    difference[:, 0] = (difference[:, 0] + WIDTH / 2) % WIDTH - WIDTH / 2
    return difference


@pytest.mark.parametrize("shift", [0, 1, -7, 16, 45])
def test_a_rolled_panorama_moves_every_point_by_the_roll(shift):
    image = panorama()
    tracks = track_features([image, np.roll(image, shift, axis=1)])
    seen = tracks.visible[1]
    first, second = tracks.keypoints[:, seen]
    assert seen.mean() > 0.95 and seen.sum() > 100
    expected = np.broadcast_to([shift, 0], first.shape)
    # Lucas-Kanade stops at steps of 0.003 px; the roll is no multiple of the coarse levels' pixels.
    np.testing.assert_allclose(wrapped_difference(second, first), expected, atol=0.03)
    assert ((second >= 0) & (second < [WIDTH, HEIGHT])).all()
    if abs(shift) > 5:
        assert (abs(second - first)[:, 0] > WIDTH / 2).any()  # some crossed the seam


def test_where_the_seam_lies_does_not_matter():
    image = panorama()
    here = track_features([image, image])
    turned = np.roll(image, 100, axis=1)
    there = track_features([turned, turned])
    expected = (here.keypoints[0] + [100, 0]) % [WIDTH, HEIGHT]
    np.testing.assert_allclose(there.keypoints[0], expected, atol=1e-9)


def test_key_points_are_continuous_pixels():
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    image[101:, 201:] = 255  # the corner where four pixels meet, at (201, 101)
    image[:, :20] = image[:, -20:] = 0
    image[180:] = 0
    tracks = track_features([image, image], min_distance_deg=10)
    distance = np.abs(tracks.keypoints[0] - [201, 101]).max(axis=1)
    # Shi-Tomasi peaks on one of the four pixels around the corner, whose centres are 0.5 px away.
    assert distance.min() == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("axis", "degrees"), [((0, 1, 0), 0.26), ((0, 1, 0), 5.3), ((0.6, 0, 0.8), 1.0)]
)
def test_bearings_turn_with_the_camera(axis, degrees):
    turn = rotation_about(axis, degrees)
    tracks = track_features([panorama(), panorama(turn)])
    seen = tracks.visible[1]
    assert seen.mean() > 0.9
    before = CAMERA.bearings_from_pixels(tracks.keypoints[0, seen])
    after = CAMERA.bearings_from_pixels(tracks.keypoints[1, seen])
    errors = np.degrees(np.linalg.norm(after - before @ turn.T, axis=1))
    # 0.05 deg is 0.07 px; a tilt also shears the windows.
    assert np.median(errors) < (0.02 if axis[1] else 0.05)


def test_points_keep_their_distance_on_the_sphere():
    tracks = track_features([panorama()] * 2, min_distance_deg=8, max_features=1000)
    bearings = CAMERA.bearings_from_pixels(tracks.keypoints[0])
    cosines = bearings @ bearings.T - 2 * np.eye(len(bearings))
    assert np.degrees(np.arccos(cosines.max())) >= 8
    # Rows near the poles get their share of the sphere's area, 1 - sin 60 = 0.13, and no more.
    assert np.mean(abs(bearings[:, 1]) > np.sin(np.radians(60))) < 0.2


def test_an_occluded_patch_is_lost_and_stays_nan():
    image = panorama()
    hidden = image.copy()
    hidden[60:160, 100:220] = panorama(seed=9)[60:160, 100:220]
    tracks = track_features([image, hidden, image])
    start = tracks.keypoints[0]
    inside = ((start > [110, 70]) & (start < [210, 150])).all(axis=1)
    outside = ((start < [85, 45]) | (start > [235, 175])).any(axis=1)
    assert inside.sum() >= 5
    assert tracks.visible[1, inside].mean() < 0.2
    assert tracks.visible[1, outside].mean() > 0.95
    lost = ~tracks.visible[1]
    assert np.isnan(tracks.keypoints[1:, lost]).all()


def test_a_looser_backward_check_loses_fewer():
    images = [panorama(), panorama(rotation_about((1, 0, 0), 9))]
    kept = [
        track_features(images, forward_backward_px=px).visible[1].sum() for px in (0.02, 0.5, 5)
    ]
    assert kept[0] < kept[1] <= kept[2]


def test_points_stay_on_the_mask():
    image = panorama()
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:, :200] = True
    tracks = track_features([image, np.roll(image, 40, axis=1)], mask=mask, max_features=500)
    assert (tracks.keypoints[0, :, 0] < 200 - 10).all()  # half a window off the edge
    gone = tracks.keypoints[0, :, 0] >= 160
    assert gone.any() and not tracks.visible[1, gone].any()
    assert tracks.visible[1, ~gone].mean() > 0.9


def test_a_partial_panorama_does_not_wrap():
    camera = Equirectangular(
        width=WIDTH, height=HEIGHT, horizontal_fov_deg=180, vertical_fov_deg=90
    )
    image = panorama()
    tracks = track_features([image, np.roll(image, 12, axis=1)], camera)
    crossing = tracks.keypoints[0, :, 0] > WIDTH - 12
    assert not tracks.visible[1, crossing].any()
    seen = tracks.visible[1]
    first, second = tracks.keypoints[:, seen]
    inner = abs(first[:, 0] - WIDTH / 2) < WIDTH / 2 - 30  # windows beyond an edge see less
    np.testing.assert_allclose((second - first)[inner][:, 0], 12, atol=0.1)


def test_points_of_a_fisheye_stay_inside_its_circle():
    fisheye = KannalaBrandt(256, 256, fx=70, fy=70, cx=128, cy=128, max_angle_deg=95)
    image = np.where(fisheye.field_of_view_mask(), panorama()[:, :256], 0).astype(np.uint8)
    tracks = track_features([image, image], fisheye)
    radii = np.hypot(*(tracks.keypoints[0] - 128).T)
    # Half a window away from the edge of the circle (116 px), which would look like a corner.
    assert len(radii) > 50 and radii.max() < 116 - 10
    assert tracks.visible[1].all()


def test_new_points_replace_lost_ones_on_request():
    images = [panorama(), panorama(seed=5), panorama(seed=5)]
    once = track_features(images)
    again = track_features(images, redetect=True)
    np.testing.assert_array_equal(again.keypoints[:, : once.keypoints.shape[1]], once.keypoints)
    assert again.visible[1].sum() > 2 * once.visible[1].sum()
    new = again.keypoints[:, once.keypoints.shape[1] :]
    assert np.isnan(new[0]).all() and np.isfinite(new[1]).all()
    assert (again.visible.sum(axis=1) <= 200).all()


def test_a_flat_image_gives_no_points():
    tracks = track_features([np.zeros((64, 128), np.uint8)] * 3)
    assert tracks.keypoints.shape == (3, 0, 2)
    assert tracks.visible.shape == (3, 0)


def test_images_may_be_files_and_a_generator(tmp_path):
    path = tmp_path / "é.png"
    path.write_bytes(cv2.imencode(".png", panorama())[1].tobytes())
    tracks = track_features(source for source in (path, panorama(), str(path)))
    assert isinstance(tracks, Tracks)
    assert tracks.keypoints.shape[0] == 3 and tracks.visible.all()


@pytest.mark.parametrize(
    ("images", "options", "message"),
    [
        ([], {}, "at least 2 images, got 0"),
        ([np.zeros((64, 128), np.uint8)], {}, "at least 2 images, got 1"),
        ("folder", {}, "sequence of images, got the single path folder"),
        (
            [np.zeros((64, 128), np.uint8), np.zeros((32, 64), np.uint8)],
            {},
            r"images\[1\] must be 128x64 .* got 64x32",
        ),
        (
            [np.zeros((64, 128), np.uint8)] * 2,
            {"camera": CAMERA},
            "128x64 but .* 512x256",
        ),
        ([np.zeros((64, 100), np.uint8)] * 2, {}, "2:1"),
        ([np.zeros((64, 128), int)] * 2, {}, r"images\[0\] must be uint8"),
        (
            [np.zeros((64, 128), np.uint8)] * 2,
            {"mask": np.ones((5, 5), bool)},
            "mask must .* 128x64, got 5x5",
        ),
        ([], {"max_features": 0}, "max_features must be positive, got 0"),
        ([], {"quality_level": np.nan}, "quality_level must be positive, got nan"),
        ([], {"forward_backward_px": -1}, "forward_backward_px must be positive"),
        ([], {"min_distance_deg": 180}, r"min_distance_deg must be in \[0, 180\), got 180"),
        ([], {"window_px": 1}, "window_px must be at least 3"),
    ],
)
def test_wrong_input_is_refused_with_the_remedy(images, options, message):
    with pytest.raises(ValueError, match=message):
        track_features(images, **options)


def test_tracks_follow_the_exact_flow_of_a_rendered_pair(data_dir):
    folder = data_dir / "replica_flow_pair"
    raw = (folder / "0001_opticalflow_forward.flo").read_bytes()
    width, height = np.frombuffer(raw, np.int32, 2, 4)
    flow = np.frombuffer(raw, np.float32, -1, 12).reshape(height, width, 2)
    tracks = track_features([folder / "0001_rgb.jpg", folder / "0002_rgb.jpg"])
    seen = tracks.visible[1]
    first, second = tracks.keypoints[:, seen]
    columns, rows = first.astype(int).T  # corners lie at pixel centres
    camera = Equirectangular(width=int(width), height=int(height))
    truth = camera.bearings_from_pixels((first + flow[rows, columns]) % [width, height])
    errors = np.degrees(np.linalg.norm(camera.bearings_from_pixels(second) - truth, axis=1))
    # Measured: 0.65 of the points are kept, median 0.19 deg (0.5 px) for a median motion of 24 px.
    assert seen.mean() > 0.55 and np.median(errors) < 0.3
