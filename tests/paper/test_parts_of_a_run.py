# SPDX-License-Identifier: BSD-3-Clause
"""Trials on disk come back as they were, in order, and never those of another run."""

import dataclasses

import numpy as np
import pytest

from epi360_paper import parts

FINGERPRINT = parts.Fingerprint("fig9", "printed", 0, "1.0", "a", "1", "")
ROWS = [
    {"cell": "a", "trial": 0, "error": 1 / 3, "method": "8pa"},
    {"cell": "a", "trial": 1, "error": float("nan"), "method": 'with "quotes", commas'},
]


@pytest.fixture
def part(tmp_path):
    path = tmp_path / "a-0.csv"
    parts.write_part(path, FINGERPRINT, ROWS, 1.5)
    return path


def test_words_come_back_as_they_were_and_numbers_to_nine_digits(part):
    trials = parts.join_parts([(part, FINGERPRINT)])
    assert list(trials.columns) == list(ROWS[0])
    for name in ("cell", "trial", "method"):
        np.testing.assert_array_equal(trials[name], [row[name] for row in ROWS])
    np.testing.assert_allclose(trials["error"], [1 / 3, np.nan], rtol=1e-9)
    assert trials["trial"].dtype.kind == "i" and trials["error"].dtype == np.float64
    assert trials.seconds == 1.5 and len(trials) == 2


def test_parts_are_joined_in_the_order_given_and_their_seconds_add_up(part, tmp_path):
    other = tmp_path / "a-1.csv"
    parts.write_part(other, FINGERPRINT, [{**ROWS[0], "trial": 7}], 0.25)
    joined = parts.join_parts([(other, FINGERPRINT), (part, FINGERPRINT)])
    np.testing.assert_array_equal(joined["trial"], [7, 0, 1])
    assert joined.seconds == 1.75


def test_rows_are_chosen_by_the_values_of_columns(part):
    trials = parts.join_parts([(part, FINGERPRINT)])
    assert len(trials.where(cell="a")) == 2
    np.testing.assert_array_equal(trials.where(cell="a", trial=1)["method"], [ROWS[1]["method"]])
    assert len(trials.where(cell="b")) == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seed": 1}, "seed 0, not 1"),
        ({"protocol": "authors"}, "protocol 'printed', not 'authors'"),
        ({"version": "2.0"}, "version '1.0', not '2.0'"),
        ({"value": "2"}, "value '1', not '2'"),
    ],
)
def test_a_part_of_another_run_is_refused_with_the_difference(part, change, words):
    other = dataclasses.replace(FINGERPRINT, **change)
    assert FINGERPRINT.difference(dataclasses.asdict(FINGERPRINT)) == ""
    with pytest.raises(ValueError, match=f"trials of another run .{words}.; give another --out"):
        parts.read_part(part, other)


def test_a_part_that_is_not_there_or_damaged_is_none(part, tmp_path):
    assert parts.read_part(tmp_path / "none.csv", FINGERPRINT) is None
    part.write_text("# {broken")
    assert parts.read_part(part, FINGERPRINT) is None


def test_parts_with_other_columns_are_not_joined(part, tmp_path):
    other = tmp_path / "a-1.csv"
    parts.write_part(other, FINGERPRINT, [{"cell": "a", "trial": 2}], 0.0)
    with pytest.raises(ValueError, match="must have the columns"):
        parts.join_parts([(part, FINGERPRINT), (other, FINGERPRINT)])
