# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of frames with tracks: which frames, which tracks, and the files that keep them."""

from functools import lru_cache

import cv2
import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.poses import Pose, rotation_from_vector
from epi360_paper import rendered
from epi360_paper.datasets import ImageSequence
from epi360_paper.method_rows import rendered_cell
from epi360_paper.options import ReproduceOptions
from epi360_paper.rendered import PAIRS_PER_SEQUENCE, RenderedTracks, fisheye_camera
from epi360_paper.sources import BLOCKS_PER_SCENE, dataset_sources, pair_rule
from epi360_paper.tracks import (
    BearingPair,
    PairRule,
    cached_pairs,
    pairs_of_frames,
    sequence_key,
)
from epi360_paper.trials import Trial
from epi360_scenes.room import scene

CAMERA = Equirectangular(256, 128)
STEP_PX = 3  # of the turning panorama from frame to frame


@pytest.fixture(scope="module")
def panorama():
    noise = np.random.default_rng(0).uniform(0, 255, (128, 256, 3))
    wide = cv2.GaussianBlur(np.hstack([noise] * 3), (0, 0), 2.0)  # without an edge at the seam
    return np.ascontiguousarray(wide[:, 256:512]).astype(np.uint8)


@pytest.fixture
def turning(panorama):
    """Picture of a frame: the world turns right by three pixels a frame."""
    return lambda index: np.roll(panorama, STEP_PX * index, axis=1)


def walk(num_frames, step_m=0.2):
    """The camera turns left with the pictures and walks along x."""
    angle = -2 * np.pi * STEP_PX / CAMERA.width
    return [
        Pose(rotation_from_vector([0, angle * index, 0]), np.array([step_m * index, 0, 0]))
        for index in range(num_frames)
    ]


def frames(pairs):
    return [(pair.frame1, pair.frame2) for pair in pairs]


def assert_equal_pairs(ours, theirs):
    assert frames(ours) == frames(theirs)
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(one.bearings1, other.bearings1)
        np.testing.assert_array_equal(one.bearings2, other.bearings2)
        poses = one.cam2_from_cam1.matrix(), other.cam2_from_cam1.matrix()
        np.testing.assert_allclose(*poses, atol=1e-15)  # a quaternion in a file rounds


def test_second_frame_is_the_first_that_is_far_enough(turning):
    pairs = pairs_of_frames(turning, walk(6), CAMERA, PairRule())
    assert frames(pairs) == [(0, 3), (1, 4), (2, 5)]  # 0.6 m, 0.4 m were not enough


def test_tracks_follow_the_turn_of_the_camera(turning):
    pair = pairs_of_frames(turning, walk(4), CAMERA, PairRule())[0]
    assert len(pair.bearings1) == 200
    turned = pair.bearings1 @ pair.cam2_from_cam1.rotation.T
    sines = np.linalg.norm(np.cross(turned, pair.bearings2), axis=1)
    assert np.degrees(np.median(sines)) < 0.05  # a thirtieth of a pixel
    np.testing.assert_allclose(pair.cam2_from_cam1.inverse().translation, [0.6, 0, 0], atol=1e-12)


def test_pairs_keep_to_segments_stride_and_block(turning):
    def found(**options):
        rule = PairRule(stride=options.pop("stride", 1))
        return frames(pairs_of_frames(turning, walk(9), CAMERA, rule, **options))

    assert found(segments=[range(0, 4), range(4, 9)]) == [(0, 3), (4, 7), (5, 8)]
    assert found(stride=2) == [(0, 3), (2, 5), (4, 7)]
    assert found(first_frames=range(2, 4)) == [(2, 5), (3, 6)]


def test_frames_without_poses_or_too_far_away_make_no_pair(turning):
    poses = [*walk(4), None, *walk(9)[5:]]
    assert frames(pairs_of_frames(turning, poses, CAMERA, PairRule())) == [(0, 3), (5, 8)]
    assert pairs_of_frames(turning, walk(9, 0.1), CAMERA, PairRule(max_frames=4)) == []


def test_pair_with_too_few_tracks_is_left_out(turning):
    mask = np.zeros((128, 256), dtype=bool)
    mask[40:80, 100:140] = True
    assert pairs_of_frames(turning, walk(4), CAMERA, PairRule(), mask=mask) == []
    assert len(pairs_of_frames(turning, walk(4), CAMERA, PairRule(min_tracks=1), mask=mask)) == 1


def test_kept_pairs_are_read_and_not_made_again(tmp_path, turning):
    made = pairs_of_frames(turning, walk(5), CAMERA, PairRule())
    assert_equal_pairs(cached_pairs(tmp_path / "new", "key", lambda: made), made)
    assert_equal_pairs(cached_pairs(tmp_path / "new", "key", lambda: pytest.fail("made")), made)
    assert cached_pairs(tmp_path / "new", "other key", lambda: []) == []
    assert cached_pairs(tmp_path / "new", "other key", lambda: pytest.fail("made")) == []


def test_damaged_file_is_made_again(tmp_path, turning):
    made = pairs_of_frames(turning, walk(4), CAMERA, PairRule())
    cached_pairs(tmp_path, "key", lambda: made)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:200])
    assert_equal_pairs(cached_pairs(tmp_path, "key", lambda: made), made)
    assert_equal_pairs(cached_pairs(tmp_path, "key", lambda: pytest.fail("made")), made)


def test_key_of_a_sequence_changes_with_its_content(tmp_path):
    path = tmp_path / "1.png"
    path.write_bytes(b"12345")

    def key(x=0.0, mask=None):
        poses = (Pose(np.eye(3), np.array([x, 0, 0])),)
        return sequence_key(ImageSequence("a", CAMERA, (path,), np.zeros(1), poses, mask=mask))

    before = key()
    assert key() == before
    assert key(x=0.5) != before
    assert key(mask=np.ones((128, 256), dtype=bool)) != before
    path.write_bytes(b"123456")
    assert key() != before


def test_true_residuals_are_angles_out_of_the_epipolar_plane():
    b2 = np.array([[0.0, np.sin(0.01), np.cos(0.01)], [0.0, -np.sin(0.02), np.cos(0.02)]])
    b1 = np.array([[0.0, 0.0, 1.0]] * 2)
    pair = BearingPair(0, 1, b1, b2, Pose(np.eye(3), np.array([1.0, 0.0, 0.0])))
    np.testing.assert_allclose(pair.true_residuals_rad(), [0.01, 0.02], atol=1e-12)


def test_only_what_is_right_tests_tracks_backwards():
    assert pair_rule("printed") == pair_rule("authors") == PairRule()
    assert pair_rule("corrected").forward_backward_px == 0.5


def test_fisheye_sees_195_degrees_in_the_corners_and_less_at_the_sides():
    mask = fisheye_camera(512).field_of_view_mask()
    assert mask[256].all()
    assert not mask[0, 0]


@lru_cache
def scene_once(name, seed):
    """Furnishing takes a second, and both lenses look at the same room."""
    return scene(name, seed)


@pytest.mark.parametrize("lens", ["360", "fisheye"])
def test_rendered_tracks_agree_with_the_true_poses(tmp_path, monkeypatch, lens):
    """A wrong direction of a pose or half a pixel of the camera would leave degrees."""
    monkeypatch.setattr(rendered, "make_scene", scene_once)
    rule = PairRule(min_baseline_m=0.1, stride=2)
    source = RenderedTracks(lens, 320, rule, tmp_path, num_frames=4)
    pairs = source.pairs(Trial(0, "any", 0, 0))
    assert 1 <= len(pairs) <= PAIRS_PER_SEQUENCE
    for pair in pairs:
        # 1.1 deg a pixel; Lucas and Kanade are good to a fifth of one.
        assert np.degrees(np.median(pair.true_residuals_rad())) < 0.4
        assert np.linalg.norm(pair.cam2_from_cam1.translation) >= 0.1
    assert_equal_pairs(source.pairs(Trial(0, "another table", 1, 0)), pairs)
    assert len(list(tmp_path.iterdir())) == 1


def test_lenses_protocols_and_widths_have_tracks_of_their_own(tmp_path):
    def cell(lens="360", **options):
        return repr(rendered_cell(lens, ReproduceOptions(out=tmp_path, **options)).source)

    cells = [cell(), cell("fisheye"), cell(protocol="corrected"), cell(image_width=512)]
    assert len(set(cells)) == 4
    assert str(tmp_path) not in cells[0]  # a folder that was moved keeps its tracks


def test_blocks_of_a_recorded_scene_are_all_of_its_pairs(tmp_path, turning):
    write_scene(tmp_path / "data" / "scene", turning, walk(12))
    sources = dataset_sources("mp3d_vo", tmp_path / "data", PairRule(), 100, tmp_path / "tracks")
    (source,) = sources.values()
    assert (source.name, source.rule.stride) == ("data/scene", 1)
    found = [
        pair for block in range(BLOCKS_PER_SCENE) for pair in source.pairs(Trial(0, "x", 0, block))
    ]
    assert_equal_pairs(found, pairs_of_frames(turning, walk(12), CAMERA, PairRule()))


def test_fisheye_tracks_turn_as_the_rig_says(tmp_path, panorama):
    """TUM-VI from its files to bearings: 16 bits, mask, rig, interpolated poses."""
    camera = KannalaBrandt(160, 160, 60.0, 60.0, 80.0, 80.0, max_angle_deg=95.0)
    cam_from_imu = Pose(rotation_from_vector([0.3, -1.2, 0.8]), np.array([0.1, -0.2, 0.3]))
    turns = [rotation_from_vector(index * np.array([0.02, -0.05, 0.03])) for index in range(5)]
    poses = [Pose(turn, np.array([0.3 * index, 0, 0])) for index, turn in enumerate(turns)]
    pictures = [seen_far_away(panorama, camera, pose) for pose in poses]
    write_room(tmp_path / "room3", pictures, [pose @ cam_from_imu for pose in poses], cam_from_imu)
    (source,) = dataset_sources("tum_vi", tmp_path, PairRule(), 100, tmp_path / "tracks").values()
    pairs = [
        pair for block in range(BLOCKS_PER_SCENE) for pair in source.pairs(Trial(0, "x", 0, block))
    ]
    assert frames(pairs) == [(0, 2), (1, 3), (2, 4)]
    for pair in pairs:
        turned = pair.bearings1 @ pair.cam2_from_cam1.rotation.T
        sines = np.linalg.norm(np.cross(turned, pair.bearings2), axis=1)
        assert np.degrees(np.median(sines)) < 0.2  # a fifth of a pixel; 7 deg of turn


def seen_far_away(panorama, camera, world_from_cam):
    """16-bit picture of a panorama at infinity, black outside the lens."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    bearings = camera.bearings_from_pixels(np.stack([u.ravel(), v.ravel()], axis=1))
    at = CAMERA.pixels_from_bearings(bearings @ world_from_cam.rotation.T) - 0.5
    at = np.nan_to_num(at, nan=-9.0).astype(np.float32).reshape(camera.height, camera.width, 2)
    gray = np.hstack([panorama[:, :, 1], panorama[:, :1, 1]]).astype(np.float32)
    seen = cv2.remap(gray, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0.0)
    return (100 * seen).astype(np.uint16)


def write_room(scene, pictures, world_from_imu, cam_from_imu):
    """TUM-VI with a pose at the time of each image, 20 a second."""
    (scene / "mav0" / "cam0" / "data").mkdir(parents=True)
    (scene / "dso").mkdir()
    images, rows = ["#timestamp [ns],filename"], []
    for index, picture in enumerate(pictures):
        time = 10**18 + 50_000_000 * index
        encoded = cv2.imencode(".png", picture)[1].tobytes()
        (scene / "mav0" / "cam0" / "data" / f"{time}.png").write_bytes(encoded)
        images.append(f"{time},{time}.png")
        pose = world_from_imu[index]
        numbers = [*pose.translation.tolist(), *pose.quaternion_wxyz.tolist()]
        rows.append(",".join(map(str, [time, *numbers])))
    (scene / "mav0" / "cam0" / "data.csv").write_text("\n".join(images))
    (scene / "dso" / "gt_imu.csv").write_text("\n".join(rows))
    (scene / "dso" / "camchain.yaml").write_text(
        f"cam0: {{camera_model: pinhole, distortion_model: equidistant, resolution: [160, 160], "
        f"intrinsics: [60.0, 60.0, 79.5, 79.5], distortion_coeffs: [0.0, 0.0, 0.0, 0.0], "
        f"T_cam_imu: {cam_from_imu.matrix().tolist()}}}\n"
    )


def test_first_frames_of_a_recording_are_spread_over_it(tmp_path, turning):
    write_scene(tmp_path, turning, walk(12))
    (source,) = dataset_sources("mp3d_vo", tmp_path, PairRule(), 5, tmp_path / "t").values()
    assert source.rule.stride == 3


def write_scene(scene, image, poses):
    (scene / "rgb").mkdir(parents=True)
    rows = []
    for index, pose in enumerate(poses):
        encoded = cv2.imencode(".png", image(index)[:, :, ::-1])[1].tobytes()
        (scene / "rgb" / f"{index + 1}.png").write_bytes(encoded)
        w, x, y, z = pose.quaternion_wxyz.tolist()
        rows.append(" ".join(map(str, [index, *pose.translation.tolist(), x, y, z, w])))
    (scene / "frm_ref.txt").write_text("\n".join(rows))
