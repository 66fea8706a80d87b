# SPDX-License-Identifier: BSD-3-Clause
"""Points are followed frame by frame, anywhere on the sphere, and keep their identities."""

from functools import lru_cache

import cv2
import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.features.frame_tracker import FrameTracker
from epi360.features.tracking_views import Cap

WIDTH, HEIGHT = 512, 256
CAMERA = Equirectangular(width=WIDTH, height=HEIGHT)
FISHEYE = KannalaBrandt(300, 300, fx=80, fy=80, cx=150, cy=150, max_angle_deg=100)
IDENTITY = np.eye(3)


def picture(camera=CAMERA, rotation=IDENTITY, seed=0, brightness=1.0):
    """A smooth texture on the sphere, sum of plane waves, seen by a turned camera: exact."""
    bearings, texture = texture_seen(camera, tuple(map(tuple, rotation)), seed)
    values = brightness * (110 + 10 * texture)
    values[np.isnan(bearings[:, 0])] = 0
    return values.clip(0, 255).round().astype(np.uint8).reshape(camera.height, camera.width)


@lru_cache(maxsize=8)
def texture_seen(camera, rotation, seed):
    """Bearings of the pixels, and the sum of the waves there."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    bearings = camera.bearings_from_pixels(np.stack([columns.ravel(), rows.ravel()], axis=1))
    rng = np.random.default_rng(seed)
    wave_numbers = np.geomspace(2, 100, 90)
    directions = rng.normal(size=(90, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    phases = rng.uniform(0, 2 * np.pi, 90)
    angles = np.nan_to_num(bearings) @ rotation @ (directions * wave_numbers[:, None]).T + phases
    return bearings, np.sin(angles.astype(np.float32)) @ (wave_numbers**-0.25).astype(np.float32)


def rotation_about(axis, degrees):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    return cv2.Rodrigues(np.radians(degrees) * axis)[0]


def common(before, after):
    """Rows of the points that both frames show."""
    _, rows1, rows2 = np.intersect1d(before.ids, after.ids, return_indices=True)
    return rows1, rows2


def angles_deg(bearings1, bearings2):
    crossed = np.linalg.norm(np.cross(bearings1, bearings2), axis=1)
    return np.degrees(np.arctan2(crossed, (bearings1 * bearings2).sum(axis=1)))


def tracked_after(turn, *, camera=CAMERA, predicted=None, **options):
    tracker = FrameTracker(camera, **options)
    before = tracker.track(picture(camera))
    return before, tracker.track(picture(camera, turn), predicted)


def test_the_first_frame_covers_the_sphere_evenly():
    frame = FrameTracker(CAMERA, max_points=300, min_distance_deg=4).track(picture())
    assert 200 < len(frame.ids) <= 300
    assert frame.is_new.all() and (frame.age == 0).all() and (frame.error == 0).all()
    assert np.isnan(frame.image_change)
    # Every octant has an eighth of the area.
    octants = (frame.bearings > 0) @ [1, 2, 4]
    shares = np.bincount(octants, minlength=8) / len(frame.ids)
    assert shares.min() > 0.07 and shares.max() < 0.18
    cosines = frame.bearings @ frame.bearings.T - 2 * np.eye(len(frame.ids))
    assert np.degrees(np.arccos(cosines.max())) >= 4 - 1e-9
    np.testing.assert_allclose(
        frame.bearings, CAMERA.bearings_from_pixels(frame.pixels), atol=1e-12
    )


@pytest.mark.parametrize("axis", [(0, 1, 0), (1, 0, 0), (0, 0, 1), (1, 2, -3)])
def test_points_turn_with_the_camera_also_at_the_seam_and_the_poles(axis):
    turn = rotation_about(axis, 1.5)
    before, after = tracked_after(turn)
    rows1, rows2 = common(before, after)
    expected = before.bearings[rows1] @ turn.T
    errors = angles_deg(after.bearings[rows2], expected)
    assert len(rows2) > 0.9 * len(before.ids)
    # One pixel is 0.7 degrees.
    assert np.median(errors) < 0.03 and np.quantile(errors, 0.95) < 0.15
    for place in (
        np.abs(expected[:, 1]) > np.cos(np.radians(15)),
        expected[:, 2] < -np.cos(np.radians(20)),
    ):
        assert place.sum() >= 5 and np.median(errors[place]) < 0.04


@pytest.mark.parametrize("latitude_deg", [-70.0, 70.0])
def test_points_of_the_ceiling_or_the_floor_alone_are_followed(latitude_deg):
    camera = Equirectangular(900, 100, 360.0, 40.0, 0.0, latitude_deg)
    before, after = tracked_after(rotation_about([0, 1, 0], 2.0), camera=camera)
    rows1, rows2 = common(before, after)
    assert len(rows1) > 0.7 * len(before.ids) > 30
    turned = before.bearings[rows1] @ rotation_about([0, 1, 0], 2.0).T
    assert np.median(angles_deg(turned, after.bearings[rows2])) < 0.1


def test_points_cross_the_seam():
    image = picture()
    tracker = FrameTracker(CAMERA)
    before, after = tracker.track(image), tracker.track(np.roll(image, 9, axis=1))
    rows1, rows2 = common(before, after)
    moved = after.pixels[rows2, 0] - before.pixels[rows1, 0]
    assert (moved < -WIDTH / 2).sum() >= 5  # over the right border
    assert ((after.pixels >= 0) & (after.pixels <= [WIDTH, HEIGHT])).all()
    strip = np.abs(before.bearings[rows1, 1]) < 0.6
    np.testing.assert_allclose((moved[strip] + 3) % WIDTH, 12, atol=0.05)


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["panorama", "fisheye"])
@pytest.mark.parametrize("axis", [(0, 1, 0), (1, 0, 0), (0, 0, 1)])
def test_a_predicted_turn_of_20_degrees_is_followed(camera, axis):
    turn = rotation_about(axis, 20)
    before, after = tracked_after(turn, camera=camera, predicted=rotation_about(axis, 19.5))
    rows1, rows2 = common(before, after)
    expected = before.bearings[rows1] @ turn.T
    visible = np.isfinite(camera.pixels_from_bearings(before.bearings @ turn.T)[:, 0]).sum()
    assert len(rows2) > 0.85 * visible
    assert np.median(angles_deg(after.bearings[rows2], expected)) < 0.05


def test_a_prediction_of_a_large_turn_makes_the_tracks_more_accurate():
    turn = rotation_about((1, 0, 0), 20)
    medians = []
    for predicted in (None, turn):
        before, after = tracked_after(turn, predicted=predicted)
        rows1, rows2 = common(before, after)
        expected = before.bearings[rows1] @ turn.T
        medians.append(np.median(angles_deg(after.bearings[rows2], expected)))
    # Windows do not turn with the scene: measured 0.19 and 0.012 degrees.
    assert medians[1] < medians[0] / 5


@pytest.mark.parametrize("brightness", [0.7, 1.3])
def test_a_change_of_exposure_by_30_percent_loses_nothing(brightness):
    turn = rotation_about((1, 1, 0), 1)
    tracker = FrameTracker(CAMERA)
    before = tracker.track(picture())
    after = tracker.track(picture(rotation=turn, brightness=brightness))
    rows1, rows2 = common(before, after)
    errors = angles_deg(after.bearings[rows2], before.bearings[rows1] @ turn.T)
    assert len(rows2) > 0.9 * len(before.ids)
    assert np.median(errors) < 0.03
    assert after.brightness / before.brightness == pytest.approx(brightness, abs=0.02)
    assert after.image_change == pytest.approx(33, abs=6)


def test_points_that_leave_the_mask_are_lost():
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:, :200] = True
    image = picture()
    tracker = FrameTracker(CAMERA, mask)
    before = tracker.track(image)
    assert len(before.ids) > 50 and (before.pixels[:, 0] < 200).all()
    after = tracker.track(np.roll(image, 10, axis=1))
    rows1, _ = common(before, after)
    leaving = before.pixels[:, 0] > 190.5
    staying = before.pixels[:, 0] < 180
    assert leaving.sum() >= 3
    assert not np.isin(np.flatnonzero(leaving), rows1).any()
    assert np.isin(np.flatnonzero(staying), rows1).mean() > 0.9
    assert (after.pixels[:, 0] < 200).all()


def test_identities_are_stable_and_never_used_again():
    tracker = FrameTracker(CAMERA, max_points=200)
    frames = [tracker.track(picture(rotation=rotation_about((1, 1, 1), 2 * n))) for n in range(6)]
    frames += [tracker.track(np.zeros((HEIGHT, WIDTH), np.uint8)), tracker.track(picture())]
    largest = -1
    for frame in frames:
        assert (np.diff(frame.ids) > 0).all()
        assert (frame.ids[frame.is_new] > largest).all()
        assert (frame.ids[~frame.is_new] <= largest).all()
        largest = max(largest, frame.ids.max(initial=-1))
    oldest = frames[5].age == 5
    assert oldest.mean() > 0.8 and np.isin(frames[5].ids[oldest], frames[0].ids).all()
    assert not np.isin(frames[7].ids, frames[5].ids).any()


def test_a_point_stays_at_its_place_over_many_frames():
    turns = [rotation_about((0.3, 1, 0.2), 0.7 * n) for n in range(21)]
    tracker = FrameTracker(CAMERA)
    first, *_, last = [tracker.track(picture(rotation=turn)) for turn in turns]
    rows1, rows2 = common(first, last)
    errors = angles_deg(last.bearings[rows2], first.bearings[rows1] @ turns[-1].T)
    assert len(rows2) > 0.7 * len(first.ids)
    # One pixel is 0.7 degrees. Lucas-Kanade alone has drifted by 0.15 in the median.
    assert np.median(errors) < 0.1


def test_a_black_frame_loses_everything_and_the_next_one_starts_again():
    tracker = FrameTracker(CAMERA)
    before = tracker.track(picture())
    black = tracker.track(np.zeros((HEIGHT, WIDTH), np.uint8))
    assert len(black.ids) == 0 and black.pixels.shape == (0, 2) and black.bearings.shape == (0, 3)
    assert black.brightness == 0 and black.image_change > 80
    again = tracker.track(picture())
    assert len(again.ids) == len(before.ids) and again.is_new.all()


def test_a_cut_to_another_place_keeps_next_to_nothing():
    tracker = FrameTracker(CAMERA)
    before, after = tracker.track(picture()), tracker.track(picture(seed=7))
    assert len(common(before, after)[0]) < 0.1 * len(before.ids)
    assert len(after.ids) > 0.9 * len(before.ids)


def test_a_frozen_picture_does_not_change():
    tracker = FrameTracker(CAMERA)
    before, after = tracker.track(picture()), tracker.track(picture())
    rows1, rows2 = common(before, after)
    assert after.image_change == 0 and len(rows1) == len(before.ids)
    np.testing.assert_allclose(after.bearings[rows2], before.bearings[rows1], atol=1e-6)


def test_points_of_a_fisheye_beyond_180_degrees_are_followed():
    turn = rotation_about((1, 2, 1), 2)
    before, after = tracked_after(turn, camera=FISHEYE)
    rows1, rows2 = common(before, after)
    behind = after.bearings[rows2, 2] < 0
    errors = angles_deg(after.bearings[rows2], before.bearings[rows1] @ turn.T)
    assert behind.sum() >= 5
    assert len(rows2) > 0.85 * len(before.ids)
    assert np.median(errors) < 0.03 and np.median(errors[behind]) < 0.06


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["panorama", "fisheye"])
def test_the_tracks_are_the_same_on_any_number_of_threads(camera):
    turns = [rotation_about((1, 1, 0), 6 * n) for n in range(3)]
    images = [picture(camera, turn) for turn in turns]
    results = []
    threads = cv2.getNumThreads()
    try:
        for count in (1, 2, 3):
            cv2.setNumThreads(count)
            tracker = FrameTracker(camera)
            results.append([tracker.track(image, turns[1]) for image in images])
    finally:
        cv2.setNumThreads(threads)
    for frames in results[1:]:
        for one, other in zip(results[0], frames, strict=True):
            np.testing.assert_array_equal(one.ids, other.ids)
            np.testing.assert_array_equal(one.bearings, other.bearings)


def test_the_callers_array_may_be_used_again():
    buffer = picture()
    tracker, other = FrameTracker(CAMERA), FrameTracker(CAMERA)
    tracker.track(buffer), other.track(buffer.copy())
    buffer[:] = picture(rotation=rotation_about((0, 1, 0), 1))
    np.testing.assert_array_equal(tracker.track(buffer).bearings, other.track(buffer).bearings)


def test_colour_and_grey_pictures_give_the_same_tracks():
    grey = picture()
    frames = [FrameTracker(CAMERA).track(image) for image in (grey, np.dstack([grey] * 3))]
    np.testing.assert_array_equal(frames[0].bearings, frames[1].bearings)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_points": 0}, "max_points must be at least 1, got 0"),
        ({"window_px": 1}, "window_px must be at least 3, got 1"),
        ({"pyramid_levels": -1}, "pyramid_levels must be at least 0, got -1"),
        ({"quality_level": np.nan}, "quality_level must be positive, got nan"),
        ({"forward_backward_px": 0}, "forward_backward_px must be positive, got 0"),
        ({"min_distance_deg": 90}, r"min_distance_deg must be in \(0, 90\), got 90"),
        ({"mask": np.ones((5, 5), bool)}, "mask must .* 512x256, got 5x5"),
    ],
)
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        FrameTracker(CAMERA, **options)


def test_another_size_is_refused_with_both_sizes():
    tracker = FrameTracker(CAMERA)
    before = tracker.track(picture())
    with pytest.raises(ValueError, match="512x256 like the camera, got 256x128"):
        tracker.track(np.zeros((128, 256), np.uint8))
    assert len(common(before, tracker.track(picture()))[0]) == len(before.ids)


@pytest.mark.parametrize("rotation", [np.eye(4), np.full((3, 3), np.nan)])
def test_a_prediction_that_is_no_rotation_is_refused(rotation):
    tracker = FrameTracker(CAMERA)
    with pytest.raises(ValueError, match=r"rotation must be finite, of shape \(3, 3\)"):
        tracker.track(picture(), rotation)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_other_pole_is_a_number_in_the_picture_of_a_pole(sign):
    cap = Cap(Equirectangular(64, 32), np.ones((32, 64), bool), sign)
    poles = np.array([[0.0, sign, 0.0], [0.0, -sign, 0.0]])
    points = cap.points_from_bearings(poles)
    assert np.isfinite(points).all()
    np.testing.assert_allclose(points[0], cap.points_from_bearings(poles[:1])[0], atol=1e-12)
    assert not cap.owns(poles)[1]
