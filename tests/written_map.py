# SPDX-License-Identifier: BSD-3-Clause
"""A small map whose key points and descriptors are made up, for the tests of damaged maps."""

from contextlib import suppress

import numpy as np

from epi360.cameras import Equirectangular
from epi360.features.picture_writing import encode_picture
from epi360.interop import (
    MatchedImage,
    MatchedPair,
    MatchGraph,
    Observations,
    PosedImage,
    Reconstruction,
    write_colmap_model,
)
from epi360.poses import Pose, rotation_from_vector

CAMERA = Equirectangular(1024, 512)  # in smaller ones chance shows as much of the map
NAMES = ["0.png", "1.png", "2.png", "new.png"]  # the last one is not in the map
COUNT = 60


def write_map(folder):
    """A COLMAP model, its database, hloc's features, and a folder with a new image.

    Three images see the same points from 0.3 m apart, and so does the new one.
    """
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(COUNT, 3))
    points = (
        directions / np.linalg.norm(directions, axis=1)[:, None] * rng.uniform(2, 5, (COUNT, 1))
    )
    poses = [Pose(rotation_from_vector([0, k, 0]), [0.3 * k, 0.1 * (k % 2), 0]) for k in range(4)]
    pixels = [
        CAMERA.pixels_from_bearings(points @ pose.rotation.T + pose.translation) for pose in poses
    ]
    posed = tuple(PosedImage(NAMES[k], "1", poses[k]) for k in range(3))
    rows = np.tile(np.arange(COUNT), 3), np.repeat(np.arange(3), COUNT), np.vstack(pixels[:3])
    seen = Observations(*rows)
    colors = np.full((COUNT, 3), 128, np.uint8)
    model = Reconstruction({"1": CAMERA}, posed, points, colors, seen)
    write_colmap_model(folder / "sparse" / "0", model)
    descriptors = rng.integers(0, 60, (COUNT, 128)).astype(np.float32)
    images = {
        name: MatchedImage(name, "1", place, descriptors)
        for name, place in zip(NAMES, pixels, strict=True)
    }
    _write_database(folder, {name: images[name] for name in NAMES[:3]})
    _write_features(folder / "features.h5", images.values())
    (folder / "new").mkdir()
    picture = np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8)  # a small file
    (folder / "new" / "new.png").write_bytes(encode_picture(picture, ".png"))


def _write_database(folder, images):
    matches = np.stack([np.arange(COUNT)] * 2, axis=1)
    pairs = tuple(MatchedPair(*names, matches) for names in (NAMES[:2], NAMES[1:3]))
    with suppress(ImportError):
        from epi360.interop import write_colmap_database

        graph = MatchGraph({"1": CAMERA}, images, pairs)
        write_colmap_database(folder / "database.db", graph)


def _write_features(path, images):
    with suppress(ImportError):
        import h5py

        with h5py.File(path, "w") as file:
            for image in images:
                group = file.create_group(image.name)
                group["keypoints"] = (image.keypoints - 0.5).astype(np.float32)
                group["descriptors"] = image.descriptors.T
