# SPDX-License-Identifier: BSD-3-Clause
"""Names from files of other people stay in the folder that is written."""

from pathlib import Path

import pytest

from epi360.runs.inside import inside


@pytest.mark.parametrize("name", ["a.jpg", "sub/ä b.jpg", "a..b/..c.jpg", "./a.jpg", "~/a.jpg"])
def test_a_name_below_the_folder_is_a_path_in_it(name):
    assert inside(Path("out"), name) == Path("out") / name


@pytest.mark.parametrize(
    "name", ["/abs/x.png", "../x.png", "sub/../../x.png", "sub/../x.png", "..", "", "."]
)
def test_a_name_that_leads_out_is_an_error(name):
    with pytest.raises(ValueError, match="leads out of out"):
        inside(Path("out"), name)
