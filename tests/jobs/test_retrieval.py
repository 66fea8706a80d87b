# SPDX-License-Identifier: BSD-3-Clause
"""Images that look alike are found among many, whatever their heading."""

import numpy as np
import pytest
from rendered_views import pictures

from epi360.features import extract_features
from epi360.jobs.pairs.retrieval import alike_pairs


def unit(values):
    return np.sqrt(values / values.sum(axis=1, keepdims=True)).astype(np.float32)


def seen_from_near(rng, place, share=0.4):
    """Descriptors of a place with noise, some of them, among others."""
    kept = rng.random(len(place)) < share
    noisy = np.abs(place + rng.normal(0.0, 0.02, place.shape).astype(np.float32)) ** 2
    return unit(np.where(kept[:, None], noisy, rng.gamma(0.4, size=place.shape)))


@pytest.fixture(scope="module")
def images():
    """Images 3 k, 3 k + 1 and 3 k + 2 are of one place."""
    rng = np.random.default_rng(0)
    places = [unit(rng.gamma(0.4, size=(300, 128))) for _ in range(20)]
    return [seen_from_near(rng, place) for place in places for _ in range(3)]


def chosen(images, count, **options):
    return alike_pairs(images.__getitem__, len(images), count, **options)


def test_images_of_one_place_are_paired(images):
    pairs = chosen(images, 2)
    together = [pair for pair in pairs if pair[0] // 3 == pair[1] // 3]
    assert len(together) >= 0.95 * 60
    assert len(pairs) < 1.1 * 60


def test_pairs_ascend_and_each_comes_once(images):
    pairs = chosen(images, 5)
    assert pairs == sorted(set(pairs))
    assert all(first < second for first, second in pairs)


def test_the_number_of_threads_does_not_show(images):
    assert chosen(images, 4, num_threads=1) == chosen(images, 4, num_threads=5)


def test_each_image_gets_its_own_partners_and_those_that_chose_it(images):
    pairs = chosen(images, 4)
    partners = np.bincount(np.ravel(pairs), minlength=len(images))
    assert partners.min() >= 4
    assert len(pairs) <= 4 * len(images)


def test_the_next_ones_take_the_place_of_pairs_that_are_there(images):
    known = set(chosen(images, 2))
    more = chosen(images, 2, without=known)
    assert not known & set(more)
    assert np.bincount(np.ravel(more), minlength=len(images)).min() >= 2


def test_fewer_images_than_partners_give_all_pairs_and_one_image_none(images):
    assert chosen(images[:3], 20) == [(0, 1), (0, 2), (1, 2)]
    assert chosen(images[:1], 20) == []


def test_an_image_without_key_points_gets_no_partner(images):
    nothing = np.zeros((0, 128), np.float32)
    pairs = chosen([*images[:6], nothing], 6)
    assert len(pairs) == 15
    assert chosen([nothing, nothing], 6) == []


def test_progress_is_told_from_the_first_image_to_the_last(images):
    said = []
    chosen(images, 2, progress=lambda *step: said.append(step))
    assert said == [("retrieval", done, 120) for done in range(121)]


@pytest.mark.parametrize(
    "turned",
    [
        lambda picture: np.roll(picture, 131, axis=1),  # to another heading
        lambda picture: picture[::-1, ::-1],  # upside down
    ],
    ids=["heading", "roll"],
)
def test_a_panorama_is_found_again_whatever_its_heading(turned):
    seen = [picture for picture in pictures() if picture.shape == (256, 512, 3)]
    both = [*seen, *(np.ascontiguousarray(turned(picture)) for picture in seen)]
    descriptors = [extract_features(picture).descriptors for picture in both]
    assert chosen(descriptors, 1) == [(k, k + len(seen)) for k in range(len(seen))]
