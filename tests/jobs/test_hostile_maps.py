# SPDX-License-Identifier: BSD-3-Clause
"""Maps and features that would give nonsense, or be read for ever, are refused in one sentence."""

import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest
from written_map import COUNT, write_map

import epi360

ENDLESS = (
    "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) "
    "SELECT n AS image_id, 1 AS rows, 2 AS cols, x'00' AS data, 1 AS type FROM r"
)


@pytest.fixture
def folder(tmp_path):
    write_map(tmp_path)
    return tmp_path


def answer(folder, features="features.h5"):
    path = None if features is None else folder / features
    world = epi360.load_map(folder, features=path)
    return epi360.localize_image(folder / "new" / "new.png", world, camera=None)


def test_the_whole_map_gives_the_pose(folder):
    pytest.importorskip("h5py")
    assert answer(folder).success


@pytest.mark.parametrize("table", ["descriptors", "keypoints", "images", "cameras"])
def test_a_database_of_views_is_refused(folder, table):
    pytest.importorskip("pycolmap")
    with closing(sqlite3.connect(folder / "database.db")) as connection:
        connection.executescript(f"DROP TABLE {table}; CREATE VIEW {table} AS {ENDLESS}")
    with pytest.raises(ValueError, match=f"{table} must be a plain table, got a view"):
        answer(folder, None)


@pytest.mark.parametrize(
    ("image", "key", "content", "message"),
    [
        (
            "0.png",
            "descriptors",
            np.full((128, COUNT), np.nan),
            "0.png: descriptors must be finite",
        ),
        ("new.png", "descriptors", np.full((128, COUNT), np.inf), "new.png: descriptors must be f"),
        ("0.png", "descriptors", np.zeros((64, COUNT)), "must have one length, got 64 and 128"),
        ("new.png", "descriptors", np.zeros((64, COUNT)), "those of the new image 64"),
        ("new.png", "descriptors", None, "new.png must have keypoints and descriptors"),
        ("new.png", "keypoints", np.zeros((3, 2)), r"of new.png must have shape \(D, 3\)"),
    ],
)
def test_features_that_do_not_fit_are_named(folder, image, key, content, message):
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "features.h5", "r+") as file:
        del file[image][key]
        if content is not None:
            file[image][key] = content.astype(np.float32)
    with pytest.raises(ValueError, match=message):
        answer(folder)


def test_the_unit_of_descriptors_does_not_matter(folder):
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "features.h5", "r+") as file:
        file["new.png"]["descriptors"][...] *= np.float32(1e36)
    assert answer(folder).success


def test_features_in_another_file_are_not_read(folder):
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "features.h5", "r+") as file:
        file.move("0.png", "elsewhere.png")
        file["0.png"] = h5py.ExternalLink("features.h5", "/elsewhere.png")
    with pytest.raises(ValueError, match=r"0\.png lies in another file"):
        answer(folder)


@pytest.mark.parametrize(("file", "place"), [("points3D.bin", 16), ("images.bin", 44)])
@pytest.mark.parametrize("number", [1e101, 1e308])
def test_a_place_whose_distance_is_no_number_is_refused(folder, file, place, number):
    path = folder / "sparse" / "0" / file
    data = bytearray(path.read_bytes())
    struct.pack_into("<d", data, place, number)
    path.write_bytes(bytes(data))
    with pytest.raises(ValueError, match=r"must have coordinates of 1e\+100 at most"):
        answer(folder, None)
