# SPDX-License-Identifier: BSD-3-Clause
"""Shared fixtures."""

import os
from pathlib import Path

import pytest

DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real image pairs, or a skip where they are not there."""
    folder = Path(os.environ.get("EPI360_DATA", DEFAULT_DATA))
    if not folder.is_dir():
        pytest.skip(f"real image pairs are not at {folder}; set EPI360_DATA to run this test")
    return folder.resolve()
