# SPDX-License-Identifier: BSD-3-Clause
"""epi360 convert: from the files of one tool to those of another."""

import dataclasses
import json

import numpy as np
import pytest
from command_line import assert_help_names
from convert_scene import CAMERA, assert_same_poses, refused, scene

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.interop import (
    MatchedImage,
    MatchedPair,
    MatchGraph,
    PosedImage,
    Reconstruction,
    TwoViewGeometry,
)
from epi360.interop.colmap_model import read_colmap_model, write_colmap_model
from epi360.interop.formats import FORMATS, format_of_file
from epi360.interop.nerfstudio import read_nerfstudio, write_nerfstudio
from epi360.interop.opensfm import read_opensfm, write_opensfm
from epi360.interop.tum import read_tum_trajectory, write_tum_trajectory
from epi360.jobs.records.match_store import MARKER
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector

COLMAP = "colmap", "colmap-text"


def test_nerfstudio_becomes_opensfm_and_comes_back(run, tmp_path):
    write_nerfstudio("transforms.json", scene())
    assert run("transforms.json", "reconstruction.json") == (
        0, "wrote reconstruction.json (OpenSfM reconstruction): 3 images, 5 points, 1 camera", ""
    )  # fmt: skip
    opensfm = read_opensfm("reconstruction.json")
    assert [image.name for image in opensfm.images] == ["hall/0.jpg", "hall/1.jpg", "hall/2.jpg"]
    assert opensfm.cameras == {"1": CAMERA}
    (tmp_path / "new").mkdir()
    code, out, _ = run("reconstruction.json", "new/transforms.json", "--images", "../pictures")
    assert (code, out.split(" (")[0]) == (0, "wrote new/transforms.json")
    back = read_nerfstudio("new/transforms.json", images="../pictures")
    for reconstruction in (opensfm, back):
        assert_same_poses(scene(), reconstruction)
        np.testing.assert_allclose(reconstruction.points, scene().points, atol=1e-12)
        np.testing.assert_array_equal(reconstruction.colors, scene().colors)


def test_the_folder_of_images_may_be_named_as_seen_from_here(run, tmp_path):
    write_nerfstudio("transforms.json", scene())
    (tmp_path / "new").mkdir()
    (tmp_path / "walk" / "rgb").mkdir(parents=True)
    assert run("transforms.json", "reconstruction.json")[0] == 0
    assert run("reconstruction.json", "new/transforms.json", "--images", "walk/rgb")[::2] == (0, "")
    back = read_nerfstudio("new/transforms.json", images="../walk/rgb")
    assert back.images[0].name == "hall/0.jpg"


def test_a_folder_of_images_that_is_nowhere_is_said(run, tmp_path):
    write_nerfstudio("transforms.json", scene())
    (tmp_path / "new").mkdir()
    code, _, said = run("transforms.json", "new/transforms.json", "--images", "rgb")
    assert code == 0
    assert "will look for images in new/rgb, which is no folder" in said.replace("\\", "/")


def test_images_may_lie_beside_the_file(run, tmp_path):
    write_opensfm("reconstruction.json", scene())
    assert run("reconstruction.json", "transforms.json", "--images", "")[0] == 0
    document = json.loads((tmp_path / "transforms.json").read_text())
    assert document["frames"][0]["file_path"] == "hall/0.jpg"
    assert read_nerfstudio("transforms.json", images="").images[0].name == "hall/0.jpg"


def test_a_trajectory_needs_a_camera_and_says_so(run, tmp_path):
    write_tum_trajectory("poses.txt", scene())
    refused(run("poses.txt", "transforms.json"), "nerfstudio needs the camera of image 0")
    assert not (tmp_path / "transforms.json").exists()
    (tmp_path / "panorama.yaml").write_text("model: Equirectangular\nwidth: 360\nheight: 180\n")
    code, out, _ = run("poses.txt", "transforms.json", "--camera", "panorama.yaml")
    assert code == 0
    assert out.endswith("3 images, 1 camera; not kept: time stamps")
    reconstruction = read_nerfstudio("transforms.json")
    assert_same_poses(scene(), reconstruction)
    assert reconstruction.cameras == {"1": CAMERA}


def test_a_camera_is_taken_by_name(run, tmp_path):
    write_tum_trajectory("poses.tum", scene())
    (tmp_path / "rig.yaml").write_text(
        "cameras:\n  left: {model: Equirectangular, width: 360, height: 180}\n"
        "  right: {model: Equirectangular, width: 720, height: 360}\n"
    )
    refused(run("poses.tum", "reconstruction.json", "--camera", "rig.yaml"), "rig.yaml:NAME")
    refused(
        run("poses.tum", "reconstruction.json", "--camera", "rig.yaml:top"),
        "rig.yaml has no camera 'top'; it holds left, right",
    )
    assert run("poses.tum", "reconstruction.json", "--camera", "rig.yaml:right")[0] == 0
    assert read_opensfm("reconstruction.json").cameras == {"right": Equirectangular(720, 360)}


def test_what_the_target_has_no_place_for_is_named(run):
    write_opensfm("reconstruction.json", scene())
    assert run("reconstruction.json", "poses.tum") == (
        0, "wrote poses.tum (TUM trajectory): 3 images; not kept: cameras, points", ""
    )  # fmt: skip
    assert_same_poses(scene(), read_tum_trajectory("poses.tum"))


def test_reconstructions_that_are_left_out_are_told(run, tmp_path):
    write_opensfm("reconstruction.json", scene())
    (document,) = json.loads((tmp_path / "reconstruction.json").read_text())
    one = dict(list(document["shots"].items())[:1])
    (tmp_path / "reconstruction.json").write_text(
        json.dumps([document, {**document, "shots": one}])
    )
    code, out, err = run("reconstruction.json", "poses.txt")
    assert code == 0 and "3 images" in out
    assert err.startswith("epi360: reconstruction.json holds 2 reconstructions")
    assert "3 of 4 shots" in err


def test_nothing_that_is_there_is_replaced(run, tmp_path):
    write_nerfstudio("transforms.json", scene())
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    refused(run("transforms.json", "transforms.json"), "transforms.json is there already")
    (tmp_path / "two_sparse_pc.ply").write_text("mine")
    refused(
        run("transforms.json", "two.json", "--format", "nerfstudio"),
        "two_sparse_pc.ply is there already",
    )
    (tmp_path / "two_sparse_pc.ply").unlink()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes").write_text("mine")
    refused(run("transforms.json", "full"), "full is there already")
    refused(run("transforms.json", "nowhere/poses.txt"), "folder nowhere does not exist")
    after = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    assert after == before


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("missing.json", "a.tum"), ["missing.json does not exist"]),
        (("notes.txt", "a.tum"), ["notes.txt is no file that can be converted"]),
        (("poses.txt", "a.json"), ["a.json does not say its format", "nerfstudio", "tum"]),
        (("poses.txt", "a.xyz"), ["a.xyz does not say its format"]),
        (("poses.txt", "a.db"), ["poses.txt holds a reconstruction", "epi360 match"]),
        (("poses.txt", "a.h5"), ["poses.txt holds a reconstruction", "epi360 match"]),
        (("matches.db", "transforms.json"), ["matches.db holds matches", "epi360 map"]),
        (("matches.db", "sparse"), ["matches.db holds matches", "epi360 map"]),
        (("matches.db", "a.h5"), ["--features"]),
        (("matches.h5", "b.h5", "--features", "f.h5"), ["both hloc's"]),
        (("matches.db", "b.db", "--features", "f.h5"), ["--features is for hloc"]),
        (("matches.db", "b.db", "--camera", "c.yaml"), ["--camera is for images without one"]),
        (("poses.txt", "b.tum", "--images", "x"), ["--images is for nerfstudio"]),
        (("poses.txt", "b.tum", "--camera", "c.yaml"), ["c.yaml does not exist"]),
        (("poses.txt", "b", "--format", "ply"), ["ply"]),
    ],
)
def test_what_cannot_be_is_one_clear_sentence(run, tmp_path, words, parts):
    write_tum_trajectory("poses.txt", scene())
    (tmp_path / "notes.txt").write_text("bring milk\n")
    (tmp_path / "matches.db").write_bytes(b"SQLite format 3\0" + bytes(100))
    (tmp_path / "matches.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    before = sorted(tmp_path.iterdir())
    refused(run(*words), *parts)
    assert sorted(tmp_path.iterdir()) == before


def test_a_camera_for_images_that_have_one_is_refused(run, tmp_path):
    write_opensfm("reconstruction.json", scene())
    (tmp_path / "c.yaml").write_text("model: Equirectangular\nwidth: 360\nheight: 180\n")
    refused(run("reconstruction.json", "p.tum", "--camera", "c.yaml"), "all images have theirs")


def test_a_camera_that_the_target_lacks_is_refused_before_anything_is_written(run, tmp_path):
    pose = Pose(np.eye(3), np.zeros(3))
    cameras = {"a": Equirectangular(360, 180), "b": KannalaBrandt(64, 64, 20, 20, 32, 32)}
    images = (PosedImage("a.jpg", "a", pose), PosedImage("b.jpg", "b", pose))
    write_opensfm("reconstruction.json", Reconstruction(cameras, images))
    refused(run("reconstruction.json", "transforms.json"), "one camera model a file")
    assert [path.name for path in tmp_path.iterdir()] == ["reconstruction.json"]


@pytest.mark.parametrize("name", COLMAP)
def test_a_colmap_model_comes_back_with_its_observations(run, tmp_path, name):
    pytest.importorskip("pycolmap")

    write_colmap_model("sparse", scene())
    code, out, _ = run("sparse", "copy", "--format", name)
    assert code == 0
    assert out == f"wrote copy ({FORMATS[name].title}): 3 images, 5 points, 1 camera"
    assert (tmp_path / "copy" / ("images.txt" if name == "colmap-text" else "images.bin")).is_file()
    before, after = scene(), read_colmap_model("copy")
    assert_same_poses(before, after)
    assert len(after.observations.points) == 15
    for point, image, pixel in zip(*vars(after.observations).values(), strict=True):
        row = 3 * point + image
        np.testing.assert_allclose(pixel, before.observations.pixels[row], atol=1e-9)
    code, out, _ = run("copy", "transforms.json")
    assert code == 0
    assert out.endswith("3 images, 5 points, 1 camera; not kept: observations")
    assert_same_poses(before, read_nerfstudio("transforms.json"))


def test_an_empty_folder_may_be_filled(run, tmp_path):
    pytest.importorskip("pycolmap")
    (tmp_path / "0").mkdir()
    write_opensfm("reconstruction.json", scene())
    assert run("reconstruction.json", "0")[0] == 0
    assert format_of_file("0") == "colmap"
    refused(run("reconstruction.json", "0"), "0 is there already")


def graph():
    rng = np.random.default_rng(0)
    images = {
        name: MatchedImage(name, "1", rng.uniform(1, 170, (6, 2)).astype(np.float32).astype(float))
        for name in ("hall/a.jpg", "hall/b.jpg", "hall/c.jpg")
    }
    matches = np.array([[0, 1], [2, 3], [4, 5]])
    turn = Pose(rotation_from_vector([0, 0.3, 0]), np.array([0.6, 0, 0.8]))
    pairs = (
        MatchedPair("hall/a.jpg", "hall/b.jpg", matches, TwoViewGeometry("ok", turn, matches)),
        MatchedPair("hall/c.jpg", "hall/a.jpg", matches),
    )
    return MatchGraph({"1": CAMERA}, images, pairs)


def test_a_database_becomes_hloc_and_a_database_again(run):
    pytest.importorskip("pycolmap")
    pytest.importorskip("h5py")
    from epi360.interop.colmap_database import read_colmap_database, write_colmap_database

    write_colmap_database("a.db", graph())
    code, out, err = run("a.db", "matches.h5", "--features", "features.h5")
    assert (code, err) == (0, "")
    assert out == (
        "wrote matches.h5 (hloc matches): 3 images, 2 pairs; not kept: cameras, poses of pairs"
    )
    code, out, _ = run("matches.h5", "b.db", "--features", "features.h5")
    assert (code, out) == (0, "wrote b.db (COLMAP database): 3 images, 2 pairs, 1 camera")
    before, after = graph(), read_colmap_database("b.db")
    for name, image in before.images.items():
        np.testing.assert_allclose(after.images[name].keypoints, image.keypoints, atol=1e-4)
    sets = [
        {
            frozenset(zip((pair.image1, pair.image2), row, strict=True))
            for pair in one.pairs
            for row in pair.matches.tolist()
        }
        for one in (before, after)
    ]
    assert sets[0] == sets[1]
    refused(run("a.db", "m.h5", "--features", "features.h5"), "features.h5 is there already")
    refused(run("a.db", "m.h5", "--features", "m.h5"), "must be different files")


def test_what_epi360_match_wrote_becomes_a_database(run, tmp_path, monkeypatch):
    pytest.importorskip("pycolmap")
    from epi360.interop.colmap_database import read_colmap_database

    (tmp_path / "matched").mkdir()
    monkeypatch.setattr("epi360.jobs.matching.match_folder.load_matches", lambda folder: graph())
    of_all = np.full((6, 128), 128.0**-0.5, np.float32)
    monkeypatch.setattr(
        "epi360.jobs.matching.match_result.descriptors_of", lambda _: lambda name: of_all
    )
    code, out, _ = run("matched", "a.db")
    assert (code, out) == (0, "wrote a.db (COLMAP database): 3 images, 2 pairs, 1 camera")
    pair = read_colmap_database("a.db").pairs[0]
    assert (pair.image1, pair.image2) == ("hall/a.jpg", "hall/b.jpg")
    assert (
        rotation_error_deg(pair.geometry.cam2_from_cam1, graph().pairs[0].geometry.cam2_from_cam1)
        < 1e-6
    )
    stored = read_colmap_database("a.db", with_descriptors=True).images["hall/b.jpg"]
    np.testing.assert_array_equal(stored.descriptors, np.round(512 * of_all))
    assert run("matched", "b.db", "--no-descriptors")[0] == 0
    without = read_colmap_database("b.db", with_descriptors=True).images["hall/b.jpg"]
    assert without.descriptors is None
    refused(run("matched", "transforms.json"), "matched holds no COLMAP model", "epi360 map")


def test_what_epi360_map_wrote_is_a_model_where_the_target_needs_poses(run, tmp_path, monkeypatch):
    write_colmap_model("map/sparse/0", scene())
    (tmp_path / "map" / MARKER).write_text("{}")
    code, out, _ = run("map", "transforms.json")
    assert (code, out.partition(":")[0]) == (0, "wrote transforms.json (nerfstudio transforms)")
    assert_same_poses(scene(), read_nerfstudio("transforms.json"))
    code, out, _ = run("map", "model")
    assert (code, out.partition(":")[0]) == (0, "wrote model (COLMAP model)")
    assert_same_poses(scene(), read_colmap_model("model"))
    pytest.importorskip("pycolmap")
    monkeypatch.setattr("epi360.jobs.matching.match_folder.load_matches", lambda folder: graph())
    code, out, _ = run("map", "matches.db", "--no-descriptors")
    assert (code, out) == (0, "wrote matches.db (COLMAP database): 3 images, 2 pairs, 1 camera")


@pytest.fixture
def ambiguous():
    """hloc's files of images whose names become one with "-" for "/"."""
    pytest.importorskip("h5py")
    from epi360.interop import write_hloc

    names = ("hall/a.jpg", "hall-a.jpg", "b.jpg")
    images = {name: MatchedImage(name, "1", np.full((2, 2), 9.5), np.eye(2)) for name in names}
    pair = MatchedPair("hall/a.jpg", "b.jpg", np.array([[0, 1]]))
    write_hloc("features.h5", "matches.h5", MatchGraph({"1": CAMERA}, images, (pair,)))


def test_a_pairs_file_says_which_images_hloc_matched(run, ambiguous, tmp_path):
    pytest.importorskip("pycolmap")
    from epi360.interop import read_colmap_database

    words = ("matches.h5", "a.db", "--features", "features.h5")
    refused(run(*words), "hall-a.jpg b.jpg or hall/a.jpg b.jpg", "give the pairs file (--pairs)")
    (tmp_path / "pairs.txt").write_text("hall/a.jpg b.jpg\n")
    assert run(*words, "--pairs", "pairs.txt")[0] == 0
    (pair,) = read_colmap_database("a.db").pairs
    assert {pair.image1, pair.image2} == {"hall/a.jpg", "b.jpg"}
    words = ("a.db", "new.h5", "--features", "new_features.h5", "--pairs")
    refused(run(*words, "pairs.txt"), "pairs.txt is there already")
    assert run(*words, "new.txt")[0] == 0
    assert set((tmp_path / "new.txt").read_text().split()) == {"hall/a.jpg", "b.jpg"}
    refused(run("a.db", "b.db", "--pairs", "pairs.txt"), "--pairs is for hloc")


def test_descriptors_are_kept_unless_they_are_not_wanted(run, ambiguous, monkeypatch):
    pycolmap = pytest.importorskip("pycolmap")
    from epi360.interop import hloc, read_colmap_database, read_hloc, write_colmap_database

    write_colmap_database("a.db", graph())
    with pycolmap.Database.open("a.db") as database:
        for image in database.read_all_images():
            sift = pycolmap.FeatureDescriptors(
                data=np.full((6, 128), 7, np.uint8), type=pycolmap.FeatureExtractorType.SIFT
            )
            database.write_descriptors(image.image_id, sift)
    assert run("a.db", "m.h5", "--features", "f.h5")[0] == 0
    images = read_hloc("f.h5", "m.h5", with_descriptors=True).images
    # hloc's descriptors have unit length, up to its half precision.
    np.testing.assert_allclose(
        images["hall/a.jpg"].descriptors, np.full((6, 128), 128**-0.5), atol=2.0**-12
    )
    assert run("m.h5", "b.db", "--features", "f.h5")[0] == 0
    stored = read_colmap_database("b.db", with_descriptors=True).images["hall/a.jpg"]
    np.testing.assert_array_equal(stored.descriptors, np.full((6, 128), 45))  # 512 / sqrt(128)
    monkeypatch.setattr(hloc.HlocPairs, "descriptors", None)  # not to be called
    assert run("m.h5", "c.db", "--features", "f.h5", "--no-descriptors")[0] == 0


def test_a_source_without_images_is_refused(run, tmp_path):
    write_opensfm("reconstruction.json", Reconstruction({"1": CAMERA}, ()))
    refused(run("reconstruction.json", "poses.tum"), "reconstruction.json holds no images")
    assert not (tmp_path / "poses.tum").exists()


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "convert", "--images", "--camera", "--format", "--features", "--pairs",
        "--fps", "--verify", "--verify-again", "--no-descriptors", "--table", "--report",
    )  # fmt: skip


def test_matches_of_hloc_say_that_they_need_verification_or_get_it(run, tmp_path):
    pytest.importorskip("pycolmap")
    pytest.importorskip("h5py")
    from epi360.interop import read_colmap_database, write_hloc

    rng = np.random.default_rng(0)
    points = 5 * rng.normal(size=(60, 3))
    pixels = [CAMERA.pixels_from_bearings(points - [0.8 * k, 0, 0]) for k in range(2)]
    names = "a.jpg", "b.jpg"
    images = {n: MatchedImage(n, "1", p) for n, p in zip(names, pixels, strict=True)}
    matches = np.column_stack([np.arange(60)] * 2)
    unverified = MatchGraph({"1": CAMERA}, images, (MatchedPair(*names, matches),))
    write_hloc("f.h5", "m.h5", unverified)
    code, _, err = run("m.h5", "a.db", "--features", "f.h5")
    assert code == 0 and "1 pair is not verified" in err and "--verify" in err
    assert read_colmap_database("a.db").pairs[0].geometry is None
    code, _, err = run("m.h5", "b.db", "--features", "f.h5", "--verify")
    assert code == 0 and "not verified" not in err
    geometry = read_colmap_database("b.db").pairs[0].geometry
    assert geometry.status == "ok" and len(geometry.inliers) > 50
    (tmp_path / "transforms.json").write_text('{"frames": []}')
    refused(run("transforms.json", "model", "--verify"), "--verify and --verify-again are for")


def test_refused_pairs_are_left_out_of_files_without_poses(run, tmp_path, monkeypatch):
    pytest.importorskip("h5py")
    from epi360.interop import read_hloc

    (tmp_path / "matched").mkdir()
    first, second = graph().pairs
    status = dataclasses.replace(first.geometry, status="refused")
    refused_one = dataclasses.replace(
        graph(), pairs=(dataclasses.replace(first, geometry=status), second)
    )
    monkeypatch.setattr(
        "epi360.jobs.matching.match_folder.load_matches", lambda folder: refused_one
    )
    words = ["matched", "m.h5", "--features", "f.h5", "--pairs", "p.txt", "--no-descriptors"]
    code, out, _ = run(*words)
    assert code == 0 and "1 pair is left out: other pairs speak against" in out
    assert [pair.image1 for pair in read_hloc("f.h5", "m.h5", pairs="p.txt").pairs] == [
        second.image1
    ]
    refused(run("matched", "a.db", "--verify-again"), "epi360 match has judged its own")
