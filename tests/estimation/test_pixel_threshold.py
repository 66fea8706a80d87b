# SPDX-License-Identifier: BSD-3-Clause
"""A gate in pixels is a gate on the tangent Sampson residual in pixels, of any camera."""

import numpy as np
import pytest
from noisy_problems import errors_deg, noisy_scene, unit_pose

from epi360 import Equirectangular, estimate_relative_pose
from epi360.epipolar import pose_residuals


def panorama_problem(seed, width=1024, noise_px=1.0):
    """Bearings and options of key points with equal noise in every pixel direction."""
    camera = Equirectangular(width, width // 2)
    scene = noisy_scene(seed, 0.0, 0.3, num_matches=300)
    rng = np.random.default_rng(seed)
    pixels = [
        np.clip(
            camera.pixels_from_bearings(b) + rng.normal(0.0, noise_px, (300, 2)),
            0,
            (width, width // 2),
        )
        for b in (scene.bearings1, scene.bearings2)
    ]
    options = {
        "jacobians1": camera.bearing_jacobians(pixels[0]),
        "jacobians2": camera.bearing_jacobians(pixels[1]),
        "residual": "tangent_sampson",
    }
    return scene, *(camera.bearings_from_pixels(p) for p in pixels), options


@pytest.mark.parametrize("threshold_px", [2.0, 4.0])
def test_inliers_lie_within_so_many_pixels(threshold_px):
    for seed in range(5):
        scene, b1, b2, options = panorama_problem(seed)
        result = estimate_relative_pose(b1, b2, inlier_threshold_px=threshold_px, **options)
        assert result.success
        assert max(errors_deg(result.cam2_from_cam1, unit_pose(scene))) < 2.0
        pixels = pose_residuals(result.cam2_from_cam1, b1, b2, **options)
        assert np.abs(pixels[result.inlier_mask]).max() < threshold_px
        # A gate of two standard deviations holds 95 % of the right matches.
        assert result.inlier_mask[scene.inlier_mask].mean() > 0.9
        inside = np.abs(pixels) < threshold_px
        assert (inside & ~result.inlier_mask).sum() < 0.1 * 300  # wrong ones behind a camera


def test_the_reported_gate_is_the_pixels_at_the_mean_resolution():
    _, b1, b2, options = panorama_problem(0)
    result = estimate_relative_pose(b1, b2, inlier_threshold_px=3.0, **options)
    squares = [(options[name] ** 2).sum(axis=(1, 2)) for name in ("jacobians1", "jacobians2")]
    rad_per_px = np.sqrt(np.mean(squares) / 2.0)
    assert result.inlier_threshold_deg == pytest.approx(3.0 * np.degrees(rad_per_px), rel=1e-9)
    gate = np.radians(result.inlier_threshold_deg)
    assert np.abs(result.residuals_rad[result.inlier_mask]).max() < gate


def test_the_same_gate_in_pixels_of_a_wider_image_is_a_smaller_angle():
    narrow, wide = (
        estimate_relative_pose(b1, b2, inlier_threshold_px=3.0, **options)
        for _, b1, b2, options in (panorama_problem(0, width) for width in (1024, 4096))
    )
    ratio = narrow.inlier_threshold_deg / wide.inlier_threshold_deg
    assert ratio == pytest.approx(4.0, rel=0.02)  # noise moves the key points
    assert narrow.noise_deg / wide.noise_deg == pytest.approx(4.0, rel=0.15)


def test_pixels_twice_as_large_and_half_the_gate_are_the_same():
    _, b1, b2, options = panorama_problem(1)
    fine = estimate_relative_pose(b1, b2, inlier_threshold_px=4.0, **options)
    large = {name: 2.0 * options[name] for name in ("jacobians1", "jacobians2")}
    coarse = estimate_relative_pose(
        b1, b2, residual="tangent_sampson", inlier_threshold_px=2.0, **large
    )
    np.testing.assert_array_equal(fine.inlier_mask, coarse.inlier_mask)
    assert coarse.inlier_threshold_deg == pytest.approx(fine.inlier_threshold_deg, rel=1e-12)
    np.testing.assert_allclose(
        coarse.cam2_from_cam1.matrix(), fine.cam2_from_cam1.matrix(), atol=1e-8
    )


def test_a_text_with_a_number_is_a_number_as_for_degrees():
    _, b1, b2, options = panorama_problem(2)
    text, number = (
        estimate_relative_pose(b1, b2, inlier_threshold_px=px, **options) for px in ("3", 3)
    )
    np.testing.assert_array_equal(text.inlier_mask, number.inlier_mask)


@pytest.mark.parametrize("pixels", [0.0, -1.0, np.nan, np.inf, "auto", [2.0, 3.0]])
def test_what_is_no_number_of_pixels_is_refused(pixels):
    _, b1, b2, options = panorama_problem(0)
    with pytest.raises(ValueError, match="inlier_threshold_px must be a positive number, got"):
        estimate_relative_pose(b1, b2, inlier_threshold_px=pixels, **options)


@pytest.mark.parametrize("residual", ["sampson", "angular", "paper"])
def test_pixels_need_a_residual_in_pixels(residual):
    _, b1, b2, options = panorama_problem(0)
    with pytest.raises(ValueError, match='needs residual="tangent_sampson" with jacobians1'):
        estimate_relative_pose(b1, b2, inlier_threshold_px=2.0, **options | {"residual": residual})


def test_one_gate_is_enough():
    _, b1, b2, options = panorama_problem(0)
    with pytest.raises(ValueError, match="inlier_threshold_deg or inlier_threshold_px, not both"):
        estimate_relative_pose(b1, b2, inlier_threshold_px=2.0, inlier_threshold_deg=1.0, **options)


def test_pixels_need_jacobians():
    _, b1, b2, _ = panorama_problem(0)
    with pytest.raises(ValueError, match="tangent_sampson needs jacobians1 and jacobians2"):
        estimate_relative_pose(b1, b2, residual="tangent_sampson", inlier_threshold_px=2.0)
