# SPDX-License-Identifier: BSD-3-Clause
import json

import cv2
import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt, load_camera
from epi360.jobs.frames.frame_source import read_frame_times
from epi360.poses import Pose
from epi360_paper.datasets import load_mp3d_vo
from epi360_scenes import Rendering, handheld_path, scene
from epi360_scenes.mp3d_layout import frame_files, poses_text, write_frame, write_whole
from epi360_scenes.raycast import nearest_hits
from epi360_scenes.sequence import render_sequence

CAMERA = Equirectangular(width=96, height=48)
OPTIONS = {"scene": "studio", "seed": 0, "camera": None}


@pytest.fixture(scope="module")
def room():
    return scene("studio")


@pytest.fixture(scope="module")
def path(room):
    return handheld_path(room, 4)


class CountingScene:
    """Renders flat pictures whose depth is the number of the picture."""

    def __init__(self):
        self.num_rendered = 0

    def render(self, camera, world_from_cam, *, supersample=2):
        self.num_rendered += 1
        shape = (camera.height, camera.width)
        image = np.full((*shape, 3), (200, 100, 50), np.uint8)
        return Rendering(image, np.full(shape, world_from_cam.translation[0], np.float32))


def still_poses(num):
    return [Pose(np.eye(3), np.array([1.5 + index, 0.0, 0.0])) for index in range(num)]


def pixel_centers(camera):
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    return np.stack([u.ravel(), v.ravel()], axis=1)


def read_poses(file):
    """Poses of frm_ref.txt by the rotation formula of unit quaternions."""
    poses = []
    for t, tx, ty, tz, x, y, z, w in np.loadtxt(file, ndmin=2):
        assert t == len(poses)
        rotation = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        poses.append(Pose(rotation, np.array([tx, ty, tz])))
    return poses


def test_frames_of_a_sequence_agree_with_each_other_by_their_poses(room, path, tmp_path):
    # All from the files: range and pose of frame k put points into the world; rays of frame k + 1
    # through them must not pass them, and must meet nearly all of them.
    assert render_sequence(room, CAMERA, path, tmp_path, OPTIONS) == 4
    poses = read_poses(tmp_path / "frm_ref.txt")
    bearings = CAMERA.bearings_from_pixels(pixel_centers(CAMERA))
    for index in range(3):
        depth = cv2.imread(str(tmp_path / f"depth/tiff/{index + 1}.tiff"), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.float32 and depth.shape == (48, 96)
        here, there = poses[index], poses[index + 1]
        world = (bearings * depth.reshape(-1, 1)) @ here.rotation.T + here.translation
        rays = world - there.translation
        lengths = np.linalg.norm(rays, axis=1)
        ranges, _ = nearest_hits(room.solids, there.translation, rays / lengths[:, None])
        assert (ranges - lengths).max() < 1e-3  # float32 ranges of up to 8 m, grazing rays
        assert np.mean(np.abs(ranges - lengths) < 1e-3) > 0.97  # the rest is hidden now
        # The next depth image, at the pixels where these points fall: a pixel of 3.75 deg is
        # coarse, so only the median must agree.
        next_depth = cv2.imread(str(frame_files(tmp_path, index + 1)[1]), cv2.IMREAD_UNCHANGED)
        u, v = np.floor(CAMERA.pixels_from_bearings(rays @ there.rotation)).astype(int).T
        ratio = next_depth[np.minimum(v, 47), u % 96] / lengths
        assert np.median(np.abs(ratio - 1)) < 0.01


def test_the_floor_lies_where_depth_and_pose_put_it(room, path):
    view = room.render(CAMERA, path[0], supersample=1)
    bearings = CAMERA.bearings_from_pixels(pixel_centers(CAMERA))
    world = (bearings * view.depth.reshape(-1, 1)) @ path[0].rotation.T + path[0].translation
    assert world[:, 1].max() == pytest.approx(0, abs=1e-5)
    low, high = room.bounds
    assert (world > low - 1e-5).all() and (world < high + 1e-5).all()


def test_the_reader_of_the_data_set_reads_a_rendered_sequence(tmp_path):
    poses = still_poses(3)
    render_sequence(CountingScene(), CAMERA, poses, tmp_path, OPTIONS)
    sequence = load_mp3d_vo(tmp_path)
    assert sequence.camera == CAMERA
    for pose, read in zip(poses, sequence.world_from_cam, strict=True):
        np.testing.assert_allclose(read.matrix(), pose.matrix(), atol=1e-15)
    assert [path.name for path in sequence.image_paths] == ["1.png", "2.png", "3.png"]
    assert [path.name for path in sequence.depth_paths] == ["1.tiff", "2.tiff", "3.tiff"]


def test_files_are_read_back_as_they_were(tmp_path):
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (12, 24, 3), dtype=np.uint8)
    depth = rng.uniform(0, 9, (12, 24)).astype(np.float32)
    depth[3] = 0
    write_frame(tmp_path, 6, Rendering(image, depth))
    assert sorted(p.name for p in tmp_path.rglob("*.*")) == ["7.png", "7.tiff"]
    bgr = cv2.imread(str(tmp_path / "rgb" / "7.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(bgr[:, :, ::-1], image)
    tiff = cv2.imread(str(tmp_path / "depth" / "tiff" / "7.tiff"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(tiff, depth)


def test_poses_lose_nothing_in_their_file(path, tmp_path):
    (tmp_path / "poses.txt").write_text(poses_text(path))
    for pose, again in zip(path, read_poses(tmp_path / "poses.txt"), strict=True):
        np.testing.assert_array_equal(again.translation, pose.translation)
        np.testing.assert_allclose(again.rotation, pose.rotation, atol=1e-15)


def test_the_camera_of_a_sequence_is_in_a_file_that_can_be_loaded(tmp_path):
    lens = KannalaBrandt(32, 32, fx=11.9, fy=11.9, cx=16.0, cy=16.0, k1=0.01, max_angle_deg=97.5)
    render_sequence(CountingScene(), lens, still_poses(1), tmp_path, OPTIONS)
    assert load_camera(tmp_path / "camera.json") == lens


def test_an_interrupted_sequence_goes_on_where_it_stopped(tmp_path):
    class Interrupted(CountingScene):
        def render(self, *arguments, **options):
            if self.num_rendered == 2:
                raise KeyboardInterrupt
            return super().render(*arguments, **options)

    with pytest.raises(KeyboardInterrupt):
        render_sequence(Interrupted(), CAMERA, still_poses(5), tmp_path, OPTIONS)
    assert not list(tmp_path.rglob("*.tmp"))
    frame_files(tmp_path, 0)[1].unlink()  # half of a frame does not count
    flat, seen = CountingScene(), []
    num = render_sequence(
        flat, CAMERA, still_poses(5), tmp_path, OPTIONS, progress=lambda *n: seen.append(n)
    )
    assert num == flat.num_rendered == 4
    assert seen == [("frames", done, 5) for done in (1, 2, 3, 4, 5)]
    for index in range(5):
        depth = cv2.imread(str(frame_files(tmp_path, index)[1]), cv2.IMREAD_UNCHANGED)
        assert (depth == 1.5 + index).all()
    assert render_sequence(flat, CAMERA, still_poses(5), tmp_path, OPTIONS) == 0


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    poses, flat = still_poses(2), CountingScene()
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="is not empty and holds no sequence of epi360 render"):
        render_sequence(flat, CAMERA, poses, tmp_path, OPTIONS)
    with pytest.raises(ValueError, match=r"must go into a folder, .*notes.txt is a file"):
        render_sequence(flat, CAMERA, poses, tmp_path / "notes.txt", OPTIONS)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    folder = tmp_path / "sequence"
    render_sequence(flat, CAMERA, poses, folder, OPTIONS)
    with pytest.raises(ValueError, match="holds a sequence with seed 0, not 1; choose another"):
        render_sequence(flat, CAMERA, poses, folder, {**OPTIONS, "seed": 1})
    with pytest.raises(ValueError, match=r"frm_ref.txt is not what these options give"):
        render_sequence(flat, CAMERA, still_poses(3), folder, OPTIONS)
    (folder / "render.json").write_text("{")
    with pytest.raises(ValueError, match=r"render.json is damaged"):
        render_sequence(flat, CAMERA, poses, folder, OPTIONS)


def test_options_are_kept_for_the_reader(tmp_path):
    render_sequence(CountingScene(), CAMERA, still_poses(1), tmp_path, OPTIONS)
    assert json.loads((tmp_path / "render.json").read_text()) == OPTIONS


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    write_whole(tmp_path / "new" / "file", b"first")
    blocked = tmp_path / "blocked"
    (blocked / "inside").mkdir(parents=True)
    with pytest.raises(OSError):
        write_whole(blocked, b"a folder is in the way")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["blocked", "new"]


def test_unknown_scenes_are_named():
    with pytest.raises(ValueError, match="scene must be one of living_room, studio, got 'cave'"):
        scene("cave")


def test_the_table_of_frames_gives_each_picture_the_time_of_its_pose(tmp_path):
    render_sequence(CountingScene(), CAMERA, still_poses(3), tmp_path, OPTIONS)
    times = read_frame_times(tmp_path / "rgb")
    assert times == {"1.png": 0.0, "2.png": 1.0, "3.png": 2.0}
    assert list(times.values()) == np.loadtxt(tmp_path / "frm_ref.txt")[:, 0].tolist()
