# SPDX-License-Identifier: BSD-3-Clause
"""How much of a panorama looks like other parts of it, on pictures that are made to repeat."""

import gc
import weakref

import cv2
import numpy as np
import pytest

from epi360.features import self_likeness
from epi360.features.self_likeness import share_like_itself
from epi360.features.warped_patches import Panorama

SIZE = (512, 1024)
ALL_REPEATS, NOTHING_REPEATS = 0.6, 0.1


def blobs(seed, size=SIZE):
    """A picture of blurred noise, which has key points everywhere."""
    noise = np.random.default_rng(seed).normal(0.0, 1.0, size)
    soft = cv2.GaussianBlur(noise, (0, 0), 3.0)
    return np.clip(128 + 40 * soft / soft.std(), 0, 255).astype(np.uint8)


def twice(seed):
    """A picture whose right half is its left half."""
    half = blobs(seed, (SIZE[0], SIZE[1] // 2))
    return np.concatenate([half, half], axis=1)


def test_what_comes_twice_is_found_and_what_comes_once_is_not():
    assert share_like_itself(Panorama.of_sharp(twice(0))) > ALL_REPEATS
    assert share_like_itself(Panorama.of_sharp(blobs(0))) < NOTHING_REPEATS


def test_the_share_does_not_depend_on_the_heading():
    turned = np.roll(twice(1), 200, axis=1)
    share = share_like_itself(Panorama.of_sharp(twice(1)))
    assert share_like_itself(Panorama.of_sharp(turned)) == pytest.approx(share, abs=0.05)


def test_the_floor_does_not_count():
    picture = blobs(2)
    below = slice(SIZE[0] * 5 // 9, None)  # ten degrees below the horizon
    picture[below] = twice(2)[below]
    assert share_like_itself(Panorama.of_sharp(picture)) < NOTHING_REPEATS


def test_what_is_masked_does_not_count():
    usable = np.ones(SIZE, dtype=bool)
    usable[:, : SIZE[1] // 2] = False
    assert share_like_itself(Panorama.of_sharp(twice(3), usable)) < NOTHING_REPEATS


def test_a_bare_panorama_says_nothing():
    assert share_like_itself(Panorama.of_sharp(np.full(SIZE, 90, np.uint8))) == 0.0


def test_a_panorama_is_searched_once_and_not_kept(monkeypatch):
    panorama = Panorama.of_sharp(twice(4))
    share = share_like_itself(panorama)
    monkeypatch.setattr(self_likeness, "extract_features", None)
    assert share_like_itself(panorama) == share
    known = weakref.ref(panorama)
    del panorama
    gc.collect()
    assert known() is None
