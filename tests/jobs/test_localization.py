# SPDX-License-Identifier: BSD-3-Clause
"""New images in a map of a rendered room: ours, COLMAP's, hloc's; and images of other places."""

import dataclasses
import pickle
import re
import shutil
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from mapped_room import CAMERA, write_picture

import epi360
from epi360.cameras import KannalaBrandt, Pinhole
from epi360.interop import write_colmap_model
from epi360.jobs.localization.outputs import model_with
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector
from epi360_scenes import furnished_room, scene

pytest.importorskip("pycolmap")

WORLD_FROM_NEW = Pose(rotation_from_vector([0.05, 2.0, -0.04]), np.array([-0.35, -1.47, -0.42]))
PHOTOGRAPH = Pinhole(400, 300, 140.0, 140.0, 200.0, 150.0)
FISHEYE = KannalaBrandt(360, 360, 103.0, 103.0, 180.0, 180.0, 0.0, 0.0, 0.0, 0.0, max_angle_deg=100)


@pytest.fixture(scope="module")
def world(room_run):
    return epi360.load_map(room_run[0])


@pytest.fixture(scope="module")
def new_image():
    return furnished_room(0).render(CAMERA, WORLD_FROM_NEW).image


def true_pose(world, truth):
    """True ``cam_from_world`` of the new image in the world of the map, and the map's unit."""
    images = [image for image in world.model.images if image.name in truth]
    ours = np.array([i.cam_from_world.inverse().translation for i in images])
    true = np.array([truth[i.name].translation for i in images])
    turns = [i.cam_from_world.rotation.T @ truth[i.name].rotation.T for i in images]
    U, _, Vt = np.linalg.svd(sum(turns))
    R = U @ Vt
    a, b = ours - ours.mean(0), (true - true.mean(0)) @ R.T
    scale = float((a * b).sum() / (b * b).sum())
    center = scale * R @ (WORLD_FROM_NEW.translation - true.mean(0)) + ours.mean(0)
    rotation = (R @ WORLD_FROM_NEW.rotation).T
    return Pose(rotation, -rotation @ center), scale


def assert_right(result, world, truth, largest_deg=0.3, largest_m=0.02):
    pose, scale = true_pose(world, truth)
    away = pose.inverse().translation - result.cam_from_world.inverse().translation
    assert result.status == "ok" and result.probability > 0.95
    assert rotation_error_deg(result.cam_from_world, pose) < largest_deg
    assert np.linalg.norm(away) / scale < largest_m
    # The map itself is off by about as much as the image.
    assert np.linalg.norm(away) < 5.0 * result.position_sigma + 0.25 * largest_m * scale


def test_a_new_panorama_gets_its_pose_and_an_honest_sigma(world, new_image, room_folder):
    result = epi360.localize_image(new_image, world)
    assert_right(result, world, room_folder[1])
    assert result.num_inliers > 50 and len(result.keypoints) == len(result.inlier_mask)
    assert result.seen_share > 3.0 * result.chance_share
    assert result.same_share > 0.8 and result.warnings == ()
    assert set(result.map_images) <= {image.name for image in world.model.images}
    again = epi360.localize_image(new_image, world)
    np.testing.assert_array_equal(again.cam_from_world.matrix(), result.cam_from_world.matrix())


def test_a_fisheye_that_sees_200_degrees_is_found_in_a_map_of_panoramas(world, room_folder):
    picture = furnished_room(0).render(FISHEYE, WORLD_FROM_NEW).image
    result = epi360.localize_image(picture, world, camera=FISHEYE)
    assert_right(result, world, room_folder[1], largest_deg=1.0, largest_m=0.05)
    beyond = FISHEYE.bearings_from_pixels(result.keypoints[result.inlier_mask])[:, 2]
    assert beyond.min() < 0.2  # also points at the rim of the lens are used


class TestAPhotograph:
    @pytest.fixture
    def picture(self):
        return furnished_room(0).render(PHOTOGRAPH, WORLD_FROM_NEW).image

    @staticmethod
    def wrong(factor):
        return dataclasses.replace(PHOTOGRAPH, fx=factor * PHOTOGRAPH.fx, fy=factor * PHOTOGRAPH.fy)

    def test_it_keeps_a_right_focal_length(self, world, picture, room_folder):
        result = epi360.localize_image(picture, world, camera=PHOTOGRAPH)
        assert_right(result, world, room_folder[1], largest_deg=0.5, largest_m=0.03)
        assert result.camera == PHOTOGRAPH and result.warnings == ()

    @pytest.mark.parametrize("factor", [0.9, 1.15])
    def test_a_wrong_focal_length_is_found_and_said(self, world, picture, room_folder, factor):
        result = epi360.localize_image(picture, world, camera=self.wrong(factor))
        assert_right(result, world, room_folder[1], largest_deg=0.5, largest_m=0.03)
        assert result.camera.fx == pytest.approx(PHOTOGRAPH.fx, rel=0.01)
        (warning,) = result.warnings
        how = "longer" if factor < 1.0 else "shorter"
        assert re.search(rf"focal length of the image is 1[0-4]\.\d% {how} ", warning)
        again = epi360.localize_image(picture, world, camera=result.camera)
        away = again.cam_from_world.translation - result.cam_from_world.translation
        assert np.linalg.norm(away) < result.position_sigma and again.warnings == ()

    def test_a_focal_length_without_a_pose_is_named(self, world):
        narrow = Pinhole(480, 360, 180.0, 180.0, 240.0, 180.0)
        picture = furnished_room(0).render(
            dataclasses.replace(narrow, fx=200.0, fy=200.0), WORLD_FROM_NEW
        )
        found = epi360.localize_image(picture.image, world, camera=narrow)
        assert found.status == "ok" and found.camera.fx == pytest.approx(200.0, rel=0.01)
        assert "with the angles as they were given there is none to rely on" in found.warnings[-1]
        options = epi360.LocalizationOptions(keep_cameras=True)
        kept = epi360.localize_image(picture.image, world, camera=narrow, options=options)
        assert kept.status == "too_few_inliers" and kept.camera == narrow
        assert "with the angles as they were given there is no pose" in kept.warnings[-1]

    def test_it_may_stay_as_it_is_given(self, world, picture, room_folder):
        given = self.wrong(1.15)
        options = epi360.LocalizationOptions(keep_cameras=True)
        kept = epi360.localize_image(picture, world, camera=given, options=options)
        assert kept.camera == given
        assert any("agree better if the focal length" in each for each in kept.warnings)
        pose, _ = true_pose(world, room_folder[1])
        away = pose.inverse().translation - kept.cam_from_world.inverse().translation
        assert np.linalg.norm(away) < 3.0 * kept.position_sigma


def test_another_room_and_noise_have_no_pose_in_the_map(world):
    inside = Pose(np.eye(3), np.array([0.2, -1.4, 0.3]))
    other = scene("studio").render(CAMERA, inside).image
    noise = np.random.default_rng(0).integers(0, 256, (256, 512, 3)).astype(np.uint8)
    for picture in (other, noise, np.full((256, 512, 3), 90, np.uint8)):
        result = epi360.localize_image(picture, world)
        assert not result.success and result.probability < 0.85
        assert np.isnan(result.cam_from_world.matrix()[:3]).all()


def test_a_room_whose_furniture_was_moved_is_found_and_shows_less_of_the_map(
    world, new_image, room_folder
):
    picture = furnished_room(5).render(CAMERA, WORLD_FROM_NEW).image
    options = epi360.LocalizationOptions(known_place=True)
    moved = epi360.localize_image(picture, world, options=options)
    assert_right(moved, world, room_folder[1], largest_deg=4.0, largest_m=0.1)
    # It might as well be another room with the same walls.
    assert epi360.localize_image(picture, world).status == "ambiguous"
    assert any("much has changed" in warning for warning in moved.warnings)
    assert moved.seen_share < 0.6 * epi360.localize_image(new_image, world).seen_share


def test_images_of_the_map_can_be_left_out(world, new_image):
    names = [image.name for image in world.model.images]
    options = epi360.LocalizationOptions(max_views=2)
    result = epi360.localize_image(new_image, world, without=names[:-1], options=options)
    assert result.map_images == (names[-1],)
    nothing = epi360.localize_image(new_image, world, without=names)
    assert nothing.status == "too_few_matches" and nothing.map_images == ()


def test_the_index_finds_the_images_of_a_place_whatever_their_heading(world, room_folder):
    """The query is an image of the map, turned; it looks most like itself."""
    view = next(i for i in world.model.images if i.name == "Küche/1.png")
    turned = room_folder[1][view.name] @ Pose(rotation_from_vector([0.1, 2.2, 0]), np.zeros(3))
    picture = furnished_room(0).render(CAMERA, turned).image
    features = world.source.of_new(picture, CAMERA, None, 0.0)
    best = world.similar_views(features)[0]
    assert world.model.images[best].name == view.name


def test_the_model_alone_with_its_database_is_enough(room_run, new_image, room_folder):
    """As COLMAP leaves it: descriptors in COLMAP's bytes, nothing of ours."""
    foreign = room_run[0].parent / "foreign"
    shutil.copytree(room_run[0] / "sparse" / "0", foreign / "sparse" / "0")
    shutil.copy(room_run[0] / "database.db", foreign)
    world = epi360.load_map(foreign / "sparse" / "0")
    assert_right(epi360.localize_image(new_image, world), world, room_folder[1])
    (foreign / "database.db").unlink()
    with pytest.raises(ValueError, match="give their folder \\(--images\\)"):
        epi360.load_map(foreign / "sparse" / "0")


def test_a_model_of_any_features_is_searched_anew_in_its_images(room_run, new_image, room_folder):
    world = epi360.load_map(room_run[0] / "sparse" / "0", images=room_folder[0])
    result = epi360.localize_image(new_image, world)
    assert_right(result, world, room_folder[1])
    assert (result.point_ids >= len(world.model.points)).all()  # triangulated for this


def test_hloc_has_the_features_of_map_and_new_image(room_run, new_image, room_folder, tmp_path):
    h5py = pytest.importorskip("h5py")
    from epi360.jobs.matching.match_result import descriptors_of, load_matches

    output = room_run[0]
    write_picture(tmp_path / "query" / "new.png", new_image)
    found = epi360.extract_features(new_image, contrast_threshold=0.013)
    with h5py.File(tmp_path / "features.h5", "w") as file:
        for name, image in load_matches(output).images.items():
            group = file.create_group(name)
            group["keypoints"] = (image.keypoints - 0.5).astype(np.float32)
            group["descriptors"] = descriptors_of(output)(name).T
        group = file.create_group("query/new.png")
        group["keypoints"] = (found.keypoints - 0.5).astype(np.float32)
        group["descriptors"] = found.descriptors.T
    world = epi360.load_map(output / "sparse" / "0", features=tmp_path / "features.h5")
    result = epi360.localize_image(tmp_path / "query" / "new.png", world)
    assert_right(result, world, room_folder[1])
    left = np.zeros((256, 512), bool)
    left[:, :300] = True
    masked = epi360.localize_image(tmp_path / "query" / "new.png", world, mask=left)
    assert 0 < len(masked.keypoints) and masked.keypoints[:, 0].max() < 300
    with h5py.File(tmp_path / "features.h5", "a") as file:
        del file["query/new.png"]["descriptors"]
        file["query/new.png"]["descriptors"] = found.descriptors[:, :64].T
    with pytest.raises(ValueError, match="128 numbers each, those of the new image 64"):
        epi360.localize_image(tmp_path / "query" / "new.png", world)
    write_picture(tmp_path / "other.png", new_image)
    with pytest.raises(ValueError, match="has no features of"):
        epi360.localize_image(tmp_path / "other.png", world)


@pytest.mark.parametrize("source", ["ours", "database", "images"])
def test_a_map_to_which_images_were_added_is_used_again(
    source, room_run, new_image, room_folder, tmp_path
):
    """The new image has another camera, and its features are kept nowhere."""
    output = tmp_path / "map"
    shutil.copytree(room_run[0], output)
    world = epi360.load_map(output)
    small = cv2.resize(new_image, (448, 224), interpolation=cv2.INTER_AREA)
    found = {"small.png": epi360.localize_image(small, world)}
    grown, _ = model_with(world.model, found)
    assert len(grown.cameras) == 2 and len(grown.images) == len(world.model.images) + 1
    path = (output if source == "ours" else tmp_path) / "sparse" / "grown"
    write_colmap_model(path, grown)
    for count in (1, 2):  # the same image once more
        grown, names = model_with(grown, found)
        assert names == {"small.png": "localized/" * count + "small.png"}
    given = {"database": {"database": output / "database.db"}, "images": {"images": room_folder[0]}}
    again = epi360.load_map(path, **given.get(source, {}))
    result = epi360.localize_image(new_image, again)
    assert_right(result, again, room_folder[1])
    assert "small.png" not in result.map_images


def test_a_folder_without_the_images_of_the_map_is_refused(room_run, new_image, tmp_path):
    world = epi360.load_map(room_run[0], images=tmp_path)
    said = "has no features of .* and 5 other images; .* is not the folder of its images"
    with pytest.raises(ValueError, match=said):
        epi360.localize_image(new_image, world)


def test_features_of_another_model_are_refused(room_run, new_image, tmp_path):
    h5py = pytest.importorskip("h5py")
    rng = np.random.default_rng(0)
    with h5py.File(tmp_path / "features.h5", "w") as file:
        for image in epi360.load_map(room_run[0]).model.images:
            group = file.create_group(image.name)
            group["keypoints"] = rng.uniform(0, 200, (300, 2)).astype(np.float32)
            group["descriptors"] = rng.random((64, 300)).astype(np.float32)
    world = epi360.load_map(room_run[0] / "sparse" / "0", features=tmp_path / "features.h5")
    with pytest.raises(ValueError, match="not those that .* was made from"):
        world.view(0)


@pytest.mark.parametrize(
    ("path", "options", "message"),
    [
        ("nowhere", {}, "nowhere"),
        (".", {}, "holds no COLMAP model"),
        (".", {"images": "a", "features": "b"}, "one of images, features and database"),
    ],
)
def test_what_is_no_map_is_said(path, options, message, tmp_path):
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        epi360.load_map(tmp_path / path, **options)


def test_what_is_no_map_and_no_options_is_refused(world, new_image):
    with pytest.raises(TypeError, match="world must be what load_map returns, got str"):
        epi360.localize_image(new_image, "map")
    with pytest.raises(TypeError, match="options must be LocalizationOptions, got dict"):
        epi360.localize_image(new_image, world, options={"max_views": 3})
    with pytest.raises(TypeError, match="without must be a sequence of names, got the string"):
        epi360.localize_image(new_image, world, without="small.png")


def test_an_image_without_a_camera_is_refused(world):
    with pytest.raises(ValueError, match="2:1"):
        epi360.localize_image(np.zeros((300, 400, 3), np.uint8), world)
    with pytest.raises(ValueError, match="max_views must be at least 1"):
        epi360.LocalizationOptions(max_views=0)


def test_a_raw_frame_of_two_circles_is_no_panorama_of_the_map(world, new_image):
    raw = np.zeros_like(new_image)
    for left in (0, 256):
        v, u = np.mgrid[:256, :256] - 127.5
        inside = np.hypot(u, v) < 124
        raw[:, left : left + 256][inside] = new_image[:, left : left + 256][inside]
    with pytest.raises(ValueError, match="raw dual fisheye"):
        epi360.localize_image(raw, world)


def test_a_map_that_colmap_made_from_its_own_sift(room_folder, new_image, tmp_path):
    """Its descriptors are VLFeat's and ours are OpenCV's, and they match."""
    import pycolmap

    database, images = tmp_path / "database.db", tmp_path / "images"
    for number, name in enumerate(name for name in room_folder[1]):
        images.mkdir(exist_ok=True)
        (images / f"{number}.png").write_bytes((room_folder[0] / name).read_bytes())
    truth = {f"{number}.png": pose for number, pose in enumerate(room_folder[1].values())}
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "EQUIRECTANGULAR"
    mode = pycolmap.CameraMode.SINGLE
    pycolmap.extract_features(database, images, camera_mode=mode, reader_options=reader)
    pycolmap.match_exhaustive(database)
    (tmp_path / "sparse").mkdir()
    options = pycolmap.IncrementalPipelineOptions()
    options.min_model_size = 3
    assert pycolmap.incremental_mapping(database, images, tmp_path / "sparse", options)
    world = epi360.load_map(tmp_path / "sparse" / "0")
    result = epi360.localize_image(new_image, world)
    assert_right(result, world, truth, largest_deg=0.5, largest_m=0.03)
    assert result.num_inliers > 150


def test_features_where_a_lens_sees_nothing_are_left_out(world, room_folder):
    """Detectors that know no lens find key points outside its circle as well."""
    narrow = dataclasses.replace(FISHEYE, max_angle_deg=80)
    picture = furnished_room(0).render(FISHEYE, WORLD_FROM_NEW).image
    found = world.source.of_new(picture, FISHEYE, None, 0.0)
    outside = np.isnan(narrow.bearings_from_pixels(found.keypoints)[:, 0])
    assert outside.sum() > 10
    source = SimpleNamespace(
        are_of_the_points=True, of_map=world.source.of_map, of_new=lambda *_: found
    )
    result = epi360.localize_image(
        picture, epi360.LocalizationMap(world.model, source), camera=narrow
    )
    assert_right(result, world, room_folder[1], largest_deg=1.0, largest_m=0.05)
    assert np.isfinite(narrow.bearings_from_pixels(result.keypoints)).all()


def test_a_map_can_be_handed_to_another_process(world, new_image):
    copy = pickle.loads(pickle.dumps(world))
    first, second = (epi360.localize_image(new_image, each) for each in (world, copy))
    assert first.success and second.success
    assert (first.cam_from_world.matrix() == second.cam_from_world.matrix()).all()
