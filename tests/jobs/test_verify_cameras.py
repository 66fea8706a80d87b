# SPDX-License-Identifier: BSD-3-Clause
"""Cameras on which the pairs of given matches agree: what is said of them, and who takes them."""

import dataclasses

import numpy as np
import pytest
from colmap_graphs import relative_pose

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.cli import main
from epi360.interop import MatchedImage, MatchedPair, MatchGraph
from epi360.jobs.matching.verify_pairs import verify_pairs
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg
from epi360.report.match_table import describe_verified

TRUE_LENS = KannalaBrandt(800, 800, 250.0, 250.0, 402.0, 397.0, 0.02, -0.008, max_angle_deg=90.0)
TOO_WIDE = dataclasses.replace(TRUE_LENS, fx=225.0, fy=225.0)
NUM_POINTS = 150


def seen_through(camera, taken_for, count=4):
    """Poses cam_from_world, and the matches of all pairs of images with a camera of their own."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-5.0, -5.0, 3.0], [5.0, 5.0, 6.0], (NUM_POINTS, 3))
    poses, images, seen = {}, {}, {}
    for index in range(count):
        name = f"{index}.jpg"
        pose = Pose(rotation_from_vector(0.1 * rng.normal(size=3)), rng.uniform(-0.8, 0.8, 3))
        pixels = camera.pixels_from_bearings(points @ pose.rotation.T + pose.translation)
        poses[name], seen[name] = pose, np.isfinite(pixels).all(axis=1)
        pixels = np.where(seen[name][:, None], pixels, 400.0) + 0.3 * rng.normal(size=pixels.shape)
        images[name] = MatchedImage(name, str(index), pixels)
    pairs = []
    for name1 in images:
        for name2 in images:
            if name1 < name2:
                rows = np.flatnonzero(seen[name1] & seen[name2])
                pairs.append(MatchedPair(name1, name2, np.column_stack([rows, rows])))
    cameras = {str(index): taken_for for index in range(count)}
    return poses, MatchGraph(cameras, images, tuple(pairs))


def with_one_camera(graph):
    images = {name: dataclasses.replace(image, camera="0") for name, image in graph.images.items()}
    return dataclasses.replace(graph, cameras={"0": graph.cameras["0"]}, images=images)


def errors_deg(found, poses):
    errors = []
    for verdict in found.verdicts:
        assert verdict.accepted
        truth = relative_pose(poses[verdict.image1], poses[verdict.image2])
        pose = verdict.cam2_from_cam1
        errors.append([rotation_error_deg(pose, truth), translation_error_deg(pose, truth)])
    return np.median(errors, axis=0)


@pytest.fixture(scope="module")
def wide():
    """Images of a lens that is taken for a wider one."""
    return seen_through(TRUE_LENS, TOO_WIDE)


def test_what_the_pairs_agree_on_is_told(wide):
    poses, graph = wide
    found = verify_pairs(with_one_camera(graph))
    assert found.graph.cameras == {"0": TOO_WIDE}
    (said,) = found.agreed
    assert said == "camera 0: 27.0 and 54.1 degrees from the axis, not 30 and 60"
    assert "--change-cameras takes the lenses" in describe_verified(found)
    assert errors_deg(found, poses).max() > 1.0


@pytest.mark.parametrize("has_one_camera", [True, False])
def test_the_pairs_are_judged_by_it_where_that_is_asked(wide, has_one_camera):
    poses, graph = wide
    given = with_one_camera(graph) if has_one_camera else graph
    found = verify_pairs(given, change_cameras=True)
    assert found.graph.cameras.keys() == given.cameras.keys()
    (camera,) = set(found.graph.cameras.values())
    assert camera.fx == pytest.approx(TRUE_LENS.fx, rel=0.01)
    assert errors_deg(found, poses).max() < 0.5
    (said,) = found.agreed
    assert said.startswith("camera 0: " if has_one_camera else "camera 0 and 3 that are equal: ")
    assert "They were judged by these" in describe_verified(found)


def test_nothing_is_said_of_a_right_lens():
    _, graph = seen_through(TRUE_LENS, TRUE_LENS)
    found = verify_pairs(graph, change_cameras=True)
    assert found.agreed == () and found.graph.cameras == graph.cameras


def test_panoramas_stay_where_they_shall():
    part = Equirectangular(2000, 1000, horizontal_fov_deg=340.0)
    _, graph = seen_through(part, Equirectangular(2000, 1000))
    kept = verify_pairs(graph, change_cameras=True, keep_panoramas=True)
    assert kept.agreed == () and kept.graph.cameras == graph.cameras
    told = describe_verified(verify_pairs(graph))
    assert "degrees around, not 360" in told and "--change-cameras" not in told
    changed = verify_pairs(graph, change_cameras=True)
    (camera,) = set(changed.graph.cameras.values())
    assert camera.horizontal_fov_deg == pytest.approx(340.0, abs=1.0)


def test_cameras_of_pairs_that_keep_their_poses_cannot_change(wide):
    verified = verify_pairs(wide[1]).graph
    with pytest.raises(ValueError, match=r"6 have been by the given ones: verify all again"):
        verify_pairs(verified, change_cameras=True)


@pytest.fixture
def database(wide, tmp_path):
    pytest.importorskip("pycolmap")
    from epi360.interop import write_colmap_database

    write_colmap_database(tmp_path / "wide.db", wide[1])
    return tmp_path / "wide.db"


def convert(capsys, *words):
    code = main(["convert", *map(str, words)])
    out, err = capsys.readouterr()
    return code, " ".join((out + err).split())


def test_the_command_writes_the_cameras_that_it_judged_by(database, tmp_path, capsys):
    from epi360.interop import read_colmap_database

    code, said = convert(capsys, database, tmp_path / "told.db", "--verify")
    assert code == 0 and "--change-cameras takes the lenses" in said
    code, said = convert(capsys, tmp_path / "told.db", tmp_path / "x.db", "--verify")
    assert code == 0 and "All pairs have a verdict already" in said
    code, said = convert(capsys, tmp_path / "told.db", tmp_path / "x1.db", "--change-cameras")
    assert code == 2 and "--change-cameras is for --verify" in said
    words = tmp_path / "told.db", tmp_path / "changed.db", "--change-cameras"
    code, said = convert(capsys, *words, "--verify")
    assert code == 2 and "--change-cameras needs --verify-again: 6 pairs are verified" in said
    hloc = tmp_path / "m.h5", "--features", tmp_path / "f.h5"
    code, said = convert(capsys, words[0], *hloc, "--verify-again", "--change-cameras")
    assert code == 2 and "hloc's files keep no cameras" in said
    code, said = convert(capsys, *words, "--verify-again")
    assert code == 0 and "They were judged by these" in said
    for camera in read_colmap_database(tmp_path / "changed.db").cameras.values():
        assert camera.fx == pytest.approx(TRUE_LENS.fx, rel=0.01)


def test_cameras_of_a_database_are_replaced_to_judge_it(database, tmp_path, capsys):
    from epi360.interop import read_colmap_database

    lens = tmp_path / "lens.yaml"
    lens.write_text(
        "model: KannalaBrandt\nwidth: 800\nheight: 800\nfx: 250\nfy: 250\ncx: 402\ncy: 397\n"
        "k1: 0.02\nk2: -0.008\n"
    )
    words = database, tmp_path / "right.db", "--camera", lens
    code, said = convert(capsys, *words)
    assert code == 2 and "--camera is for images without one, and for --verify" in said
    code, said = convert(capsys, *words, "--verify")
    assert code == 0 and "other angles" not in said
    for camera in read_colmap_database(tmp_path / "right.db").cameras.values():
        assert camera.fx == 250.0
    lens.write_text(lens.read_text().replace("800", "640"))
    code, said = convert(capsys, database, tmp_path / "x.db", "--verify", "--camera", lens)
    assert code == 2 and "0.jpg, an image of camera 1 of 800x800 pixels, has none of" in said


def test_a_camera_that_pycolmap_made_up_is_refused_where_poses_need_it(tmp_path, capsys):
    pycolmap = pytest.importorskip("pycolmap")
    from epi360.interop import write_colmap_database

    whole = Equirectangular(2000, 1000)
    _, graph = seen_through(whole, whole)
    path = tmp_path / "guessed.db"
    write_colmap_database(path, graph)
    with pycolmap.Database.open(path) as file:
        for camera in file.read_all_cameras():
            guessed = pycolmap.Camera.create_from_model_name(
                camera.camera_id, "SIMPLE_RADIAL", 2400.0, 2000, 1000
            )
            file.update_camera(guessed)
    code, said = convert(capsys, path, tmp_path / "a.db", "--verify")
    assert code == 2 and "as pycolmap makes one up; give the true camera by --camera FILE" in said
    assert convert(capsys, path, tmp_path / "b.db")[0] == 0  # nothing needs it
    panorama = tmp_path / "panorama.yaml"
    panorama.write_text("model: Equirectangular\nwidth: 2000\nheight: 1000\n")
    code, said = convert(capsys, path, tmp_path / "c.db", "--verify", "--camera", panorama)
    assert code == 0 and "Accepted 6" in said


def test_a_database_without_one_right_pair_is_told_by_the_exit_code(tmp_path, capsys):
    pytest.importorskip("pycolmap")
    from epi360.interop import write_colmap_database

    whole = Equirectangular(2000, 1000)
    _, graph = seen_through(whole, whole, count=3)
    rng = np.random.default_rng(0)
    images = {
        name: dataclasses.replace(image, keypoints=rng.uniform(0.0, [2000.0, 1000.0], (150, 2)))
        for name, image in graph.images.items()
    }
    write_colmap_database(tmp_path / "a.db", dataclasses.replace(graph, images=images))
    code, said = convert(capsys, tmp_path / "a.db", tmp_path / "b.db", "--verify")
    assert code == 1 and "Accepted 0" in said and (tmp_path / "b.db").exists()
