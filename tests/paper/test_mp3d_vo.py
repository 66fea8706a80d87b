# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from written_scenes import rotation_about_z, textured, write_mp3d_vo, write_png

from epi360.cameras import Equirectangular
from epi360.poses import Pose
from epi360_paper.datasets import find_mp3d_vo_scenes, load_mp3d_vo
from epi360_scenes import Rendering
from epi360_scenes.mp3d_layout import poses_text, write_frame


@pytest.fixture
def scene(tmp_path):
    write_mp3d_vo(tmp_path / "scene", [0, 10, 30])
    return tmp_path / "scene"


def rewrite_row(scene, row, text):
    path = scene / "frm_ref.txt"
    lines = path.read_text().splitlines()
    lines[row] = text
    path.write_text("\n".join(lines))


def test_pose_k_belongs_to_file_k_plus_one(scene):
    sequence = load_mp3d_vo(scene)
    assert sequence.image_paths[2].name == "3.png"
    np.testing.assert_allclose(sequence.world_from_cam[2].translation, [2, 4, -2])
    np.testing.assert_allclose(
        sequence.world_from_cam[2].rotation, rotation_about_z(30), atol=1e-12
    )
    np.testing.assert_array_equal(sequence.depth(2), np.full((32, 64), 3.5, np.float32))


def test_camera_is_the_full_panorama_of_the_image_size(scene):
    sequence = load_mp3d_vo(scene)
    assert (sequence.camera, sequence.name, len(sequence)) == (Equirectangular(64, 32), "scene", 3)
    assert sequence.image(0).shape == (32, 64, 3)


def test_what_render_writes_is_read_back(tmp_path):
    poses = [Pose(rotation_about_z(20.0 * index), np.array([0.1, index, -2])) for index in range(2)]
    depth = np.linspace(0, 5, 32 * 64, dtype=np.float32).reshape(32, 64)
    for index in range(2):
        write_frame(tmp_path, index, Rendering(textured(32, 64, index), depth + index))
    (tmp_path / "frm_ref.txt").write_text(poses_text(poses))
    sequence = load_mp3d_vo(tmp_path)
    for index, pose in enumerate(poses):
        read = sequence.world_from_cam[index]
        np.testing.assert_allclose(read.matrix(), pose.matrix(), atol=1e-15)
        np.testing.assert_array_equal(sequence.image(index), textured(32, 64, index))
        np.testing.assert_array_equal(sequence.depth(index), depth + index)


def test_files_are_taken_by_number_not_by_name(tmp_path):
    write_mp3d_vo(tmp_path, range(11), depth=False)
    names = [path.name for path in load_mp3d_vo(tmp_path).image_paths]
    assert names == [f"{number}.png" for number in range(1, 12)]


def test_depth_is_optional_and_asking_for_a_missing_one_says_so(tmp_path):
    write_mp3d_vo(tmp_path, [0, 1], depth=False)
    with pytest.raises(ValueError, match="has no depth maps"):
        load_mp3d_vo(tmp_path).depth(0)


def test_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        load_mp3d_vo(tmp_path / "nowhere")


def test_folder_without_images_is_named(scene):
    for path in (scene / "rgb").iterdir():
        path.unlink()
    with pytest.raises(FileNotFoundError, match=r"rgb has no images 1\.png"):
        load_mp3d_vo(scene)


def test_gap_in_the_numbers_is_named(scene):
    (scene / "rgb" / "2.png").unlink()
    with pytest.raises(ValueError, match=r"from 1 to 3, 2\.png is missing"):
        load_mp3d_vo(scene)


def test_numbers_that_start_at_zero_are_refused(scene):
    write_png(scene / "rgb" / "0.png", textured(32, 64))
    with pytest.raises(ValueError, match=r"there is a 0\.png"):
        load_mp3d_vo(scene)


def test_different_counts_of_poses_and_images_are_refused(scene):
    write_png(scene / "rgb" / "4.png", textured(32, 64))
    with pytest.raises(ValueError, match="3 rows in frm_ref.txt and 4 images"):
        load_mp3d_vo(scene)


def test_different_counts_of_depth_maps_and_images_are_refused(scene):
    (scene / "depth" / "tiff" / "3.tiff").unlink()
    with pytest.raises(ValueError, match="got 2 in depth/tiff and 3 images"):
        load_mp3d_vo(scene)


@pytest.mark.parametrize("row", ["1 2 3", "1 0 0 nan 0 0 0 1", "1 0 0 x 0 0 0 1"])
def test_bad_row_is_named_with_its_file_and_line(scene, row):
    rewrite_row(scene, 1, row)
    with pytest.raises(ValueError, match=r"row 2 of .*frm_ref\.txt must hold"):
        load_mp3d_vo(scene)


def test_quaternion_far_from_unit_length_is_refused(scene):
    rewrite_row(scene, 2, "1 0 0 0 0 0 1 1")
    with pytest.raises(ValueError, match="row 3 of .* must hold a unit quaternion"):
        load_mp3d_vo(scene)


def test_rounded_quaternion_is_scaled_to_unit_length(scene):
    rewrite_row(scene, 2, "1 0 0 0 0 0 0.087 0.996")
    rotation = load_mp3d_vo(scene).world_from_cam[2].rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


def test_image_of_another_size_is_refused_when_it_is_read(scene):
    write_png(scene / "rgb" / "2.png", textured(16, 32))
    with pytest.raises(ValueError, match=r"2\.png must have the camera's size 64x32, got 32x16"):
        load_mp3d_vo(scene).image(1)


def test_damaged_depth_map_is_named(scene):
    (scene / "depth" / "tiff" / "2.tiff").write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"2\.tiff must be a TIFF of one float channel"):
        load_mp3d_vo(scene).depth(1)


def test_scenes_are_found_below_a_folder(tmp_path):
    write_mp3d_vo(tmp_path / "b" / "0", [0, 1], depth=False)
    write_mp3d_vo(tmp_path / "a" / "0", [0, 1], depth=False)
    names = [path.relative_to(tmp_path).as_posix() for path in find_mp3d_vo_scenes(tmp_path)]
    assert names == ["a/0", "b/0"]
    assert find_mp3d_vo_scenes(tmp_path / "a" / "0") == [tmp_path / "a" / "0"]


def test_folder_without_scenes_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="has no scene"):
        find_mp3d_vo_scenes(tmp_path)
