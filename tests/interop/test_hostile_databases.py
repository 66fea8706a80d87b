# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP databases that would be read for ever."""

import sqlite3
from contextlib import closing

import pytest
from test_old_colmap_databases import BEFORE_3_12, GEOMETRIES

from epi360.interop import colmap_tables
from epi360.interop.colmap_tables import ColmapTables

ENDLESS = "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT"


@pytest.fixture
def database(tmp_path):
    path = tmp_path / "database.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(BEFORE_3_12 + GEOMETRIES.format(""))
    return path


@pytest.mark.parametrize("table", ["keypoints", "Matches", "images", "frames"])
@pytest.mark.parametrize(
    "columns",
    [
        "n AS image_id, 1 AS rows, 2 AS cols, x'00' AS data FROM r",
        "count(*) AS image_id, 1 AS rows, 2 AS cols, x'00' AS data FROM r",
    ],
)
def test_a_view_in_place_of_a_table_is_refused(database, table, columns):
    with closing(sqlite3.connect(database)) as connection:
        connection.executescript(
            f"DROP TABLE IF EXISTS {table}; CREATE VIEW {table} AS {ENDLESS} {columns}"
        )
    with pytest.raises(ValueError, match=f"{table} must be a plain table, got a view"):
        ColmapTables(database)


def test_a_virtual_table_is_refused(database):
    with closing(sqlite3.connect(database)) as connection:
        try:
            connection.executescript(
                "DROP TABLE matches; CREATE VIRTUAL TABLE matches USING fts5(a)"
            )
        except sqlite3.OperationalError as error:
            pytest.skip(str(error))
    with pytest.raises(ValueError, match="matches must be a plain table"):
        ColmapTables(database)


def test_views_that_are_not_asked_do_no_harm(database):
    with closing(sqlite3.connect(database)) as connection:
        connection.executescript(f"CREATE VIEW mine AS {ENDLESS} n FROM r")
    with ColmapTables(database) as tables:
        assert tables.has_columns("keypoints", "rows")


def test_rows_without_end_are_cut_by_the_size_of_the_file(database):
    with ColmapTables(database) as tables, pytest.raises(ValueError, match="more rows than bytes"):
        list(tables.rows(f"{ENDLESS} n AS rows FROM r"))


def test_a_row_that_does_not_come_is_not_waited_for(database, monkeypatch):
    monkeypatch.setattr(colmap_tables, "LONGEST_STEP_S", 0.05)
    with ColmapTables(database) as tables, pytest.raises(ValueError, match="interrupted"):
        list(tables.rows(f"{ENDLESS} count(*) AS rows FROM r"))
