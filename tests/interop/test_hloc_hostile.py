# SPDX-License-Identifier: BSD-3-Clause
"""hloc's files that hold what no extractor writes."""

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.interop import MatchedImage, MatchedPair, MatchGraph
from epi360.interop.hloc import read_hloc, write_hloc

h5py = pytest.importorskip("h5py")

NAMES = FIRST, SECOND = "hall/1.jpg", "hall/2.jpg"


@pytest.fixture
def files(tmp_path):
    """Features and matches of two panoramas."""
    images = {name: MatchedImage(name, "pano", np.ones((3, 2))) for name in NAMES}
    pair = MatchedPair(FIRST, SECOND, np.array([[0, 1]]))
    paths = tmp_path / "features.h5", tmp_path / "matches.h5"
    write_hloc(*paths, MatchGraph({"pano": Equirectangular(1024, 512)}, images, (pair,)))
    return paths


def test_a_file_that_holds_itself_comes_to_an_end(files):
    with h5py.File(files[0], "a") as file:
        file["hall/loop"] = file["/"]
        file["hall/link"] = h5py.SoftLink("/")
    assert list(read_hloc(*files).images) == list(NAMES)


@pytest.mark.parametrize("size", [2 * 10**8, 10**12])
def test_a_small_file_that_claims_a_huge_table_is_refused_before_it_is_read(files, size):
    with h5py.File(files[0], "a") as file:
        del file[FIRST]["keypoints"]
        file[FIRST].create_dataset("keypoints", shape=(size, 2), chunks=(1000, 2), dtype="f4")
    with pytest.raises(ValueError, match=f"{FIRST}/keypoints must be a dataset of .* at most"):
        read_hloc(*files)


def test_a_type_in_place_of_a_table_is_refused(files):
    with h5py.File(files[0], "a") as file:
        del file[FIRST]["image_size"]
        file[FIRST]["image_size"] = np.dtype("f4")
    with pytest.raises(ValueError, match=f"{FIRST}/image_size must be a dataset"):
        read_hloc(*files)


@pytest.mark.parametrize("size", [(np.inf, 512), (np.nan, 512), (1e300, 1), (0, 5)])
def test_an_image_size_that_is_none_is_refused(files, size):
    with h5py.File(files[0], "a") as file:
        del file[FIRST]["image_size"]
        file[FIRST]["image_size"] = np.array(size)
    with pytest.raises(ValueError, match=f"image_size of {FIRST} must be width and height, got"):
        read_hloc(*files)


@pytest.mark.parametrize("name", ["./a.jpg", "a//b.jpg", "/a.jpg", "."])
def test_a_name_that_hdf5_would_change_is_refused(tmp_path, name):
    graph = MatchGraph({}, {name: MatchedImage(name, None, np.ones((1, 2)))}, ())
    with pytest.raises(ValueError, match="cannot stand in hloc's files"):
        write_hloc(tmp_path / "f.h5", tmp_path / "m.h5", graph)
    assert not list(tmp_path.iterdir())
