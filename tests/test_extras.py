# SPDX-License-Identifier: BSD-3-Clause
"""Libraries of extras: one that is missing says how to get it, one that is broken what is wrong."""

import pytest

from epi360.extras import extra_library


def test_a_library_that_is_missing_says_how_to_get_it():
    with pytest.raises(ImportError, match="^views need no_such_library: pip install"):
        extra_library("no_such_library.part", extra="x", purpose="views")


@pytest.mark.parametrize("reason", ["import no_such_part_of_it", "raise ImportError('no codec')"])
def test_a_library_that_is_broken_says_why(tmp_path, monkeypatch, reason):
    (tmp_path / "broken_library.py").write_text(reason)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match="which is there but cannot be loaded: (No module|no co)"):
        extra_library("broken_library", extra="x", purpose="views")
