# SPDX-License-Identifier: BSD-3-Clause
"""Visual words and signatures."""

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from epi360.features.visual_words import evenly_spread, learn_words, rarity, signature


def random_descriptors(seed, count):
    """Unit descriptors without negative entries, as RootSIFT gives them."""
    values = np.random.default_rng(seed).gamma(0.4, size=(count, 128))
    return np.sqrt(values / values.sum(axis=1, keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def words():
    return learn_words(random_descriptors(0, 2000))


def test_there_is_a_word_for_every_ten_samples(words):
    assert words.shape == (200, 128)
    assert learn_words(random_descriptors(0, 9)).shape == (0, 128)


def test_words_do_not_depend_on_the_threads_of_the_product(words):
    for threads in (1, 2):
        with threadpool_limits(threads, user_api="blas"):
            np.testing.assert_array_equal(learn_words(random_descriptors(0, 2000)), words)


def test_the_order_of_the_descriptors_does_not_show_in_a_signature(words):
    descriptors = random_descriptors(1, 500)
    first = signature(descriptors, words)
    second = signature(np.random.default_rng(2).permutation(descriptors), words)
    np.testing.assert_array_equal(first.words, second.words)
    np.testing.assert_array_equal(first.signs, second.signs)


def test_a_signature_has_each_nearest_word_once(words):
    descriptors = random_descriptors(3, 300)
    made = signature(descriptors, words)
    distances = np.linalg.norm(descriptors[:, None] - words, axis=2)
    np.testing.assert_array_equal(made.words, np.unique(distances.argmin(axis=1)))
    assert made.signs.shape == (len(made.words), 16)


def test_the_signs_say_on_which_side_of_its_word_a_descriptor_lies(words):
    descriptor = random_descriptors(4, 1)
    made = signature(descriptor, words)
    is_above = descriptor[0] > words[made.words[0]]
    agreement = np.mean(np.unpackbits(made.signs[0]) == is_above)
    assert agreement > 0.95  # entries within the rounding of a descriptor may go either way


def test_an_image_without_descriptors_has_an_empty_signature(words):
    assert len(signature(np.zeros((0, 128), np.float32), words).words) == 0
    assert len(signature(random_descriptors(5, 10), words[:0]).words) == 0


def test_strong_and_weak_descriptors_are_taken_alike():
    np.testing.assert_array_equal(evenly_spread(np.arange(9), 3), [0, 4, 8])
    np.testing.assert_array_equal(evenly_spread(np.arange(2), 3), [0, 1])
    assert len(evenly_spread(np.arange(0), 3)) == 0


def test_a_rare_word_counts_more_and_one_that_all_have_still_a_little():
    weights = rarity(10, np.array([1, 5, 10]))
    assert weights[0] > weights[1] > weights[2] > 0
