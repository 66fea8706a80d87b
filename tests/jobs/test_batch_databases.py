# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP databases and hloc's files as inputs of a batch, and the copy of a database it writes."""

import os
import subprocess
import sys

import numpy as np
import pytest
from batch_inputs import array_of, pose_rows, version_of

from epi360 import cli
from epi360.cameras import Equirectangular
from epi360.interop import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.jobs.batch import BatchJob, MatchSource, estimate_parts, missing_parts, run_batch
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg
from epi360.runs import whole_files

parquet = pytest.importorskip("pyarrow.parquet")

PANORAMA = Equirectangular(width=2000, height=1000)
NUM_POINTS, NUM_WRONG = 120, 30


@pytest.fixture(scope="module")
def world():
    """Poses cam_from_world of five panoramas and the graph of their ten pairs.

    A quarter of the matches is wrong; the last pair has none.
    """
    rng = np.random.default_rng(0)
    points = rng.normal(size=(NUM_POINTS, 3))
    points *= (rng.uniform(2, 5, NUM_POINTS) / np.linalg.norm(points, axis=1))[:, None]
    poses, images = {}, {}
    for name in ("a/ä 0.jpg", "a/1.jpg", "b/2.jpg", "b/3.jpg", "c.jpg"):
        pose = Pose(rotation_from_vector(0.4 * rng.normal(size=3)), 0.5 * rng.normal(size=3))
        pixels = PANORAMA.pixels_from_bearings(points @ pose.rotation.T + pose.translation)
        images[name] = MatchedImage(name, "pano", pixels + 0.3 * rng.normal(size=pixels.shape))
        poses[name] = pose
    matches = np.column_stack([np.arange(NUM_POINTS)] * 2)
    matches[:NUM_WRONG, 1] = np.roll(matches[:NUM_WRONG, 1], 1)
    names = list(images)
    pairs = [MatchedPair(a, b, matches) for i, a in enumerate(names) for b in names[i + 1 :]]
    pairs[-1] = MatchedPair(pairs[-1].image1, pairs[-1].image2, matches[:0])
    return poses, MatchGraph({"pano": PANORAMA}, images, tuple(pairs))


@pytest.fixture
def database(world, tmp_path):
    pytest.importorskip("pycolmap")
    from epi360.interop.colmap_database import write_colmap_database

    write_colmap_database(tmp_path / "in.db", world[1])
    return tmp_path / "in.db"


@pytest.fixture
def hloc(world, tmp_path):
    pytest.importorskip("h5py")
    from epi360.interop.hloc import write_hloc

    features, matches = tmp_path / "features.h5", tmp_path / "matches.h5"
    write_hloc(features, matches, world[1], pairs=tmp_path / "pairs.txt")
    return features, matches, tmp_path / "pairs.txt"


def assert_poses_are_right(path, poses):
    rows = parquet.read_table(path)
    status = rows.column("status").to_pylist()
    rotations = array_of(rows, "rotation", (3, 3))
    translations = array_of(rows, "translation", (3,))
    for k, (name1, name2) in enumerate(pairs_in(rows)):
        if {name1, name2} == {"b/3.jpg", "c.jpg"}:
            assert status[k] == "too_few_matches"
            continue
        truth = poses[name2] @ poses[name1].inverse()
        assert status[k] == "ok"
        pose = Pose(rotations[k], translations[k])
        assert rotation_error_deg(pose, truth) < 0.1
        assert translation_error_deg(pose, truth) < 0.5


def pairs_in(rows):
    names = (rows.column(name).to_pylist() for name in ("image1", "image2"))
    return list(zip(*names, strict=True))


def test_the_poses_of_a_database_are_right_and_the_database_stays(world, database, capsys):
    before = database.read_bytes(), os.stat(database).st_mtime_ns
    output = database.with_name("poses.parquet")
    assert cli.main(["batch", str(database), "--output", str(output)]) == 0
    assert_poses_are_right(output, world[0])
    assert pairs_in(parquet.read_table(output)) == [
        (pair.image1, pair.image2) for pair in world[1].pairs
    ]
    assert (database.read_bytes(), os.stat(database).st_mtime_ns) == before
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("10 pairs; ") and said[0].endswith(" pairs/s")
    assert said[1:] == ["  ok: 9", "  too_few_matches: 1", f"wrote {output}"]


def test_key_points_of_smaller_pictures_are_refused(world, tmp_path, capsys):
    pytest.importorskip("pycolmap")
    from epi360.interop.colmap_database import write_colmap_database

    graph = world[1]
    larger = {"pano": Equirectangular(width=4000, height=2000)}
    graph = MatchGraph(larger, graph.images, graph.pairs)
    write_colmap_database(tmp_path / "in.db", graph)
    words = ["batch", str(tmp_path / "in.db"), "--output", str(tmp_path / "poses.parquet")]
    assert cli.main(words) == 2
    assert "were they found in smaller pictures?" in capsys.readouterr().err
    assert not (tmp_path / "poses.parquet").exists()


def with_guessed_cameras(database):
    """What pycolmap writes for images whose camera nobody tells it of."""
    import pycolmap

    with pycolmap.Database.open(database) as file:
        (camera,) = file.read_all_cameras()
        guessed = pycolmap.Camera.create_from_model_name(
            camera.camera_id, "SIMPLE_RADIAL", 1.2 * camera.width, camera.width, camera.height
        )
        assert not guessed.has_prior_focal_length
        file.update_camera(guessed)
    return database


def test_a_camera_that_pycolmap_has_made_up_for_a_panorama_is_refused(database, capsys):
    output = str(database.with_name("poses.parquet"))
    assert cli.main(["batch", str(with_guessed_cameras(database)), "--output", output]) == 2
    said = capsys.readouterr().err
    assert "a/ä 0.jpg has the shape of a panorama, 2000x1000" in said and "--camera FILE" in said


def test_another_camera_takes_the_place_of_that_of_a_database(world, database, tmp_path, capsys):
    with_guessed_cameras(database)
    camera = tmp_path / "pano.yaml"
    camera.write_text("model: Equirectangular\nwidth: 2000\nheight: 1000\n")
    output = tmp_path / "poses.parquet"
    words = ["batch", str(database), "--camera", str(camera), "--output", str(output)]
    assert cli.main(words) == 0
    assert_poses_are_right(output, world[0])
    copy = ["--write-database", str(tmp_path / "copy.db")]
    assert cli.main([*words, *copy]) == 2
    assert "set the cameras in the database" in capsys.readouterr().err
    assert not (tmp_path / "copy.db").exists()


def test_the_poses_of_hlocs_files_are_right(world, hloc):
    features, matches, pairs = map(str, hloc)
    output = hloc[0].with_name("poses.parquet")
    words = ["batch", matches, "--features", features, "--pairs", pairs, "--output", str(output)]
    assert cli.main(words) == 0
    assert_poses_are_right(output, world[0])
    assert pairs_in(parquet.read_table(output)) == [
        (pair.image1, pair.image2) for pair in world[1].pairs
    ]


def test_hlocs_matches_need_the_features(hloc, capsys):
    assert cli.main(["batch", str(hloc[1]), "--output", str(hloc[1].with_name("out"))]) == 2
    assert "give --features FILE" in capsys.readouterr().err


def test_an_image_that_is_no_panorama_needs_a_camera(world, hloc, tmp_path):
    import h5py

    with h5py.File(hloc[0], "r+") as file:
        for name in world[1].images:
            file[name]["image_size"][...] = (2000, 700)
    source = MatchSource("hloc", str(hloc[1]), features=str(hloc[0]))
    with pytest.raises(ValueError, match="--camera FILE"):
        run_batch(BatchJob(source, str(tmp_path / "out.parquet")))


def test_parts_do_not_change_the_poses_and_a_restart_goes_on(database, tmp_path):
    whole = BatchJob(MatchSource("colmap", str(database)), str(tmp_path / "whole.parquet"))
    run_batch(whole)
    source = MatchSource("colmap", str(database), pairs_per_part=3)
    cut = BatchJob(source, str(tmp_path / "cut.parquet"))
    estimate_parts(cut, [2])
    assert missing_parts(cut) == [0, 1, 3]
    assert run_batch(cut).num_estimated == 7
    assert pose_rows(cut.output) == pose_rows(whole.output)


def test_a_changed_database_is_another_input(world, database, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    job = BatchJob(MatchSource("colmap", str(database), pairs_per_part=3), str(tmp_path / "o"))
    estimate_parts(job, [0])
    with pycolmap.Database.open(database) as opened:
        opened.delete_matches(1, 2)
        opened.write_matches(1, 2, np.column_stack([np.arange(50, dtype=np.uint32)] * 2))
    with pytest.raises(ValueError, match="poses of another job .input"):
        run_batch(job)


def geometries_in(path):
    from epi360.interop.colmap_database import read_colmap_database

    graph = read_colmap_database(path)
    return {(pair.image1, pair.image2): pair.geometry for pair in graph.pairs}


def test_the_copy_of_the_database_has_the_geometries(world, database, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    before = database.read_bytes()
    output, copy = tmp_path / "poses.parquet", tmp_path / "out.db"
    words = ["batch", str(database), "--output", str(output), "--write-database", str(copy)]
    assert cli.main([*words, "--pairs-per-part", "4"]) == 0
    assert database.read_bytes() == before
    rows = parquet.read_table(output)
    rotations, counts = array_of(rows, "rotation", (3, 3)), rows.column("num_inliers").to_pylist()
    geometries = geometries_in(copy)
    wrong = {(k, (k - 1) % NUM_WRONG) for k in range(NUM_WRONG)}
    for k, names in enumerate(pairs_in(rows)):
        geometry: TwoViewGeometry = geometries[names]
        assert len(geometry.inliers) == counts[k]
        if counts[k]:
            np.testing.assert_allclose(geometry.cam2_from_cam1.rotation, rotations[k], atol=1e-12)
            assert counts[k] > 70
            assert len(wrong & set(map(tuple, geometry.inliers.tolist()))) < 5
    with pycolmap.Database.open(copy) as opened:
        assert opened.num_verified_image_pairs() == 10
        assert opened.num_matched_image_pairs() == 10
    assert sorted(os.listdir(tmp_path)) == ["in.db", "out.db", "poses.parquet"]


def test_a_database_that_is_there_is_left_as_it_is_and_said(database, tmp_path, capsys):
    pytest.importorskip("pycolmap")
    output, copy = tmp_path / "poses.parquet", tmp_path / "out.db"
    words = ["batch", str(database), "--output", str(output), "--write-database"]
    assert cli.main([*words, str(copy)]) == 0
    before = copy.read_bytes(), database.read_bytes()
    capsys.readouterr()
    assert cli.main([*words, str(copy)]) == 0
    assert f"{copy} is there already, it is left as it is" in capsys.readouterr().out
    assert cli.main([*words, str(database)]) == 2  # what is read is never written
    assert "give the name of a new file" in capsys.readouterr().err
    assert (copy.read_bytes(), database.read_bytes()) == before


def test_an_output_that_is_read_is_refused(database, tmp_path, capsys):
    link = tmp_path / "poses.parquet"
    link.symlink_to(database)
    assert cli.main(["batch", str(database), "--output", str(link)]) == 2
    assert "poses.parquet is read; give the output another name" in capsys.readouterr().err


def leave_a_temporary_file(path):
    """What a run leaves that is killed while it writes a database, with SQLite's own file."""
    code = (
        "import os, sys; from epi360.runs.whole_files import whole_path\n"
        "with whole_path(sys.argv[1]) as path:\n"
        "    path.touch(); open(f'{path}-wal', 'w').close(); os._exit(9)"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert len(list(path.parent.glob(".*.tmp*"))) == 2
    whole_files.remove_leftovers.cache_clear()  # this process is another run


def test_geometries_that_were_there_are_replaced(world, database, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    with pycolmap.Database.open(database) as opened:
        old = pycolmap.TwoViewGeometry()
        old.config = pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED
        old.inlier_matches = np.zeros((7, 2), np.uint32)
        opened.write_two_view_geometry(1, 2, old)
    job = BatchJob(MatchSource("colmap", str(database)), str(tmp_path / "poses.parquet"))
    leave_a_temporary_file(tmp_path / "out.db")
    run_batch(job, database=str(tmp_path / "out.db"))
    assert sorted(os.listdir(tmp_path)) == ["in.db", "out.db", "poses.parquet"]
    geometry = geometries_in(tmp_path / "out.db")["a/ä 0.jpg", "a/1.jpg"]
    assert geometry.status == "ok" and len(geometry.inliers) > 70


def test_a_finished_output_gets_its_database_by_estimating_again(database, tmp_path):
    job = BatchJob(MatchSource("colmap", str(database)), str(tmp_path / "poses.parquet"))
    run_batch(job)
    before = version_of(job.output)
    summary = run_batch(job, database=str(tmp_path / "out.db"))
    assert (summary.num_estimated, summary.files) == (10, (str(tmp_path / "out.db"),))
    assert run_batch(job, database=str(tmp_path / "out.db")).num_estimated == 0
    assert version_of(job.output) == before
    assert sorted(os.listdir(tmp_path)) == ["in.db", "out.db", "poses.parquet"]


def test_a_database_that_is_there_is_not_overwritten(database, tmp_path):
    job = BatchJob(MatchSource("colmap", str(database)), str(tmp_path / "poses.parquet"))
    for target in (database, tmp_path / "mine.db"):
        (tmp_path / "mine.db").write_bytes(b"mine")
        before = target.read_bytes()
        with pytest.raises(ValueError, match="is there already"):
            run_batch(job, database=str(target))
        assert target.read_bytes() == before
    assert not os.path.exists(job.output)


def test_a_database_that_fails_leaves_no_half_copy_and_keeps_the_work(
    database, tmp_path, monkeypatch
):
    from epi360.jobs.batch import database_copy

    job = BatchJob(MatchSource("colmap", str(database)), str(tmp_path / "poses.parquet"))

    def fail(geometry):
        raise RuntimeError("database or disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(database_copy, "two_view_geometry_to_colmap", fail)
        with pytest.raises(OSError, match="out.db cannot be written: database or disk is full"):
            run_batch(job, database=str(tmp_path / "out.db"))
    assert sorted(os.listdir(tmp_path)) == ["in.db", "poses.parquet", "poses.parquet.parts"]
    assert run_batch(job, database=str(tmp_path / "out.db")).num_estimated == 0
    assert (tmp_path / "out.db").exists()


def test_databases_are_on_this_machine():
    with pytest.raises(ValueError, match="read from this machine's disks"):
        MatchSource("colmap", "s3://bucket/database.db")


LIMITED = """
import resource, sys
from epi360 import cli
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
sys.exit(cli.main(sys.argv[2:]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="limits of the size of files are POSIX")
def test_a_copy_that_does_not_fit_on_the_disk_is_an_error(world, database, tmp_path):
    # The geometries of a hundred pairs are what is too much, when SQLite closes the file.
    pycolmap = pytest.importorskip("pycolmap")
    graph = world[1]
    with pycolmap.Database.open(database) as opened:
        for number in range(60):
            image = pycolmap.Image(name=f"d/{number}.jpg", camera_id=1)
            opened.write_image(image)
        ids = [image.image_id for image in opened.read_all_images()]
        pixels = np.float32(graph.images["a/1.jpg"].keypoints)
        matches = np.uint32(graph.pairs[0].matches)
        for number in ids[5:]:
            opened.write_keypoints(number, pixels)
            opened.write_matches(1, number, matches)
            opened.write_matches(3, number, matches)
    room = os.path.getsize(database) + 4096
    copy, output = tmp_path / "out.db", tmp_path / "poses.parquet"
    words = ["batch", database, "--output", output, "--write-database", copy]
    answer = subprocess.run(
        [sys.executable, "-c", LIMITED, str(room), *map(str, words)],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert answer.returncode == 2
    assert f"{copy} cannot be written" in answer.stderr.splitlines()[-1]
    assert not copy.exists() and output.exists()
    assert [name for name in os.listdir(tmp_path) if name.endswith(".tmp")] == []
