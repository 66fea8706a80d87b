# SPDX-License-Identifier: BSD-3-Clause
"""Maps that begin with given poses: rendered images whose poses are disturbed, and some missing."""

import shutil

import numpy as np
import pytest
from mapped_room import room_poses
from test_mapping import aligned_errors, poses_of, rig_graph

pytest.importorskip("pycolmap")

from epi360.interop import PosedImage, Reconstruction  # noqa: E402
from epi360.interop.colmap_database import write_colmap_database  # noqa: E402
from epi360.jobs.folder.image_set import find_images  # noqa: E402
from epi360.jobs.mapping import map_folder  # noqa: E402
from epi360.jobs.mapping.colmap_mapper import MapperOptions  # noqa: E402
from epi360.jobs.mapping.given_poses import model_from_poses  # noqa: E402
from epi360.jobs.mapping.map_attempts import map_by_attempts  # noqa: E402
from epi360.jobs.mapping.map_folder import MapOptions, map_images  # noqa: E402
from epi360.jobs.matching.match_folder import MatchOptions  # noqa: E402
from epi360.jobs.matching.match_result import load_matches_and_colors  # noqa: E402
from epi360.poses import Pose, rotation_from_vector  # noqa: E402

PATH = 0.3  # metres from one place of the room to the next


def disturbed(truth, *, degrees, share, seed=0):
    """Poses as a drifting odometry may give them, in a world of its own scale."""
    rng = np.random.default_rng(seed)
    images = []
    for name, world_from_cam in truth.items():
        turn = rotation_from_vector(np.radians(degrees) * rng.normal(size=3) / np.sqrt(3))
        moved = world_from_cam.translation + share * PATH * rng.normal(size=3) / np.sqrt(3)
        pose = Pose(world_from_cam.rotation @ turn, 4.0 * moved).inverse()
        images.append(PosedImage(name, None, pose))
    return Reconstruction({}, tuple(images))


@pytest.fixture
def output(room_run, tmp_path):
    """Folder with the matches of the room, which need not be found again."""
    copy = tmp_path / "out"
    shutil.copytree(room_run[0], copy)
    return copy


def options():
    return MapOptions(MatchOptions(num_threads=1), mapper_threads=1)


def test_disturbed_poses_are_adjusted_and_no_mapper_runs(room_folder, output, monkeypatch):
    folder, truth = room_folder
    initial = disturbed(truth, degrees=1.0, share=0.1)
    before = aligned_errors(poses_of(initial), truth)
    assert before[0] > 0.01 and before[1] > 0.5
    monkeypatch.setattr(
        "epi360.jobs.mapping.map_attempts.run_mapper", lambda *_, **__: pytest.fail()
    )
    run = map_images(find_images(folder), output, options(), initial=initial)
    (attempt,) = run.attempts
    assert (attempt.how, attempt.num_registered, attempt.kept) == ("the given poses", 6, True)
    position, degrees = aligned_errors(poses_of(run.models[0].reconstruction), truth)
    assert position < 0.004 and degrees < 0.15  # as the incremental mapper's
    assert len(run.models[0].reconstruction.points) > 200
    assert run.models[0].reconstruction.colors.std(axis=0).min() > 20


def test_images_without_a_given_pose_are_added(room_folder, output):
    folder, truth = room_folder
    known = {name: pose for name, pose in truth.items() if not name.endswith(("0.png", "3.png"))}
    initial = disturbed(known, degrees=0.3, share=0.03)
    run = map_images(find_images(folder), output, options(), initial=initial)
    poses = poses_of(run.models[0].reconstruction)
    assert poses.keys() == truth.keys()
    position, degrees = aligned_errors(poses, truth)
    assert position < 0.004 and degrees < 0.15


def test_poses_that_are_wrong_throughout_are_given_up_for_a_mapper(room_folder, output):
    folder, truth = room_folder
    initial = disturbed(truth, degrees=120.0, share=5.0)
    run = map_images(find_images(folder), output, options(), initial=initial)
    assert [attempt.kept for attempt in run.attempts] == [False, True]
    assert run.attempts[1].how == "incremental mapper"
    position, degrees = aligned_errors(poses_of(run.models[0].reconstruction), truth)
    assert position < 0.004 and degrees < 0.15


def test_other_given_poses_are_mapped_again_and_the_same_are_not(room_folder, output):
    folder, truth = room_folder
    images, initial = find_images(folder), disturbed(truth, degrees=0.3, share=0.03)
    first = map_images(images, output, options(), initial=initial)
    again = map_images(images, output, options(), initial=initial)
    assert not first.was_mapped and again.was_mapped
    assert again.attempts == first.attempts
    other = disturbed(truth, degrees=0.3, share=0.03, seed=1)
    assert not map_images(images, output, options(), initial=other).was_mapped


def test_poses_of_other_images_are_refused(room_folder, output):
    initial = disturbed({"nowhere.png": room_poses(1)[0]}, degrees=0.0, share=0.0)
    with pytest.raises(ValueError, match="initial must have poses of the images"):
        map_images(find_images(room_folder[0]), output, options(), initial=initial)


def test_the_frames_of_a_rig_are_placed_and_its_cameras_stay(tmp_path):
    back_from_front = Pose(rotation_from_vector([0.0, 2.0, 0.0]), np.array([0.0, 0.0, -0.3]))
    graph, poses = rig_graph(back_from_front)
    write_colmap_database(tmp_path / "database.db", graph)
    rng = np.random.default_rng(0)
    given = {
        name: Pose(rotation_from_vector(0.01 * rng.normal(size=3)), np.zeros(3)) @ pose
        for name, pose in poses.items()
        if name.startswith("front")
    }
    model = model_from_poses(tmp_path / "database.db", given, MapperOptions())
    assert model.num_reg_images() == 8
    found = {
        image.name: Pose.from_matrix(image.cam_from_world().matrix())
        for image in model.images.values()
    }
    for frame in range(4):
        pose = found[f"back/{frame}.png"] @ found[f"front/{frame}.png"].inverse()
        np.testing.assert_allclose(pose.matrix(), back_from_front.matrix(), atol=1e-9)
    truth = {name: pose.inverse() for name, pose in poses.items()}
    position, degrees = aligned_errors({name: p.inverse() for name, p in found.items()}, truth)
    assert position < 0.001 and degrees < 0.03  # 0.0003, 0.018 measured


def test_what_was_tried_is_in_the_record(room_folder, output):
    images = find_images(room_folder[0])
    map_images(images, output, options())
    record = map_folder.read_record(output / map_folder.RECORD, remedy="")
    assert [each["how"] for each in record["attempts"]] == ["incremental mapper"]
    assert record["attempts"][0]["num_registered"] == 6
    assert record["unconfirmed"] == []
    graph, colors = load_matches_and_colors(output)
    assert (
        map_by_attempts(output / map_folder.DATABASE, MapperOptions(), graph, [], colors=colors)
        .attempts[0]
        .num_registered
        == 6
    )
