# SPDX-License-Identifier: BSD-3-Clause
"""A large match folder is loaded within the memory of its files, and holds what was written."""

import tracemalloc

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.jobs.folder.image_set import ImageSet, SourceImage
from epi360.jobs.mapping.map_pairs import without_doubtful
from epi360.jobs.matching.match_result import load_matches, write_index
from epi360.jobs.records.match_store import FEATURES, PAIRS, Verdict, VerifiedPair, write_part
from epi360.poses import Pose, rotation_from_vector
from epi360.runs import arrays as npz
from epi360.runs.arrays import npz_bytes

NUM_IMAGES, NUM_KEYPOINTS, NUM_MATCHES = 40, 300, 200
NAMES = [f"{number}.jpg" for number in range(NUM_IMAGES)]
ENDS = [(a, b) for a in range(NUM_IMAGES) for b in range(a + 1, NUM_IMAGES)]


def verified(row, first, second):
    rng = np.random.default_rng(row)
    pose = Pose(rotation_from_vector(rng.normal(size=3)), np.array([0.0, 0.6, 0.8]))
    status = "ok" if row % 3 else "too_few_inliers"
    verdict = Verdict(status=status, cam2_from_cam1=pose, warnings=("a long sentence" * 9,))
    matches = rng.integers(0, NUM_KEYPOINTS, (NUM_MATCHES, 2))
    return VerifiedPair((f"k{first}", f"k{second}"), verdict, matches, rng.random(200) < 0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("matches")
    for part in (FEATURES, PAIRS):
        (folder / part).mkdir()
    rng = np.random.default_rng(0)
    for number in range(NUM_IMAGES):
        pixels = rng.uniform(0, 30, (NUM_KEYPOINTS, 2)).astype(np.float32)
        colors = np.zeros((NUM_KEYPOINTS, 3), np.uint8)
        content = npz_bytes({"pixels": pixels, "colors": colors})
        (folder / FEATURES / f"k{number}.npz").write_bytes(content)
    made = [verified(row, *ends) for row, ends in enumerate(ENDS)]
    for start in range(0, len(made), 60):
        write_part(folder, made[start : start + 60])
    images = tuple(SourceImage(name, folder / name, "c") for name in NAMES)
    keys = {name: f"k{number}" for number, name in enumerate(NAMES)}
    named = [(NAMES[a], NAMES[b]) for a, b in ENDS]
    write_index(folder, ImageSet(folder, {"c": Equirectangular(64, 32)}, images), keys, named)
    return folder


def test_every_pair_has_what_was_written(folder):
    graph = load_matches(folder)
    assert list(graph.images) == NAMES
    assert len(graph.pairs) == len(ENDS)
    for row in (0, 1, 59, 60, len(ENDS) - 1):
        pair, written = graph.pairs[row], verified(row, *ENDS[row])
        assert (pair.image1, pair.image2) == tuple(NAMES[index] for index in ENDS[row])
        np.testing.assert_array_equal(pair.matches, written.matches)
        assert pair.matches.dtype == np.int64
        np.testing.assert_array_equal(pair.geometry.inliers, written.matches[written.inlier_mask])
        assert pair.geometry.status == written.verdict.status
        np.testing.assert_array_equal(
            pair.geometry.cam2_from_cam1.matrix(), written.verdict.cam2_from_cam1.matrix()
        )


def test_pairs_are_a_sequence(folder):
    pairs = load_matches(folder).pairs
    names = [(pair.image1, pair.image2) for pair in pairs]
    assert [(pair.image1, pair.image2) for pair in pairs[-3:]] == names[-3:]
    assert (pairs[-1].image1, pairs[-1].image2) == names[-1]
    with pytest.raises(IndexError):
        pairs[len(pairs)]


def test_pairs_take_little_more_memory_than_their_matches_in_16_bits(folder):
    tracemalloc.start()
    try:
        graph = load_matches(folder)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A pair: 1000 bytes of matches and mask, about 300 of pose and names. An image: 2400 bytes.
    # Matches and inliers in 64 bits alone would be 4800.
    assert held < 2000 * len(graph.pairs)


def test_each_file_is_read_once(folder, monkeypatch):
    read = []
    from epi360.jobs.matching import match_result
    from epi360.jobs.records import match_store

    for module in (match_result, match_store):
        monkeypatch.setattr(
            module, "read_arrays", lambda path: read.append(path) or npz.read_arrays(path)
        )
    graph = load_matches(folder)
    assert sum(len(pair.matches) for pair in graph.pairs) == NUM_MATCHES * len(ENDS)
    assert len(read) == len(set(read)) == NUM_IMAGES + -(-len(ENDS) // 60)


def test_pairs_that_a_map_leaves_out_are_not_made_again(folder):
    graph = load_matches(folder)

    class Matched:
        verdicts = ()

    kept = without_doubtful(graph, Matched).pairs
    assert len(kept) == len(ENDS)
    np.testing.assert_array_equal(kept[7].matches, graph.pairs[7].matches)
