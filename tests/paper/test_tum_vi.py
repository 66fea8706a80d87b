# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from written_scenes import (
    CAM_FROM_IMU,
    CENTER,
    FOCAL,
    SECOND_NS,
    SIZE,
    START_NS,
    camchain,
    fisheye_image,
    imu_row,
    rotation_about_z,
    write_png,
    write_tum_vi,
)

from epi360.cameras import KannalaBrandt, UnifiedCamera
from epi360_paper.datasets import find_tum_vi_rooms, load_tum_vi

OPENCV_TO_CONTINUOUS = 0.5


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "dataset-room1_512_16"
    write_tum_vi(folder)
    return folder


def write_poses(scene, rows, header="# timestamp[ns],tx,ty,tz,qw,qx,qy,qz"):
    (scene / "dso" / "gt_imu.csv").write_text("\n".join([header, *rows]) + "\n")


def pixel_by_hand(point, imu_rotation, imu_position):
    """Equidistant projection through the rig: world to IMU, IMU to camera by T_cam_imu."""
    in_imu = imu_rotation.T @ (point - imu_position)
    x, y, z = CAM_FROM_IMU[:3, :3] @ in_imu + CAM_FROM_IMU[:3, 3]
    angle, around = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    center = CENTER + OPENCV_TO_CONTINUOUS
    return center + FOCAL * angle * np.array([np.cos(around), np.sin(around)])


def test_world_point_is_seen_where_the_rig_says(scene):
    """The direction of T_cam_imu: with its inverse the pixels would be tens of pixels off."""
    sequence = load_tum_vi(scene)
    point = np.array([-2.0, 0.3, 0.6])
    for index, seconds in enumerate((0.0, 0.05, 0.1, 0.15)):
        cam_from_world = sequence.world_from_cam[index].inverse()
        in_camera = cam_from_world.rotation @ point + cam_from_world.translation
        seen = sequence.camera.pixels_from_bearings(in_camera[None])[0]
        by_hand = pixel_by_hand(
            point, rotation_about_z(10 * seconds), np.array([seconds, 0.5, 0.25])
        )
        np.testing.assert_allclose(seen, by_hand, atol=1e-6)  # the file has nine decimals


def test_poses_between_samples_turn_and_move_in_proportion(scene):
    write_poses(
        scene,
        [
            imu_row(START_NS - SECOND_NS // 100, 0, (0, 0, 0)),
            imu_row(START_NS + 3 * SECOND_NS // 100, 40, (4, 0, 0)),
        ],
    )
    world_from_cam = load_tum_vi(scene).world_from_cam[0]
    world_from_imu = world_from_cam.matrix() @ CAM_FROM_IMU
    np.testing.assert_allclose(world_from_imu[:3, :3], rotation_about_z(10), atol=1e-8)
    np.testing.assert_allclose(world_from_imu[:3, 3], [1, 0, 0], atol=1e-8)


def test_images_in_a_gap_and_outside_of_the_poses_have_none(scene):
    late = START_NS + SECOND_NS // 20
    write_poses(scene, [imu_row(t, 0, (0, 0, 0)) for t in (START_NS, START_NS + 1, late + 10**7)])
    poses = load_tum_vi(scene).world_from_cam
    assert [pose is None for pose in poses] == [False, True, True, True]
    assert load_tum_vi(scene, max_gap_s=0.07).world_from_cam[1] is not None


def test_poses_of_the_motion_capture_folder_are_read_too(tmp_path):
    write_tum_vi(tmp_path, poses="mav0/mocap0/data.csv")
    header = (
        "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
        "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
    )
    path = tmp_path / "mav0" / "mocap0" / "data.csv"
    path.write_text("\n".join([header, *path.read_text().splitlines()[1:]]))
    assert None not in load_tum_vi(tmp_path).world_from_cam


def test_timestamps_keep_their_differences(scene):
    np.testing.assert_allclose(np.diff(load_tum_vi(scene).timestamps_s), 0.05, atol=1e-6)


def test_sixteen_bits_are_spread_over_eight(scene):
    """Divided by 257, values of 10,000 to 30,000 would span 39 to 117."""
    sequence = load_tum_vi(scene)
    image = sequence.image(0)
    assert image.dtype == np.uint8
    low, high = np.percentile(image[sequence.mask], (5, 95))
    assert low < 130
    assert high > 200


def test_black_rim_is_masked_and_the_lit_circle_is_used(scene):
    mask = load_tum_vi(scene).mask
    rows, columns = np.mgrid[:SIZE, :SIZE]
    radius = np.hypot(rows - CENTER, columns - CENTER)
    assert not mask[radius > 44].any()
    assert mask[radius < 42].all()


def test_eight_bit_images_without_a_rim_are_used_as_they_are(scene):
    for index, path in enumerate(sorted((scene / "mav0" / "cam0" / "data").iterdir())):
        image = np.full((SIZE, SIZE), 100 + index, np.uint8)
        write_png(path, image)
    sequence = load_tum_vi(scene)
    assert sequence.mask.all()
    np.testing.assert_array_equal(sequence.image(2)[0, 0], [102, 102, 102])


@pytest.mark.parametrize("name", ["mav0/cam0/data.csv", "dso/camchain.yaml", "dso/gt_imu.csv"])
def test_missing_part_is_named(scene, name):
    (scene / name).unlink()
    with pytest.raises(FileNotFoundError, match=name):
        load_tum_vi(scene)


def test_image_that_the_table_names_must_be_there(scene):
    (scene / "mav0" / "cam0" / "data" / f"{START_NS}.png").unlink()
    with pytest.raises(FileNotFoundError, match=rf"{START_NS}\.png does not exist but row 2 of"):
        load_tum_vi(scene)


def test_image_of_another_size_than_the_calibration_is_refused(scene):
    for path in (scene / "mav0" / "cam0" / "data").iterdir():
        write_png(path, fisheye_image()[:90])
    with pytest.raises(ValueError, match="must have the camera's size 96x96, got 96x90"):
        load_tum_vi(scene)


@pytest.mark.parametrize("row", ["12", "x,1,2,3,1,0,0,0", "12,1,2,3,1,0,0,y"])
def test_bad_row_is_named_with_its_file_and_line(scene, row):
    write_poses(scene, [imu_row(START_NS, 0, (0, 0, 0)), row])
    with pytest.raises(ValueError, match=r"row 3 of .*gt_imu\.csv must hold"):
        load_tum_vi(scene)


def test_times_that_go_back_are_refused(scene):
    write_poses(scene, [imu_row(t, 0, (0, 0, 0)) for t in (START_NS, START_NS - 5)])
    with pytest.raises(ValueError, match="row 3 of .* a later time than the row before"):
        load_tum_vi(scene)


def test_times_that_do_not_overlap_are_refused(scene):
    write_poses(scene, [imu_row(t, 0, (0, 0, 0)) for t in (5, 6)])
    with pytest.raises(ValueError, match="must overlap the images in time"):
        load_tum_vi(scene)


@pytest.mark.parametrize("header", ["# t,tx,ty,tz,qx,qy,qz,qw", "#timestamp,filename"])
def test_header_of_another_format_is_refused(scene, header):
    write_poses(scene, [imu_row(START_NS, 0, (0, 0, 0))], header)
    with pytest.raises(ValueError, match=r"header of .*gt_imu\.csv must name t,x,y,z,qw,qx,qy,qz"):
        load_tum_vi(scene)


def test_calibration_without_the_rig_is_refused(scene):
    (scene / "dso" / "camchain.yaml").write_text(camchain().replace("T_cam_imu", "T_other"))
    with pytest.raises(ValueError, match="T_cam_imu"):
        load_tum_vi(scene)


def test_unified_calibration_above_the_scenes_comes_first(scene):
    chain = camchain().replace("pinhole", "omni").replace("equidistant", "radtan")
    chain = chain.replace(f"[{FOCAL}, ", f"[1.5, {FOCAL}, ")
    (scene.parent / "omni_calib.yaml").write_text(chain)
    center = CENTER + OPENCV_TO_CONTINUOUS
    omni = UnifiedCamera(SIZE, SIZE, FOCAL, FOCAL, center, center, 1.5, 0.0, 0.0, 0.0, 0.0)
    assert load_tum_vi(scene).camera == omni
    equidistant = load_tum_vi(scene, scene / "dso" / "camchain.yaml").camera
    assert equidistant == KannalaBrandt(SIZE, SIZE, FOCAL, FOCAL, center, center)


def test_rooms_are_found_by_name_and_other_scenes_left_out(tmp_path):
    names = ["dataset-room2_512_16", "dataset-room1_512_16", "dataset-corridor1_512_16", "room7"]
    for name in names:
        (tmp_path / name / "mav0").mkdir(parents=True)
    found = [path.name for path in find_tum_vi_rooms(tmp_path)]
    assert found == ["dataset-room1_512_16", "dataset-room2_512_16"]
    assert find_tum_vi_rooms(tmp_path / names[2]) == [tmp_path / names[2]]


def test_folder_without_rooms_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="has no rooms"):
        find_tum_vi_rooms(tmp_path)
