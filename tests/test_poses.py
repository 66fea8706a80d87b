# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360.poses import (
    Pose,
    poses_agree,
    rotation_error_deg,
    rotation_from_vector,
    translation_error_deg,
    vector_from_rotation,
)

QUARTER_TURN_RIGHT = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # about y (down): +z goes to +x


def random_pose(seed: int) -> Pose:
    rng = np.random.default_rng(seed)
    return Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))


def about(axis, angle_deg: float) -> np.ndarray:
    axis = np.asarray(axis, dtype=float)
    return rotation_from_vector(axis / np.linalg.norm(axis) * np.radians(angle_deg))


@pytest.mark.parametrize("seed", range(10))
def test_pose_times_its_inverse_is_the_identity(seed):
    pose = random_pose(seed)
    np.testing.assert_allclose((pose @ pose.inverse()).matrix(), np.eye(4), atol=1e-14)
    np.testing.assert_allclose((pose.inverse() @ pose).matrix(), np.eye(4), atol=1e-14)


@pytest.mark.parametrize("seed", range(10))
def test_composition_is_associative_and_multiplies_the_matrices(seed):
    a, b, c = (random_pose(100 * seed + i) for i in range(3))
    np.testing.assert_allclose(((a @ b) @ c).matrix(), (a @ (b @ c)).matrix(), atol=1e-13)
    np.testing.assert_allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-14)


@pytest.mark.parametrize("rows", [3, 4])
def test_pose_goes_through_its_matrix_unchanged(rows):
    pose = random_pose(0)
    copy = Pose.from_matrix(pose.matrix()[:rows])
    np.testing.assert_array_equal(copy.rotation, pose.rotation)
    np.testing.assert_array_equal(copy.translation, pose.translation)


def test_composition_of_two_poses_by_hand():
    cam2_from_cam1 = Pose(QUARTER_TURN_RIGHT, [1, 0, 0])
    twice = cam2_from_cam1 @ cam2_from_cam1
    np.testing.assert_array_equal(twice.rotation, np.diag([-1.0, 1.0, -1.0]))
    np.testing.assert_array_equal(twice.translation, [1.0, 0.0, -1.0])


def test_pose_keeps_copies_that_nobody_can_change():
    rotation = np.eye(3)
    pose = Pose(rotation, np.zeros(3))
    rotation[0, 0] = 5.0
    assert pose.rotation[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        pose.translation[0] = 1.0
    with pytest.raises(AttributeError):
        pose.rotation = rotation


def test_single_precision_and_lists_become_float64():
    pose = Pose(random_pose(3).rotation.astype(np.float32), [0, 0, 1])
    assert pose.rotation.dtype == pose.translation.dtype == np.float64


def test_pose_of_nan_stays_nan():
    pose = Pose.nan()
    assert np.isnan(pose.rotation).all() and np.isnan(pose.translation).all()
    assert np.isnan((pose @ random_pose(0)).rotation).all()
    assert np.isnan(pose.inverse().translation).all()
    assert np.isnan(pose.quaternion_wxyz).all()


def test_unknown_translation_leaves_the_rotation_usable():
    pose = Pose(QUARTER_TURN_RIGHT, np.full(3, np.nan))
    np.testing.assert_array_equal(pose.inverse().rotation, np.transpose(QUARTER_TURN_RIGHT))
    assert rotation_error_deg(pose, np.eye(3)) == pytest.approx(90, abs=1e-12)
    assert np.isnan(translation_error_deg(pose, [0, 0, 1]))


@pytest.mark.parametrize(
    ("rotation", "translation", "message"),
    [
        (np.eye(4), np.zeros(3), r"rotation must have shape \(3, 3\), got \(4, 4\)"),
        (np.eye(3), np.zeros((3, 1)), r"translation must have shape \(3,\), got \(3, 1\)"),
        (1.01 * np.eye(3), np.zeros(3), "orthonormal"),
        (np.diag([1, 1, -1]), np.zeros(3), "determinant"),
        (np.eye(3), [0, np.inf, 0], "translation must be finite"),
        (np.full((3, 3), np.inf), np.zeros(3), "rotation must be finite"),
    ],
)
def test_pose_refuses_what_is_no_rigid_transform(rotation, translation, message):
    with pytest.raises(ValueError, match=message):
        Pose(rotation, translation)


def test_from_matrix_refuses_other_shapes_and_last_rows():
    with pytest.raises(ValueError, match=r"matrix must have shape \(3, 4\) or \(4, 4\)"):
        Pose.from_matrix(np.eye(3))
    with pytest.raises(ValueError, match="last row"):
        Pose.from_matrix(np.diag([1, 1, 1, 2]))


def rotation_from_quaternion(wxyz: np.ndarray) -> np.ndarray:
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.mark.parametrize("angle_deg", [0, 1e-9, 30, 120, 180 - 1e-9, 180, 270])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, -2, 3)])
def test_quaternion_is_of_unit_length_and_gives_the_rotation_back(axis, angle_deg):
    rotation = about(axis, angle_deg)
    wxyz = Pose(rotation, np.zeros(3)).quaternion_wxyz
    assert wxyz[0] >= 0
    assert np.linalg.norm(wxyz) == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(rotation_from_quaternion(wxyz), rotation, atol=1e-14)


def test_quaternion_of_a_quarter_turn_by_hand():
    wxyz = Pose(QUARTER_TURN_RIGHT, np.zeros(3)).quaternion_wxyz
    np.testing.assert_allclose(wxyz, [np.sqrt(0.5), 0, np.sqrt(0.5), 0], atol=1e-15)


@pytest.mark.parametrize("angle", [0, 1e-300, 1e-12, 1e-5, 1.0, 3.0, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, -1, 0), (1, -2, 3)])
def test_vector_to_rotation_and_back_is_the_identity(axis, angle):
    vector = angle * np.asarray(axis) / np.linalg.norm(axis)
    back = vector_from_rotation(rotation_from_vector(vector))
    if angle == np.pi:  # both axes are right
        back = back * np.sign(back @ vector)
    np.testing.assert_allclose(back, vector, rtol=1e-12, atol=2e-15)


@pytest.mark.parametrize("number", [1e101, -1e200, 1.7e308])
def test_a_vector_whose_length_is_no_number_is_refused(number):
    assert rotation_from_vector([1e100, 0, 0]) @ [1, 0, 0] == pytest.approx([1, 0, 0])
    with pytest.raises(ValueError, match=r"rotation vector must be at most 1e\+100 long"):
        rotation_from_vector([0, number, 1])


def test_rotation_from_a_long_vector_wraps_around():
    once, again = about((1, 2, 3), 40), about((1, 2, 3), 760)
    np.testing.assert_allclose(again, once, atol=1e-14)
    np.testing.assert_allclose(once @ once.T, np.eye(3), atol=1e-15)


def test_vector_of_an_unknown_rotation_is_nan():
    assert np.isnan(vector_from_rotation(np.full((3, 3), np.nan))).all()


@pytest.mark.parametrize(
    "angle_deg", [0, 1e-9, 1e-6, 1e-3, 1, 89.9, 90, 179, 180 - 1e-6, 180 - 1e-9, 180]
)
def test_angles_between_poses_are_exact_from_tiny_to_half_a_turn(angle_deg):
    base = random_pose(7)
    turned = Pose(base.rotation @ about((1, -2, 3), angle_deg), base.translation)
    assert rotation_error_deg(base, turned) == pytest.approx(angle_deg, abs=1e-12)
    assert rotation_error_deg(turned.rotation, base) == pytest.approx(angle_deg, abs=1e-12)
    side = about((0, 1, 0), angle_deg) @ [0, 0, 5.0]
    assert translation_error_deg([0, 0, 1], side) == pytest.approx(angle_deg, abs=1e-12)
    assert translation_error_deg(side, [0, 0, 1]) == pytest.approx(angle_deg, abs=1e-12)


def test_length_of_a_translation_does_not_change_its_angle():
    for scale in (1e-200, 1.0, 1e200):
        assert translation_error_deg([scale, 0, 0], [0, scale, 0]) == pytest.approx(90, abs=1e-12)


def test_angle_to_an_unknown_pose_or_a_zero_translation_is_nan():
    pose = random_pose(0)
    assert np.isnan(rotation_error_deg(pose, Pose.nan()))
    assert np.isnan(translation_error_deg(Pose.nan(), pose))
    assert np.isnan(translation_error_deg(pose, np.zeros(3)))


def test_angles_refuse_other_shapes_by_name():
    with pytest.raises(ValueError, match=r"b must have shape \(3, 3\), got \(3,\)"):
        rotation_error_deg(np.eye(3), np.zeros(3))
    with pytest.raises(ValueError, match=r"a must have shape \(3,\), got \(3, 3\)"):
        translation_error_deg(np.eye(3), np.ones(3))
    with pytest.raises(ValueError, match="orthonormal"):
        rotation_error_deg(2 * np.eye(3), np.eye(3))


def test_pose_composes_only_with_poses():
    with pytest.raises(TypeError, match="two poses, got ndarray; points .* are moved by points @"):
        random_pose(0) @ np.eye(4)
    with pytest.raises(TypeError):
        np.eye(4) @ random_pose(0)


@pytest.mark.parametrize(("turn_deg", "aside_deg"), [(0.9, 1.9), (1.1, 0.0), (0.0, 2.1)])
def test_poses_agree_within_both_angles(turn_deg, aside_deg):
    turn, aside = np.radians([turn_deg, aside_deg])
    pose = Pose(rotation_from_vector([0.0, turn, 0.0]), [np.sin(aside), 0.0, np.cos(aside)])
    straight = Pose(np.eye(3), [0.0, 0.0, 2.0])
    assert poses_agree(pose, straight, 1.0, 2.0) == (turn_deg < 1.0 and aside_deg < 2.0)
    assert not poses_agree(Pose.nan(), straight, 1.0, 2.0)
