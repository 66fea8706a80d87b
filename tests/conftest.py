# SPDX-License-Identifier: BSD-3-Clause
"""Shared fixtures."""

import os
import signal
from pathlib import Path

import pytest

# A job in the background ignores Ctrl-C, and so would every program that the tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

DEFAULT_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real image pairs, or a skip where they are not there."""
    folder = Path(os.environ.get("EPI360_DATA", DEFAULT_DATA))
    if not folder.is_dir():
        pytest.skip(f"real image pairs are not at {folder}; set EPI360_DATA to run this test")
    return folder.resolve()


@pytest.fixture(scope="session")
def room_folder(tmp_path_factory):
    """A folder of panoramas of a rendered room, and their true poses by name."""
    from mapped_room import write_room

    folder = tmp_path_factory.mktemp("room") / "images"
    return folder, write_room(folder)


@pytest.fixture(scope="session")
def room_run(room_folder, tmp_path_factory):
    """Output folder of the map of that room, and what the run returned."""
    from epi360.jobs.folder.image_set import find_images
    from epi360.jobs.mapping.map_folder import MapOptions, map_images
    from epi360.jobs.matching.match_folder import MatchOptions

    output = tmp_path_factory.mktemp("run") / "out"
    options = MapOptions(MatchOptions(num_threads=1), mapper_threads=1)
    return output, map_images(find_images(room_folder[0]), output, options)


@pytest.fixture(scope="session")
def ray_session():
    """Address of a Ray of two CPUs that all tests share: its start takes the longest."""
    ray = pytest.importorskip("ray")
    if not Path("/proc/self/stat").exists():
        pytest.skip("finds Ray's workers in /proc")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    quiet = {"include_dashboard": False, "log_to_driver": False, "logging_level": "CRITICAL"}
    session = ray.init(address="local", num_cpus=2, object_store_memory=80 * 2**20, **quiet)
    yield session.address_info["gcs_address"]
    ray.shutdown()
