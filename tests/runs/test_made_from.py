# SPDX-License-Identifier: BSD-3-Clause
"""Whether results were made from what is asked for now."""

import numpy as np
import pytest

from epi360.runs.made_from import fingerprint, first_difference, read_record, write_record


def test_equal_options_do_not_differ_also_when_they_come_back_from_a_file(tmp_path):
    options = {"faces": ("up", "down"), "fov_deg": 90.0, "size": None, "seed": 3}
    write_record(tmp_path / "record.json", options)
    before = read_record(tmp_path / "record.json", remedy="delete it")
    assert first_difference(before, options) is None


def test_the_first_option_that_differs_is_named_with_both_values():
    before, now = {"seed": 0, "width": 2048}, {"seed": 0, "width": 1024, "new": 1}
    assert first_difference(before, now) == ("width", 2048, 1024)
    assert first_difference({**before, "width": 1024}, now) == ("new", None, 1)


def test_what_is_not_asked_for_does_not_matter():
    assert first_difference({"seed": 0, "seconds": 4.0}, {"seed": 0}) is None


def test_a_missing_record_is_none_and_a_damaged_one_is_an_error(tmp_path):
    path = tmp_path / "record.json"
    assert read_record(path, remedy="delete it") is None
    for content in ('{"a": 1', "[1]", "\x00"):
        path.write_text(content)
        with pytest.raises(ValueError, match=r"record\.json is damaged; delete it"):
            read_record(path, remedy="delete it")


def test_the_fingerprint_is_that_of_all_pieces():
    pixels = np.arange(6.0).reshape(2, 3)
    first = fingerprint(("a", 1), b"content", pixels)
    assert first == fingerprint(("a", 1), b"content", np.asfortranarray(pixels))
    others = {
        fingerprint(("a", 2), b"content", pixels),
        fingerprint(("a", 1), b"contents", pixels),
        fingerprint(("a", 1), b"content", pixels + 1e-15),
    }
    assert len(others | {first}) == 4


def test_a_fingerprint_never_changes():
    assert fingerprint(("a", 1), b"\x00") == "9eda58e199b8d8ee4c7117f593694540"
