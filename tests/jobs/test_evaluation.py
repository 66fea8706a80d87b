# SPDX-License-Identifier: BSD-3-Clause
"""Errors of trajectories: hand-made truth, laws, and what evo prints."""

from pathlib import Path

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.interop.colmap_model import write_colmap_model
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.interop.tum import write_tum_trajectory
from epi360.jobs.evaluation import evaluate
from epi360.jobs.trajectories import (
    Similarity,
    align,
    matching_frames,
    posed_frames,
    read_trajectory,
)
from epi360.poses import Pose, rotation_from_vector


def straight(count=11, step_m=1.0):
    """A camera that goes straight ahead along x without turning."""
    poses = [Pose(np.eye(3), np.array([step_m * k, 0.0, 0.0])) for k in range(count)]
    return frames_of(poses)


def frames_of(poses, names=None, times=True):
    names = names or [f"{k}.jpg" for k in range(len(poses))]
    return posed_frames(names, np.arange(len(poses)) / 10 if times else None, poses)


def wandering(count=60, seed=0):
    """A smooth random walk of 6 degrees of freedom."""
    rng = np.random.default_rng(seed)
    pose, poses, speed, spin = Pose(np.eye(3), np.zeros(3)), [], np.zeros(3), np.zeros(3)
    for _ in range(count):
        speed = 0.9 * speed + 0.03 * rng.standard_normal(3)
        spin = 0.9 * spin + 0.02 * rng.standard_normal(3)
        pose = pose @ Pose(rotation_from_vector(spin), speed + [0, 0, 0.1])
        poses.append(pose)
    return poses


def disturbed(poses, seed=1, position=0.02, angle=0.01):
    rng = np.random.default_rng(seed)
    return [
        Pose(
            pose.rotation @ rotation_from_vector(angle * rng.standard_normal(3)),
            pose.translation + position * rng.standard_normal(3),
        )
        for pose in poses
    ]


def moved(poses, scale=0.3):
    """The same way in another world, of another scale."""
    world = Pose(rotation_from_vector([0.4, -1.0, 0.7]), np.array([5.0, -2.0, 1.0]))
    return [world @ Pose(pose.rotation, scale * pose.translation) for pose in poses]


def test_one_position_that_is_off_gives_errors_a_reader_can_check():
    poses = [Pose(np.eye(3), np.array([float(k), 0.0, 0.0])) for k in range(11)]
    wrong = list(poses)
    wrong[5] = Pose(np.eye(3), np.array([5.0, 0.3, 0.0]))
    result = evaluate(frames_of(wrong), frames_of(poses), alignment="none", distance_m=2.0)
    assert result.path_m == 10 and result.coverage == 1
    np.testing.assert_allclose(result.position_errors_m, [0] * 5 + [0.3] + [0] * 5, atol=1e-12)
    np.testing.assert_allclose(result.steps.translation_m, [0] * 4 + [0.3, 0.3] + [0] * 4)
    assert result.stretches.pairs.tolist() == [[k, k + 2] for k in range(9)]
    np.testing.assert_allclose(result.stretches.length_m, 2.0)
    expected = np.zeros(9)
    expected[[3, 5]] = np.degrees(np.arctan2(0.3, 2.0))
    np.testing.assert_allclose(result.stretches.direction_deg, expected, atol=1e-9)


def test_a_camera_that_is_turned_by_a_degree_has_that_error():
    poses = [Pose(np.eye(3), np.array([float(k), 0.0, 0.0])) for k in range(6)]
    turn = rotation_from_vector(np.radians([0.0, 1.0, 0.0]))
    wrong = [Pose(turn if k == 3 else np.eye(3), pose.translation) for k, pose in enumerate(poses)]
    result = evaluate(frames_of(wrong), frames_of(poses), alignment="se3", distance_m=1.0)
    np.testing.assert_allclose(result.rotation_errors_deg, [0, 0, 0, 1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(result.steps.rotation_deg, [0, 0, 1, 1, 0], atol=1e-9)
    # From camera 2, camera 1's direction turns only where camera 2 is the one that is turned.
    np.testing.assert_allclose(result.steps.direction_deg, [0, 0, 1, 0, 0], atol=1e-9)


def test_a_straight_way_says_nothing_about_the_turn_of_the_cameras_about_it():
    poses = [Pose(np.eye(3), np.array([float(k), 0.0, 0.0])) for k in range(6)]
    turned = Pose(rotation_from_vector([0.7, 0.0, 0.0]), np.zeros(3))
    result = evaluate(frames_of([turned @ pose for pose in poses]), frames_of(poses))
    np.testing.assert_allclose(result.orientation_errors_deg, 0, atol=1e-9)
    unaligned = evaluate(
        frames_of([turned @ pose for pose in poses]), frames_of(poses), alignment="none"
    )
    np.testing.assert_allclose(unaligned.orientation_errors_deg, np.degrees(0.7), atol=1e-9)


def test_drift_of_scale_is_said_for_a_metre():
    poses = [Pose(np.eye(3), np.array([0.1 * k, 0.0, 0.0])) for k in range(101)]
    longer = [Pose(np.eye(3), 1.02 * pose.translation) for pose in poses]
    result = evaluate(frames_of(longer), frames_of(poses), alignment="none")
    assert result.distance_m == 1.0 and len(result.stretches.pairs) == 91
    errors = result.stretches.translation_m / result.stretches.length_m
    np.testing.assert_allclose(errors, 0.02, atol=1e-12)
    aligned = evaluate(frames_of(longer), frames_of(poses), alignment="sim3")
    assert aligned.similarity.scale == pytest.approx(1 / 1.02)
    assert aligned.position_errors_m.max() < 1e-12


def test_another_world_changes_nothing_after_sim3():
    truth = wandering()
    estimate = disturbed(truth)
    here = evaluate(frames_of(estimate), frames_of(truth))
    there = evaluate(frames_of(moved(estimate)), frames_of(truth))
    np.testing.assert_allclose(there.position_errors_m, here.position_errors_m, atol=1e-9)
    np.testing.assert_allclose(there.rotation_errors_deg, here.rotation_errors_deg, atol=1e-9)
    for name in ("translation_m", "rotation_deg", "direction_deg"):
        np.testing.assert_allclose(
            getattr(there.stretches, name), getattr(here.stretches, name), atol=1e-7
        )


@pytest.mark.parametrize("scale", [1.0, 0.2])
def test_alignment_finds_the_transform_again(scale):
    truth = np.random.default_rng(0).standard_normal((20, 3))
    rotation = rotation_from_vector([0.3, 2.0, -0.4])
    estimate = (truth - [1.0, 2.0, 3.0]) @ rotation / scale
    found = align(estimate, truth, "sim3")
    assert found.scale == pytest.approx(scale)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, [1.0, 2.0, 3.0], atol=1e-12)


def test_no_small_turn_or_shift_of_the_alignment_makes_the_error_smaller():
    truth, estimate = frames_of(wandering()), frames_of(moved(disturbed(wandering())))
    best = evaluate(estimate, truth)
    rng = np.random.default_rng(0)
    for _ in range(20):
        other = Similarity(
            best.similarity.scale * (1 + 1e-3 * rng.standard_normal()),
            best.similarity.rotation @ rotation_from_vector(1e-3 * rng.standard_normal(3)),
            best.similarity.translation + 1e-3 * rng.standard_normal(3),
        )
        errors = np.linalg.norm(other.of(estimate).positions - truth.positions, axis=1)
        assert (errors**2).sum() > (best.position_errors_m**2).sum()


def test_frames_without_a_pose_lower_the_coverage():
    truth = frames_of(wandering())
    estimate = truth.rows(np.arange(15, 60))
    result = evaluate(estimate, truth)
    assert result.coverage == 0.75 and result.num_truth == 60


def test_times_match_the_nearest_frame_within_the_gap_and_each_frame_once():
    truth = posed_frames(["a", "b", "c"], np.array([0.0, 0.1, 0.2]), wandering(3))
    estimate = posed_frames(
        ["x", "y", "z", "w"], np.array([0.004, 0.006, 0.115, 0.2]), wandering(4)
    )
    rows, truth_rows = matching_frames(estimate, truth, 0.01)
    assert (rows.tolist(), truth_rows.tolist()) == ([0, 3], [0, 2])
    rows, truth_rows = matching_frames(estimate, truth, 0.02)
    assert (rows.tolist(), truth_rows.tolist()) == ([0, 2, 3], [0, 1, 2])


def test_names_match_where_times_are_missing_also_without_folder_and_extension():
    truth = frames_of(wandering(3), ["2.png", "10.png", "3.png"], times=False)
    estimate = frames_of(wandering(2), ["images/10.jpg", "images/2.jpg"])
    rows, truth_rows = matching_frames(estimate, truth, 0.01)
    assert (rows.tolist(), truth_rows.tolist()) == ([1, 0], [0, 1])


def test_frames_of_two_cameras_are_told_apart_by_their_folders():
    names = ["walk/cam0/1.png", "walk/cam1/1.png", "walk/cam0/2.png"]
    truth = frames_of(wandering(3), names, times=False)
    estimate = frames_of(wandering(3), ["cam1/1.jpg", "cam0/1.jpg", "cam1/2.jpg"], times=False)
    rows, truth_rows = matching_frames(estimate, truth, 0.01)
    assert (rows.tolist(), truth_rows.tolist()) == ([1, 0], [0, 1])
    flat = frames_of(wandering(2), ["1.jpg", "2.jpg"], times=False)
    with pytest.raises(ValueError, match=r"cam0/1.png and walk/cam1/1.png are both the frame 1"):
        matching_frames(flat, truth, 0.01)


def test_one_name_that_is_the_same_does_not_keep_others_from_being_compared_without_extension():
    truth = frames_of(wandering(3), ["1.png", "2.png", "3.png"], times=False)
    estimate = frames_of(wandering(3), ["3.jpg", "2.png", "1.jpg"], times=False)
    rows, truth_rows = matching_frames(estimate, truth, 0.01)
    assert (rows.tolist(), truth_rows.tolist()) == ([2, 1, 0], [0, 1, 2])


def test_times_of_a_trajectory_are_never_taken_for_names(tmp_path):
    # Image 1.png is the first one and has the time 0, as in a rendered sequence.
    truth = read_trajectory(write_tum(tmp_path / "truth.txt", wandering(12)))
    estimate = frames_of(wandering(12), [f"{k + 1}.png" for k in range(12)], times=False)
    with pytest.raises(ValueError, match=r"truth has times and no names.*--frames"):
        evaluate(estimate, truth)
    with pytest.raises(ValueError, match=r"estimate has times and no names.*--frames"):
        evaluate(truth, estimate)


def test_a_table_of_frames_must_have_a_time_for_each_image(tmp_path):
    images = [PosedImage(f"{k}.jpg", "c", pose.inverse()) for k, pose in enumerate(wandering(4))]
    write_colmap_model(
        tmp_path / "model", Reconstruction({"c": Equirectangular(8, 4)}, tuple(images))
    )
    with pytest.raises(ValueError, match=r"1 of 4 images of .*model have no time.*such as 3.jpg"):
        read_trajectory(tmp_path / "model", {f"{k}.jpg": float(k) for k in range(3)})
    with pytest.raises(ValueError, match=r"no image of .*model has a time.*as 0.jpg, the table x"):
        read_trajectory(tmp_path / "model", {"x.jpg": 0.0})


def of_two_cameras(tmp_path):
    """Model of a rig: three moments of two cameras, and the front one's poses."""
    poses = wandering(3)
    images = [
        PosedImage(f"{camera}/{k}.jpg", "c", pose.inverse())
        for camera in ("front", "back")
        for k, pose in enumerate(poses)
    ]
    write_colmap_model(
        tmp_path / "rig", Reconstruction({"c": Equirectangular(8, 4)}, tuple(images))
    )
    return tmp_path / "rig", poses


def test_two_images_of_one_time_are_no_trajectory(tmp_path):
    model, poses = of_two_cameras(tmp_path)
    both = {f"{camera}/{k}.jpg": float(k) for camera in ("front", "back") for k in range(3)}
    truth = posed_frames(["a", "b", "c"], np.arange(3.0), poses)
    with pytest.raises(ValueError, match=r"(front|back)/0.jpg have the same time; a trajectory"):
        evaluate(read_trajectory(model, both), truth)


def test_a_table_of_one_camera_leaves_out_the_others(tmp_path):
    model, poses = of_two_cameras(tmp_path)
    frames = read_trajectory(model, {f"front/{k}.jpg": float(k) for k in range(3)})
    assert frames.names == ("front/0.jpg", "front/1.jpg", "front/2.jpg")
    np.testing.assert_allclose(frames.positions, [pose.translation for pose in poses], atol=1e-12)


def test_too_few_frames_in_common_and_a_still_estimate_are_refused():
    truth = straight()
    later = posed_frames(list(truth.names), truth.times_s + 100, wandering(11))
    with pytest.raises(ValueError, match="0 of 11 true frames.*times from 100 to 101 s"):
        evaluate(later, truth)
    other = frames_of(wandering(4), ["p", "q", "r", "s"], times=False)
    with pytest.raises(ValueError, match="the names differ, such as p and 0.jpg"):
        evaluate(other, truth)
    still = frames_of([Pose(np.eye(3), np.ones(3))] * 11)
    with pytest.raises(ValueError, match="it has no scale"):
        evaluate(still, truth)
    assert evaluate(still, truth, alignment="se3").position_errors_m.max() == pytest.approx(5)
    with pytest.raises(ValueError, match="distance_m must be positive"):
        evaluate(truth, truth, distance_m=0.0)


def write_tum(path, poses):
    images = tuple(
        PosedImage(f"{k / 10}", None, pose.inverse(), k / 10) for k, pose in enumerate(poses)
    )
    write_tum_trajectory(path, Reconstruction({}, images))
    return path


def test_a_trajectory_file_is_read_in_the_order_of_its_times(tmp_path):
    poses = wandering(12)
    path = write_tum(tmp_path / "way.txt", poses)
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *rows[::-1]]) + "\n")
    frames = read_trajectory(path)
    np.testing.assert_allclose(frames.times_s, np.arange(12) / 10)
    np.testing.assert_allclose(frames.positions, [pose.translation for pose in poses], atol=1e-12)


# What evo 1.38.1 printed as rmse for the files in the folder evo: evo_ape, evo_ape -r angle_deg,
# evo_rpe -r trans_part and evo_rpe -r angle_deg --delta 1 --delta_unit f, with --align and for sim3
# --correct_scale. evo is GPL and is not needed here.
EVO = {
    "sim3": (0.019856, 0.887915, 0.029729, 1.256412),
    "se3": (0.305907, 0.887915, 0.037245, 1.256412),
}


@pytest.mark.parametrize("alignment", EVO)
def test_ate_and_rpe_agree_with_evo(alignment):
    folder = Path(__file__).parent / "evo"
    estimate, truth = (read_trajectory(folder / f"{name}.txt") for name in ("estimate", "truth"))
    ours = evaluate(estimate, truth, alignment=alignment)
    errors = (
        ours.position_errors_m,
        ours.rotation_errors_deg,
        ours.steps.translation_m,
        ours.steps.rotation_deg,
    )
    for values, theirs in zip(errors, EVO[alignment], strict=True):
        assert np.sqrt(np.mean(values**2)) == pytest.approx(theirs, abs=2e-6)
