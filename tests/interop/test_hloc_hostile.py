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


@pytest.mark.parametrize("way", ["link", "external", "virtual"])
def test_data_in_another_file_are_not_read(files, way, tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes(np.ones(2, np.int64).tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["size"] = np.array([1024, 512])
    with h5py.File(files[0], "a") as file:
        group = file[FIRST]
        del group["image_size"]
        if way == "link":
            group["image_size"] = h5py.ExternalLink("other.h5", "/size")
        elif way == "external":
            place = [(str(secret), 0, 16)]
            group.create_dataset("image_size", (2,), np.int64, external=place)
        else:
            layout = h5py.VirtualLayout((2,), np.int64)
            layout[:] = h5py.VirtualSource("other.h5", "size", shape=(2,))
            group.create_virtual_dataset("image_size", layout)
    with pytest.raises(ValueError, match=f"{FIRST}/image_size lies in another file"):
        read_hloc(*files)


@pytest.mark.parametrize("kind", [np.dtype("f4"), np.float32(1)])
def test_key_points_that_are_no_table_are_refused(files, kind):
    from epi360.interop.hloc_pairs import HlocPairs

    with h5py.File(files[0], "a") as file:
        del file[SECOND]["keypoints"]
        file[SECOND]["keypoints"] = kind
    with pytest.raises(ValueError, match="is damaged"), HlocPairs(*files) as pairs:
        pairs.matches(FIRST, SECOND)
