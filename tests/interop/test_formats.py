# SPDX-License-Identifier: BSD-3-Clause
"""Which tool a file belongs to."""

from typing import get_args

import pytest

from epi360.cli.convert import FormatName
from epi360.interop.formats import FORMATS, colmap_model_folder, format_of_file, format_of_name


def test_the_command_line_knows_every_format():
    assert get_args(FormatName) == tuple(FORMATS)


@pytest.mark.parametrize(
    ("content", "name"),
    [
        (b"SQLite format 3\0rest", "colmap-database"),
        (b"\x89HDF\r\n\x1a\nrest", "hloc"),
        (b'\n [{"cameras"', "opensfm"),
        (b'\xef\xbb\xbf{"frames"', "nerfstudio"),
        (b'{ "cameras": {}, "shots"', "opensfm"),
        (b'{"camera_model": "PINHOLE"', "nerfstudio"),
        (b"# timestamp\n\n0.5 1 2 3 0 0 0 1\n", "tum"),
    ],
)
def test_the_format_is_found_from_the_content(tmp_path, content, name):
    path = tmp_path / "file"
    path.write_bytes(content)
    assert format_of_file(path) == name


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("a.DB", "colmap-database"), ("m.h5", "hloc"), ("t.tum", "tum"), ("t.txt", "tum"),
        ("transforms_train.json", "nerfstudio"), ("reconstruction.meshed.json", "opensfm"),
        ("sparse/0", "colmap"), ("my_reconstruction.json", "opensfm"),
    ],
)  # fmt: skip
def test_the_format_is_found_from_the_name(file, name):
    assert format_of_name(file) == name


def test_a_folder_with_a_dot_is_a_model(tmp_path):
    (tmp_path / "sparse.v2").mkdir()
    assert format_of_name(tmp_path / "sparse.v2") == "colmap"


@pytest.mark.parametrize("text", ["", "# nothing\n", "1 2 3 4 5 6 7\n", "a b c d e f g h\n"])
def test_other_text_is_no_trajectory(tmp_path, text):
    path = tmp_path / "table.txt"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"table.txt is no file that can be converted.*matches$"):
        format_of_file(path)


@pytest.mark.parametrize("name", ["matches.npz", "MATCHES.PT"])
def test_who_has_arrays_of_matches_is_told_what_to_do_with_them(tmp_path, name):
    (tmp_path / name).write_bytes(b"PK\x03\x04")
    with pytest.raises(ValueError, match="'Matches of your own' in docs/existing_project.md"):
        format_of_file(tmp_path / name)


def test_a_folder_with_a_reconstruction_is_a_project_of_opensfm(tmp_path):
    (tmp_path / "reconstruction.json").write_text("[]")
    assert format_of_file(tmp_path) == "opensfm-folder"


def test_the_model_of_a_folder_is_itself_or_its_first_one(tmp_path):
    assert colmap_model_folder(tmp_path) is None
    first = tmp_path / "sparse" / "0"
    first.mkdir(parents=True)
    (first / "images.bin").write_bytes(b"")
    assert colmap_model_folder(tmp_path) == colmap_model_folder(first) == first
    assert format_of_file(tmp_path) == "colmap"
    (tmp_path / "images.txt").write_text("")
    assert colmap_model_folder(tmp_path) == tmp_path


def test_a_folder_without_a_model_is_no_reconstruction(tmp_path):
    with pytest.raises(ValueError, match="must hold a COLMAP model"):
        format_of_file(tmp_path)
