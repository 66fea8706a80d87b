# SPDX-License-Identifier: BSD-3-Clause
"""The lens distortion and its inverse, on the disc where they are one-to-one."""

import numpy as np
import pytest

from epi360.cameras.radial_tangential import BLOCK, RadialTangential


def random_distortion(rng):
    """Coefficients of ordinary lenses up to absurd ones."""
    radial = rng.normal(size=2) * 10 ** rng.uniform(-3, 0.5)
    tangential = rng.normal(size=2) * 10 ** rng.uniform(-4, -0.5) * (rng.random() < 0.7)
    return RadialTangential(*radial, *tangential)


def points_of_a_disc(rng, radius, count=200):
    radii, angles = radius * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
    return radii * np.cos(angles), radii * np.sin(angles)


def smallest_eigenvalues(distortion, x, y):
    xx, xy, yy = distortion.derivatives(x, y)
    return (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)


@pytest.mark.parametrize("seed", range(100))
def test_points_of_the_disc_come_back(seed):
    rng = np.random.default_rng(seed)
    distortion = random_distortion(rng)
    x, y = points_of_a_disc(rng, 0.999 * min(distortion.max_radius, 3.0))
    again = distortion.undistort(*distortion.distort(x, y))
    # A residual of 1e-15 moves the point by that over the slope of the distortion.
    slopes = np.minimum(smallest_eigenvalues(distortion, x, y), 1)
    assert (slopes > 0).all()
    assert (np.hypot(again[0] - x, again[1] - y) * slopes).max() < 1e-13


@pytest.mark.parametrize("seed", range(100))
def test_what_no_point_of_the_disc_comes_to_has_no_inverse(seed):
    rng = np.random.default_rng(seed)
    distortion = random_distortion(rng)
    inner, outer = distortion.radius_bounds(distortion.max_radius)
    if np.isinf(outer):
        assert distortion.max_radius == np.inf
        return
    x, y = points_of_a_disc(rng, 1.0)
    far = 1.0001 * outer / np.hypot(x, y)
    assert np.isnan(distortion.undistort(far * x, far * y)).all()
    assert np.isfinite(distortion.undistort(0.9999 * inner * x, 0.9999 * inner * y)).all()


def test_ordinary_lenses_are_inverted_to_a_trillionth():
    rng = np.random.default_rng(0)
    distortion = RadialTangential(-0.28, 0.07, 1e-3, -2e-3)
    x, y = points_of_a_disc(rng, 1.0, 3 * BLOCK + 17)
    again = distortion.undistort(*distortion.distort(x, y))
    np.testing.assert_allclose(again, (x, y), atol=1e-12)


def test_disc_ends_at_the_fold_of_a_radial_polynomial():
    assert RadialTangential(-0.3, 0, 0, 0).max_radius == pytest.approx(np.sqrt(1 / 0.9), abs=1e-14)
    both = RadialTangential(-0.5, 0.1, 0, 0)  # 1 - 1.5 r^2 + 0.5 r^4 is zero at r = 1
    assert both.max_radius == pytest.approx(1, abs=1e-12)
    assert RadialTangential(-0.28, 0.07, 0, 0).max_radius == np.inf
    assert RadialTangential(0.1, 0.1, 0, 0).max_radius == np.inf
    assert RadialTangential(0, 0, 0, 0).max_radius == np.inf
    assert RadialTangential(0, 0, 0.003, 0.004).max_radius == pytest.approx(1 / 0.03, abs=1e-9)


def test_fold_is_seen_from_both_sides():
    distortion = RadialTangential(-0.3, 0, 0, 0)
    largest = distortion.distort(np.array([distortion.max_radius]), np.zeros(1))[0][0]
    assert largest == pytest.approx(2 / 3 * distortion.max_radius, abs=1e-12)
    x, _ = distortion.undistort(largest * np.array([0.0, 0.9999, 1.0001, 5.0, np.nan]), np.zeros(5))
    np.testing.assert_array_equal(np.isnan(x), [False, False, True, True, True])
    assert x[0] == 0 and 0.98 < x[1] / distortion.max_radius < 1


def test_derivatives_equal_central_differences():
    distortion = RadialTangential(-0.2, 0.05, 2e-3, -1e-2)
    x, y = points_of_a_disc(np.random.default_rng(1), 1.5)
    step = 1e-6
    by_x = np.subtract(distortion.distort(x + step, y), distortion.distort(x - step, y))
    by_y = np.subtract(distortion.distort(x, y + step), distortion.distort(x, y - step))
    xx, xy, yy = distortion.derivatives(x, y)
    np.testing.assert_allclose(by_x / (2 * step), (xx, xy), atol=1e-9)
    np.testing.assert_allclose(by_y / (2 * step), (xy, yy), atol=1e-9)
