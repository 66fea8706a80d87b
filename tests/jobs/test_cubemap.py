# SPDX-License-Identifier: BSD-3-Clause
import json
import os
import signal
import subprocess
import sys

import cv2
import numpy as np
import pytest
from cube_inputs import (
    PANORAMA,
    direction_colors,
    pixel_centres,
    plain_reconstruction,
    read_picture,
    two_panoramas,
    write_png,
)

from epi360.cameras import Equirectangular, KannalaBrandt, Pinhole
from epi360.interop import Observations, PosedImage, Reconstruction
from epi360.jobs.cubes.cube_faces import (
    FACES,
    CubemapOptions,
    cubemap_reconstruction,
    face_camera,
    face_from_cam,
    face_image_names,
    visible_faces,
)
from epi360.jobs.cubes.face_sampler import FaceSampler
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

FISHEYE = KannalaBrandt(200, 200, 60.0, 60.0, 100.0, 100.0, 0, 0, 0, 0, max_angle_deg=95)
IDENTITY = Pose(np.eye(3), np.zeros(3))
KILLED_AT_A_FACE = """
import os, signal, sys
from epi360 import cli
replace = os.replace
def kill_at_a_face(source, target):
    if str(target).endswith(".jpg"):
        os.kill(os.getpid(), signal.SIGKILL)
    replace(source, target)
os.replace = kill_at_a_face
cli.main(sys.argv[1:])
"""


@pytest.mark.parametrize("face", FACES)
@pytest.mark.parametrize("fov_deg", [90.0, 110.0])
def test_each_pixel_of_a_face_shows_what_lies_in_its_direction(face, fov_deg):
    picture = direction_colors(PANORAMA.bearings_from_pixels(pixel_centres(PANORAMA)), PANORAMA)
    pinhole = face_camera(PANORAMA, CubemapOptions(face_size=96, fov_deg=fov_deg))
    rays = pinhole.bearings_from_pixels(pixel_centres(pinhole))
    wanted = direction_colors(rays @ face_from_cam(face).rotation, pinhole)
    shown = FaceSampler(PANORAMA, pinhole, face).picture(picture)
    errors = shown.astype(float) - wanted
    # A pixel is up to 3 grey levels, so half a pixel would be 1.5; rounding leaves 0.1 on average.
    assert abs(errors.mean(axis=(0, 1))).max() < 0.25
    assert np.abs(errors).max() <= 2


def test_the_face_across_the_seam_is_as_good_as_the_one_in_the_middle():
    noise = np.random.default_rng(0).integers(0, 256, (64, 128, 3), dtype=np.uint8)
    camera = Equirectangular(128, 64)
    pinhole = face_camera(camera, CubemapOptions(face_size=160))  # five pixels for one
    across = FaceSampler(camera, pinhole, "back").picture(noise)
    middle = FaceSampler(camera, pinhole, "front").picture(np.roll(noise, 64, axis=1))
    difference = cv2.absdiff(across, middle)
    assert difference.max() <= 12  # cv2.remap knows 32 places in a pixel, rounded differently
    assert difference.mean() < 0.5


def test_faces_look_where_their_names_say_and_stand_upright():
    middles = {face: face_from_cam(face).rotation.T @ (0, 0, 1) for face in FACES}
    expected = {
        "front": (0, 0, 1), "right": (1, 0, 0), "back": (0, 0, -1),
        "left": (-1, 0, 0), "up": (0, -1, 0), "down": (0, 1, 0),
    }  # fmt: skip
    for face, middle in expected.items():
        np.testing.assert_array_equal(middles[face], middle)
    for face in ("front", "right", "back", "left"):
        np.testing.assert_array_equal(face_from_cam(face).rotation.T @ (0, 1, 0), (0, 1, 0))
    np.testing.assert_array_equal(face_from_cam("up").rotation.T @ (0, 1, 0), (0, 0, 1))
    np.testing.assert_array_equal(face_from_cam("down").rotation.T @ (0, -1, 0), (0, 0, 1))


def test_a_strong_reduction_averages_instead_of_picking_pixels():
    camera = Equirectangular(512, 256)
    checkers = np.where(np.indices((256, 512)).sum(axis=0) % 2, np.uint8(255), np.uint8(0))
    pinhole = face_camera(camera, CubemapOptions(face_size=24))
    face = FaceSampler(camera, pinhole, "front").picture(checkers)
    assert abs(face.mean() - 127.5) < 3
    assert face.std() < 25  # of picked pixels it would be about 127


def test_default_faces_have_a_quarter_of_the_width():
    pinhole = face_camera(PANORAMA, CubemapOptions())
    assert pinhole == Pinhole(64, 64, 32.0, 32.0, 32.0, 32.0)
    wide = face_camera(PANORAMA, CubemapOptions(fov_deg=100))
    assert wide.fx == pytest.approx(32.0, abs=0.5)  # the size of a pixel stays
    assert wide.width == 2 * round(32 * np.tan(np.radians(50)))


def test_a_fisheye_has_no_back_and_its_other_faces_end_where_its_view_ends():
    options = CubemapOptions(face_size=64)
    assert visible_faces(FISHEYE, options) == ("front", "right", "left", "up", "down")
    sampler = FaceSampler(FISHEYE, face_camera(FISHEYE, options), "right")
    rays = face_camera(FISHEYE, options).bearings_from_pixels(np.array([[1.0, 32.0], [40.0, 32.0]]))
    angles_deg = np.degrees(np.arccos((rays @ face_from_cam("right").rotation)[:, 2]))
    assert angles_deg[0] < 95 < angles_deg[1]
    assert sampler.visible[32, 1] and not sampler.visible[32, 40]
    assert not sampler.picture(np.full((200, 200), 255, np.uint8))[~sampler.visible].any()


def test_names_keep_folders_and_never_collide():
    options = CubemapOptions(faces=("front", "up"))
    names = face_image_names(["rüm/a.jpg", "b.png"], options)
    assert names["rüm/a.jpg", "front"] == "rüm/a_front.jpg"
    assert names["b.png", "up"] == "b_up.jpg"
    twins = face_image_names(["a.jpg", "A.png", "x/a.jpg"], options)
    assert len({name.casefold() for name in twins.values()}) == 6
    assert twins["a.jpg", "front"] == "a.jpg_front.jpg"


def test_flat_names_survive_programs_that_drop_folders_and_what_follows_a_dot():
    options = CubemapOptions(faces=("front", "up"), flat=True)
    names = face_image_names(["a b/v1.2 x.jpg", "c.png"], options)
    assert names["a b/v1.2 x.jpg", "front"] == "a_b_v1_2_x_front.jpg"
    assert names["c.png", "up"] == "c_up.jpg"
    same = ["x/1.jpg", "x.1.jpg", "X 1.jpg", "y.jpg"]
    flat = face_image_names(same, options)
    stems = {name.split(".")[0].casefold() for name in flat.values()}
    assert len(stems) == 8 and all(name.count(".") == 1 for name in flat.values())
    assert flat["X 1.jpg", "up"] == "3_X_1_up.jpg"


def test_observations_fall_where_the_exported_poses_see_the_points():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3)) * 3
    colors = rng.integers(0, 256, (200, 3)).astype(np.uint8)
    poses = [Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)) for _ in range(3)]
    images = tuple(PosedImage(f"{i}.jpg", "pano", pose) for i, pose in enumerate(poses))
    seen = [
        PANORAMA.pixels_from_bearings(points @ pose.rotation.T + pose.translation) for pose in poses
    ]
    observations = Observations(
        np.tile(np.arange(200), 3), np.repeat(np.arange(3), 200), np.concatenate(seen)
    )
    source = Reconstruction({"pano": PANORAMA}, images, points, colors, observations)
    cube = cubemap_reconstruction(source, CubemapOptions())
    assert len(cube.images) == 18 and len(cube.observations.points) == 600
    np.testing.assert_array_equal(cube.points, points)
    np.testing.assert_array_equal(cube.colors, colors)
    for point, index, pixel in zip(
        cube.observations.points, cube.observations.images, cube.observations.pixels, strict=True
    ):
        pose = cube.images[index].cam_from_world
        x, y, z = pose.rotation @ cube.points[point] + pose.translation
        assert z > 0
        np.testing.assert_allclose((32 * x / z + 32, 32 * y / z + 32), pixel, atol=1e-8)


def test_points_that_only_a_missing_face_saw_are_left_out():
    points = np.array([[0.0, 5.0, 0.1], [0.0, 0.2, 5.0]])  # below, in front
    observations = Observations(
        np.array([0, 1]), np.array([0, 0]), PANORAMA.pixels_from_bearings(points)
    )
    source = plain_reconstruction(
        ["a.jpg"], points=points, colors=np.zeros((2, 3), np.uint8), observations=observations
    )
    cube = cubemap_reconstruction(source, CubemapOptions(faces=("front", "left")))
    np.testing.assert_array_equal(cube.points, points[1:])
    np.testing.assert_array_equal(cube.observations.points, [0])
    np.testing.assert_array_equal(cube.observations.images, [0])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"faces": ()}, "different ones of front"),
        ({"faces": ("front", "front")}, "different ones of front"),
        ({"faces": ("top",)}, "got top"),
        ({"fov_deg": 180.0}, "fov_deg must be 10 to 150"),
        ({"face_size": 0}, "face_size must be 8 to 16384"),
        ({"face_size": "large"}, "face_size must be 8 to 16384 pixels or"),
        ({"jpeg_quality": 0}, "jpeg_quality"),
        ({"alpha": True}, "image_format must be png for alpha"),
        ({"image_format": "gif"}, "image_format must be jpg or png"),
    ],
)
def test_options_out_of_range_are_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        CubemapOptions(**wrong)


def test_an_image_without_camera_is_refused():
    source = Reconstruction({}, (PosedImage("1.0", None, IDENTITY),))
    with pytest.raises(ValueError, match=r"1\.0 has no camera"):
        cubemap_reconstruction(source, CubemapOptions())


class TestExport:
    """The folder that is written."""

    @pytest.fixture(autouse=True)
    def needs_pycolmap(self):
        pytest.importorskip("pycolmap")

    def test_faces_equal_pictures_rendered_at_the_exported_poses(self, tmp_path):
        from epi360.interop.colmap_model import read_colmap_model
        from epi360.interop.nerfstudio import read_nerfstudio
        from epi360.jobs.cubes.cubemap import export_cubemap

        room, camera = furnished_room(0), Equirectangular(512, 256)
        world_from_cam = room.sample_pose(np.random.default_rng(1), max_tilt_deg=40.0)
        write_png(tmp_path / "in" / "a.png", room.render(camera, world_from_cam).image)
        source = Reconstruction(
            {"p": camera}, (PosedImage("a.png", "p", world_from_cam.inverse()),)
        )
        out = tmp_path / "out"
        png = CubemapOptions(image_format="png")
        export_cubemap(tmp_path / "in", source, out, png, keep_world=True)
        model = read_colmap_model(out / "sparse" / "0")
        assert len(model.images) == 6
        for image in model.images:
            shown = read_picture(out / "images" / image.name).astype(np.float32)
            pinhole = model.cameras[image.camera]
            direct = room.render(pinhole, image.cam_from_world.inverse()).image.astype(np.float32)
            assert np.abs(shown - direct).mean() < 5  # a flipped face: more than 30
            window = cv2.createHanningWindow((128, 128), cv2.CV_32F)
            (du, dv), _ = cv2.phaseCorrelate(shown.mean(axis=2), direct.mean(axis=2), window)
            assert np.hypot(du, dv) < 0.1  # pixels; the textures decide it to 0.05
        transforms = read_nerfstudio(out / "transforms.json")
        for one, other in zip(model.images, transforms.images, strict=True):
            assert one.name == other.name
            np.testing.assert_allclose(
                one.cam_from_world.matrix(), other.cam_from_world.matrix(), atol=1e-9
            )

    def test_a_record_without_the_newest_options_is_that_of_their_defaults(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        out = tmp_path / "out"
        export_cubemap(folder, source, out)
        record = json.loads((out / "cubemap.json").read_text())
        del record["options"]["flat"], record["options"]["alpha"]
        (out / "cubemap.json").write_text(json.dumps(record))
        assert export_cubemap(folder, source, out).num_kept == 2
        with pytest.raises(ValueError, match="other options"):
            export_cubemap(folder, source, out, CubemapOptions(flat=True))

    def test_a_damaged_record_is_named(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        export_cubemap(folder, source, tmp_path / "out")
        for content in ("{}", "[1", "[]", '{"options": {}, "made_from": 3}'):
            (tmp_path / "out" / "cubemap.json").write_text(content)
            with pytest.raises(ValueError, match=r"cubemap.json is damaged; delete"):
                export_cubemap(folder, source, tmp_path / "out")

    def test_a_second_run_cuts_only_what_changed(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        out = tmp_path / "out"
        calls = []
        first = export_cubemap(folder, source, out, progress=lambda *call: calls.append(call))
        assert (first.num_written, first.num_kept) == (2, 0)
        assert calls == [("cutting cube faces", done, 2) for done in (0, 1, 2)]
        (out / "images" / "b_up.jpg").unlink()
        second = export_cubemap(folder, source, out)
        assert (second.num_written, second.num_kept) == (1, 1)
        assert (out / "images" / "b_up.jpg").exists()

    def test_faces_with_another_mask_or_camera_are_cut_again(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        one, other = tmp_path / "one.png", tmp_path / "other.png"
        for path, below in ((one, 0), (other, 9)):
            mask = np.full((128, 256), 255, np.uint8)
            mask[128 - below :] = 0
            write_png(path, mask)
        out = tmp_path / "out"
        export_cubemap(folder, source, out, masks={"a.png": one, "b.png": one})
        assert (out / "masks" / "a_front.jpg.png").exists()
        second = export_cubemap(folder, source, out, masks={"a.png": other, "b.png": one})
        assert (second.num_written, second.num_kept) == (1, 1)
        export_cubemap(folder, source, out)
        assert not (out / "masks" / "a_front.jpg.png").exists()
        turned = Equirectangular(256, 128, center_longitude_deg=90.0)
        third = export_cubemap(folder, plain_reconstruction(["a.png", "b.png"], turned), out)
        assert (third.num_written, third.num_kept) == (2, 0)

    def test_faces_of_another_picture_of_the_same_name_and_time_are_cut_again(
        self, tmp_path, monkeypatch
    ):
        """Who renames a picture, unpacks or copies it keeps its time."""
        monkeypatch.setattr("epi360.runs.file_digests._SETTLED_NS", 0)  # hashes are remembered
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        write_png(folder / "b.png", np.full((128, 256, 3), 90, np.uint8))
        mask = tmp_path / "mask.png"
        write_png(mask, np.full((128, 256), 255, np.uint8))
        masks = {"a.png": mask, "b.png": None}
        out, fresh = tmp_path / "out", tmp_path / "fresh"
        export_cubemap(folder, source, out, masks=masks)
        (folder / "a.png").rename(folder / "c.png")
        (folder / "b.png").rename(folder / "a.png")
        (folder / "c.png").rename(folder / "b.png")
        assert export_cubemap(folder, source, out, masks=masks).num_written == 2
        picture = np.full((128, 256), 255, np.uint8)
        picture[:40] = 0
        was = mask.stat()
        write_png(mask, picture)
        os.utime(mask, ns=(was.st_atime_ns, was.st_mtime_ns))
        assert export_cubemap(folder, source, out, masks=masks).num_written == 1
        export_cubemap(folder, source, fresh, masks=masks)
        for file in (*fresh.glob("images/*"), *fresh.glob("masks/*")):
            assert (out / file.relative_to(fresh)).read_bytes() == file.read_bytes()

    def test_faces_of_a_panorama_that_left_the_model_are_removed(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        out = tmp_path / "out"
        export_cubemap(folder, source, out, mask_nadir_deg=20.0)
        again = export_cubemap(folder, plain_reconstruction(["b.png"]), out, mask_nadir_deg=20.0)
        assert again.num_kept == 1
        left = {path.name[:2] for part in ("images", "masks") for path in (out / part).iterdir()}
        assert left == {"b_"}

    def test_nothing_that_is_there_is_overwritten(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        out = tmp_path / "out"
        export_cubemap(folder, source, out)
        with pytest.raises(ValueError, match="other options"):
            export_cubemap(folder, source, out, CubemapOptions(fov_deg=100))
        with pytest.raises(ValueError, match="holds other files"):
            export_cubemap(folder, source, folder.parent)
        with pytest.raises(ValueError, match="images' folder"):
            export_cubemap(folder, source, folder)

    @pytest.mark.parametrize("way", ["absolute", "up"])
    def test_a_name_that_leads_out_of_the_output_touches_nothing_there(self, tmp_path, way):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, _ = two_panoramas(tmp_path)
        victim = tmp_path / "victim_front.jpg"
        victim.write_bytes(b"theirs")
        name = str(tmp_path / "victim.png") if way == "absolute" else "../../victim.png"
        with pytest.raises(ValueError, match=r"victim_front\.jpg' leads out of .*images"):
            export_cubemap(folder, plain_reconstruction(["a.png", name]), tmp_path / "out")
        assert victim.read_bytes() == b"theirs"
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize("name", [".", "/"])
    def test_an_image_without_a_name_is_refused(self, tmp_path, name):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, _ = two_panoramas(tmp_path)
        with pytest.raises(ValueError, match=f"images must have names, got '{name}'"):
            export_cubemap(folder, plain_reconstruction(["a.png", name]), tmp_path / "out")

    def test_no_face_is_removed_before_all_images_and_masks_are_there(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        out, mask = tmp_path / "out", tmp_path / "mask.png"
        export_cubemap(folder, source, out)
        before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
        write_png(mask, np.full((128, 256), 255, np.uint8))
        masks = {"a.png": mask, "b.png": tmp_path / "missing.png"}
        with pytest.raises(FileNotFoundError, match=r"mask .*missing\.png does not exist"):
            export_cubemap(folder, source, out, masks=masks)
        write_png(mask, np.full((64, 128), 255, np.uint8))
        with pytest.raises(ValueError, match=r"mask of a\.png is 128x64 but its camera is 256x128"):
            export_cubemap(folder, source, out, masks={"a.png": mask})
        (folder / "b.png").unlink()
        with pytest.raises(FileNotFoundError, match=r"b\.png"):
            export_cubemap(folder, plain_reconstruction(["b.png"]), out)
        del before[out / "cubemap.json"]
        assert {path: path.read_bytes() for path in before} == before

    def test_a_record_with_a_name_that_leads_out_removes_nothing(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        out, victim = tmp_path / "out", tmp_path / "victim_front.jpg"
        export_cubemap(folder, source, out)
        victim.write_bytes(b"theirs")
        record = json.loads((out / "cubemap.json").read_text())
        record["made_from"] |= {"../../victim.png": "", str(tmp_path / "victim.png"): ""}
        (out / "cubemap.json").write_text(json.dumps(record))
        with pytest.raises(ValueError, match="leads out of"):
            export_cubemap(folder, plain_reconstruction(["b.png"]), out)
        assert victim.read_bytes() == b"theirs"
        assert (out / "images" / "a_front.jpg").exists()

    @pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
    def test_what_a_killed_run_leaves_is_removed_by_the_next_one(self, tmp_path):
        from epi360.interop import write_colmap_model
        from epi360.jobs.cubes.cubemap import export_cubemap
        from epi360.runs.whole_files import remove_leftovers

        folder, source = two_panoramas(tmp_path, ("sub/a.png", "sub/b.png"))
        out, model = tmp_path / "out", tmp_path / "model"
        write_colmap_model(model, source)
        command = [sys.executable, "-c", KILLED_AT_A_FACE, "cubemap", model, folder, out]
        assert subprocess.run(command, timeout=60).returncode == -signal.SIGKILL
        assert list(out.rglob(".epi360-*.tmp"))
        remove_leftovers.cache_clear()  # of this process, which may have looked before
        export_cubemap(folder, source, out)
        assert list(out.rglob(".*")) == []
        assert len(list((out / "images" / "sub").iterdir())) == 12

    def test_a_link_in_the_output_is_not_followed_out_of_it(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        out, victim = tmp_path / "out", tmp_path / "victim.jpg"
        export_cubemap(folder, source, out)
        victim.write_bytes(b"theirs")
        (out / "images" / "a_front.jpg").unlink()
        (out / "images" / "a_front.jpg").symlink_to(victim)
        with pytest.raises(ValueError, match="a link leads to"):
            export_cubemap(folder, source, out)
        assert victim.read_bytes() == b"theirs"

    def test_a_vanished_or_another_image_is_named_before_anything_is_written(self, tmp_path):
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, source = two_panoramas(tmp_path)
        out = tmp_path / "out"
        (folder / "b.png").unlink()
        with pytest.raises(FileNotFoundError, match=r"b\.png"):
            export_cubemap(folder, source, out)
        write_png(folder / "b.png", np.zeros((64, 128, 3), np.uint8))
        with pytest.raises(ValueError, match=r"b\.png is 128x64 but its camera is 256x128"):
            export_cubemap(folder, source, out)
        assert not out.exists()

    def test_mixed_sizes_get_one_camera_each(self, tmp_path):
        from epi360.interop.colmap_model import read_colmap_model
        from epi360.jobs.cubes.cubemap import export_cubemap

        folder, _ = two_panoramas(tmp_path, ("a.png",))
        two_panoramas(tmp_path, ("b.png",), Equirectangular(512, 256))
        source = Reconstruction(
            {"1": PANORAMA, "2": Equirectangular(512, 256)},
            (PosedImage("a.png", "1", IDENTITY), PosedImage("b.png", "2", IDENTITY)),
        )
        export_cubemap(folder, source, tmp_path / "out", CubemapOptions(faces=("front",)))
        model = read_colmap_model(tmp_path / "out" / "sparse" / "0")
        assert [model.cameras[image.camera].width for image in model.images] == [64, 128]
        frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
        assert [frame["file_path"] for frame in frames] == [
            "images/a_front.jpg",
            "images/b_front.jpg",
        ]
