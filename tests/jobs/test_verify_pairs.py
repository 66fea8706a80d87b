# SPDX-License-Identifier: BSD-3-Clause
"""Matches that nobody has verified: poses for their pairs, and what COLMAP does with them."""

import csv
import dataclasses
import shutil

import cv2
import numpy as np
import pytest
from colmap_graphs import PANORAMA, panoramas_of_points, relative_pose
from rendered_views import write_png
from twin_rooms import rooms as twin_rooms
from twin_rooms import truth, write_rooms

from epi360.cameras import KannalaBrandt
from epi360.cli import main
from epi360.interop import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.jobs.matching.verify_pairs import unverified_pairs, verify_pairs, without_geometries
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg
from epi360.report.folder_page import NO_PICTURES
from epi360.report.match_table import describe_verified
from epi360_scenes.lenses import Lens


def test_pairs_get_the_poses_that_their_matches_have():
    poses, graph = panoramas_of_points(4)
    assert len(unverified_pairs(without_geometries(graph))) == 6
    verified = verify_pairs(without_geometries(graph)).graph
    assert not unverified_pairs(verified)
    for pair in verified.pairs:
        truth = relative_pose(poses[pair.image1], poses[pair.image2])
        assert pair.geometry.status == "ok" and len(pair.geometry.inliers) > 190
        assert rotation_error_deg(pair.geometry.cam2_from_cam1, truth) < 0.1
        assert translation_error_deg(pair.geometry.cam2_from_cam1, truth) < 1.0


def test_a_folder_whose_camera_carries_more_than_it_sees_gets_its_poses():
    """300 key points that never move, as on a car, beside 200 of the scene."""
    poses, graph = panoramas_of_points(4)
    below = np.random.default_rng(0).uniform([0.0, 760.0], [2000.0, 1000.0], (300, 2))
    rows = 200 + np.arange(300)
    images = {
        name: dataclasses.replace(image, keypoints=np.concatenate([image.keypoints, below]))
        for name, image in graph.images.items()
    }
    pairs = tuple(
        dataclasses.replace(pair, matches=np.concatenate([pair.matches, np.stack([rows] * 2, 1)]))
        for pair in graph.pairs
    )
    carried = dataclasses.replace(graph, images=images, pairs=pairs)
    found = verify_pairs(without_geometries(carried))
    for pair, verdict in zip(found.graph.pairs, found.verdicts, strict=True):
        truth = relative_pose(poses[pair.image1], poses[pair.image2])
        assert verdict.accepted and "300 of 500 matches stand still" in verdict.warnings[0]
        assert rotation_error_deg(pair.geometry.cam2_from_cam1, truth) < 0.1
        assert (pair.geometry.inliers < 200).all()


def test_a_folder_says_that_its_panoramas_were_cropped():
    """Panoramas of 340 degrees that are taken for whole ones."""
    _, graph = panoramas_of_points(4)
    images = {}
    for name, image in graph.images.items():
        keypoints = image.keypoints.copy()
        keypoints[:, 0] = (keypoints[:, 0] - 1000.0) * 360.0 / 340.0 + 1000.0
        images[name] = dataclasses.replace(image, keypoints=keypoints)
    inside = {
        name: (image.keypoints[:, 0] > 0.0) & (image.keypoints[:, 0] < 2000.0)
        for name, image in images.items()
    }
    cropped = []
    for pair in graph.pairs:
        both = [
            inside[name][rows]
            for name, rows in zip((pair.image1, pair.image2), pair.matches.T, strict=True)
        ]
        cropped.append(dataclasses.replace(pair, matches=pair.matches[both[0] & both[1]]))
    images = {
        name: dataclasses.replace(image, keypoints=np.clip(image.keypoints, 0.0, [2000.0, 1000.0]))
        for name, image in images.items()
    }
    changed = dataclasses.replace(graph, images=images, pairs=tuple(cropped))
    found = verify_pairs(without_geometries(changed))
    told = [text for verdict in found.verdicts for text in verdict.warnings if "around" in text]
    assert len(told) >= 3 and all(" degrees around, not 360 " in text for text in told)
    widths = [float(text.split("both images are ")[1].split()[0]) for text in told]
    np.testing.assert_allclose(widths, 340.0, atol=2.0)
    assert "would agree better with other angles of the cameras" in describe_verified(found)


def test_a_folder_of_good_cameras_says_nothing_of_them():
    _, graph = panoramas_of_points(4)
    found = verify_pairs(without_geometries(graph))
    assert "other angles" not in describe_verified(found)


def test_a_pair_that_has_a_geometry_keeps_it():
    _, graph = panoramas_of_points(3)
    first, *others = graph.pairs
    mixed = without_geometries(dataclasses.replace(graph, pairs=tuple(others)))
    mixed = dataclasses.replace(mixed, pairs=(first, *mixed.pairs))
    assert verify_pairs(mixed).graph.pairs[0].geometry is first.geometry


def test_a_pair_without_matches_keeps_its_pose():
    _, graph = panoramas_of_points(3)
    first, *others = graph.pairs
    none = np.zeros((0, 2), np.int64)
    empty = dataclasses.replace(graph, pairs=(dataclasses.replace(first, matches=none), *others))
    found = verify_pairs(without_geometries(empty))
    assert found.graph.pairs[0].geometry is first.geometry
    assert len(found.verdicts) == 2


def test_random_matches_are_refused():
    _, graph = panoramas_of_points(2)
    rng = np.random.default_rng(0)
    (pair,) = graph.pairs
    shuffled = np.column_stack([np.arange(200), rng.permutation(200)])
    wrong = dataclasses.replace(graph, pairs=(dataclasses.replace(pair, matches=shuffled),))
    (found,) = verify_pairs(without_geometries(wrong)).graph.pairs
    assert found.geometry.status == "too_few_inliers"


def test_an_image_without_a_camera_is_named():
    _, graph = panoramas_of_points(2)
    images = {name: dataclasses.replace(image, camera=None) for name, image in graph.images.items()}
    nameless = dataclasses.replace(without_geometries(graph), images=images)
    with pytest.raises(ValueError, match="0.jpg has no camera"):
        verify_pairs(nameless)


def test_colmap_triangulates_what_was_verified_and_nothing_else(tmp_path):
    """The way of hloc's triangulation: a model with poses, a database with verified matches."""
    pycolmap = pytest.importorskip("pycolmap")
    from epi360.interop import PosedImage, Reconstruction, write_colmap_database, write_colmap_model

    poses, graph = panoramas_of_points(5)
    posed = tuple(PosedImage(name, "theta", pose) for name, pose in poses.items())
    write_colmap_model(tmp_path / "model", Reconstruction(graph.cameras, posed))
    counts = []
    for number, one in enumerate(
        (without_geometries(graph), verify_pairs(without_geometries(graph)).graph)
    ):
        database, found = tmp_path / f"{number}.db", tmp_path / f"{number}"
        write_colmap_database(database, one)
        found.mkdir()
        model = pycolmap.triangulate_points(
            pycolmap.Reconstruction(str(tmp_path / "model")), database, tmp_path, found
        )
        counts.append(model.num_points3D())
    assert counts[0] == 0 and counts[1] > 190


def with_a_wrong_pair(graph, poses):
    """The graph, whose first pair matches key points that another pose of its first image has."""
    first, *others = graph.pairs
    seen = graph.images[first.image1]
    bearings = PANORAMA.bearings_from_pixels(graph.images[first.image2].keypoints)
    turned = Pose(rotation_from_vector([0.3, 0.8, -0.2]), np.array([0.3, -0.1, 0.2]))
    depths = np.random.default_rng(1).uniform(2, 6, (len(bearings), 1))
    points = (depths * bearings) @ turned.rotation.T + turned.translation
    keypoints = np.concatenate([seen.keypoints, PANORAMA.pixels_from_bearings(points)])
    rows = np.arange(len(points))
    matches = np.column_stack([len(seen.keypoints) + rows, rows])
    images = {**graph.images, first.image1: dataclasses.replace(seen, keypoints=keypoints)}
    pairs = (dataclasses.replace(first, matches=matches), *others)
    return dataclasses.replace(graph, images=images, pairs=pairs)


def test_a_pair_that_the_others_contradict_is_refused():
    poses, graph = panoramas_of_points(5)
    found = verify_pairs(without_geometries(with_a_wrong_pair(graph, poses)))
    first, *others = found.graph.pairs
    assert found.verdicts[0].contradicted and not found.verdicts[0].accepted
    assert first.geometry.status == "refused" and len(first.geometry.inliers) > 150
    assert all(pair.geometry.status == "ok" for pair in others)


def test_a_wrong_pair_alone_is_believed():
    """What its own matches say is all that there is: the refusal above comes from the others."""
    poses, graph = panoramas_of_points(2)
    found = verify_pairs(without_geometries(with_a_wrong_pair(graph, poses)))
    assert found.graph.pairs[0].geometry.status == "ok"


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """Pictures of two twin rooms, and matches of all pairs."""
    folder = tmp_path_factory.mktemp("rooms")
    run = match_images(
        write_rooms(folder / "a"), folder / "matched", MatchOptions(pairs="exhaustive")
    )
    return folder, run, without_geometries(load_matches(folder / "matched", by_others=False))


def in_one_room(pair):
    return pair.image1[0] == pair.image2[0]


def test_pictures_tell_twin_rooms_apart(rooms):
    folder, run, graph = rooms
    found = verify_pairs(graph, pictures=folder / "a")
    assert [v.accepted for v in found.verdicts] == [v.accepted for v in run.verdicts]
    assert found.looked_around
    for pair in found.graph.pairs:
        assert pair.geometry.status == ("ok" if in_one_room(pair) else "refused")
        if in_one_room(pair):
            wanted = truth(pair.image1, pair.image2)
            assert rotation_error_deg(pair.geometry.cam2_from_cam1, wanted) < 2
            assert translation_error_deg(pair.geometry.cam2_from_cam1, wanted) < 2


def test_without_pictures_twin_rooms_are_one(rooms):
    _, _, graph = rooms
    found = verify_pairs(graph)
    between = [pair for pair in found.graph.pairs if not in_one_room(pair)]
    assert sum(pair.geometry.status == "ok" for pair in between) >= 5
    assert found.num_comparable == len(graph.pairs) == 15


def test_the_result_does_not_depend_on_the_number_of_threads(rooms):
    folder, _, graph = rooms
    runs = [verify_pairs(graph, pictures=folder / "a", num_threads=count) for count in (1, 2)]
    told = [[repr((v.accepted, v.probability)) for v in run.verdicts] for run in runs]
    assert told[0] == told[1]
    for one, other in zip(*(run.graph.pairs for run in runs), strict=True):
        np.testing.assert_array_equal(one.geometry.inliers, other.geometry.inliers)


def test_level_panoramas_are_noticed(rooms):
    _, run, graph = rooms
    assert verify_pairs(graph).level == run.level is not None


def test_pictures_tell_fisheye_frames_of_twin_rooms_apart(tmp_path):
    """They may be larger than what their camera is of."""
    for name, (pose, picture) in twin_rooms().items():
        lens = Lens.of(200.0, 768, pose.rotation.T @ rotation_from_vector([0.0, 2.6, 0.0]))
        write_png(tmp_path / "a" / name, lens.picture(picture))
    lens.write_camera(tmp_path / "lens.yaml")
    images = find_images(tmp_path / "a", camera=str(tmp_path / "lens.yaml"))
    match_images(images, tmp_path / "out", MatchOptions(pairs="exhaustive"))
    graph = without_geometries(load_matches(tmp_path / "out", by_others=False))
    for path in (tmp_path / "a").iterdir():
        write_png(path, cv2.resize(cv2.imread(str(path))[..., ::-1], None, fx=1.5, fy=1.5))
    found = verify_pairs(graph, pictures=tmp_path / "a")
    assert found.looked_around and found.num_comparable == 15
    accepted = [each for each in found.verdicts if each.accepted]
    assert len(accepted) == 6
    assert all(each.image1[0] == each.image2[0] for each in accepted)


def test_a_picture_that_is_missing_is_named(rooms, tmp_path):
    _, _, graph = rooms
    for folder in (tmp_path, str(tmp_path)):
        with pytest.raises(FileNotFoundError, match=r"must hold the pictures by .*a0\.png"):
            verify_pairs(graph, pictures=folder)


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (b"no picture", "a0.png"),
        (np.zeros((64, 64, 3), np.uint8), "the shape of its camera, 768x384; it is 64x64"),
    ],
)
def test_a_picture_that_cannot_be_compared_is_said(rooms, tmp_path, picture, message):
    folder, _, graph = rooms
    shutil.copytree(folder / "a", tmp_path / "a")
    if isinstance(picture, bytes):
        (tmp_path / "a" / "a0.png").write_bytes(picture)
    else:
        write_png(tmp_path / "a" / "a0.png", picture)
    with pytest.raises(ValueError, match=message):
        verify_pairs(graph, pictures=tmp_path / "a")


def test_the_order_of_images_in_a_pair_does_not_matter(rooms):
    folder, run, graph = rooms
    swapped = [
        dataclasses.replace(
            pair, image1=pair.image2, image2=pair.image1, matches=pair.matches[:, ::-1]
        )
        for pair in reversed(graph.pairs)
    ]
    found = verify_pairs(dataclasses.replace(graph, pairs=tuple(swapped)), pictures=folder / "a")
    accepted = {frozenset((v.image1, v.image2)) for v in found.verdicts if v.accepted}
    assert accepted == {frozenset((v.image1, v.image2)) for v in run.verdicts if v.accepted}
    for pair in found.graph.pairs:
        if in_one_room(pair):
            wanted = truth(pair.image1, pair.image2)
            assert rotation_error_deg(pair.geometry.cam2_from_cam1, wanted) < 2


def test_pairs_that_have_a_pose_have_a_say_about_the_others(rooms):
    """One pair of two twin rooms alone would be believed without pictures."""
    folder, _, graph = rooms
    judged = verify_pairs(graph, pictures=folder / "a").graph
    row = next(
        row
        for row, (pair, given) in enumerate(
            zip(verify_pairs(graph).graph.pairs, judged.pairs, strict=True)
        )
        if pair.geometry.status == "ok" and not in_one_room(given)
    )
    pairs = list(judged.pairs)
    pairs[row] = dataclasses.replace(pairs[row], geometry=None)
    found = verify_pairs(dataclasses.replace(judged, pairs=tuple(pairs)), pictures=folder / "a")
    assert [v.accepted for v in found.verdicts] == [False]
    assert found.graph.pairs[row].geometry.status == "refused"
    assert len(found.kept) == 6
    assert "1 pair, 6 more had a pose" in describe_verified(found)
    alone = dataclasses.replace(graph, pairs=(graph.pairs[row],))
    assert verify_pairs(alone).verdicts[0].accepted
    assert not verify_pairs(alone, pictures=folder / "a").verdicts[0].accepted


def test_a_triangle_with_kept_pairs_contradicts_a_new_one():
    poses, graph = panoramas_of_points(5)
    wrong = with_a_wrong_pair(graph, poses)
    pairs = (dataclasses.replace(wrong.pairs[0], geometry=None), *wrong.pairs[1:])
    found = verify_pairs(dataclasses.replace(wrong, pairs=pairs))
    assert found.graph.pairs[0].geometry.status == "refused"


def test_a_pose_that_its_own_inliers_do_not_fit_has_no_say(rooms):
    """It is kept, because nobody has asked to judge it anew, and it is named."""
    folder, _, graph = rooms
    judged = verify_pairs(graph, pictures=folder / "a")
    accepted = [verdict.accepted for verdict in judged.verdicts]
    row = accepted.index(True)
    right = judged.graph.pairs[row].geometry
    turn = rotation_from_vector([0.0, 1.2, 0.0])
    pose = Pose(turn @ right.cam2_from_cam1.rotation, right.cam2_from_cam1.translation)
    pairs = list(graph.pairs)
    pairs[row] = dataclasses.replace(
        pairs[row], geometry=dataclasses.replace(right, cam2_from_cam1=pose)
    )
    found = verify_pairs(dataclasses.replace(graph, pairs=tuple(pairs)), pictures=folder / "a")
    names = pairs[row].image1, pairs[row].image2
    assert found.kept == found.questioned == (names,)
    assert [v.accepted for v in found.verdicts] == accepted[:row] + accepted[row + 1 :]
    text = describe_verified(found)
    assert "1 pair keeps a pose that others or its own inliers speak against" in text
    assert f"({names[0]} - {names[1]}): --verify-again judges all pairs anew" in text
    assert verify_pairs(judged.graph, pictures=folder / "nowhere").verdicts == ()


def test_key_points_that_no_ray_leads_to_do_not_hide_that_a_pose_fits_nothing():
    poses, graph = panoramas_of_points(3)
    # Its corners are black.
    fisheye = KannalaBrandt(1000, 1000, 400.0, 400.0, 500.0, 500.0, max_angle_deg=90.0)
    corner = [1.0, 1.0]
    assert np.isnan(fisheye.bearings_from_pixels(np.array([corner]))).all()
    points = np.random.default_rng(2).normal(size=(200, 3)) + [0.0, 0.0, 4.0]
    images = {
        name: MatchedImage(
            name,
            "f",
            np.vstack([fisheye.pixels_from_bearings(points - [0.3 * k, 0.0, 0.0]), corner]),
        )
        for k, name in enumerate(poses)
    }
    matches = np.column_stack([np.arange(201)] * 2)
    names = list(poses)
    turned = Pose(rotation_from_vector([0.0, 0.5, 0.0]), np.array([1.0, 0.0, 0.0]))
    wrong = MatchedPair(names[0], names[1], matches, TwoViewGeometry("ok", turned, matches))
    right = Pose(np.eye(3), np.array([-1.0, 0.0, 0.0]))
    other = MatchedPair(names[0], names[2], matches, TwoViewGeometry("ok", right, matches))
    pairs = (wrong, other, MatchedPair(names[1], names[2], matches))
    found = verify_pairs(MatchGraph({"f": fisheye}, images, pairs))
    assert found.questioned == ((names[0], names[1]),)
    assert found.verdicts[0].accepted and found.verdicts[0].num_triangles == 0


def test_the_command_says_what_became_of_the_pairs(rooms, tmp_path, capsys):
    pytest.importorskip("pycolmap")
    pytest.importorskip("h5py")
    from epi360.interop import read_colmap_database, write_hloc

    folder, _, graph = rooms
    write_hloc(tmp_path / "f.h5", tmp_path / "m.h5", graph)
    words = ["convert", str(tmp_path / "m.h5"), "--features", str(tmp_path / "f.h5"), "--verify"]
    assert main([*words, str(tmp_path / "a.db"), "--images", str(folder / "a")]) == 0
    out, err = capsys.readouterr()
    assert "Verified      15 pairs\nAccepted      6\n" in out
    assert "shows another place" in out and "The panoramas are level" in out
    assert "--images" not in err
    pairs = read_colmap_database(tmp_path / "a.db").pairs
    assert [pair.geometry.status == "ok" for pair in pairs] == list(map(in_one_room, pairs))
    assert [len(pair.geometry.inliers) > 0 for pair in pairs] == list(map(in_one_room, pairs))
    assert main([*words, str(tmp_path / "b.db")]) == 0
    assert "name their folder with --images" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "c.db"), "--images", str(tmp_path / "none")]) == 2
    assert "--images must be the folder of the pictures" in capsys.readouterr().err
    assert not (tmp_path / "c.db").exists()


def test_pairs_that_have_a_pose_are_verified_again_when_that_is_asked(tmp_path, capsys):
    pytest.importorskip("pycolmap")
    from epi360.interop import read_colmap_database, write_colmap_database

    poses, graph = panoramas_of_points(5)
    write_colmap_database(tmp_path / "a.db", with_a_wrong_pair(graph, poses))
    words = ["convert", str(tmp_path / "a.db")]
    assert main([*words, str(tmp_path / "b.db"), "--verify"]) == 0
    assert "All pairs have a verdict already; --verify-again judges" in capsys.readouterr().out
    assert main([*words, str(tmp_path / "c.db"), "--verify-again"]) == 0
    out = capsys.readouterr().out
    assert "Accepted      9\n" in out and "did not fit other pairs" in out
    wrong = [graph.pairs[0].image1, graph.pairs[0].image2]
    for name, expected in (("b", "ok"), ("c", "too_few_inliers")):
        pairs = read_colmap_database(tmp_path / f"{name}.db").pairs
        (found,) = [p for p in pairs if [p.image1, p.image2] == wrong]
        assert found.geometry.status == expected


def test_a_pair_that_was_refused_does_not_come_back_through_files_of_hloc(tmp_path, capsys):
    pytest.importorskip("pycolmap")
    pytest.importorskip("h5py")
    from epi360.interop import read_hloc, write_colmap_database

    poses, graph = panoramas_of_points(5)
    wrong = without_geometries(with_a_wrong_pair(graph, poses))
    write_colmap_database(tmp_path / "a.db", wrong)

    def converted(source, name, *options):
        words = ["convert", str(tmp_path / source), str(tmp_path / f"{name}.h5"), "--features"]
        assert main([*words, str(tmp_path / f"{name}-f.h5"), *options]) == 0
        pairs = read_hloc(tmp_path / f"{name}-f.h5", tmp_path / f"{name}.h5").pairs
        return {frozenset((pair.image1, pair.image2)) for pair in pairs}

    everyone = {frozenset((pair.image1, pair.image2)) for pair in wrong.pairs}
    refused = frozenset((wrong.pairs[0].image1, wrong.pairs[0].image2))
    assert converted("a.db", "verified", "--verify") == everyone - {refused}
    assert "1 pair is left out: other pairs speak against" in capsys.readouterr().out
    assert main(["convert", str(tmp_path / "a.db"), str(tmp_path / "b.db"), "--verify"]) == 0
    assert converted("b.db", "unaware") == everyone
    assert "1 pair is without a pose in the database" in capsys.readouterr().err
    assert converted("b.db", "again", "--verify-again") == everyone - {refused}


def test_verdicts_are_written_as_a_table_and_a_page(rooms, tmp_path, capsys):
    pytest.importorskip("pycolmap")
    from epi360.interop import write_colmap_database

    folder, _, graph = rooms
    write_colmap_database(tmp_path / "a.db", graph)
    table, page = tmp_path / "a.csv", tmp_path / "a.html"
    words = ["convert", str(tmp_path / "a.db"), str(tmp_path / "b.db"), "--table", str(table)]
    words += ["--report", str(page)]
    assert main(words) == 2
    assert "--table and --report are for --verify" in capsys.readouterr().err
    words += ["--verify", "--images", str(folder / "a")]
    assert main(words) == 0
    assert f"wrote {table}\nwrote {page}\n" in capsys.readouterr().out
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 15
    for row in rows:
        right = row["image1"][0] == row["image2"][0]
        assert (row["accepted"] == "yes") == right
        assert right or row["reason"].startswith("shows another place")
        assert (row["rotation_sigma_deg"] != "") >= right
    text = page.read_text(encoding="utf-8")
    assert "6 images gave 15 pairs (matched beforehand), and 6 pairs are accepted." in text
    assert "data:image/" in text and NO_PICTURES not in text
    assert main(words) == 2
    assert "is there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "path", "message"),
    [
        ("--table", "a.txt", "--table must end in .csv"),
        ("--report", "a.txt", "--report must end in .html"),
        ("--table", "none/a.csv", "none does not exist; create it first"),
    ],
)
def test_where_verdicts_cannot_be_written_is_said_before_the_work(
    tmp_path, capsys, option, path, message
):
    pytest.importorskip("pycolmap")
    from epi360.interop import write_colmap_database

    write_colmap_database(tmp_path / "a.db", panoramas_of_points(3)[1])
    words = ["convert", str(tmp_path / "a.db"), str(tmp_path / "b.db"), "--verify-again"]
    assert main([*words, option, str(tmp_path / path)]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "b.db").exists()


@pytest.mark.parametrize(
    ("factor", "message"), [(2.0, "lie outside its 2000x1000 pixels"), (0.5, "upper left quarters")]
)
def test_key_points_of_a_picture_of_another_size_are_refused(factor, message):
    _, graph = panoramas_of_points(3)
    images = {
        name: dataclasses.replace(image, keypoints=factor * image.keypoints)
        for name, image in graph.images.items()
    }
    with pytest.raises(ValueError, match=message):
        verify_pairs(without_geometries(dataclasses.replace(graph, images=images)))
