# SPDX-License-Identifier: BSD-3-Clause
"""Two images to a pose, on pictures of a rendered room whose truth is exact."""

import cv2
import numpy as np
import pytest

import epi360
from epi360 import (
    relative_pose_of_images,
    rotation_error_deg,
    translation_error_deg,
    two_view,
)
from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.poses import Pose, rotation_from_vector
from epi360.second_look import later_is_better
from epi360_scenes import demo_pair, furnished_room

WIDTH = 512
CAMERA = Equirectangular(WIDTH, WIDTH // 2)
FISHEYE = KannalaBrandt(400, 400, 118, 118, 200, 200, k1=-0.01, k2=0.002, max_angle_deg=95)
WORLD_FROM_CAM1 = Pose(rotation_from_vector((0.05, 0.3, -0.04)), np.array([0.1, -1.5, -0.35]))
CAM2_FROM_CAM1 = Pose(rotation_from_vector((0.1, -0.5, 0.05)), np.array([0.5, 0.05, -0.4]))
WORLD_FROM_CAM2 = WORLD_FROM_CAM1 @ CAM2_FROM_CAM1.inverse()


def assert_pose(result, cam2_from_cam1, rotation_deg=0.5, translation_deg=1.5):
    assert result.status == "ok"
    assert result.success
    assert rotation_error_deg(result.cam2_from_cam1, cam2_from_cam1) < rotation_deg
    assert translation_error_deg(result.cam2_from_cam1, cam2_from_cam1) < translation_deg


def assert_pure_rotation(result, rotation):
    assert result.status == "pure_rotation"
    assert not result.success
    assert rotation_error_deg(result.cam2_from_cam1.rotation, rotation) < 0.1
    assert np.isnan(result.cam2_from_cam1.translation).all()
    assert np.isnan(result.E).all()


def assert_no_pose(result):
    assert not result.success
    assert np.isnan(result.cam2_from_cam1.rotation).all()
    assert np.isnan(result.cam2_from_cam1.translation).all()


def assert_identical(a, b):
    np.testing.assert_array_equal(a.cam2_from_cam1.matrix(), b.cam2_from_cam1.matrix())
    for name in ("keypoints1", "keypoints2", "inlier_mask", "residuals_rad", "covariance"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert (a.status, a.noise_deg, a.num_iterations) == (b.status, b.noise_deg, b.num_iterations)


@pytest.fixture(scope="module")
def pair():
    return demo_pair(width=WIDTH)


@pytest.fixture(scope="module")
def result(pair):
    return relative_pose_of_images(pair.image1, pair.image2)


@pytest.fixture(scope="module")
def room():
    return furnished_room(1)


@pytest.fixture(scope="module")
def view(room):
    return room.render(CAMERA, WORLD_FROM_CAM1).image


@pytest.fixture(scope="module")
def second_view(room):
    return room.render(CAMERA, WORLD_FROM_CAM2).image


@pytest.fixture(scope="module")
def second_fisheye(room):
    return room.render(FISHEYE, WORLD_FROM_CAM2).image


def texture(seed):
    """Panorama of smooth noise that shows nothing."""
    noise = np.random.default_rng(seed).normal(size=(WIDTH // 2, WIDTH))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2)
    return (128 + 45 * smooth / smooth.std()).clip(0, 255).astype(np.uint8)


def test_two_panoramas_of_a_room_give_its_pose(pair, result):
    assert_pose(result, pair.cam2_from_cam1)
    assert result.num_inliers > 100
    assert result.warnings == ()
    translation = result.cam2_from_cam1.translation
    assert np.linalg.norm(translation) == pytest.approx(1.0, abs=1e-12)


def test_the_pose_is_as_certain_as_its_covariance_says(pair, result):
    sigmas = np.degrees(np.sqrt(np.diag(result.covariance)))
    assert rotation_error_deg(result.cam2_from_cam1, pair.cam2_from_cam1) < 5 * sigmas[:3].max()
    assert translation_error_deg(result.cam2_from_cam1, pair.cam2_from_cam1) < 5 * sigmas[3:].max()


def test_key_points_are_where_the_depth_says(pair, result):
    inliers1, inliers2 = (k[result.inlier_mask] for k in (result.keypoints1, result.keypoints2))
    columns, rows = inliers1.astype(int).T
    points = CAMERA.bearings_from_pixels(inliers1) * pair.depth1[rows, columns][:, None]
    expected = points @ pair.cam2_from_cam1.rotation.T + pair.cam2_from_cam1.translation
    offsets = CAMERA.pixels_from_bearings(expected) - inliers2
    offsets[:, 0] = (offsets[:, 0] + WIDTH / 2) % WIDTH - WIDTH / 2
    low = np.abs(inliers2[:, 1] - WIDTH / 4) < WIDTH / 8  # near the poles a column is no angle
    assert np.median(np.linalg.norm(offsets[low], axis=1)) < 0.5
    np.testing.assert_allclose(np.median(offsets[low], axis=0), 0.0, atol=0.1)


def test_one_row_for_each_match_in_the_pixels_of_the_images(result):
    shape = (result.num_matches, 2)
    assert result.keypoints1.shape == result.keypoints2.shape == shape
    assert result.inlier_mask.shape == result.residuals_rad.shape == shape[:1]
    for keypoints in (result.keypoints1, result.keypoints2):
        assert (keypoints >= 0).all()
        assert (keypoints <= [WIDTH, WIDTH // 2]).all()


def test_swapping_the_images_inverts_the_pose(pair, result):
    swapped = relative_pose_of_images(pair.image2, pair.image1)
    assert_pose(swapped, pair.cam2_from_cam1.inverse())
    # The matches are the same; samples and the linearisation are not.
    assert swapped.num_matches == result.num_matches
    assert_pose(swapped, result.cam2_from_cam1.inverse(), 0.02, 0.05)


def test_the_same_call_gives_the_same_bits(pair, result):
    assert_identical(relative_pose_of_images(pair.image1, pair.image2), result)


def test_the_number_of_threads_changes_nothing(pair, result):
    threads = cv2.getNumThreads()
    try:
        for count in (1, 3):
            cv2.setNumThreads(count)
            assert_identical(relative_pose_of_images(pair.image1, pair.image2), result)
    finally:
        cv2.setNumThreads(threads)


def test_files_and_arrays_of_any_kind_give_the_same_pose(pair, result, tmp_path):
    path = tmp_path / "a.png"
    assert cv2.imwrite(str(path), pair.image1[:, :, ::-1])
    opaque = np.dstack([pair.image2, np.full(pair.image2.shape[:2], 255, np.uint8)])
    assert_identical(relative_pose_of_images(str(path), opaque), result)


def test_panoramas_of_different_sizes_simply_work(pair):
    half = cv2.resize(pair.image2, (360, 180), interpolation=cv2.INTER_AREA)
    result = relative_pose_of_images(pair.image1, half)
    assert_pose(result, pair.cam2_from_cam1)
    assert result.keypoints1[:, 0].max() > 400
    assert result.keypoints2[:, 0].max() <= 360


def test_a_smaller_search_answers_in_pixels_of_the_original(pair):
    result = relative_pose_of_images(pair.image1, pair.image2, max_width=384)
    assert_pose(result, pair.cam2_from_cam1)
    assert result.keypoints1[:, 0].max() > 400


def test_masked_pixels_have_no_matches(pair):
    mask1, mask2 = np.ones((2, WIDTH // 2, WIDTH), bool)
    mask1[:, 256:] = False
    mask2[:100] = False
    result = relative_pose_of_images(pair.image1, pair.image2, mask1=mask1, mask2=mask2)
    assert result.num_matches > 30
    assert result.keypoints1[:, 0].max() < 256
    assert result.keypoints2[:, 1].min() >= 100
    assert_pose(result, pair.cam2_from_cam1)


def test_transparent_pixels_have_no_matches(pair, result):
    pictures = []
    for image in (pair.image1, pair.image2):
        alpha = np.full(image.shape[:2], 255, np.uint8)
        alpha[170:] = 0
        pictures.append(np.dstack([image, alpha]))
    found = relative_pose_of_images(*pictures)
    assert_pose(found, pair.cam2_from_cam1)
    assert result.keypoints1[:, 1].max() > 175.0
    for keypoints in (found.keypoints1, found.keypoints2):
        assert keypoints[:, 1].max() < 170.0


def test_the_nadir_cap_is_ignored_in_both_images(pair, result):
    capped = relative_pose_of_images(pair.image1, pair.image2, mask_nadir_deg=60)
    limit = WIDTH / 2 * (180 - 60) / 180
    for name in ("keypoints1", "keypoints2"):
        assert getattr(result, name)[:, 1].max() > limit
        assert getattr(capped, name)[:, 1].max() <= limit
    assert_pose(capped, pair.cam2_from_cam1)


def test_a_given_threshold_is_used(pair):
    result = relative_pose_of_images(pair.image1, pair.image2, inlier_threshold_deg=0.3)
    assert_pose(result, pair.cam2_from_cam1)
    assert result.inlier_threshold_deg == pytest.approx(0.3, abs=1e-12)
    assert np.abs(np.degrees(result.residuals_rad[result.inlier_mask])).max() <= 0.3


def test_progress_is_told_in_words(pair):
    words = []
    relative_pose_of_images(pair.image1, pair.image2, progress=words.append)
    assert len(words) >= 3
    assert all(isinstance(word, str) and word for word in words)
    assert "reading" in words[0]


def test_the_same_image_twice_is_a_rotation_by_nothing(pair):
    assert_pure_rotation(relative_pose_of_images(pair.image1, pair.image1), np.eye(3))


@pytest.mark.parametrize("columns", [1, 37, 128, 256, 300, 384, 511])
def test_a_panorama_against_itself_rolled_is_a_turn_about_the_vertical(pair, columns):
    rolled = np.roll(pair.image1, columns, axis=1)
    turn = rotation_from_vector((0, 2 * np.pi * columns / WIDTH, 0))
    assert_pure_rotation(relative_pose_of_images(pair.image1, rolled), turn)


def test_a_panorama_upside_down_is_half_a_turn_about_the_axis(pair):
    result = relative_pose_of_images(pair.image1, pair.image1[::-1, ::-1])
    assert_pure_rotation(result, np.diag([-1.0, -1.0, 1.0]))


@pytest.mark.parametrize(
    "vector",
    [(1.6, 0.2, 0.1), (0, 0, 0.02), (0.5, 0.9, -0.4), (0.12, 0.31, -0.04), (0.04, -2.33, -0.22)],
)
def test_a_turn_at_the_same_place_is_no_translation(room, view, vector):
    turn = Pose(rotation_from_vector(vector), np.zeros(3))  # cam2_from_cam1
    turned = room.render(CAMERA, WORLD_FROM_CAM1 @ turn.inverse()).image
    assert_pure_rotation(relative_pose_of_images(view, turned), turn.rotation)


@pytest.mark.parametrize("vector", [(1.6, 0.2, 0.1), (0.5, 0.9, -0.4)])
def test_the_evidence_for_a_turn_is_that_of_the_rotation(room, view, vector):
    turn = Pose(rotation_from_vector(vector), np.zeros(3))  # cam2_from_cam1
    turned = room.render(CAMERA, WORLD_FROM_CAM1 @ turn.inverse()).image
    result = relative_pose_of_images(view, turned)
    assert result.status == "pure_rotation"
    there = CAMERA.bearings_from_pixels(result.keypoints1) @ result.cam2_from_cam1.rotation.T
    seen = CAMERA.bearings_from_pixels(result.keypoints2)
    angles = 2 * np.arcsin(np.linalg.norm(there - seen, axis=1) / 2)
    np.testing.assert_allclose(np.abs(result.residuals_rad), angles / np.sqrt(2), atol=1e-8)
    assert np.isfinite(result.covariance[:3, :3]).all()
    assert np.isnan(result.covariance[3:]).all()
    assert np.isnan(result.covariance[:, 3:]).all()


def test_two_fisheyes_of_190_degrees_give_the_pose(room, second_fisheye):
    first = room.render(FISHEYE, WORLD_FROM_CAM1).image
    result = relative_pose_of_images(first, second_fisheye, camera1=FISHEYE, camera2=FISHEYE)
    assert_pose(result, CAM2_FROM_CAM1)
    for keypoints in (result.keypoints1, result.keypoints2):
        assert np.isfinite(FISHEYE.bearings_from_pixels(keypoints)).all()


def test_a_panorama_and_a_fisheye_give_the_pose(view, second_fisheye):
    result = relative_pose_of_images(view, second_fisheye, camera2=FISHEYE)
    assert_pose(result, CAM2_FROM_CAM1)


def test_a_part_of_a_panorama_gives_the_pose_of_the_whole(view, second_view):
    part = Equirectangular(
        300, 180, horizontal_fov_deg=300 * 360 / 512, vertical_fov_deg=180 * 180 / 256,
        center_longitude_deg=(106 + 150 - 256) * 360 / 512,
        center_latitude_deg=(128 - 30 - 90) * 180 / 256,
    )  # fmt: skip
    cut = view[30:210, 106:406]
    assert_pose(relative_pose_of_images(cut, second_view, camera1=part), CAM2_FROM_CAM1)


@pytest.mark.parametrize("both", [True, False])
def test_black_images_have_too_few_matches(pair, both):
    black = np.zeros_like(pair.image2)
    result = relative_pose_of_images(black if both else pair.image1, black)
    assert result.status == "too_few_matches"
    assert_no_pose(result)
    assert result.num_matches == 0
    assert result.keypoints1.shape == result.keypoints2.shape == (0, 2)


@pytest.mark.parametrize("seed", range(4))
def test_unrelated_images_give_no_pose(view, seed):
    camera = Equirectangular(512, 256)  # nobody would take these for panoramas
    found = relative_pose_of_images(
        texture(seed), texture(seed + 100), camera1=camera, camera2=camera
    )
    assert_no_pose(found)
    assert_no_pose(relative_pose_of_images(view, texture(seed), camera2=camera))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"camera1": Equirectangular(64, 32)}, "image1 is 512x256"),
        ({"camera2": Equirectangular(64, 32)}, "image2 is 512x256"),
        (
            {"camera1": "camchain.yaml:cam0"},
            "the camera of image1 must be a camera, got 'camchain.yaml:cam0'; load_camera.FILE. ",
        ),
        ({"camera2": 120.0}, "the camera of image2 must be a camera, got 120.0"),
        ({"mask1": np.ones((32, 64), bool)}, "mask1 must have the size"),
        ({"mask2": np.ones((32, 64), bool)}, "mask2 must have the size"),
        ({"inlier_threshold_deg": 0.0}, "inlier_threshold_deg must be"),
        ({"inlier_threshold_deg": "tight"}, "inlier_threshold_deg must be"),
    ],
)
def test_wrong_input_is_refused_by_its_name(view, options, message):
    with pytest.raises(ValueError, match=message):
        relative_pose_of_images(view, view, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"mask2": np.ones((32, 64), bool)},
        {"inlier_threshold_deg": 0.0},
        {"max_width": 0},
        {"mask_nadir_deg": -1.0},
    ],
)
def test_wrong_input_is_refused_before_the_work(view, options):
    words = []
    with pytest.raises(ValueError, match=next(iter(options))):
        relative_pose_of_images(view, view, progress=words.append, **options)
    assert set(words) <= {"reading images"}


def test_the_result_is_public():
    assert epi360.ImagePairResult.__name__ == "ImagePairResult"
    assert epi360.relative_pose_of_images is relative_pose_of_images


@pytest.mark.parametrize("status", ["ok", "pure_rotation", "planar_ambiguous"])
def test_a_pose_is_given_up_for_another_or_for_a_contradiction(status):
    assert later_is_better("ok", status)


@pytest.mark.parametrize("status", ["too_few_matches", "too_few_inliers", "concentrated_inliers"])
def test_a_closer_look_that_finds_nothing_does_not_take_a_pose_away(status):
    assert not later_is_better("ok", status)
    assert later_is_better("planar_ambiguous", status)


def test_gravity_reaches_every_look_at_a_pair(view, second_view, monkeypatch):
    given = []
    estimate = two_view.estimate_relative_pose

    def noted(bearings1, bearings2, **options):
        given.append([options[name] for name in ("gravity1", "gravity2", "gravity_sigma_deg")])
        return estimate(bearings1, bearings2, **options)

    monkeypatch.setattr(two_view, "estimate_relative_pose", noted)
    world_from_cams = (WORLD_FROM_CAM1, WORLD_FROM_CAM2)
    down1, down2 = (pose.rotation.T @ [0.0, 1.0, 0.0] for pose in world_from_cams)
    known = relative_pose_of_images(
        view, second_view, gravity1=down1, gravity2=down2, gravity_sigma_deg=0.5
    )
    assert_pose(known, CAM2_FROM_CAM1)
    assert given and all(each[0] is down1 and each[1] is down2 for each in given)
    assert {each[2] for each in given} == {0.5}
    with pytest.raises(ValueError, match="gravity1 and gravity2 must be given together"):
        relative_pose_of_images(view, second_view, gravity1=down1)
