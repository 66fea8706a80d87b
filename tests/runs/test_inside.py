# SPDX-License-Identifier: BSD-3-Clause
"""Names from files of other people stay in the folder that is written."""

from pathlib import Path

import pytest

from epi360.runs.inside import inside


@pytest.mark.parametrize("name", ["a.jpg", "sub/ä b.jpg", "a..b/..c.jpg", "./a.jpg", "~/a.jpg"])
def test_a_name_below_the_folder_is_a_path_in_it(name):
    assert inside(Path("out"), name) == Path("out") / name


@pytest.mark.parametrize(
    "name", ["/abs/x.png", "../x.png", "sub/../../x.png", "sub/../x.png", "..", "", ".", "a\0b.png"]
)
def test_a_name_that_leads_out_is_an_error(name):
    with pytest.raises(ValueError, match="leads out of out"):
        inside(Path("out"), name)


def test_a_link_that_leads_out_is_an_error(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    (tmp_path / "precious.jpg").write_text("precious")
    (folder / "face.jpg").symlink_to(tmp_path / "precious.jpg")
    (folder / "sub").symlink_to(tmp_path)
    for name in ("face.jpg", "sub/precious.jpg", "sub/new.jpg"):
        with pytest.raises(ValueError, match=r"leads out of .*a link leads to"):
            inside(folder, name)


def test_the_folder_itself_may_be_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    assert inside(tmp_path / "out", "a.jpg") == tmp_path / "out" / "a.jpg"


def test_a_long_name_is_shortened_in_the_message():
    with pytest.raises(ValueError) as error:
        inside(Path("out"), "/" + "x" * 5000)
    assert len(str(error.value)) < 300
