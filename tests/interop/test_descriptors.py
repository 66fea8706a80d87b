# SPDX-License-Identifier: BSD-3-Clause
"""Descriptors on their way between epi360, COLMAP and hloc."""

import dataclasses

import numpy as np
import pytest
from colmap_graphs import panoramas_of_points

from epi360.features.detection import root_sift
from epi360.features.matching import rounded_descriptors
from epi360.interop.descriptors import colmap_descriptors, stored_descriptors, unit_descriptors


def sift_bytes(rng, count=200):
    """Descriptors like SIFT's: few large numbers, most small."""
    return np.minimum(rng.gamma(0.6, 30.0, (count, 128)), 255).astype(np.uint8)


def with_descriptors(graph, make):
    images = {
        name: dataclasses.replace(image, descriptors=make(len(image.keypoints)))
        for name, image in graph.images.items()
    }
    return dataclasses.replace(graph, images=images)


def test_root_sift_in_colmaps_bytes_is_off_by_half_a_step_at_most():
    values = root_sift(sift_bytes(np.random.default_rng(0)))
    kind, stored = colmap_descriptors(values)
    assert kind == 0 and stored.dtype == np.uint8
    below = values < 255.5 / 512
    assert below.mean() > 0.999
    np.testing.assert_allclose((stored / 512)[below], values[below], atol=0.5 / 512 + 1e-6)


def test_sift_in_bytes_and_floats_of_networks_are_kept_to_the_last_bit():
    rng = np.random.default_rng(1)
    for descriptors in (
        sift_bytes(rng).astype(np.float32),
        rng.normal(size=(50, 256)).astype(np.float32),
        rng.normal(size=(50, 128)).astype(np.float32),  # ALIKED's length
    ):
        kind, stored = colmap_descriptors(descriptors)
        np.testing.assert_array_equal(stored_descriptors(kind, stored), descriptors)


def test_a_database_keeps_sift_as_pycolmap_reads_it(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    from epi360.interop import read_colmap_database, write_colmap_database

    rng = np.random.default_rng(2)
    graph = with_descriptors(panoramas_of_points(3)[1], lambda n: root_sift(sift_bytes(rng, n)))
    write_colmap_database(tmp_path / "a.db", graph)
    with pycolmap.Database.open(tmp_path / "a.db") as database:
        first = database.read_descriptors(1)
        assert first.type == pycolmap.FeatureExtractorType.SIFT
        assert first.data.shape == (200, 128) and first.data.dtype == np.uint8
    again = read_colmap_database(tmp_path / "a.db", with_descriptors=True)
    for name, image in graph.images.items():
        found = unit_descriptors(again.images[name].descriptors)
        assert np.einsum("nd,nd->n", found, image.descriptors).min() > 0.999


def test_descriptors_are_asked_for_one_image_at_a_time(tmp_path):
    pytest.importorskip("pycolmap")
    from epi360.interop import read_colmap_database, write_colmap_database

    _, graph = panoramas_of_points(3)
    asked = []

    def descriptors(name):
        asked.append(name)
        return None if len(asked) == 2 else np.full((200, 64), 0.125, np.float32)

    write_colmap_database(tmp_path / "a.db", graph, descriptors=descriptors)
    assert asked == list(graph.images)
    found = read_colmap_database(tmp_path / "a.db", with_descriptors=True).images
    assert [image.descriptors is None for image in found.values()] == [False, True, False]


def test_hloc_keeps_what_is_matched_in_half_precision(tmp_path):
    h5py = pytest.importorskip("h5py")
    from epi360.interop import read_hloc, write_hloc

    rng = np.random.default_rng(3)
    graph = with_descriptors(
        panoramas_of_points(2)[1], lambda n: rounded_descriptors(root_sift(sift_bytes(rng, n)))
    )
    files = tmp_path / "features.h5", tmp_path / "matches.h5"
    write_hloc(*files, graph)
    with h5py.File(files[0]) as file:
        stored = file[next(iter(graph.images))]["descriptors"]
        assert stored.shape == (128, 200) and stored.dtype == np.float16
    again = read_hloc(*files, with_descriptors=True)
    for name, image in graph.images.items():
        np.testing.assert_array_equal(again.images[name].descriptors, image.descriptors)


def test_descriptors_go_from_hloc_to_a_database_and_back(tmp_path):
    pytest.importorskip("pycolmap")
    pytest.importorskip("h5py")
    from epi360.interop import read_colmap_database, read_hloc, write_colmap_database, write_hloc

    rng = np.random.default_rng(4)
    graph = with_descriptors(panoramas_of_points(2)[1], lambda n: root_sift(sift_bytes(rng, n)))
    write_colmap_database(tmp_path / "a.db", graph)
    stored = read_colmap_database(tmp_path / "a.db", with_descriptors=True)
    files = tmp_path / "features.h5", tmp_path / "matches.h5"
    write_hloc(*files, stored)
    for name, image in read_hloc(*files, with_descriptors=True).images.items():
        lengths = np.linalg.norm(image.descriptors, axis=1)  # as hloc has them, not up to 255
        np.testing.assert_allclose(lengths, 1.0, atol=0.01)
        assert np.einsum("nd,nd->n", image.descriptors, graph.images[name].descriptors).min() > 0.99
