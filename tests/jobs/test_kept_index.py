# SPDX-License-Identifier: BSD-3-Clause
"""The index over a map's images is kept beside the map, and never needed."""

import os

import numpy as np
import pytest
from written_map import COUNT, write_map

import epi360
from epi360.jobs.localization.kept_index import INDEX_FILE
from epi360.jobs.localization.view_index import ViewIndex
from epi360.runs.arrays import npz_bytes, read_arrays

h5py = pytest.importorskip("h5py")


@pytest.fixture
def folder(tmp_path):
    write_map(tmp_path)
    return tmp_path


@pytest.fixture
def made(monkeypatch):
    """How often an index was made."""
    calls, make = [], ViewIndex.of

    def counted(descriptors):
        calls.append(1)
        return make(descriptors)

    monkeypatch.setattr(ViewIndex, "of", counted)
    return calls


def pose(folder):
    world = epi360.load_map(folder, features=folder / "features.h5")
    result = epi360.localize_image(folder / "new" / "new.png", world)
    assert result.success
    return result.cam_from_world.matrix()


def test_the_second_run_uses_the_index_of_the_first(folder, made):
    before = pose(folder)
    kept = (folder / INDEX_FILE).read_bytes()
    np.testing.assert_array_equal(pose(folder), before)
    assert len(made) == 1 and (folder / INDEX_FILE).read_bytes() == kept
    assert not list(folder.glob(".epi360-*"))


def test_an_index_of_other_features_is_made_again(folder, made):
    pose(folder)
    with h5py.File(folder / "features.h5", "a") as file:
        group = file.create_group("another.png")
        group["keypoints"] = np.zeros((COUNT, 2), np.float32)
        group["descriptors"] = np.ones((128, COUNT), np.float32)
    pose(folder)
    pose(folder)
    assert len(made) == 2


def test_an_index_of_another_model_is_made_again(folder, made):
    from epi360.interop import read_colmap_model, write_colmap_model

    pose(folder)
    model = read_colmap_model(folder / "sparse" / "0")
    images = (*model.images[1:], model.images[0])
    seen = model.observations
    turned = type(seen)(seen.points, (seen.images + 2) % 3, seen.pixels)
    changed = type(model)(model.cameras, images, model.points, model.colors, turned)
    write_colmap_model(folder / "sparse" / "0", changed)
    pose(folder)
    assert len(made) == 2


def damaged(arrays):
    yield b"no archive"
    yield npz_bytes(arrays)[:-40]
    yield npz_bytes({name: each for name, each in arrays.items() if name != "words"})
    for name in set(arrays) - {"key"}:
        yield npz_bytes({**arrays, name: arrays[name][:-1]})
        yield npz_bytes({**arrays, name: arrays[name].astype(np.float64)[None]})
    yield npz_bytes({**arrays, "numbers": arrays["numbers"] + 1})
    yield npz_bytes({**arrays, "numbers": -arrays["numbers"] - 1})
    yield npz_bytes({**arrays, "ends": arrays["ends"][::-1]})
    yield npz_bytes({**arrays, "image_words": arrays["image_words"] + np.uint16(9000)})
    yield npz_bytes({**arrays, "image_signs": arrays["image_signs"][:, :3]})


def test_a_damaged_index_is_made_again(folder, made):
    path = folder / INDEX_FILE
    before = pose(folder)
    arrays = read_arrays(path)
    contents = list(damaged(arrays))
    for count, content in enumerate(contents, start=2):
        path.write_bytes(content)
        np.testing.assert_array_equal(pose(folder), before)
        assert len(made) == count
    assert path.read_bytes() == npz_bytes(arrays)


def test_the_index_is_done_without_where_it_cannot_be_written(folder, made):
    """Not even root writes a file in place of a folder."""
    (folder / INDEX_FILE).mkdir()
    pose(folder)
    pose(folder)
    assert len(made) == 2 and not any((folder / INDEX_FILE).iterdir())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="has no pipes")
def test_a_pipe_in_its_place_is_not_waited_for(folder, made):
    os.mkfifo(folder / INDEX_FILE)
    pose(folder)
    assert len(made) == 1
