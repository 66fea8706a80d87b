# SPDX-License-Identifier: BSD-3-Clause
"""Files of every format, cut and with bytes changed at random: read, or refused in one sentence."""

import random
import sqlite3
import warnings
from contextlib import closing
from itertools import cycle, islice

import numpy as np
import pytest
from test_old_colmap_databases import BEFORE_3_12, GEOMETRIES, PAIR_1_2, blob

from epi360.cameras import Equirectangular, load_cameras
from epi360.interop import (
    MatchedImage,
    MatchedPair,
    MatchGraph,
    Observations,
    PosedImage,
    Reconstruction,
    read_colmap_database,
    read_colmap_model,
    read_hloc,
    read_nerfstudio,
    read_opensfm,
    read_pairs_file,
    read_tum_trajectory,
    write_colmap_model,
    write_hloc,
    write_nerfstudio,
    write_opensfm,
    write_pairs_file,
    write_tum_trajectory,
)
from epi360.poses import Pose, rotation_from_vector

CAMERAS = {"pano": Equirectangular(100, 50)}
IMAGES = tuple(
    PosedImage(f"hall/ä {index}.jpg", "pano", Pose(rotation_from_vector([0, index, 1]), [1, 2, 3]))
    for index in range(3)
)
RECONSTRUCTION = Reconstruction(
    CAMERAS,
    IMAGES,
    np.arange(6.0).reshape(2, 3),
    np.ones((2, 3), np.uint8),
    Observations(np.array([0, 1]), np.array([0, 2]), np.array([[1.0, 2.0], [3.0, 4.0]])),
)
NUMBERS = [b"1e999", b"-1", b"NaN", b"99999999999999999999", b"null", b"[]", b'"x"', b"", b"\xff"]


def colmap(folder):
    write_colmap_model(folder / "model", RECONSTRUCTION)
    return lambda: read_colmap_model(folder / "model")


def colmap_text(folder):
    images = tuple(
        PosedImage(image.name.replace(" ", "_"), "pano", image.cam_from_world) for image in IMAGES
    )
    write_colmap_model(folder / "model", Reconstruction(CAMERAS, images), text=True)
    return lambda: read_colmap_model(folder / "model")


def colmap_database(folder):
    path = folder / "database.db"
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(BEFORE_3_12 + GEOMETRIES.format(""))
        database.execute("INSERT INTO cameras VALUES (1, 17, 100, 50, ?, 1)", (blob("d", 100, 50),))
        for image_id in (1, 2):
            database.execute(
                "INSERT INTO images (name, camera_id) VALUES (?, 1)", (f"{image_id}.jpg",)
            )
            points = np.ones((2, 2), "<f4").tobytes()
            database.execute("INSERT INTO keypoints VALUES (?, 2, 2, ?)", (image_id, points))
        row = (PAIR_1_2, 1, 2, blob("I", 0, 1))
        database.execute("INSERT INTO matches VALUES (?, ?, ?, ?)", row)
        database.execute(
            "INSERT INTO two_view_geometries VALUES (?, ?, ?, ?, 2, NULL, ?, NULL)",
            (*row, blob("d", *range(9))),
        )
    return lambda: read_colmap_database(path, with_descriptors=True)


def hloc(folder):
    pytest.importorskip("h5py")
    images = {name: MatchedImage(name, "pano", np.ones((2, 2)), np.ones((2, 4), "f4"))
              for name in ("hall/1.jpg", "hall/2.jpg")}  # fmt: skip
    pair = MatchedPair(*images, np.array([[0, 1]]))
    files = folder / "features.h5", folder / "matches.h5"
    write_hloc(*files, MatchGraph(CAMERAS, images, (pair,)))
    return lambda: read_hloc(*files, with_descriptors=True)


def opensfm(folder):
    write_opensfm(folder / "reconstruction.json", RECONSTRUCTION)
    return lambda: read_opensfm(folder / "reconstruction.json")


def nerfstudio(folder):
    write_nerfstudio(folder / "transforms.json", RECONSTRUCTION)
    return lambda: read_nerfstudio(folder / "transforms.json")


def tum(folder):
    write_tum_trajectory(folder / "poses.tum", RECONSTRUCTION)
    return lambda: read_tum_trajectory(folder / "poses.tum")


def pairs(folder):
    write_pairs_file(folder / "pairs.txt", [("a b.jpg", "c.jpg"), ("d.jpg", "e.jpg")])
    return lambda: read_pairs_file(folder / "pairs.txt")


def calibration(folder):
    (folder / "a.yaml").write_text("cameras:\n  left: {model: Pinhole, width: 640, height: 480, "
                                   "fx: 400, fy: 400.5, cx: 320, cy: 240}\n")  # fmt: skip
    return lambda: load_cameras(folder / "a.yaml")


def damaged(data, rng):
    """Content that is cut, has a word replaced, or has bytes changed."""
    kind, place = rng.randrange(3), rng.randrange(len(data))
    if kind == 0:
        return data[:place]
    if kind == 1:
        end = place + rng.choice((1, 4, 8))
        return data[:place] + rng.choice([b"\xff" * 8, bytes(8), *NUMBERS]) + data[end:]
    changed = bytearray(data)
    for _ in range(rng.choice((1, 4, 32))):
        changed[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(changed)


@pytest.mark.parametrize(
    "write",
    [
        colmap, colmap_text, colmap_database, hloc, opensfm, nerfstudio, tum, pairs, calibration,
    ],
)  # fmt: skip
def test_a_damaged_file_is_read_or_refused_in_one_sentence(write, tmp_path):
    whole = tmp_path / "whole"
    whole.mkdir()
    read = write(whole)
    read()
    files = sorted(path for path in whole.rglob("*") if path.is_file())
    contents = {path: path.read_bytes() for path in files}
    rng, refused = random.Random(write.__name__), 0
    for path in islice(cycle(files), 150):
        path.write_bytes(damaged(contents[path], rng))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                read()
        except (ValueError, OSError) as error:
            message = str(error)
            assert "\n" not in message and str(whole) in message and len(message) < 500, message
            refused += 1
        path.write_bytes(contents[path])
    assert refused > 20
