# SPDX-License-Identifier: BSD-3-Clause
import time

import cv2
import numpy as np
import pytest
from place_views import CAMERA, first_visit, second_visit

from epi360.features.binary_features import extract_binary_features, match_binary_descriptors
from epi360.odometry.places import PlaceIndex
from epi360_scenes import furnished_room


def random_descriptors(rng, count=300):
    return rng.integers(0, 256, (count, 32), dtype=np.uint8)


def seen_again(rng, descriptors, share=0.5):
    """Some of the descriptors with a few bits turned over, among others."""
    again = random_descriptors(rng, len(descriptors))
    kept = rng.random(len(descriptors)) < share
    noise = rng.random((kept.sum(), 256)) < 0.05
    again[kept] = descriptors[kept] ^ np.packbits(noise, axis=1)
    return again


@pytest.mark.parametrize("num_places", [3, 20, 150])
def test_place_seen_again_comes_first(num_places):
    rng = np.random.default_rng(num_places)
    places = [random_descriptors(rng) for _ in range(num_places)]
    index = PlaceIndex()
    for k, place in enumerate(places):
        index.add(10 * k, place)
    for k in (0, num_places // 2, num_places - 1):
        (best, similarity), *others = index.most_similar(seen_again(rng, places[k]), 3)
        assert best == 10 * k
        assert 0.0 < similarity <= 1.0
        assert all(other < similarity for _, other in others)


def test_key_frame_itself_has_similarity_one():
    rng = np.random.default_rng(0)
    index = PlaceIndex()
    places = [random_descriptors(rng) for _ in range(5)]
    for k, place in enumerate(places):
        index.add(k, place)
    assert index.most_similar(places[2], 1)[0] == (2, pytest.approx(1.0))


def test_order_of_the_strongest_descriptors_does_not_matter():
    rng = np.random.default_rng(1)
    index = PlaceIndex()
    for k in range(40):
        index.add(k, random_descriptors(rng))
    query = random_descriptors(rng)
    assert index.most_similar(query, 5) == index.most_similar(rng.permutation(query), 5)


def test_late_key_frames_can_be_left_out():
    rng = np.random.default_rng(2)
    index = PlaceIndex()
    for k in range(10):
        index.add(k, random_descriptors(rng))
    query = random_descriptors(rng)
    assert {k for k, _ in index.most_similar(query, 10, not_after=3)} == {0, 1, 2, 3}
    assert index.most_similar(query, 10, not_after=-1) == []
    assert len(index.most_similar(query, 4)) == 4


def test_key_frames_of_another_index_are_found_among_those_before_them():
    rng = np.random.default_rng(4)
    own, others = ([random_descriptors(rng) for _ in range(count)] for count in (33, 5))
    index = PlaceIndex()
    for k, descriptors in enumerate(own):
        index.add(k, descriptors)
        assert index.has_learned == (k >= 31)
    numbers = {k: 2 * k for k in range(len(own))}
    index.take_in(numbers, {10 * k + 1: each for k, each in enumerate(others)})
    assert len(index) == 38
    for k, descriptors in enumerate(own):
        assert index.most_similar(seen_again(rng, descriptors), 1)[0][0] == 2 * k
    for k, descriptors in enumerate(others):
        assert index.most_similar(seen_again(rng, descriptors), 1)[0][0] == 10 * k + 1
    before, _ = index.similar_before(31)
    assert before.tolist() == sorted([*range(0, 31, 2), 1, 11, 21])
    index.add(70, own[0])
    assert index.most_similar(own[0], 2, not_after=69)[0][0] == 0


def test_empty_index_and_pictures_without_features_have_no_places():
    index = PlaceIndex()
    empty = np.zeros((0, 32), np.uint8)
    some = random_descriptors(np.random.default_rng(3))
    assert index.most_similar(some, 3) == []
    index.add(0, empty)
    index.add(1, some)
    assert index.most_similar(empty, 3) == []
    assert index.most_similar(some, 3)[0][0] == 1
    assert len(index) == 2


def test_wrong_input_is_named():
    index = PlaceIndex()
    index.add(4, np.zeros((3, 32), np.uint8))
    with pytest.raises(ValueError, match="above the last one, 4, got 4"):
        index.add(4, np.zeros((3, 32), np.uint8))
    with pytest.raises(ValueError, match=r"uint8 of shape \(N, 32\), got float64 \(3, 32\)"):
        index.add(5, np.zeros((3, 32)))


def test_key_frames_are_added_and_searched_quickly():
    rng = np.random.default_rng(4)
    index = PlaceIndex()
    batch = [random_descriptors(rng) for _ in range(50)]
    begin = time.process_time()
    for k in range(500):
        index.add(k, batch[k % 50])
    seconds = time.process_time() - begin
    assert seconds / 500 < 0.02
    begin = time.process_time()
    index.most_similar(batch[0], 5)
    assert time.process_time() - begin < 0.2


@pytest.fixture(scope="module")
def picture():
    room = furnished_room(1)
    pose = room.sample_pose(np.random.default_rng(0))
    image = room.render(CAMERA, pose, supersample=1).image
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def test_turned_panorama_has_the_same_key_points_in_turned_directions(picture):
    quarter = CAMERA.width // 4
    here = extract_binary_features(picture, CAMERA)
    turned = extract_binary_features(np.roll(picture, quarter, axis=1), CAMERA)
    matches = match_binary_descriptors(here.descriptors, turned.descriptors)
    assert len(matches) > 0.5 * len(here)
    x, y, z = here.bearings[matches[:, 0]].T
    expected = np.stack([z, y, -x], axis=1)  # a quarter turn to the right
    away = np.linalg.norm(turned.bearings[matches[:, 1]] - expected, axis=1)
    assert np.median(away) < np.radians(0.2)


def test_mask_and_number_of_features_are_kept(picture):
    mask = np.zeros(picture.shape, dtype=bool)
    mask[:, : CAMERA.width // 2] = True
    found = extract_binary_features(picture, CAMERA, mask, max_features=100)
    assert 0 < len(found) <= 100
    assert (found.bearings[:, 0] < 0.01).all()  # the left half
    assert len(extract_binary_features(np.full_like(picture, 90), CAMERA)) == 0


def test_room_is_recognised_whatever_the_heading():
    index = PlaceIndex()
    views = [*first_visit(0), *first_visit(1)]
    for k, (_, features) in enumerate(views):
        index.add(k, features.descriptors)
    for _, features in second_visit(0):
        best, _ = index.most_similar(features.descriptors, 1)[0]
        assert best in (0, 1, 2)
