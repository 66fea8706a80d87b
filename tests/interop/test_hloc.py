# SPDX-License-Identifier: BSD-3-Clause
"""hloc's HDF5 files, written here by hand as hloc lays them out, and what is wrong in bad ones."""

import sys

import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt, Pinhole
from epi360.interop import MatchedImage, MatchedPair, MatchGraph
from epi360.interop.hloc import HlocPairs, read_hloc, write_hloc
from epi360.interop.pairs_file import read_pairs_file

h5py = pytest.importorskip("h5py")

LEFT, RIGHT, BACK = "rig/left/1.jpg", "rig/right/1.jpg", "zurück-2.jpg"
PANORAMA, FISHEYE = (1024, 512), (640, 480)


def add_image(path, name, keypoints, size=PANORAMA, **datasets):
    with h5py.File(path, "a", libver="latest") as file:
        group = file.create_group(name)
        group["keypoints"] = np.asarray(keypoints, np.float16)
        group["keypoints"].attrs["uncertainty"] = 1.5
        group["scores"] = np.ones(len(keypoints), np.float16)
        if size is not None:
            group["image_size"] = np.array(size)
        for key, value in datasets.items():
            group[key] = value


def add_matches(path, group, matches0):
    with h5py.File(path, "a", libver="latest") as file:
        file[f"{group}/matches0"] = np.asarray(matches0, np.int16)
        file[f"{group}/matching_scores0"] = np.ones(len(matches0), np.float16)


@pytest.fixture
def features(tmp_path):
    """Three images in folders, 3, 2 and 2 key points."""
    path = tmp_path / "features.h5"
    add_image(path, LEFT, [(0, 0), (10, 20), (300.5, 7)])
    add_image(
        path, RIGHT, [(1, 2), (3, 4)], descriptors=np.arange(8, dtype=np.float16).reshape(4, 2)
    )
    add_image(path, BACK, [(5, 6), (7, 8)], size=FISHEYE)
    return path


@pytest.fixture
def matches(tmp_path):
    """Left with right and right with back."""
    path = tmp_path / "matches.h5"
    add_matches(path, "rig-left-1.jpg/rig-right-1.jpg", [1, -1, 0])
    add_matches(path, "rig-right-1.jpg/zurück-2.jpg", [-1, -1])
    return path


def write_lines(path, *lines):
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_the_middle_of_the_first_pixel_is_half_a_pixel_from_the_corner(features, matches):
    graph = read_hloc(features, matches)
    np.testing.assert_array_equal(
        graph.images[LEFT].keypoints, [(0.5, 0.5), (10.5, 20.5), (301.0, 7.5)]
    )


def test_matches0_names_the_key_point_of_image_2(features, matches):
    graph = read_hloc(features, matches)
    assert list(graph.images) == [LEFT, RIGHT, BACK]
    first, second = graph.pairs
    assert (first.image1, first.image2) == (LEFT, RIGHT)
    np.testing.assert_array_equal(first.matches, [(0, 1), (2, 0)])
    assert (second.image1, second.image2) == (RIGHT, BACK)
    assert second.matches.shape == (0, 2)
    assert first.geometry is None


def test_descriptors_come_one_row_a_key_point(features, matches):
    images = read_hloc(features, matches, with_descriptors=True).images
    np.testing.assert_array_equal(images[RIGHT].descriptors, [(0, 2, 4, 6), (1, 3, 5, 7)])
    assert images[LEFT].descriptors is None
    assert read_hloc(features, matches).images[RIGHT].descriptors is None


@pytest.mark.parametrize(
    "group",
    [
        "rig-left-1.jpg/rig-right-1.jpg",
        "rig-left-1.jpg_rig-right-1.jpg",
        "rig-right-1.jpg/rig-left-1.jpg",
        "rig-right-1.jpg_rig-left-1.jpg",
    ],
)
def test_a_pair_is_found_under_every_name_that_hloc_gave_it(features, tmp_path, group):
    path, pairs = tmp_path / "m.h5", write_lines(tmp_path / "pairs.txt", f"{LEFT} {RIGHT}")
    in_file = [(0, 1), (2, 0)]
    if group.startswith("rig-left"):
        add_matches(path, group, [1, -1, 0])
    else:
        add_matches(path, group, [2, 0])
    (pair,) = read_hloc(features, path, pairs=pairs).pairs
    assert (pair.image1, pair.image2) == (LEFT, RIGHT)
    assert sorted(map(tuple, pair.matches.tolist())) == in_file
    (pair,) = read_hloc(features, path).pairs  # without the list: the order of the name
    assert pair.image1 == (LEFT if group.startswith("rig-left") else RIGHT)


def test_a_pairs_file_chooses_pairs_and_their_order(features, matches, tmp_path):
    pairs = write_lines(tmp_path / "pairs.txt", f"{BACK} {RIGHT}", f"{RIGHT} {BACK}")
    (pair,) = read_hloc(features, matches, pairs=pairs).pairs
    assert (pair.image1, pair.image2) == (BACK, RIGHT)


def test_one_pair_can_be_read_in_either_order(features, matches):
    with HlocPairs(features, matches) as files:
        assert files.pairs() == [(LEFT, RIGHT), (RIGHT, BACK)]
        assert files.images() == [LEFT, RIGHT, BACK]
        forward, backward = files.matches(LEFT, RIGHT), files.matches(RIGHT, LEFT)
        assert forward.dtype == np.int64
        np.testing.assert_array_equal(forward, backward[:, ::-1])
        np.testing.assert_array_equal(files.keypoints(RIGHT), [(1.5, 2.5), (3.5, 4.5)])
        assert files.image_size(BACK) == FISHEYE
        with pytest.raises(ValueError, match="has no pair"):
            files.matches(LEFT, BACK)
        with pytest.raises(ValueError, match="has no image x.jpg"):
            files.keypoints("x.jpg")
    files.close()


def test_names_that_become_one_need_the_pairs_file(tmp_path):
    features, matches = tmp_path / "f.h5", tmp_path / "m.h5"
    for name in ("a/b.jpg", "a-b.jpg", "c.jpg"):
        add_image(features, name, [(0, 0)])
    add_matches(matches, "a-b.jpg/c.jpg", [0])
    with pytest.raises(ValueError, match=r"may be the pair a-b.jpg c.jpg or a/b.jpg c.jpg; give"):
        read_hloc(features, matches)
    pairs = write_lines(tmp_path / "pairs.txt", "a/b.jpg c.jpg")
    (pair,) = read_hloc(features, matches, pairs=pairs).pairs
    assert pair.image1 == "a/b.jpg"
    write_lines(pairs, "a/b.jpg c.jpg", "a-b.jpg c.jpg")
    with pytest.raises(ValueError, match="are both called 'a-b.jpg/c.jpg'"):
        read_hloc(features, matches, pairs=pairs)


def test_underscores_in_names_are_resolved_by_the_known_names(tmp_path):
    features, matches = tmp_path / "f.h5", tmp_path / "m.h5"
    for name in ("im_1.jpg", "im_2.jpg"):
        add_image(features, name, [(0, 0)])
    add_matches(matches, "im_1.jpg_im_2.jpg", [0])
    (pair,) = read_hloc(features, matches).pairs
    assert (pair.image1, pair.image2) == ("im_1.jpg", "im_2.jpg")


def test_a_folder_may_be_called_like_a_dataset(tmp_path):
    features, matches = tmp_path / "f.h5", tmp_path / "m.h5"
    for name in ("keypoints/1.jpg", "keypoints/2.jpg"):
        add_image(features, name, [(0, 0)])
    add_matches(matches, "keypoints-1.jpg/keypoints-2.jpg", [0])
    assert len(read_hloc(features, matches).pairs) == 1


def test_a_two_to_one_image_is_a_panorama_and_others_have_no_camera(features, matches):
    graph = read_hloc(features, matches)
    assert graph.cameras == {"panorama_1024x512": Equirectangular(1024, 512)}
    assert graph.images[LEFT].camera == "panorama_1024x512"
    assert graph.images[BACK].camera is None


def test_one_camera_is_that_of_all_images_of_its_size(features, matches):
    lens = KannalaBrandt(640, 480, 300, 300, 320, 240)
    images = read_hloc(features, matches, cameras={"lens": lens}).images
    assert images[BACK].camera == "lens"
    assert images[LEFT].camera == "panorama_1024x512"


def test_several_cameras_go_by_folder_or_image_and_must_have_its_size(features, matches):
    wide = Pinhole(1024, 512, 300, 300, 512, 256)  # 2:1, and yet no panorama
    lens = KannalaBrandt(640, 480, 300, 300, 320, 240)
    images = read_hloc(features, matches, cameras={"rig": wide, BACK: lens}).images
    assert [image.camera for image in images.values()] == ["rig", "rig", BACK]
    images = read_hloc(features, matches, cameras={"rig": wide, "rig/left": wide}).images
    assert [image.camera for image in images.values()] == ["rig/left", "rig", None]
    with pytest.raises(ValueError, match="must have the size of image .*1024x512, got 640x480"):
        read_hloc(features, matches, cameras={"rig": lens, BACK: lens})


def graph_of(pairs, **keypoints):
    images = {
        name: MatchedImage(name, None, np.array(points)) for name, points in keypoints.items()
    }
    return MatchGraph({}, images, tuple(MatchedPair(*pair) for pair in pairs))


def test_what_is_written_is_laid_out_as_hloc_reads_it(tmp_path):
    camera = Equirectangular(1024, 512)
    images = [
        MatchedImage("a/1.jpg", "c", np.array([(0.5, 0.5), (9.5, 4.5)]), np.eye(2, 3, dtype="f4")),
        MatchedImage("b/1.jpg", None, np.array([(1.0, 2.0)])),
    ]
    pair = MatchedPair("b/1.jpg", "a/1.jpg", np.array([(0, 1)]))
    graph = MatchGraph({"c": camera}, {image.name: image for image in images}, (pair,))
    features, matches, pairs = (tmp_path / name for name in ("f.h5", "m.h5", "pairs.txt"))
    write_hloc(features, matches, graph, pairs=pairs)
    with h5py.File(features) as file:
        np.testing.assert_array_equal(file["a/1.jpg/keypoints"], [(0, 0), (9, 4)])
        np.testing.assert_array_equal(file["a/1.jpg/image_size"], PANORAMA)
        assert file["a/1.jpg/descriptors"].shape == (3, 2)
        assert list(file["b/1.jpg"]) == ["keypoints"]
    with h5py.File(matches) as file:
        np.testing.assert_array_equal(file["b-1.jpg/a-1.jpg/matches0"], [1])
        np.testing.assert_array_equal(file["b-1.jpg/a-1.jpg/matching_scores0"], [1])
    assert read_pairs_file(pairs) == [("b/1.jpg", "a/1.jpg")]


def test_a_graph_comes_back_as_it_was_written(features, matches, tmp_path):
    before = read_hloc(features, matches, with_descriptors=True)
    write_hloc(tmp_path / "f2.h5", tmp_path / "m2.h5", before)
    after = read_hloc(tmp_path / "f2.h5", tmp_path / "m2.h5", with_descriptors=True)
    assert after.cameras == before.cameras
    for name, image in before.images.items():
        np.testing.assert_array_equal(after.images[name].keypoints, image.keypoints)
    np.testing.assert_array_equal(after.images[RIGHT].descriptors, before.images[RIGHT].descriptors)
    for old, new in zip(before.pairs, after.pairs, strict=True):
        assert (new.image1, new.image2) == (old.image1, old.image2)
        np.testing.assert_array_equal(new.matches, old.matches)


@pytest.mark.parametrize(
    ("graph", "message"),
    [
        (
            graph_of([("a", "b", np.array([(0, 0), (0, 1)]))], a=[(1, 1)], b=[(1, 1), (2, 2)]),
            "pair a b matches a key point of a twice",
        ),
        (
            graph_of(
                [("a", "b/c", np.array([(0, 0)])), ("a", "b-c", np.array([(0, 0)]))],
                **{"a": [(1, 1)], "b/c": [(1, 1)], "b-c": [(1, 1)]},
            ),
            "another pair is called 'a/b-c' as well",
        ),
    ],
)
def test_a_graph_that_does_not_fit_leaves_both_files_as_they_were(tmp_path, graph, message):
    features, matches = tmp_path / "f.h5", tmp_path / "m.h5"
    matches.write_bytes(b"before")
    with pytest.raises(ValueError, match=message):
        write_hloc(features, matches, graph)
    assert [path.name for path in tmp_path.iterdir()] == ["m.h5"]
    assert matches.read_bytes() == b"before"


def test_neither_file_appears_where_one_cannot_be_written(features, matches, tmp_path):
    graph = read_hloc(features, matches)
    new = tmp_path / "new.h5"
    with pytest.raises(FileNotFoundError):
        write_hloc(new, tmp_path / "missing" / "m.h5", graph)
    with pytest.raises(IsADirectoryError, match="must be a file to write"):
        write_hloc(new, tmp_path, graph)
    with pytest.raises(ValueError, match="must be two files"):
        write_hloc(new, new, graph)
    assert not new.exists()


@pytest.mark.parametrize("which", ["features", "matches"])
@pytest.mark.parametrize("damage", ["truncated", "text", "empty", "missing"])
def test_a_damaged_or_missing_file_is_named(features, matches, which, damage):
    path = features if which == "features" else matches
    content = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes({"truncated": content[:-100], "text": b"a b\n" * 99, "empty": b""}[damage])
    error = FileNotFoundError if damage == "missing" else ValueError
    with pytest.raises(error, match=path.name) as caught:
        read_hloc(features, matches)
    assert "\n" not in str(caught.value)


def test_a_missing_h5py_is_told_with_the_command_that_installs_it(features, matches, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    for work in (lambda: read_hloc(features, matches), lambda: write_hloc("f", "m", graph_of([]))):
        with pytest.raises(ImportError, match=r"need h5py: pip install 'epi360\[hloc\]'"):
            work()


def test_flipped_bytes_never_give_another_error(features, matches):
    rng = np.random.default_rng(0)
    content = np.frombuffer(features.read_bytes(), np.uint8)
    refused = 0
    for _ in range(30):
        damaged = content.copy()
        places = rng.integers(100, len(content), 20)
        damaged[places] ^= 0xFF
        features.write_bytes(damaged.tobytes())
        try:
            read_hloc(features, matches)
        except ValueError:
            refused += 1
    assert refused > 0


def test_swapped_files_are_told(features, matches):
    with pytest.raises(ValueError, match=r"holds matches, not key points; were the two files sw"):
        read_hloc(matches, features)
    with pytest.raises(ValueError, match=r"holds key points, not matches; were the two files sw"):
        read_hloc(features, features)


def test_a_features_file_without_key_points_is_refused(features, matches, tmp_path):
    with h5py.File(features, "a") as file:
        file["global.jpg/global_descriptor"] = np.zeros(8)
    message = "global.jpg must have 'keypoints', got global_descriptor"
    with pytest.raises(ValueError, match=message):
        read_hloc(features, matches)
    with h5py.File(tmp_path / "none.h5", "w"):
        pass
    with pytest.raises(ValueError, match=r"none.h5 has no images"):
        read_hloc(tmp_path / "none.h5", matches)


@pytest.mark.parametrize(
    ("dataset", "value", "message"),
    [
        ("keypoints", np.zeros((3, 4)), r"must be numbers of shape \(N, 2\), got float64 \(3, 4\)"),
        ("keypoints", np.full((3, 2), np.nan), "must be finite"),
        ("descriptors", np.zeros((3, 128)), r"must be numbers of shape \(D, 3\)"),
        ("image_size", np.array([512]), "must be width and height"),
    ],
)
def test_a_dataset_of_another_shape_is_refused(features, matches, dataset, value, message):
    with h5py.File(features, "a") as file:
        if dataset in file[LEFT]:
            del file[LEFT][dataset]
        file[LEFT][dataset] = value
    with pytest.raises(ValueError, match=f"{dataset} of {LEFT} {message}"):
        read_hloc(features, matches, with_descriptors=True)


@pytest.mark.parametrize(
    ("matches0", "message"),
    [
        ([1, -1], "must be 3 integers, one for each key point of rig/left/1.jpg.*computed anew"),
        ([2, -1, 0], "must be -1 or one of the 2 key points of rig/right/1.jpg, got -1 to 2"),
        ([-2, -1, 0], "must be -1 or one of the 2 key points .* got -2 to 0"),
    ],
)
def test_matches_that_do_not_fit_the_key_points_are_refused(features, tmp_path, matches0, message):
    path = tmp_path / "m.h5"
    add_matches(path, "rig-left-1.jpg/rig-right-1.jpg", matches0)
    with pytest.raises(ValueError, match=message):
        read_hloc(features, path)


def test_a_pair_without_matches0_is_refused(features, matches):
    with h5py.File(matches, "a") as file:
        del file["rig-left-1.jpg/rig-right-1.jpg/matches0"]
    message = "rig-left-1.jpg/rig-right-1.jpg must have 'matches0', got matching_scores0"
    with pytest.raises(ValueError, match=message):
        read_hloc(features, matches)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (f"{LEFT} {BACK}", "is listed, but has no matches; match with the same pairs file"),
        (f"{LEFT} gone.jpg", "is listed, but the features have no image gone.jpg"),
        (LEFT, "pairs.txt, line 1: expected two image names"),
    ],
)
def test_a_listed_pair_must_be_there(features, matches, tmp_path, line, message):
    pairs = write_lines(tmp_path / "pairs.txt", line)
    with pytest.raises(ValueError, match=message):
        read_hloc(features, matches, pairs=pairs)


def test_a_matched_image_that_the_features_lack_is_refused(features, matches):
    add_matches(matches, "gone.jpg/rig-right-1.jpg", [0])
    with pytest.raises(ValueError, match="have no two images of which the pair is 'gone.jpg/rig-"):
        read_hloc(features, matches)


def test_a_pair_that_is_there_in_both_orders_needs_the_pairs_file(features, matches, tmp_path):
    add_matches(matches, "rig-right-1.jpg/rig-left-1.jpg", [2, 0])
    with pytest.raises(ValueError, match="is there twice; give the pairs file"):
        read_hloc(features, matches)
    pairs = write_lines(tmp_path / "pairs.txt", f"{RIGHT} {LEFT}")
    (pair,) = read_hloc(features, matches, pairs=pairs).pairs
    np.testing.assert_array_equal(pair.matches, [(0, 2), (1, 0)])
