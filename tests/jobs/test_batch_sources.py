# SPDX-License-Identifier: BSD-3-Clause
"""What the inputs of a batch are read into: names, bearings, parts, fingerprints."""

import hashlib
import shutil

import numpy as np
import pytest
from batch_inputs import columns_of, scenes, write_matches

from epi360 import Equirectangular
from epi360.jobs.batch.inputs import check_names, open_matches
from epi360.jobs.batch.sources import MatchSource, PairMatches, kind_of, pair_seed, parts_of

pyarrow = pytest.importorskip("pyarrow")

CAMERA = Equirectangular(width=1024, height=512)
YAML = '{"model": "Equirectangular", "width": 1024, "height": 512}'


def parts_in(source, parts=None) -> list[PairMatches]:
    with open_matches(source) as matches:
        wanted = range(len(matches.part_sizes)) if parts is None else parts
        return list(matches.read(list(wanted)))


def fingerprint_of(source) -> str:
    with open_matches(source) as matches:
        return matches.fingerprint


def test_the_seed_of_a_pair_is_the_start_of_a_hash_and_never_changes():
    text = b"7 5 7 a.jpgb\xc3\xa4.jpg"  # seed, bytes of both names
    expected = int(hashlib.sha256(text).hexdigest()[:16], 16)
    assert pair_seed(7, "a.jpg", "bä.jpg") == expected
    assert pair_seed(0, "a", "b") == 0x084B1EBDB00D193A  # the same on every machine


def test_seeds_of_other_pairs_are_others():
    pairs = [("a", "b"), ("b", "a"), ("ab", ""), ("", "ab"), ("a ", "b"), ("a", " b")]
    assert len({pair_seed(seed, *pair) for seed in (0, 1, -1) for pair in pairs}) == 18


@pytest.mark.parametrize(
    ("num_pairs", "size", "expected"),
    [(7, 3, [(0, 3), (3, 6), (6, 7)]), (6, 3, [(0, 3), (3, 6)]), (2, 9, [(0, 2)]), (0, 3, [])],
)
def test_parts_cover_all_pairs_once(num_pairs, size, expected):
    assert [(part.start, part.stop) for part in parts_of(num_pairs, size)] == expected


def test_a_part_is_a_row_group_and_large_ones_are_cut(tmp_path):
    columns = columns_of(12)
    path = write_matches(tmp_path / "in.parquet", columns, row_group_size=5)
    whole = parts_in(MatchSource("parquet", str(path)))
    assert [(part.first_row, len(part)) for part in whole] == [(0, 5), (5, 5), (10, 2)]
    cut = parts_in(MatchSource("parquet", str(path), pairs_per_part=2))
    assert [(part.first_row, len(part)) for part in cut] == [
        (0, 2), (2, 2), (4, 1), (5, 2), (7, 2), (9, 1), (10, 2),
    ]  # fmt: skip
    for parts in (whole, cut):
        assert [name for part in parts for name in part.image2] == columns["image2"]
        for view in ("bearings1", "bearings2"):
            arrays = [array for part in parts for array in getattr(part, view)]
            for array, scene in zip(arrays, scenes(12), strict=True):
                np.testing.assert_array_equal(array, getattr(scene, view))


@pytest.mark.parametrize("wanted", [[3], [0, 6], [1, 2, 5], []])
def test_some_parts_are_read_without_the_others(tmp_path, wanted):
    path = write_matches(tmp_path / "in.parquet", columns_of(12), row_group_size=5)
    source = MatchSource("parquet", str(path), pairs_per_part=2)
    everything = parts_in(source)
    some = parts_in(source, wanted)
    assert [part.image1 for part in some] == [everything[index].image1 for index in wanted]
    assert [part.first_row for part in some] == [everything[index].first_row for index in wanted]


NUMBER = pyarrow.float64()
KINDS = {
    "flat": pyarrow.list_(NUMBER),
    "large": pyarrow.large_list(NUMBER),
    "single precision": pyarrow.list_(pyarrow.float32()),
    "lists of three": pyarrow.list_(pyarrow.list_(NUMBER, 3)),
    "lists of lists": pyarrow.large_list(pyarrow.list_(NUMBER)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_lists_may_be_flat_or_nested_and_of_any_precision(tmp_path, kind):
    columns = columns_of(4)
    is_nested = "lists of" in kind
    if is_nested:
        for name in ("bearings1", "bearings2"):
            columns[name] = [np.reshape(row, (-1, 3)).tolist() for row in columns[name]]
    text = pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
    schema = pyarrow.schema(
        {"image1": text, "image2": text, "bearings1": KINDS[kind], "bearings2": KINDS[kind]}
    )
    path = write_matches(tmp_path / "in.parquet", columns, schema=schema)
    (first, second) = parts_in(MatchSource("parquet", str(path), pairs_per_part=3))
    assert first.image1 == ["a/0.jpg", "a/1.jpg", "a/2.jpg"]
    tolerance = 1e-7 if kind == "single precision" else 0.0
    for array, scene in zip([*first.bearings2, *second.bearings2], scenes(4), strict=True):
        np.testing.assert_allclose(array, scene.bearings2, rtol=0, atol=tolerance)


def pixel_columns(camera1, camera2):
    made = scenes(3)
    return {
        "image1": [f"left/{k}.jpg" for k in range(3)],
        "image2": [f"right/sub/{k}.jpg" for k in range(3)],
        "pixels1": [camera1.pixels_from_bearings(scene.bearings1).tolist() for scene in made],
        "pixels2": [
            camera2.pixels_from_bearings(scene.bearings2).ravel().tolist() for scene in made
        ],
    }


def test_pixels_become_bearings_by_the_camera_of_the_top_folder(tmp_path):
    other = Equirectangular(width=2000, height=1000)
    (tmp_path / "cameras.yaml").write_text(
        f"cameras: {{left: {YAML}, right: {{model: Equirectangular, width: 2000, height: 1000}}}}"
    )
    path = write_matches(tmp_path / "in.parquet", pixel_columns(CAMERA, other))
    (part,) = parts_in(MatchSource("parquet", str(path), str(tmp_path / "cameras.yaml")))
    for k, scene in enumerate(scenes(3)):
        np.testing.assert_allclose(part.bearings1[k], scene.bearings1, atol=1e-12)
        np.testing.assert_allclose(part.bearings2[k], scene.bearings2, atol=1e-12)


def test_one_camera_of_several_is_that_of_all_images(tmp_path):
    other = "{model: Equirectangular, width: 2000, height: 1000}"
    (tmp_path / "cameras.yaml").write_text(f"cameras: {{one: {other}, two: {YAML}}}")
    path = write_matches(tmp_path / "in.parquet", pixel_columns(CAMERA, CAMERA))
    camera = str(tmp_path / "cameras.yaml")
    (part,) = parts_in(MatchSource("parquet", str(path), f"{camera}:two"))
    for k, scene in enumerate(scenes(3)):
        np.testing.assert_allclose(part.bearings1[k], scene.bearings1, atol=1e-12)
        np.testing.assert_allclose(part.bearings2[k], scene.bearings2, atol=1e-12)
    with pytest.raises(ValueError, match="has no camera 'three'; it holds one, two"):
        parts_in(MatchSource("parquet", str(path), f"{camera}:three"))


def test_the_middle_of_a_panorama_is_ahead_and_its_border_behind(tmp_path):
    (tmp_path / "camera.yaml").write_text(YAML)
    columns = {"image1": ["a"], "image2": ["b"]}
    columns |= {"pixels1": [[512.0, 256.0]], "pixels2": [[0.0, 256.0]]}
    path = write_matches(tmp_path / "in.parquet", columns)
    (part,) = parts_in(MatchSource("parquet", str(path), str(tmp_path / "camera.yaml")))
    np.testing.assert_allclose(part.bearings1[0], [[0.0, 0.0, 1.0]], atol=1e-12)
    np.testing.assert_allclose(part.bearings2[0], [[0.0, 0.0, -1.0]], atol=1e-12)


@pytest.mark.parametrize("num_pixels", [49, 50])
def test_many_pixels_outside_of_the_picture_are_refused(tmp_path, num_pixels):
    (tmp_path / "camera.yaml").write_text(YAML)
    inside = np.random.default_rng(0).uniform(0.0, [CAMERA.width, CAMERA.height], (num_pixels, 2))
    larger = 2.0 * inside
    columns = {"image1": ["a"], "image2": ["b"]}
    columns |= {"pixels1": [inside.ravel().tolist()], "pixels2": [larger.ravel().tolist()]}
    path = write_matches(tmp_path / "in.parquet", columns)
    source = MatchSource("parquet", str(path), str(tmp_path / "camera.yaml"))
    if num_pixels < 50:
        assert len(parts_in(source)) == 1
    else:
        with pytest.raises(ValueError, match="key points of b lie outside its .* larger picture"):
            parts_in(source)


def test_missing_matches_are_nan_rows(tmp_path):
    columns = columns_of(2)
    columns["bearings1"][0][3:6] = [np.nan, 0.0, 0.0]
    columns["bearings1"][0][6:9] = [None, None, None]
    path = write_matches(tmp_path / "in.parquet", columns)
    (part,) = parts_in(MatchSource("parquet", str(path)))
    assert np.flatnonzero(np.isnan(part.bearings1[0]).any(axis=1)).tolist() == [1, 2]


def test_the_fingerprint_is_that_of_the_content(tmp_path):
    columns = columns_of(6)
    path = write_matches(tmp_path / "in.parquet", columns)
    source = MatchSource("parquet", str(path))
    first = fingerprint_of(source)
    copy = MatchSource("parquet", str(shutil.copy(path, tmp_path / "copy.parquet")))
    assert fingerprint_of(copy) == first
    columns["bearings1"][3][7] += 1e-9
    write_matches(path, columns)
    assert fingerprint_of(source) != first
    columns["image1"][3] = "a/9.jpg"
    others = {first, fingerprint_of(source)}
    write_matches(path, columns)
    assert fingerprint_of(source) not in others


def test_the_fingerprint_of_pixels_is_also_that_of_the_camera(tmp_path):
    path = write_matches(tmp_path / "in.parquet", pixel_columns(CAMERA, CAMERA))
    (tmp_path / "camera.yaml").write_text(YAML)
    source = MatchSource("parquet", str(path), str(tmp_path / "camera.yaml"))
    first = fingerprint_of(source)
    (tmp_path / "camera.yaml").write_text(f"# the same\n{YAML}\n")
    assert fingerprint_of(source) == first
    (tmp_path / "camera.yaml").write_text(YAML.replace("1024", "2048").replace("512", "1024"))
    assert fingerprint_of(source) != first


@pytest.mark.parametrize(
    ("start", "kind"),
    [(b"PAR1", "parquet"), (b"SQLite format 3\0", "colmap"), (b"\x89HDF\r\n\x1a\n", "hloc")],
)
def test_the_kind_of_an_input_is_found_by_its_first_bytes(tmp_path, start, kind):
    (tmp_path / "in").write_bytes(start + b"rest")
    assert kind_of(str(tmp_path / "in")) == kind


class Named:
    """An input that has nothing but names."""

    def __init__(self, *batches):
        self.batches = batches

    def names(self):
        return iter(self.batches)


def test_a_pair_of_an_image_with_itself_is_refused():
    with pytest.raises(ValueError, match="in: row 1 is a pair of b with itself"):
        check_names("in", Named((["a", "b"], ["b", "b"])))


def test_the_same_pair_twice_is_found_also_across_batches():
    matches = Named((["a", "b"], ["c", "d"]), (["a", "c"], ["x", "a"]), (["b"], ["d"]))
    with pytest.raises(ValueError, match="in: the pair b d is there twice, in rows 1 and 4"):
        check_names("in", matches)


def test_the_other_order_is_another_pair():
    both_orders = ["a", "b"], ["b", "a"]
    check_names("in", Named(both_orders))
    with pytest.raises(ValueError, match="in: the pair b a is there twice, in rows 1 and 2"):
        check_names("in", Named(both_orders, (["b"], ["a"])))


def test_no_pairs_are_an_error():
    with pytest.raises(ValueError, match="in has no pairs"):
        check_names("in", Named())
