# SPDX-License-Identifier: BSD-3-Clause
"""Arrays come back whole or not at all."""

import numpy as np

from epi360.runs.arrays import npz_bytes, read_arrays

ARRAYS = {
    "numbers": np.arange(6.0).reshape(2, 3),
    "words": np.array(["é", "ok"]),
    "none": np.zeros((0, 2), np.uint8),
}


def test_arrays_come_back(tmp_path):
    (tmp_path / "a.npz").write_bytes(npz_bytes(ARRAYS))
    found = read_arrays(tmp_path / "a.npz")
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype


def test_equal_arrays_give_equal_bytes():
    assert npz_bytes(ARRAYS) == npz_bytes({name: array.copy() for name, array in ARRAYS.items()})


def test_a_missing_file_is_none(tmp_path):
    assert read_arrays(tmp_path / "a.npz") is None


def test_no_flipped_bit_changes_an_array(tmp_path):
    data = npz_bytes(ARRAYS)
    path = tmp_path / "a.npz"
    num_refused = 0
    for place in range(len(data)):
        path.write_bytes(data[:place] + bytes([data[place] ^ (1 << place % 8)]) + data[place + 1 :])
        found = read_arrays(path)
        if found is None or set(found) != set(ARRAYS):
            num_refused += 1
            continue
        for name, array in ARRAYS.items():
            np.testing.assert_array_equal(found[name], array)
    assert num_refused > len(data) / 2


def test_a_cut_file_is_none(tmp_path):
    data = npz_bytes(ARRAYS)
    for length in range(0, len(data), 7):
        (tmp_path / "a.npz").write_bytes(data[:length])
        assert read_arrays(tmp_path / "a.npz") is None
