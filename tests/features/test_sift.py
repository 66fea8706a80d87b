# SPDX-License-Identifier: BSD-3-Clause
"""The core's SIFT finds what OpenCV's finds, and looks only where it is asked to."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from epi360 import _core

CONTRAST = 0.02


def speckles(width, height, seed=0):
    """Noise of several scales: key points of all sizes."""
    rng = np.random.default_rng(seed)
    grey = np.zeros((height, width))
    for sigma in (1.0, 2.5, 6.0, 15.0):
        waves = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), sigma)
        grey += waves / waves.std()
    return (128 + 25 * grey).clip(0, 255).astype(np.uint8)


def opencv_sift(picture, contrast_threshold=CONTRAST):
    sift = cv2.SIFT_create(contrastThreshold=contrast_threshold, enable_precise_upscale=True)
    points, descriptors = sift.detectAndCompute(picture, None)
    return np.array([(*p.pt, p.size, p.response) for p in points]), descriptors


def shares_found(rows, descriptors, others, other_descriptors):
    """Share of key points that others have too, and that with the same descriptor as well."""
    # A key point with several orientations is there as often; the likest descriptor is its own.
    distances, nearest = cKDTree(others[:, :3]).query(rows[:, :3], k=6)
    differences = np.abs(
        other_descriptors[nearest].astype(int) - descriptors[:, None].astype(int)
    ).max(axis=2)
    differences[distances > 0.01] = 255
    return (distances[:, 0] < 0.01).mean(), (differences.min(axis=1) <= 4).mean()


@pytest.mark.parametrize(("width", "height"), [(400, 300), (333, 257), (64, 500), (700, 40)])
@pytest.mark.parametrize("contrast_threshold", [0.013, 0.02, 0.04])
def test_key_points_and_descriptors_are_those_of_opencv(width, height, contrast_threshold):
    picture = speckles(width, height)
    rows, descriptors = _core.find_sift(picture, None, contrast_threshold)
    expected, expected_descriptors = opencv_sift(picture, contrast_threshold)
    assert len(expected) > 30
    # Where two numbers are equal but for rounding, one of the two may see an extremum or a second
    # orientation that the other does not see.
    for sets in (
        (rows, descriptors, expected, expected_descriptors),
        (expected, expected_descriptors, rows, descriptors),
    ):
        same_place, same_descriptor = shares_found(*sets)
        assert same_place > 0.99
        assert same_descriptor > 0.98


def test_strengths_and_sizes_are_those_of_opencv():
    picture = speckles(400, 300)
    rows, _ = _core.find_sift(picture, None, CONTRAST)
    expected, _ = opencv_sift(picture)
    distances, nearest = cKDTree(expected[:, :3]).query(rows[:, :3])
    same = distances < 0.01
    np.testing.assert_allclose(rows[same, 3], expected[nearest[same], 3], atol=1e-5)


def test_a_mask_leaves_out_its_key_points_and_changes_no_other():
    picture = speckles(400, 300)
    mask = np.zeros_like(picture)
    mask[50:200, 100:300] = 255
    rows, descriptors = _core.find_sift(picture, None, CONTRAST)
    columns, lines = np.floor(rows[:, :2] + 0.5).astype(int).T
    kept = mask[lines, columns] > 0
    masked_rows, masked_descriptors = _core.find_sift(picture, mask, CONTRAST)
    assert 0 < kept.sum() < len(kept)
    np.testing.assert_array_equal(masked_rows, rows[kept])
    np.testing.assert_array_equal(masked_descriptors, descriptors[kept])


def test_a_mask_of_another_size_is_refused():
    with pytest.raises(ValueError, match="size of the picture"):
        _core.find_sift(speckles(60, 40), np.ones((40, 59), np.uint8), CONTRAST)


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (2, 2), (5, 7), (13, 200), (31, 16)])
def test_tiny_pictures_have_few_key_points_or_none(size):
    rows, descriptors = _core.find_sift(speckles(400, 300)[: size[0], : size[1]], None, CONTRAST)
    assert len(rows) == len(descriptors) <= size[0] * size[1]
    assert np.isfinite(rows).all()


def test_a_picture_without_contrast_has_no_key_points():
    rows, descriptors = _core.find_sift(np.full((100, 200), 77, np.uint8), None, CONTRAST)
    assert rows.shape == (0, 4)
    assert descriptors.shape == (0, 128)


def test_searches_at_the_same_time_find_the_same():
    picture = speckles(300, 200)
    rows, descriptors = _core.find_sift(picture, None, CONTRAST)
    with ThreadPoolExecutor(4) as pool:
        for again in pool.map(lambda _: _core.find_sift(picture, None, CONTRAST), range(8)):
            np.testing.assert_array_equal(again[0], rows)
            np.testing.assert_array_equal(again[1], descriptors)
