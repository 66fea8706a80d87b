# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP databases read pair by pair, and those that cannot be read."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest
from colmap_graphs import PANORAMA, panoramas_of_points

from epi360.interop.colmap_database import (
    ColmapPairs,
    open_colmap_database,
    read_colmap_database,
    write_colmap_database,
)

pytest.importorskip("pycolmap")
PAIR_1_2 = 2147483647 + 2


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("databases") / "whole ä.db"
    write_colmap_database(path, panoramas_of_points(3)[1])
    return path


@pytest.fixture
def database(whole, tmp_path):
    path = tmp_path / "database.db"
    path.write_bytes(whole.read_bytes())
    return path


def change(path, *statements):
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement)


def test_pairs_are_read_one_at_a_time(whole):
    _, graph = panoramas_of_points(3)
    with ColmapPairs(whole) as pairs:
        assert len(pairs.names) == 3
        assert pairs.names == [(pair.image1, pair.image2) for pair in graph.pairs]
        assert pairs.images == dict.fromkeys(graph.images, "1")
        for index, pair in enumerate(graph.pairs):
            np.testing.assert_array_equal(pairs.matches(index), pair.matches)
            for name, column in zip(pairs.names[index], pair.matches.T, strict=True):
                expected = graph.images[name].keypoints[column]
                pixels = pairs.keypoints(name)[column]
                np.testing.assert_allclose(pixels, expected, rtol=0, atol=1e-4)  # float32
                assert pairs.camera(name) == PANORAMA


def test_images_out_of_the_cache_are_read_again(whole, monkeypatch):
    monkeypatch.setattr("epi360.interop.colmap_pairs.CACHED_IMAGES", 1)
    with ColmapPairs(whole) as pairs:
        first = [pairs.keypoints(name) for name in pairs.images]
        for name, keypoints in zip(pairs.images, first, strict=True):
            np.testing.assert_array_equal(pairs.keypoints(name), keypoints)


def test_reading_leaves_the_file_and_its_folder_alone(database):
    before = database.read_bytes(), database.stat().st_mtime_ns
    database.chmod(0o444)
    read_colmap_database(database, with_descriptors=True)
    with ColmapPairs(database) as pairs:
        pairs.matches(0)
        pairs.keypoints(pairs.names[0][0])
        assert list(database.parent.iterdir()) == [database]
    assert (database.read_bytes(), database.stat().st_mtime_ns) == before
    assert list(database.parent.iterdir()) == [database]


def test_what_a_writer_has_not_moved_into_the_file_yet_is_seen(database):
    with closing(sqlite3.connect(database)) as writer:
        writer.execute("PRAGMA journal_mode = WAL")
        with writer:
            writer.execute(f"DELETE FROM matches WHERE pair_id = {PAIR_1_2}")
        with ColmapPairs(database) as pairs:
            assert len(pairs.names) == 2


def test_database_of_an_older_colmap_is_read(database):
    change(
        database,
        "DROP TABLE frame_data",
        "DROP TABLE frames",
        "DROP TABLE rig_sensors",
        "DROP TABLE rigs",
        "ALTER TABLE two_view_geometries DROP COLUMN qvec",
        "ALTER TABLE two_view_geometries DROP COLUMN tvec",
        "ALTER TABLE descriptors DROP COLUMN type",
    )
    graph = read_colmap_database(database, with_descriptors=True)
    assert [pair.geometry.status for pair in graph.pairs] == ["ok"] * 3  # from E


def test_pair_of_a_geometry_without_matches_has_its_inliers(database):
    change(database, f"DELETE FROM matches WHERE pair_id = {PAIR_1_2}")
    graph = read_colmap_database(database)
    assert len(graph.pairs) == 3
    pair = next(
        pair for pair in graph.pairs if {pair.image1, pair.image2} == {*list(graph.images)[:2]}
    )
    np.testing.assert_array_equal(pair.matches, pair.geometry.inliers)


def test_pair_without_matches_is_listed(database):
    change(database, "UPDATE matches SET rows = 0, data = NULL")
    with ColmapPairs(database) as pairs:
        assert len(pairs.names) == 3 and pairs.matches(0).shape == (0, 2)


def readers():
    return [ColmapPairs, read_colmap_database, open_colmap_database]


@pytest.mark.parametrize("read", readers())
@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.9999])
def test_truncated_database_is_one_clear_error(share, read, database):
    data = database.read_bytes()
    database.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ValueError, match="truncated|must be an SQLite file") as raised:
        read(database)
    assert str(database) in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize("read", readers())
def test_what_is_no_database_of_colmap_is_said(read, tmp_path):
    text, other = tmp_path / "a.txt", tmp_path / "other.db"
    text.write_text("hello " * 1000)
    change(other, "CREATE TABLE images (image_id INTEGER, name TEXT)")
    for path, message in (
        (text, "must be an SQLite file"),
        (other, "must have a table .* is it a database of COLMAP"),
        (tmp_path, "must be a file"),
    ):
        with pytest.raises(ValueError, match=message):
            read(path)
    with pytest.raises(FileNotFoundError, match="none.db does not exist"):
        read(tmp_path / "none.db")
    assert {path.name for path in tmp_path.iterdir()} == {"a.txt", "other.db"}


def test_damaged_pages_are_one_clear_error(database):
    data = bytearray(database.read_bytes())
    data[4096 * 2 :] = b"\xff" * len(data[4096 * 2 :])
    database.write_bytes(data)
    with pytest.raises(ValueError, match="it cannot be read"):
        read_colmap_database(database)


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("DELETE FROM keypoints WHERE image_id = 2", r"of pano/ä 1.jpg, which has 0 key points"),
        ("UPDATE keypoints SET rows = 150, data = substr(data, 1, 1200)", "up to key point 199"),
        ("UPDATE keypoints SET data = substr(data, 1, 80)", "key points of .* must be 1600 bytes"),
        ("UPDATE keypoints SET cols = 1, data = substr(data, 1, 800)", "2, 4 or 6 columns, got 1"),
        ("UPDATE matches SET data = NULL", "matches of pair .* must be 1600 bytes, got 0"),
        ("UPDATE matches SET cols = 1, rows = 400", "must have 2 columns, got 1"),
        ("UPDATE matches SET rows = -1", "matches of pair"),
        ("UPDATE two_view_geometries SET data = x'00'", "matches of pair .* got 1"),
        ("UPDATE images SET camera_id = 9 WHERE image_id = 3", "has camera 9, which is not there"),
        ("DELETE FROM images WHERE image_id = 3", "has image 3, which is not there"),
        (
            f"INSERT INTO matches SELECT {2 * 2147483647 + 1}, rows, cols, data "
            f"FROM matches WHERE pair_id = {PAIR_1_2}",
            "must name two images, the smaller id first",
        ),
        ("UPDATE cameras SET model = 6", "camera 1: COLMAP model 'FULL_OPENCV' is not supported"),
        ("UPDATE cameras SET model = 99", "model 'number 99' is not supported"),
        ("UPDATE cameras SET params = NULL", "EQUIRECTANGULAR parameters must be 2 numbers"),
        ("UPDATE cameras SET params = x'0000'", "camera 1 must be 0 bytes, got 2"),
        ("UPDATE two_view_geometries SET E = x'00', qvec = NULL", "matrix of pair .* 72 bytes"),
        ("UPDATE two_view_geometries SET qvec = x'00'", "pose of pair .* must be 32 bytes, got 1"),
    ],
)
def test_rows_that_do_not_fit_together_are_one_clear_error(statement, message, database):
    change(database, statement)
    with pytest.raises(ValueError, match=message) as raised:
        read_colmap_database(database)
    assert str(database) in str(raised.value) and "\n" not in str(raised.value)
