# SPDX-License-Identifier: BSD-3-Clause
"""What the images of a map know around a pose: how much of it a new image shows."""

import numpy as np
from test_other_places import CAMERA, CENTERS, NEW, Source, room, view_of

from epi360.features.sphere_cells import SphereCells
from epi360.interop.reconstruction import Observations, PosedImage, Reconstruction
from epi360.jobs.localization.map_matches import joined, matches_with
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.jobs.localization.new_image import NewImage
from epi360.jobs.localization.surroundings import surroundings_at
from epi360.poses import Pose

POINTS, DESCRIPTORS = room(np.random.default_rng(0))
_, OTHERS = room(np.random.default_rng(6))
DIRECTIONS = POINTS @ NEW.rotation.T + NEW.translation  # in the new camera
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


def world_of(points, descriptors):
    """Map of four images that all see all points."""
    rng = np.random.default_rng(1)
    poses = [Pose(np.eye(3), -np.array(center)) for center in CENTERS]
    features = {f"{k}.jpg": view_of(p, points, descriptors, rng) for k, p in enumerate(poses)}
    images = tuple(PosedImage(f"{k}.jpg", "c", p) for k, p in enumerate(poses))
    pixels = np.concatenate([features[image.name].keypoints for image in images])
    rows = np.tile(np.arange(len(points)), len(images))
    seen = Observations(rows, np.repeat(np.arange(len(images)), len(points)), pixels)
    colors = np.zeros((len(points), 3), np.uint8)
    model = Reconstruction({"c": CAMERA}, images, points, colors, seen)
    return LocalizationMap(model, Source(features))


def picture(points, descriptors):
    return view_of(NEW, points, descriptors, np.random.default_rng(5))


def asked(world, features, mask=None, left_out=frozenset()):
    """What the map says of the true pose."""
    new = NewImage.of(features, CAMERA, mask)
    matches = joined([matches_with(world.view(k), k, features) for k in range(len(CENTERS))])
    return surroundings_at(world, matches, NEW, new, 0.01, left_out)


def with_others(changed):
    """Picture of a room in which some points are others."""
    return picture(POINTS, np.where(changed[:, None], OTHERS, DESCRIPTORS))


def test_the_room_itself_is_confirmed():
    around = asked(world_of(POINTS, DESCRIPTORS), picture(POINTS, DESCRIPTORS))
    assert around.confirm and around.probability > 0.99 and around.share > 0.9
    assert around.num_parts > 60 and around.witness in {"0.jpg", "1.jpg", "2.jpg", "3.jpg"}


def test_images_that_are_left_out_say_nothing():
    world, features = world_of(POINTS, DESCRIPTORS), picture(POINTS, DESCRIPTORS)
    witness = asked(world, features).witness
    around = asked(world, features, left_out={int(witness.removesuffix(".jpg"))})
    assert around.confirm and around.witness not in {witness, ""}
    assert asked(world, features, left_out=frozenset(range(4))).witness == ""


def test_a_picture_all_of_whose_features_are_alike_confirms_nothing():
    same = np.tile(DESCRIPTORS[:1], (len(POINTS), 1))
    assert not asked(world_of(POINTS, same), picture(POINTS, same)).confirm


def test_a_room_of_which_half_is_another_is_not_confirmed():
    every_other_cell = SphereCells(183).indices(DIRECTIONS) % 2 == 0
    around = asked(world_of(POINTS, DESCRIPTORS), with_others(every_other_cell))
    assert not around.confirm and around.probability < 0.1 and 0.4 < around.share < 0.6


def test_what_a_mask_hides_is_not_missing():
    on_the_left = DIRECTIONS[:, 0] < 0.0
    world, features = world_of(POINTS, DESCRIPTORS), with_others(on_the_left)
    assert not asked(world, features).confirm
    mask = np.zeros((CAMERA.height, CAMERA.width), dtype=bool)
    mask[:, CAMERA.width // 2 :] = True
    kept = features.chosen(~on_the_left)
    around = asked(world, kept, mask)
    assert around.confirm and around.share > 0.9
    assert not asked(world, kept).confirm


def test_what_nearer_points_hide_is_not_missing():
    """Half of the room is behind a shelf, whose points the map knows if the shelf was there."""
    behind = DIRECTIONS[:, 0] < 0.0
    center = NEW.inverse().translation
    near, described = room(np.random.default_rng(7))
    near = center + 0.8 * (near - center) / np.linalg.norm(near - center, axis=1, keepdims=True)
    in_front = ((near - center) @ NEW.rotation.T)[:, 0] < 0.0
    shelf, shelf_looks = near[in_front], described[in_front]
    shown = picture(
        np.concatenate([POINTS[~behind], shelf]),
        np.concatenate([DESCRIPTORS[~behind], shelf_looks]),
    )
    everything = world_of(
        np.concatenate([POINTS, shelf]), np.concatenate([DESCRIPTORS, shelf_looks])
    )
    around = asked(everything, shown)
    assert around.confirm and around.share > 0.9
    assert not asked(world_of(POINTS, DESCRIPTORS), shown).confirm


def test_a_pose_that_no_image_shares_points_with_is_not_confirmed():
    elsewhere = picture(*room(np.random.default_rng(9)))
    around = asked(world_of(POINTS, DESCRIPTORS), elsewhere)
    assert (around.probability, around.num_parts, around.witness) == (0.0, 0, "")
