# SPDX-License-Identifier: BSD-3-Clause
"""Maps of a rendered room, of exact matches and of real panoramas: poses, files, second runs."""

import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from mapped_room import CAMERA, room_poses, write_picture
from PIL import Image
from real_data import reference_poses

from epi360.cameras import DoubleSphere, Equirectangular, KannalaBrandt, Pinhole
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector

pycolmap = pytest.importorskip("pycolmap")

from epi360.interop import (  # noqa: E402
    MatchedImage,
    MatchedPair,
    MatchGraph,
    PosedImage,
    Reconstruction,
    TwoViewGeometry,
)
from epi360.interop.colmap_database import CONFIG_OF_STATUS, write_colmap_database  # noqa: E402
from epi360.interop.colmap_model import read_colmap_model  # noqa: E402
from epi360.interop.nerfstudio import read_nerfstudio  # noqa: E402
from epi360.jobs.folder.image_set import ImageSet, SourceImage, find_images  # noqa: E402
from epi360.jobs.mapping import guided_matches  # noqa: E402
from epi360.jobs.mapping.colmap_mapper import MapperOptions, _distinct, run_mapper  # noqa: E402
from epi360.jobs.mapping.map_folder import MapOptions, map_images  # noqa: E402
from epi360.jobs.mapping.mapped_models import MappedModel, write_transforms_of  # noqa: E402
from epi360.jobs.matching.match_folder import MatchOptions  # noqa: E402


def aligned_errors(world_from_cam, truth):
    """Largest position error as a share of the path and rotation error, after a similarity.

    The rotation is that of the cameras: positions near a line do not determine it.
    """
    names = [name for name in truth if name in world_from_cam]
    U, _, Vt = np.linalg.svd(
        sum(truth[name].rotation @ world_from_cam[name].rotation.T for name in names)
    )
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    ours = np.array([R @ world_from_cam[name].translation for name in names])
    true = np.array([truth[name].translation for name in names])
    path = np.linalg.norm(np.diff(true, axis=0), axis=1).sum()
    ours, true = ours - ours.mean(axis=0), true - true.mean(axis=0)
    distances = np.linalg.norm(true - (ours * true).sum() / (ours**2).sum() * ours, axis=1)
    degrees = [rotation_error_deg(R @ world_from_cam[name].rotation, truth[name]) for name in names]
    return distances.max() / path, max(degrees)


def poses_of(reconstruction):
    return {image.name: image.cam_from_world.inverse() for image in reconstruction.images}


def test_every_image_of_a_rendered_room_is_placed_right_also_one_that_only_turned(
    room_folder, room_run
):
    _, truth = room_folder
    _, run = room_run
    poses = poses_of(run.models[0].reconstruction)
    assert poses.keys() == truth.keys()
    assert run.branches == ()
    position, degrees = aligned_errors(poses, truth)
    assert position < 0.004  # 0.0013 measured; a pixel is 0.7 degrees
    assert degrees < 0.15  # 0.05 measured


def test_colors_and_points_come_from_the_pictures(room_run):
    _, run = room_run
    model = run.models[0].reconstruction
    assert len(model.points) > 200
    assert run.models[0].mean_track_length > 2.3
    assert 0 < run.models[0].mean_error_px < 0.5
    assert model.colors.std(axis=0).min() > 20


def test_an_image_that_does_not_register_is_named_with_the_reason(room_run):
    _, run = room_run
    assert run.num_images == 7
    assert run.unregistered.keys() == {"zz_grey.png"}
    assert "no accepted pair" in run.unregistered["zz_grey.png"]
    assert "too_few_matches" in run.unregistered["zz_grey.png"]


def test_the_model_and_the_transforms_on_disk_are_the_result(room_run):
    output, run = room_run
    result = poses_of(run.models[0].reconstruction)
    on_disk = poses_of(read_colmap_model(output / "sparse" / "0"))
    transforms = read_nerfstudio(output / "transforms.json", images="../../room0/images")
    frames = json.loads((output / "transforms.json").read_text(encoding="utf-8"))["frames"]
    assert len(frames) == len(result) == 6
    for frame in frames:
        assert (output / frame["file_path"]).is_file()
    for name, pose in result.items():
        np.testing.assert_array_equal(on_disk[name].matrix(), pose.matrix())
    by_file = {Path(image.name).stem: image for image in transforms.images}
    for name, pose in result.items():
        np.testing.assert_allclose(
            by_file[Path(name).stem].cam_from_world.inverse().matrix(), pose.matrix(), atol=1e-9
        )


def test_down_is_plus_y_in_the_model_as_its_cameras_say(room_run):
    output, run = room_run
    model = run.models[0].reconstruction
    axes = np.array([image.cam_from_world.rotation[1] for image in model.images])
    mean = axes.mean(axis=0)
    np.testing.assert_allclose(mean / np.linalg.norm(mean), [0, 1, 0], atol=1e-12)
    transforms = json.loads((output / "transforms.json").read_text(encoding="utf-8"))
    turned = [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]  # z up, and nothing else
    np.testing.assert_allclose(transforms["applied_transform"], turned, atol=1e-12)
    assert transforms["orientation_override"] == "none"


def test_a_second_run_maps_nothing_again_unless_an_option_changes(room_folder, room_run):
    output, first = room_run
    images = find_images(room_folder[0])
    files = [output / "database.db", output / "sparse" / "0" / "images.bin"]
    before = [path.stat().st_mtime_ns for path in files]
    one = MatchOptions(num_threads=1)
    again = map_images(images, output, MapOptions(MatchOptions(num_threads=2), mapper_threads=1))
    assert [path.stat().st_mtime_ns for path in files] == before
    assert again.seconds["mapping"] == first.seconds["mapping"]
    assert again.was_mapped and not first.was_mapped
    assert again.unregistered == first.unregistered
    other = map_images(images, output, MapOptions(one, mapper="global"))
    assert [path.stat().st_mtime_ns for path in files] != before
    position, degrees = aligned_errors(poses_of(other.models[0].reconstruction), room_folder[1])
    assert position < 0.004 and degrees < 0.15  # as above
    shutil.rmtree(output / "sparse")  # somebody tidied up
    back = map_images(images, output, MapOptions(one, mapper_threads=1))
    for image, same in zip(
        first.models[0].reconstruction.images, back.models[0].reconstruction.images, strict=True
    ):  # mapped twice from the same matches: equal to the last bit
        np.testing.assert_array_equal(image.cam_from_world.matrix(), same.cam_from_world.matrix())


@pytest.mark.parametrize("name", ["points3D.bin", "images.bin"])
def test_a_damaged_model_is_mapped_again(room_folder, room_run, tmp_path, name):
    output, first = room_run[0], tmp_path / "map"
    shutil.copytree(output, first)
    file = first / "sparse" / "0" / name
    file.write_bytes(file.read_bytes()[:100])
    options = MapOptions(MatchOptions(num_threads=1), mapper_threads=1)
    run = map_images(find_images(room_folder[0]), first, options)
    assert not run.was_mapped and len(run.models[0].reconstruction.images) == 6
    assert map_images(find_images(room_folder[0]), first, options).was_mapped


def test_a_negative_seed_maps_as_well(room_folder, room_run, tmp_path):
    output = tmp_path / "map"
    options = MapOptions(MatchOptions(num_threads=1, seed=-1), mapper_threads=1)
    run = map_images(find_images(room_folder[0]), output, options)
    assert len(run.models[0].reconstruction.images) == 6


def test_the_database_is_written_again_where_it_lacks_what_is_asked_for(
    room_folder, room_run, tmp_path
):
    output = tmp_path / "map"
    shutil.copytree(room_run[0], output)
    images, match = find_images(room_folder[0]), MatchOptions(num_threads=1)

    def num_with_descriptors(descriptors):
        options = MapOptions(match, mapper_threads=1, descriptors=descriptors)
        assert map_images(images, output, options).was_mapped
        with closing(sqlite3.connect(output / "database.db")) as database:
            return database.execute("SELECT COUNT(*) FROM descriptors WHERE rows > 0").fetchone()[0]

    assert num_with_descriptors(False) == 0
    assert num_with_descriptors(True) == 6
    (output / "database.db").unlink()  # somebody tidied up
    assert num_with_descriptors(True) == 6


def test_pairs_get_more_inliers_along_their_epipolar_curves(room_folder, tmp_path, monkeypatch):
    path, truth = room_folder
    monkeypatch.setattr(guided_matches, "_ENOUGH", 10**6)  # its pairs have hundreds
    options = MapOptions(MatchOptions(num_threads=1), mapper_threads=1)
    run = map_images(find_images(path), tmp_path, options)
    with closing(sqlite3.connect(tmp_path / "database.db")) as database:
        (num_mapped,) = database.execute("SELECT SUM(rows) FROM two_view_geometries").fetchone()
    num_found = sum(
        told.num_inliers for told in run.matched.verdicts if told.status in CONFIG_OF_STATUS
    )
    assert num_mapped > 1.1 * num_found
    poses = poses_of(run.models[0].reconstruction)
    assert poses.keys() == truth.keys()
    position, degrees = aligned_errors(poses, truth)
    assert position < 0.004 and degrees < 0.15


def rig_graph(back_from_front):
    """Exact key points of two fisheye lenses on a rig at four places among random points."""
    lens = KannalaBrandt(800, 800, 250.0, 251.0, 400.0, 400.0, 0.01, 0.002, 0.001, 0.0)
    points = np.random.default_rng(0).uniform((-3, -2.7, -2.5), (3, 0, 2.5), (400, 3))
    seen, images, poses = {}, {}, {}
    for frame, world_from_front in enumerate(room_poses(4)[:4]):
        front_from_world = world_from_front.inverse()
        for camera, pose in (
            ("front", front_from_world),
            ("back", back_from_front @ front_from_world),
        ):
            name = f"{camera}/{frame}.png"
            pixels = lens.pixels_from_bearings(points @ pose.rotation.T + pose.translation)
            seen[name] = np.flatnonzero(np.isfinite(pixels[:, 0]))
            images[name] = MatchedImage(name, camera, pixels[seen[name]], frame=str(frame))
            poses[name] = pose
    pairs = []
    for name1, name2 in combinations(images, 2):
        _, rows1, rows2 = np.intersect1d(seen[name1], seen[name2], return_indices=True)
        matches = np.column_stack([rows1, rows2])
        cam2_from_cam1 = poses[name2] @ poses[name1].inverse()
        length = np.linalg.norm(cam2_from_cam1.translation)
        unit = Pose(cam2_from_cam1.rotation, cam2_from_cam1.translation / length)
        pairs.append(MatchedPair(name1, name2, matches, TwoViewGeometry("ok", unit, matches)))
    rig = {"front": Pose(np.eye(3), np.zeros(3)), "back": back_from_front}
    return MatchGraph({"front": lens, "back": lens}, images, tuple(pairs), rig), poses


# COLMAP's global mapper ends its adjustment before the scale, the weakest direction, is right.
@pytest.mark.parametrize(("mapper", "scale_error"), [("incremental", 0.003), ("global", 0.1)])
def test_the_cameras_of_a_rig_stay_where_they_are_and_give_the_scale(tmp_path, mapper, scale_error):
    back_from_front = Pose(rotation_from_vector([0.0, 2.0, 0.0]), np.array([0.0, 0.0, -0.3]))
    graph, poses = rig_graph(back_from_front)
    write_colmap_database(tmp_path / "database.db", graph)
    colors = {
        name: np.full((len(image.keypoints), 3), (9, 8, 7), np.uint8)
        for name, image in graph.images.items()
    }
    (model,) = run_mapper(tmp_path / "database.db", MapperOptions(mapper), colors=colors)
    assert {tuple(point.color) for point in model.points3D.values()} == {(9, 8, 7)}
    assert model.num_reg_images() == 8
    found = {
        image.name: Pose.from_matrix(image.cam_from_world().matrix())
        for image in model.images.values()
    }
    for frame in range(4):
        pose = found[f"back/{frame}.png"] @ found[f"front/{frame}.png"].inverse()
        np.testing.assert_allclose(pose.matrix(), back_from_front.matrix(), atol=1e-9)
    for camera in model.cameras.values():
        np.testing.assert_array_equal(camera.params, (250, 251, 400, 400, 0.01, 0.002, 0.001, 0))
    first, last = "front/0.png", "front/3.png"
    step = (found[last] @ found[first].inverse()).translation
    true = (poses[last] @ poses[first].inverse()).translation
    assert np.linalg.norm(step) == pytest.approx(np.linalg.norm(true), rel=scale_error)


def test_models_within_a_larger_one_and_single_images_are_dropped():
    def model(*images):
        return SimpleNamespace(
            reg_image_ids=lambda: list(images), num_reg_images=lambda: len(images), images=images
        )

    found = (model(2, 3), model(1, 2, 3), model(3, 4), model(5), model(4, 3))
    assert [each.images for each in _distinct(found)] == [(1, 2, 3), (3, 4)]


def test_two_images_are_enough(room_folder, tmp_path):
    for name in ("1.png", "2.png"):
        (tmp_path / "in").mkdir(exist_ok=True)
        (tmp_path / "in" / name).write_bytes((room_folder[0] / "Küche" / name).read_bytes())
    run = map_images(find_images(tmp_path / "in"), tmp_path / "out")
    assert len(run.models[0].reconstruction.images) == 2
    assert len(run.models[0].reconstruction.points) > 50


def written_transforms(tmp_path, cameras, masks=None, mask_nadir_deg=0.0):
    """Remarks, and the frames of a file for one image of each camera."""
    sources = tuple(
        SourceImage(f"{name}.jpg", tmp_path / "in" / f"{name}.jpg", name, (masks or {}).get(name))
        for name in cameras
    )
    posed = tuple(
        PosedImage(image.name, image.camera, Pose(np.eye(3), np.zeros(3))) for image in sources
    )
    remarks = write_transforms_of(
        ImageSet(tmp_path / "in", cameras, sources),
        tmp_path,
        (MappedModel(tmp_path, Reconstruction(cameras, posed), 0.5),),
        mask_nadir_deg,
    )
    path = tmp_path / "transforms.json"
    return remarks, json.loads(path.read_text())["frames"] if path.exists() else []


def test_transforms_name_the_masks_where_every_image_has_one(tmp_path):
    cameras = {"a": CAMERA, "b": CAMERA}
    both = {name: tmp_path / "masks" / f"{name}.png" for name in cameras}
    remarks, frames = written_transforms(tmp_path, cameras, both)
    assert [frame["mask_path"] for frame in frames] == ["masks/a.png", "masks/b.png"]
    assert remarks == ()
    remarks, frames = written_transforms(tmp_path, cameras, {"a": both["a"]})
    assert not any("mask_path" in frame for frame in frames)
    others = "the faces that --cubemap cuts have all masks"
    no_files = "masks, because some images have none"
    assert remarks == (f"transforms.json lacks {no_files}; {others}",)
    nadir = written_transforms(tmp_path, cameras, mask_nadir_deg=20.0)[0]
    assert nadir == (f"transforms.json lacks what --mask-nadir-deg masks; {others}",)
    assert written_transforms(tmp_path, cameras)[0] == ()


def test_cameras_of_two_kinds_are_pointed_to_the_cube_faces(tmp_path):
    (remark,), frames = written_transforms(tmp_path, {"a": CAMERA, "b": Pinhole(9, 9, 5, 5, 4, 4)})
    assert remark.startswith("transforms.json was not written: nerfstudio has one camera model")
    assert remark.endswith("that of --cubemap has one camera model")
    assert frames == []


def test_a_camera_that_colmap_lacks_is_refused_before_the_matching(tmp_path):
    camera = DoubleSphere(64, 64, 30, 30, 32, 32, -0.2, 0.6)
    image = SourceImage("a.png", tmp_path / "a.png", "c")
    with pytest.raises(ValueError, match="DoubleSphere"):
        map_images(ImageSet(tmp_path, {"c": camera}, (image,)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_part_of_a_panorama_is_named_and_the_others_are_mapped(tmp_path, room_folder):
    whole = find_images(room_folder[0])
    part = Equirectangular(512, 128, vertical_fov_deg=90.0)
    cut = SourceImage("cut.png", tmp_path / "cut.png", "part")
    both = replace(whole, images=(*whole.images, cut), cameras={**whole.cameras, "part": part})
    run = map_images(both, tmp_path / "out")
    assert "fill the picture up to 2:1" in run.unregistered["cut.png"]
    assert run.num_images == len(both.images)
    assert set(run.unregistered) == {"cut.png", "zz_grey.png"}
    names = [image.name for image in whole.images if image.name != "zz_grey.png"]
    listed = tmp_path / "pairs.txt"
    listed.write_text("".join(f"{name}\tcut.png\n{names[0]}\t{name}\n" for name in names[1:]))
    options = MapOptions(match=MatchOptions(pairs=listed))
    assert "cut.png" in map_images(both, tmp_path / "listed", options).unregistered
    with pytest.raises(ValueError, match="no camera for a part of a panorama"):
        map_images(replace(both, images=(cut,), cameras={"part": part}), tmp_path / "none")


def test_pictures_that_a_tag_turns_are_remarked_on(tmp_path):
    upright = np.zeros((32, 64, 3), np.uint8)
    (tmp_path / "in").mkdir()
    for name, orientation in (("a", 6), ("b", 1), ("c", 0), ("d", 9)):
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.fromarray(upright).save(tmp_path / "in" / f"{name}.jpg", exif=exif)
    (remark,), _ = written_transforms(tmp_path, dict.fromkeys("abcd", CAMERA))
    assert remark.startswith("a.jpg is stored turned (Exif)") and "COLMAP and nerfstudio" in remark


@pytest.mark.parametrize("content", ["[1, 2]", "{", "3"])
def test_a_damaged_record_is_named(tmp_path, content):
    (tmp_path / "mapping.json").write_text(content)
    image = SourceImage("a.png", tmp_path / "a.png", "c")
    with pytest.raises(ValueError, match=r"mapping.json is damaged; delete it"):
        map_images(ImageSet(tmp_path, {"c": CAMERA}, (image,)), tmp_path)


def test_files_of_something_else_are_not_replaced(tmp_path, room_folder):
    (tmp_path / "database.db").write_bytes(b"precious")
    with pytest.raises(ValueError, match="made by something else"):
        map_images(find_images(room_folder[0]), tmp_path)
    assert (tmp_path / "database.db").read_bytes() == b"precious"


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"mapper": "hierarchical"}, "incremental or global"), ({"mapper_threads": 0}, "1 or more")],
)
def test_options_out_of_range_are_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        MapOptions(**wrong)


def test_five_real_panoramas_agree_with_their_reference_poses(data_dir, tmp_path):
    folder = data_dir / "theta_flat"
    truth = reference_poses(folder / "poses.csv")
    truth = {name: truth[name] for name in list(truth)[::2][:5]}
    for name in truth:
        picture = cv2.imread(str(folder / "images" / name))
        small = cv2.resize(picture, (1344, 672), interpolation=cv2.INTER_AREA)
        write_picture(tmp_path / "in" / name, small[..., ::-1])
    run = map_images(find_images(tmp_path / "in"), tmp_path / "out")
    poses = poses_of(run.models[0].reconstruction)
    assert poses.keys() == truth.keys()
    position, degrees = aligned_errors(poses, truth)
    assert position < 0.003  # half the resolution, half the images: 0.001 measured
    assert degrees < 0.15  # 0.06 measured
