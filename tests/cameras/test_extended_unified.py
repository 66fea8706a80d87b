# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360.cameras import DoubleSphere, ExtendedUnified, KannalaBrandt, Pinhole, UnifiedCamera

CAMERA = ExtendedUnified(1000, 900, 250, 252, 501, 448, 0.62, 1.3)


def directions(angles_deg, azimuths_deg=0.0):
    angles, azimuths = np.broadcast_arrays(np.radians(angles_deg), np.radians(azimuths_deg))
    sines = np.sin(angles)
    return np.column_stack([sines * np.cos(azimuths), sines * np.sin(azimuths), np.cos(angles)])


def random_directions(limit_deg, count=1000, seed=0):
    rng = np.random.default_rng(seed)
    return directions(rng.uniform(0, limit_deg, count), rng.uniform(0, 360, count))


def khomutenko(direction, camera):
    """Khomutenko, Garcia & Martinet, RA-L 2016, for one direction of any length."""
    x, y, z = direction
    d = np.sqrt(camera.beta * (x * x + y * y) + z * z)
    depth = camera.alpha * d + (1 - camera.alpha) * z
    return camera.fx * x / depth + camera.cx, camera.fy * y / depth + camera.cy


@pytest.mark.parametrize("alpha", [0.0, 0.3, 0.5, 0.62, 0.9])
def test_pixels_follow_the_published_formula(alpha):
    camera = ExtendedUnified(2000, 1900, 250, 252, 1001, 948, alpha, 1.3)
    bearings = 3 * random_directions(75 if alpha == 0 else 90)
    expected = np.array([khomutenko(bearing, camera) for bearing in bearings])
    np.testing.assert_allclose(camera.pixels_from_bearings(bearings), expected, atol=1e-9)


def test_alpha_zero_is_the_pinhole():
    camera = ExtendedUnified(640, 480, 300, 310, 322, 238, 0, 2)
    pinhole = Pinhole(640, 480, 300, 310, 322, 238)
    pixels = np.random.default_rng(0).uniform((0, 0), (640, 480), (500, 2))
    np.testing.assert_allclose(
        camera.bearings_from_pixels(pixels), pinhole.bearings_from_pixels(pixels), atol=1e-15
    )
    assert np.isnan(camera.pixels_from_bearings([[0, 0, -1], [0.1, 0.1, -1]])).all()


@pytest.mark.parametrize("xi", [0.0, 0.4, 1.0, 2.5])
def test_beta_one_is_the_unified_camera(xi):
    alpha = xi / (1 + xi)
    unified = UnifiedCamera(1000, 900, 400, 402, 501, 448, xi)
    camera = ExtendedUnified(1000, 900, 400 / (1 + xi), 402 / (1 + xi), 501, 448, alpha, 1)
    bearings = random_directions(180)
    np.testing.assert_allclose(
        camera.pixels_from_bearings(bearings), unified.pixels_from_bearings(bearings), atol=1e-9
    )
    pixels = np.random.default_rng(1).uniform((0, 0), (1000, 900), (1000, 2))
    # 1e-9: xi of 2.5 has its rim in the image, where rounding errors of pixels grow.
    np.testing.assert_allclose(
        camera.bearings_from_pixels(pixels), unified.bearings_from_pixels(pixels), atol=1e-9
    )


def test_pixels_are_those_of_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    if not hasattr(pycolmap.CameraModelId, "EUCM"):
        pytest.skip("this pycolmap does not have EUCM")
    colmap = pycolmap.Camera(
        model="EUCM", width=1000, height=900, params=[250, 252, 501, 448, 0.62, 1.3]
    )
    bearings = random_directions(89)
    np.testing.assert_allclose(
        CAMERA.pixels_from_bearings(bearings), colmap.img_from_cam(bearings), atol=1e-9
    )


@pytest.mark.parametrize("beta", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("alpha", [0.0, 0.2, 0.5, 0.6, 0.8, 1.0])
def test_directions_that_are_seen_are_those_of_the_pixels(alpha, beta):
    # The picture of the sphere is small in the image: only the model limits it. The centre is
    # the image's corner, so that pixels have all their digits.
    camera = ExtendedUnified(100_000, 100_000, 5, 5, 0, 0, alpha, beta)
    angles = np.linspace(0, 180, 1801)
    pixels = camera.pixels_from_bearings(directions(angles, 30))
    seen = np.isfinite(pixels[:, 0])
    last = np.flatnonzero(seen)[-1]
    assert seen[: last + 1].all() and (np.diff(pixels[: last + 1, 0]) > 0).all()
    w = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
    x, _, z = directions(angles).T
    inside = z > -w * np.sqrt(beta * x * x + z * z)  # the half-space of the paper
    assert abs(last - np.flatnonzero(inside)[-1]) <= 1
    np.testing.assert_allclose(
        camera.bearings_from_pixels(pixels[: last + 1]), directions(angles[: last + 1], 30),
        atol=1e-6,  # a pixel is up to 20 degrees here, and the last angle may be the rim
    )  # fmt: skip


def test_rim_is_a_circle_of_pixels():
    radius = np.sqrt(1 / (1.3 * 0.24))
    u = 501 + 250 * radius * np.array([0.999999, 1.000001])
    bearings = CAMERA.bearings_from_pixels(np.column_stack([u, [448, 448]]))
    np.testing.assert_array_equal(np.isnan(bearings[:, 0]), [False, True])
    camera = ExtendedUnified(1000, 1000, 150, 150, 500, 500, 0.62, 1.3)
    assert camera.field_of_view_mask().sum() == pytest.approx(np.pi * (150 * radius) ** 2, rel=1e-3)


def test_directions_at_180_degrees_and_corners_go_both_ways():
    sideways = directions(90, np.arange(0, 360, 15))
    pixels = CAMERA.pixels_from_bearings(sideways)
    assert np.isfinite(pixels).all()
    np.testing.assert_allclose(CAMERA.bearings_from_pixels(pixels), sideways, atol=1e-12)
    whole = ExtendedUnified(1000, 900, 400, 402, 501, 448, 0.55, 1.3)
    pinned = np.array([(0, 0), (1000, 0), (0, 900), (1000, 900), (500, 450), (501, 448)], float)
    again = whole.pixels_from_bearings(whole.bearings_from_pixels(pinned))
    np.testing.assert_allclose(again, pinned, atol=1e-9)


def test_published_calibrations_of_one_lens_agree_in_three_models():
    # Camera 0 of TUM-VI: the data set's own camchain, and basalt's calibrations of it.
    kannala_brandt = KannalaBrandt(
        512, 512, 190.97847715128717, 190.9733070521226, 254.93170605935475, 256.8974428996504,
        0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202,
        0.00020293673591811182,
    )  # fmt: skip
    extended = ExtendedUnified(
        512, 512, 191.14799836282189, 191.13150963902818, 254.9585771534443, 256.88154645599448,
        0.6291060881178562, 1.0418067381860868,
    )  # fmt: skip
    double = DoubleSphere(
        512, 512, 158.28600034966977, 158.2743455478755, 254.96116578191653, 256.8894394501779,
        -0.17213086034353243, 0.5931177593944744,
    )  # fmt: skip
    bearings = random_directions(85)
    pixels = [c.pixels_from_bearings(bearings) for c in (kannala_brandt, extended, double)]
    seen = np.isfinite(np.column_stack(pixels)).all(axis=1)
    assert seen.sum() > 800
    # They were fitted to pictures, not to each other: 0.7 px apart at 85 degrees, in 512 px.
    assert np.linalg.norm(pixels[0] - pixels[1], axis=1)[seen].max() < 1
    assert np.linalg.norm(pixels[1] - pixels[2], axis=1)[seen].max() < 0.1


@pytest.mark.parametrize("alpha", [-0.1, 1.1])
def test_alpha_out_of_range_is_refused(alpha):
    with pytest.raises(ValueError, match=r"alpha must be in \[0, 1\]"):
        ExtendedUnified(640, 480, 300, 300, 320, 240, alpha, 1)


def test_beta_must_be_positive():
    with pytest.raises(ValueError, match="beta must be positive"):
        ExtendedUnified(640, 480, 300, 300, 320, 240, 0.5, 0)
