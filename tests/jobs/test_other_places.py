# SPDX-License-Identifier: BSD-3-Clause
"""A new image in a map with two rooms: which of them it shows, and how sure that is."""

from dataclasses import dataclass

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.features import Features
from epi360.interop.reconstruction import Observations, PosedImage, Reconstruction
from epi360.jobs.localization import LocalizationOptions, localize
from epi360.jobs.localization.map_matches import SecondLook, no_matches
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.poses import Pose, rotation_from_vector

CAMERA = Equirectangular(2048, 1024)
NUM_POINTS, APART_M = 300, 10.0
# Centres of four images of the first room and two of the second, in the frame of either.
CENTERS = [(0.0, 0.0, 0.0), (0.4, 0.1, 0.0), (0.0, 0.0, 0.5), (-0.4, 0.0, 0.3)]
NEW = Pose(rotation_from_vector([0.1, 0.7, 0.0]), np.array([0.2, -0.1, 0.1])).inverse()


@dataclass
class Source:
    features: dict
    are_of_the_points = True

    def of_map(self, name, camera):
        return self.features[name]


def room(rng):
    away = rng.normal(size=(NUM_POINTS, 3))
    points = away / np.linalg.norm(away, axis=1)[:, None] * rng.uniform(2.0, 4.0, (NUM_POINTS, 1))
    return points, unit(np.abs(rng.normal(size=(NUM_POINTS, 128))))


def unit(descriptors):
    return (descriptors / np.linalg.norm(descriptors, axis=1)[:, None]).astype(np.float32)


def view_of(pose, points, descriptors, rng, noise=0.01):
    pixels = CAMERA.pixels_from_bearings(points @ pose.rotation.T + pose.translation)
    return Features(
        pixels + rng.normal(scale=0.2, size=pixels.shape),
        unit(descriptors + noise * np.abs(rng.normal(size=descriptors.shape))),
        np.ones(len(pixels)),
    )


def two_rooms(share, by_side=False):
    """Map of a room and of another one that shares its first points, and a new image of the first.

    With ``by_side`` they lie on one side of both rooms, else everywhere. The new image is told to
    look more like the first room by less noise in its descriptors.
    """
    rng = np.random.default_rng(0)
    points, descriptors = room(rng)
    others, other_descriptors = room(rng)
    if by_side:
        points, others = (each[each[:, 0].argsort()] for each in (points, others))
    same = np.arange(NUM_POINTS) < share * NUM_POINTS
    others[same], other_descriptors[same] = points[same], descriptors[same]
    features, images, rows, owners = {}, [], [], []
    rooms = [(points, descriptors, CENTERS, 0.01), (others, other_descriptors, CENTERS[:2], 0.03)]
    for number, (seen, described, centers, noise) in enumerate(rooms):
        for center in centers:
            name, pose = f"{len(images)}.jpg", Pose(np.eye(3), -np.array(center))
            features[name] = view_of(pose, seen, described, rng, noise)
            shift = np.array([number * APART_M, 0.0, 0.0])
            rows.append(np.arange(NUM_POINTS) + number * NUM_POINTS)
            owners.append(np.full(NUM_POINTS, len(images)))
            images.append(PosedImage(name, "c", Pose(np.eye(3), -np.array(center) - shift)))
    all_points = np.concatenate([points, others + [APART_M, 0.0, 0.0]])
    pixels = np.concatenate([features[image.name].keypoints for image in images])
    observations = Observations(np.concatenate(rows), np.concatenate(owners), pixels)
    model = Reconstruction(
        {"c": CAMERA}, tuple(images), all_points, np.zeros((len(all_points), 3), np.uint8),
        observations,
    )  # fmt: skip
    return LocalizationMap(model, Source(features)), view_of(NEW, points, descriptors, rng)


def localized(world, features, **options):
    return localize.localize_features(
        features, CAMERA, world, frozenset(), LocalizationOptions(**options)
    )


def is_at(pose, place):
    return np.linalg.norm(pose.inverse().translation - place) < 0.05


HERE = NEW.inverse().translation
THERE = HERE + [APART_M, 0.0, 0.0]


def test_a_room_whose_copy_is_in_the_map_too_is_ambiguous():
    result = localized(*two_rooms(0.8))
    assert result.status == "ambiguous" and 0.5 < result.probability < 0.7
    assert is_at(result.cam_from_world, HERE)
    assert is_at(result.alternatives[0], THERE)


def test_without_a_look_at_other_places_the_copy_stays_unseen():
    result = localized(*two_rooms(0.8), max_views=4)
    assert result.status == "ok" and is_at(result.cam_from_world, HERE)


def test_a_room_that_shares_some_things_leaves_a_warning():
    result = localized(*two_rooms(0.4))
    assert result.status == "ok" and is_at(result.cam_from_world, HERE)
    assert any("another place of the map explains" in warning for warning in result.warnings)


def test_a_room_of_its_own_is_beyond_doubt():
    result = localized(*two_rooms(0.0))
    assert result.status == "ok" and result.warnings == ()
    assert is_at(result.cam_from_world, HERE)


def test_of_two_rooms_that_look_alike_the_surroundings_choose_the_right_one():
    result = localized(*two_rooms(0.55, by_side=True))
    assert result.status == "ok" and is_at(result.cam_from_world, HERE)
    assert any("another place of the map explains" in warning for warning in result.warnings)


@pytest.mark.parametrize(("known", "status"), [(False, "ambiguous"), (True, "ok")])
def test_a_place_of_which_the_image_shows_little_may_be_a_copy(known, status):
    """A copy that is in the map in place of the room: a third of the view is alike."""
    world, features = two_rooms(0.0)
    changed = features.descriptors.copy()
    left = CAMERA.bearings_from_pixels(features.keypoints)[:, 0] < 0.3
    changed[left] = unit(np.abs(np.random.default_rng(1).normal(size=changed[left].shape)))
    image = Features(features.keypoints, changed, features.sizes_px)
    result = localized(world, image, known_place=known)
    assert result.status == status and is_at(result.cam_from_world, HERE)
    assert result.same_share < 0.6 and (known or result.probability < 0.2)
    assert any("parts of the view" in warning for warning in result.warnings)


@pytest.mark.parametrize(("chance", "status"), [(0.19, "too_few_inliers"), (0.02, "ok")])
def test_a_pose_that_shows_no_more_than_chance_is_refused(monkeypatch, chance, status):
    look = SecondLook(no_matches(), 0.2, chance)
    monkeypatch.setattr(localize, "look_again", lambda *_: look)
    result = localized(*two_rooms(0.0))
    assert (result.status, result.seen_share) == (status, 0.2)
    if status != "ok":
        assert result.probability < 0.1 and is_at(result.alternatives[0], HERE)
        assert np.isnan(result.cam_from_world.matrix()[:3]).all()
