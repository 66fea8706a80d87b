# SPDX-License-Identifier: BSD-3-Clause
import json

import pytest


@pytest.fixture
def written(tmp_path):
    """Function that writes text, or anything else as JSON, to a file and returns its path."""

    def write(text, name="calibration.txt"):
        path = tmp_path / name
        path.write_text(text if isinstance(text, str) else json.dumps(text), encoding="utf-8")
        return path

    return write
