# SPDX-License-Identifier: BSD-3-Clause
"""Databases of COLMAP before 4, built by hand: https://colmap.github.io/database.html.

Camera 2 is turned by 90 degrees about the viewing direction and moved; the numbers of the blobs
are written out, so that a convention that writer and reader share is seen.
"""

import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest

from epi360.interop.colmap_database import ColmapPairs, read_colmap_database

HALF = 0.5**0.5
R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x2 = R x1 + t
T = np.array([0.6, 0, 0.8])
ESSENTIAL = [[-0.8, 0, 0], [0, -0.8, -0.6], [0.6, 0, 0]]  # rows of [t]x R
PAIR_1_2 = 2147483647 * 1 + 2
IN_CAMERA_1 = np.array(
    [[x, y, z] for x in (-1.0, 0.5, 1.5) for y in (-1.2, 0.2, 1.1) for z in (4, 6)]
)

BEFORE_3_12 = """
CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, model INTEGER NOT NULL,
    width INTEGER NOT NULL, height INTEGER NOT NULL, params BLOB,
    prior_focal_length INTEGER NOT NULL);
CREATE TABLE images (image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, name TEXT NOT NULL UNIQUE,
    camera_id INTEGER NOT NULL, prior_qw REAL, prior_qx REAL, prior_qy REAL, prior_qz REAL,
    prior_tx REAL, prior_ty REAL, prior_tz REAL,
    CONSTRAINT image_id_check CHECK(image_id >= 0 and image_id < 2147483647),
    FOREIGN KEY(camera_id) REFERENCES cameras(camera_id));
CREATE TABLE keypoints (image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    cols INTEGER NOT NULL, data BLOB);
CREATE TABLE descriptors (image_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    cols INTEGER NOT NULL, data BLOB);
CREATE TABLE matches (pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    cols INTEGER NOT NULL, data BLOB);
"""
GEOMETRIES = """
CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY NOT NULL, rows INTEGER NOT NULL,
    cols INTEGER NOT NULL, data BLOB, config INTEGER NOT NULL, F BLOB, E BLOB, H BLOB{});
"""
RIGS = """
CREATE TABLE rigs (rig_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    ref_sensor_id INTEGER NOT NULL, ref_sensor_type INTEGER NOT NULL);
CREATE TABLE rig_sensors (rig_id INTEGER NOT NULL, sensor_id INTEGER NOT NULL,
    sensor_type INTEGER NOT NULL, sensor_from_rig BLOB);
CREATE TABLE frames (frame_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, rig_id INTEGER NOT NULL);
CREATE TABLE frame_data (frame_id INTEGER NOT NULL, data_id INTEGER NOT NULL,
    sensor_id INTEGER NOT NULL, sensor_type INTEGER NOT NULL);
INSERT INTO rigs VALUES (1, 1, 0);
INSERT INTO frames VALUES (7, 1);
INSERT INTO frame_data VALUES (7, 1, 1, 0), (7, 2, 2, 0);
"""


def blob(layout, *values):
    return struct.pack(f"<{len(values)}{layout}", *values)


def pixels_of(points):
    return 100 * points[:, :2] / points[:, 2:] + 200


@pytest.fixture
def build(tmp_path):
    """Function that writes a database with a pinhole camera for each image and returns its path."""

    def build(config, **blobs):
        path = tmp_path / "old.db"
        columns = "".join(f", {name} BLOB" for name in blobs if name != "E")
        with closing(sqlite3.connect(path)) as database, database:
            database.executescript(BEFORE_3_12 + GEOMETRIES.format(columns))
            for image_id, points in ((1, IN_CAMERA_1), (2, IN_CAMERA_1 @ R.T + T)):
                camera = blob("d", 100, 100, 200, 200)
                database.execute(
                    "INSERT INTO cameras VALUES (?, 1, 400, 400, ?, 1)", (image_id, camera)
                )
                database.execute(
                    "INSERT INTO images (image_id, name, camera_id) VALUES (?, ?, ?)",
                    (image_id, f'it\'s "{image_id}".jpg', image_id),
                )
                pixels = pixels_of(points)
                shapes = np.tile([1.0, 0, 0, 1], (len(pixels), 1))  # COLMAP's affine shape
                table = np.hstack([pixels, shapes]).astype("<f4")
                database.execute(
                    "INSERT INTO keypoints VALUES (?, ?, 6, ?)",
                    (image_id, len(table), table.tobytes()),
                )
            matches = np.arange(len(IN_CAMERA_1), dtype="<u4").repeat(2).tobytes()
            count = len(IN_CAMERA_1)
            database.execute("INSERT INTO matches VALUES (?, ?, 2, ?)", (PAIR_1_2, count, matches))
            values = {"pair_id": PAIR_1_2, "rows": count, "cols": 2, "data": matches}
            values |= {"config": config, **blobs}
            names, marks = ", ".join(values), ", ".join("?" * len(values))
            database.execute(
                f"INSERT INTO two_view_geometries ({names}) VALUES ({marks})", [*values.values()]
            )
        return path

    return build


def only_pair(path):
    graph = read_colmap_database(path, with_descriptors=True)
    (pair,) = graph.pairs
    assert (pair.image1, pair.image2) == ('it\'s "1".jpg', 'it\'s "2".jpg')
    assert [image.descriptors for image in graph.images.values()] == [None, None]
    assert not graph.cam_from_rig
    return pair


def test_before_3_6_a_geometry_has_no_pose_and_is_found_from_the_rows_of_the_matrix(build):
    pair = only_pair(build(2, E=blob("d", *np.ravel(ESSENTIAL))))
    assert pair.geometry.status == "ok"
    np.testing.assert_allclose(pair.geometry.cam2_from_cam1.rotation, R, atol=1e-6)
    np.testing.assert_allclose(pair.geometry.cam2_from_cam1.translation, T, atol=1e-6)


def test_a_pose_is_a_quaternion_with_w_first_and_a_translation(build):
    pair = only_pair(build(3, qvec=blob("d", HALF, 0, 0, HALF), tvec=blob("d", 1.2, 0, 1.6)))
    np.testing.assert_allclose(pair.geometry.cam2_from_cam1.rotation, R, atol=1e-12)
    np.testing.assert_allclose(pair.geometry.cam2_from_cam1.translation, T, atol=1e-12)


def test_a_pose_that_was_not_computed_is_the_identity_and_is_found_from_the_matrix(build):
    not_computed = {"qvec": blob("d", 1, 0, 0, 0), "tvec": blob("d", 0, 0, 0)}
    pair = only_pair(build(2, E=blob("d", *np.ravel(ESSENTIAL)), **not_computed))
    np.testing.assert_allclose(pair.geometry.cam2_from_cam1.rotation, R, atol=1e-6)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("bad", [struct.pack("<Q", 0x7FF0000000000001), blob("d", 1e200)])
def test_a_pose_whose_length_is_no_number_is_found_from_the_matrix(build, bad):
    pair = only_pair(build(2, E=blob("d", *np.ravel(ESSENTIAL)), qvec=4 * bad, tvec=3 * bad))
    np.testing.assert_allclose(pair.geometry.cam2_from_cam1.rotation, R, atol=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_none_are_no_pose(build, bad):
    path = build(2, E=blob("d", *[bad] * 9), qvec=blob("d", *[bad] * 4), tvec=blob("d", *[bad] * 3))
    assert only_pair(path).geometry is None


def test_a_rig_of_3_12_has_the_sensors_quaternion_with_w_first_then_the_translation(build):
    path = build(2, E=blob("d", *np.ravel(ESSENTIAL)))
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(RIGS)
        pose = blob("d", HALF, 0, 0, HALF, 1, 2, 3)
        database.execute("INSERT INTO rig_sensors VALUES (1, 2, 0, ?)", (pose,))
    graph = read_colmap_database(path)
    np.testing.assert_array_equal(graph.cam_from_rig["1"].matrix(), np.eye(4))
    np.testing.assert_allclose(graph.cam_from_rig["2"].rotation, R, atol=1e-12)
    assert graph.cam_from_rig["2"].translation.tolist() == [1, 2, 3]
    assert [image.frame for image in graph.images.values()] == ["7", "7"]
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE rig_sensors SET sensor_from_rig = zeroblob(56)")
    with pytest.raises(ValueError, match="pose of camera 2 on its rig must be a quaternion"):
        read_colmap_database(path)


def test_an_image_without_key_points_is_there_and_in_no_pair(build):
    path = build(1)
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("INSERT INTO images (name, camera_id) VALUES ('third.jpg', 1)")
        database.execute("INSERT INTO keypoints VALUES (3, 0, 0, NULL)")
        database.execute("INSERT INTO descriptors VALUES (3, 0, 128, x'')")
    graph = read_colmap_database(path, with_descriptors=True)
    third = graph.images["third.jpg"]
    assert third.keypoints.shape == (0, 2) and len(third.descriptors) == 0
    assert graph.pairs[0].geometry.status == "too_few_inliers"


def test_a_database_of_no_images_is_an_empty_graph(tmp_path):
    path = tmp_path / "empty.db"
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(BEFORE_3_12 + GEOMETRIES.format(""))
    graph = read_colmap_database(path)
    assert not graph.images and not graph.pairs
    with ColmapPairs(path) as pairs:
        assert len(pairs.names) == 0


@pytest.mark.parametrize(
    ("table", "column", "value", "wanted"),
    [
        ("cameras", "model", "'PINHOLE'", "integer"),
        ("cameras", "params", "1.5", "bytes"),
        ("keypoints", "rows", "NULL", "integer"),
        ("keypoints", "cols", "'many'", "integer"),
        ("matches", "data", "3", "bytes"),
        ("two_view_geometries", "config", "x'02'", "integer"),
        ("images", "name", "x'6162'", "text"),
    ],
)
def test_a_value_of_another_type_is_one_clear_error(build, table, column, value, wanted):
    path = build(2, E=blob("d", *np.ravel(ESSENTIAL)))
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(f"CREATE TABLE loose AS SELECT * FROM {table}")  # without its NOT NULL
        database.execute(f"DROP TABLE {table}")
        database.execute(f"ALTER TABLE loose RENAME TO {table}")
        database.execute(f"UPDATE {table} SET {column} = {value}")
    with pytest.raises(ValueError, match=f"column {column} must hold .*{wanted}.*, got") as raised:
        read_colmap_database(path)
    assert str(path) in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize("bad", ["nan", "inf"])
def test_key_points_that_are_no_numbers_are_refused(build, bad):
    path = build(2)
    with closing(sqlite3.connect(path)) as database, database:
        row = np.full((1, 6), float(bad), "<f4").tobytes()
        database.execute("UPDATE keypoints SET rows = 1, data = ?", (row,))
        database.execute("DELETE FROM matches")
        database.execute("DELETE FROM two_view_geometries")
    with pytest.raises(ValueError, match=r"key points of it's .* must be finite"):
        read_colmap_database(path)
