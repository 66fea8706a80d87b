# SPDX-License-Identifier: BSD-3-Clause
"""The picture of a pair: curves that pass through their points, and a figure for every case."""

import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt, Pinhole
from epi360.report.curves import epipolar_curve, spread_matches
from epi360.report.figure import draw_pair

PANORAMA = Equirectangular(width=1024, height=512)
FISHEYE = KannalaBrandt(
    width=600, height=600, fx=170, fy=170, cx=300, cy=300, k1=0.01, k2=0.0, k3=0.0, k4=0.0
)
PINHOLE = Pinhole(width=640, height=480, fx=300, fy=300, cx=320, cy=240)
CAMERAS = [PANORAMA, FISHEYE, PINHOLE]


def grey_image(camera):
    return np.full((camera.height, camera.width, 3), 128, np.uint8)


def distance_to_polyline(point, curve):
    """Smallest distance of a point to the segments between finite neighbours, in pixels."""
    start, step = curve[:-1], np.diff(curve, axis=0)
    length2 = np.maximum((step**2).sum(axis=1), 1e-12)
    along = np.clip(((point - start) * step).sum(axis=1) / length2, 0.0, 1.0)
    return np.nanmin(np.linalg.norm(point - start - along[:, None] * step, axis=1))


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_epipolar_curve_passes_through_the_match(make_result, camera):
    result = make_result("ok", camera, noise_deg=0.0)
    bearings1 = camera.bearings_from_pixels(result.keypoints1)
    bearings2 = camera.bearings_from_pixels(result.keypoints2)
    anywhere = np.array([0.36, -0.48, 0.8])  # not helped by a sample at the match itself
    for b1, b2, pixel1, pixel2 in zip(
        bearings1, bearings2, result.keypoints1, result.keypoints2, strict=True
    ):
        curve1 = epipolar_curve(camera, result.E.T @ b2, anywhere)
        curve2 = epipolar_curve(camera, result.E @ b1, anywhere)
        assert distance_to_polyline(pixel1, curve1) < 1.0
        assert distance_to_polyline(pixel2, curve2) < 1.0


@pytest.mark.parametrize("seed", range(10))
def test_curves_break_at_the_seam_and_reach_both_borders(seed):
    normal = np.random.default_rng(seed).normal(size=3)
    curve = epipolar_curve(PANORAMA, normal, np.array([0.0, 0.0, 1.0]))
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    assert np.nanmax(steps) <= PANORAMA.width / 2
    assert np.isnan(curve[:, 0]).sum() == 1
    gap = np.flatnonzero(np.isnan(curve[:, 0]))[0]
    at_border = np.sort(curve[[gap - 1, gap + 1], 0])
    np.testing.assert_allclose(at_border, [0.0, PANORAMA.width], atol=0.5)


def test_every_point_of_a_curve_lies_in_its_plane():
    normal = np.array([0.3, -0.5, 0.2])
    curve = epipolar_curve(PANORAMA, normal, normal)  # the start is the pole of the circle
    bearings = PANORAMA.bearings_from_pixels(curve[np.isfinite(curve).all(axis=1)])
    np.testing.assert_allclose(bearings @ normal, 0.0, atol=1e-9)
    assert len(bearings) > 1000


def test_curves_leave_out_what_a_camera_does_not_see():
    curve = epipolar_curve(FISHEYE, np.array([0.0, 1.0, 0.2]), np.array([0.0, 0.0, 1.0]))
    assert np.isnan(curve).any()
    assert np.isfinite(curve).any()


def test_numbered_matches_are_distinct_inliers_away_from_the_epipole(make_result):
    result = make_result("ok", PANORAMA)
    bearings1 = PANORAMA.bearings_from_pixels(result.keypoints1)
    normals1 = PANORAMA.bearings_from_pixels(result.keypoints2) @ result.E
    chosen = spread_matches(bearings1, normals1, result.inlier_mask, 8)
    assert len(set(chosen)) == 8
    assert result.inlier_mask[chosen].all()
    assert (np.linalg.norm(normals1[chosen], axis=1) > 0.3).all()
    nothing = spread_matches(bearings1, normals1, np.zeros_like(result.inlier_mask), 8)
    assert len(nothing) == 0


@pytest.mark.parametrize("camera", CAMERAS)
def test_every_status_and_camera_has_a_figure_without_warnings(make_result, any_status, camera):
    result = make_result(any_status, camera)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Older versions of matplotlib call what newer ones of pyparsing will remove.
        warnings.filterwarnings("ignore", message=".*deprecated", category=DeprecationWarning)
        figure = draw_pair(grey_image(camera), grey_image(camera), camera, camera, result)
        figure.canvas.draw()
    title = figure.texts[0].get_text()
    assert "nan" not in " ".join(text.get_text() for text in figure.texts)
    assert ("25.2" in title) == (any_status in ("ok", "pure_rotation", "planar_ambiguous"))
    assert title.startswith(any_status) == (any_status != "ok")


def test_epipoles_are_where_the_other_camera_stands(make_result):
    result = make_result("ok", PANORAMA)
    image = grey_image(PANORAMA)
    figure = draw_pair(image, image, PANORAMA, PANORAMA, result)
    pose = result.cam2_from_cam1
    centres = (-pose.rotation.T @ pose.translation, pose.translation)
    for axes, centre in zip(figure.axes, centres, strict=False):
        stars = [line for line in axes.lines if line.get_marker() == "*"]
        expected = PANORAMA.pixels_from_bearings(centre[None])[0]
        np.testing.assert_allclose(stars[0].get_xydata()[0], expected, atol=1e-9)


def test_epipoles_are_those_of_the_camera_that_the_pose_belongs_to(make_result):
    cut = replace(PANORAMA, vertical_fov_deg=171.0, center_latitude_deg=4.5)
    result = replace(make_result("ok", PANORAMA), cameras=(cut, cut))
    image = grey_image(PANORAMA)
    figure = draw_pair(image, image, PANORAMA, PANORAMA, result)
    (star,) = (line for line in figure.axes[1].lines if line.get_marker() == "*")
    expected = cut.pixels_from_bearings(result.cam2_from_cam1.translation[None])[0]
    np.testing.assert_allclose(star.get_xydata()[0], expected, atol=1e-9)


def test_nothing_matched_is_drawn_all_the_same(make_result):
    result = make_result("too_few_matches", PANORAMA, count=0)
    image = grey_image(PANORAMA)
    figure = draw_pair(image, image, PANORAMA, PANORAMA, result)
    assert figure.texts[0].get_text() == "too_few_matches: no pose"


def test_the_picture_is_1400_pixels_wide_and_views_may_differ(make_result, tmp_path):
    result = make_result("ok", PANORAMA, FISHEYE)
    path = tmp_path / "pair.png"
    draw_pair(grey_image(PANORAMA), grey_image(FISHEYE), PANORAMA, FISHEYE, result, path=path)
    picture = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape[1] == 1400
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("suffix", ["jpg", "pdf", "svg", "webp"])
def test_other_formats_are_written(make_result, tmp_path, suffix):
    path = tmp_path / f"pair.{suffix}"
    result = make_result("ok", PINHOLE)
    draw_pair(grey_image(PINHOLE), grey_image(PINHOLE), PINHOLE, PINHOLE, result, path=path)
    assert path.stat().st_size > 1000


def test_an_image_that_is_not_its_cameras_is_named(make_result):
    result = make_result("ok", PANORAMA)
    with pytest.raises(ValueError, match=r"image2 must have the shape \(512, 1024, 3\)"):
        draw_pair(grey_image(PANORAMA), grey_image(PINHOLE), PANORAMA, PANORAMA, result)
