# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360.cameras import DoubleSphere, ExtendedUnified, UnifiedCamera


def directions(angles_deg, azimuths_deg=0.0):
    angles, azimuths = np.broadcast_arrays(np.radians(angles_deg), np.radians(azimuths_deg))
    sines = np.sin(angles)
    return np.column_stack([sines * np.cos(azimuths), sines * np.sin(azimuths), np.cos(angles)])


def random_directions(limit_deg, count=1000, seed=0):
    rng = np.random.default_rng(seed)
    return directions(rng.uniform(0, limit_deg, count), rng.uniform(0, 360, count))


def usenko_projection(direction, camera):
    """Usenko, Demmel & Cremers, 3DV 2018, eq. 40-42, for one direction of any length."""
    x, y, z = direction
    d1 = np.sqrt(x * x + y * y + z * z)
    d2 = np.sqrt(x * x + y * y + (camera.xi * d1 + z) ** 2)
    depth = camera.alpha * d2 + (1 - camera.alpha) * (camera.xi * d1 + z)
    return camera.fx * x / depth + camera.cx, camera.fy * y / depth + camera.cy


def usenko_unprojection(pixel, camera):
    """Eq. 46-50 of the same, for one pixel."""
    mx, my = (pixel[0] - camera.cx) / camera.fx, (pixel[1] - camera.cy) / camera.fy
    r2 = mx * mx + my * my
    alpha, xi = camera.alpha, camera.xi
    mz = (1 - alpha**2 * r2) / (alpha * np.sqrt(1 - (2 * alpha - 1) * r2) + 1 - alpha)
    scale = (mz * xi + np.sqrt(mz * mz + (1 - xi * xi) * r2)) / (mz * mz + r2)
    return scale * mx, scale * my, scale * mz - xi


@pytest.mark.parametrize("xi", [-0.3, -0.17, 0.0, 0.4])
@pytest.mark.parametrize("alpha", [0.1, 0.5, 0.59, 0.85])
def test_pixels_and_bearings_follow_the_published_formulas(xi, alpha):
    camera = DoubleSphere(3000, 2900, 240, 242, 1501, 1448, xi, alpha)
    bearings = random_directions(75)
    pixels = camera.pixels_from_bearings(3 * bearings)
    seen = np.isfinite(pixels[:, 0])
    assert seen.sum() > 900  # lenses that see less than 180 degrees put some outside the image
    bearings, pixels = bearings[seen], pixels[seen]
    expected = np.array([usenko_projection(bearing, camera) for bearing in bearings])
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
    expected = np.array([usenko_unprojection(pixel, camera) for pixel in pixels])
    np.testing.assert_allclose(camera.bearings_from_pixels(pixels), expected, atol=1e-12)


def test_spheres_on_one_another_are_the_extended_unified_camera():
    camera = DoubleSphere(1000, 900, 240, 242, 501, 448, 0, 0.58)
    single = ExtendedUnified(1000, 900, 240, 242, 501, 448, 0.58, 1)
    bearings = random_directions(180)
    np.testing.assert_allclose(
        camera.pixels_from_bearings(bearings), single.pixels_from_bearings(bearings), atol=1e-10
    )


def test_alpha_zero_is_the_unified_camera():
    camera = DoubleSphere(1000, 900, 440, 442, 501, 448, 0.6, 0)
    unified = UnifiedCamera(1000, 900, 440, 442, 501, 448, 0.6)
    bearings = random_directions(180)
    np.testing.assert_allclose(
        camera.pixels_from_bearings(bearings), unified.pixels_from_bearings(bearings), atol=1e-9
    )
    pixels = np.random.default_rng(1).uniform((0, 0), (1000, 900), (1000, 2))
    np.testing.assert_allclose(
        camera.bearings_from_pixels(pixels), unified.bearings_from_pixels(pixels), atol=1e-13
    )


@pytest.mark.parametrize("xi", [-0.5, -0.2, 0.0, 0.3, 0.8])
@pytest.mark.parametrize("alpha", [0.0, 0.2, 0.5, 0.58, 0.8, 1.0])
def test_directions_that_are_seen_are_those_of_the_pixels(alpha, xi):
    # The picture of the sphere is small in the image: only the model limits it. The centre is
    # the image's corner, so that pixels have all their digits.
    camera = DoubleSphere(100_000, 100_000, 5, 5, 0, 0, xi, alpha)
    angles = np.linspace(0, 180, 1801)
    bearings = directions(angles, 30)
    pixels = camera.pixels_from_bearings(bearings)
    with np.errstate(divide="ignore", invalid="ignore"):  # straight back
        radii = np.array([usenko_projection(bearing, camera)[0] for bearing in bearings])
    # They end where the formula turns round or the depth becomes negative, and not before.
    rising = np.append(np.diff(radii) > 0, False) & (radii >= 0)
    last = np.flatnonzero(~rising)[0]
    seen = np.isfinite(pixels[:, 0])
    assert abs(np.flatnonzero(seen)[-1] - last) <= 1
    np.testing.assert_allclose(
        camera.bearings_from_pixels(pixels[seen]), bearings[seen],
        atol=1e-6,  # a pixel is up to 20 degrees here, and the last angle may be the rim
    )  # fmt: skip


def test_limit_of_the_paper_differs_from_where_the_pixels_end():
    camera = DoubleSphere(1000, 1000, 150, 150, 500, 500, -0.2, 0.57)
    w1 = 0.43 / 0.57
    w2 = (w1 - 0.2) / np.sqrt(2 * w1 * -0.2 + 0.04 + 1)
    between = (-w2 + camera._lowest_z) / 2  # z of a direction that eq. 43 leaves out
    assert camera._lowest_z < between < -w2
    pixel = usenko_projection([np.sqrt(1 - between**2), 0, between], camera)
    bearing = np.array(usenko_unprojection(pixel, camera))
    np.testing.assert_allclose(bearing[2], between, atol=1e-12)  # and that has a pixel
    np.testing.assert_allclose(camera.pixels_from_bearings([bearing])[0], pixel, atol=1e-9)


def test_rim_is_a_circle_of_pixels():
    radius = np.sqrt(1 / 0.16)
    u = 501 + 240 * radius * np.array([0.99999, 1.00001])
    camera = DoubleSphere(3000, 900, 240, 242, 501, 448, -0.2, 0.58)
    bearings = camera.bearings_from_pixels(np.column_stack([u, [448, 448]]))
    np.testing.assert_array_equal(np.isnan(bearings[:, 0]), [False, True])
    small = DoubleSphere(1000, 1000, 150, 150, 500, 500, -0.2, 0.65)
    area = np.pi * 150**2 / 0.3
    assert small.field_of_view_mask().sum() == pytest.approx(area, rel=1e-3)


def test_directions_at_180_degrees_and_corners_go_both_ways():
    sideways = directions(90, np.arange(0, 360, 15))
    camera = DoubleSphere(1000, 1000, 210, 212, 501, 498, -0.2, 0.52)
    pixels = camera.pixels_from_bearings(sideways)
    assert np.isfinite(pixels).all()
    np.testing.assert_allclose(camera.bearings_from_pixels(pixels), sideways, atol=1e-12)
    pinned = [(0.0, 0.0), (1000, 0), (0, 1000), (1000, 1000), (500, 500), (501, 498)]
    again = camera.pixels_from_bearings(camera.bearings_from_pixels(pinned))
    np.testing.assert_allclose(again, pinned, atol=1e-9)


@pytest.mark.parametrize("xi", [1 - 1e-16, 1 - 1e-9, 1 - 1e-3, -1 + 1e-3, -1 + 1e-9])
@pytest.mark.parametrize("alpha", [0.3, 0.6])
def test_spheres_nearly_a_radius_apart_lose_no_digits(xi, alpha):
    camera = DoubleSphere(1000, 1000, 200, 210, 500, 498, xi, alpha)
    pixels = np.random.default_rng(0).uniform(300, 700, (1000, 2))
    bearings = camera.bearings_from_pixels(pixels)
    seen = np.isfinite(bearings).all(axis=1)
    # Near xi = -1 the image holds directions within a millionth of the axis.
    again = camera.pixels_from_bearings(bearings[seen])
    np.testing.assert_allclose(again, pixels[seen], rtol=0, atol=1e-9 if xi > 0 else 1e-6)
    assert seen.all()


@pytest.mark.parametrize("xi", [-1, 1, 1.5])
def test_spheres_too_far_apart_are_refused(xi):
    with pytest.raises(ValueError, match="xi must be between -1 and 1"):
        DoubleSphere(640, 480, 300, 300, 320, 240, xi, 0.5)


@pytest.mark.parametrize("alpha", [-0.1, 1.1])
def test_alpha_out_of_range_is_refused(alpha):
    with pytest.raises(ValueError, match=r"alpha must be in \[0, 1\]"):
        DoubleSphere(640, 480, 300, 300, 320, 240, 0, alpha)


@pytest.mark.parametrize("xi", [1 - 1e-16, 1 - 1e-12, 1 - 1e-6, -1 + 1e-16, -1 + 1e-12])
def test_spheres_that_almost_touch_a_centre_lose_no_digits(xi):
    camera = DoubleSphere(512, 512, 200, 200, 256, 256, xi, 0.5)
    pixels = np.array([[100.5, 100.5], [256.0, 256.0], [300.0, 280.0]])
    bearings = camera.bearings_from_pixels(pixels)
    np.testing.assert_allclose(camera.pixels_from_bearings(bearings), pixels, atol=1e-9)
