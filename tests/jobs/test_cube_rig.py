# SPDX-License-Identifier: BSD-3-Clause
"""Cube faces as COLMAP's rig: what its bundle adjustment does with them, and their numbers."""

import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt, Pinhole
from epi360.interop import (
    Observations,
    PosedImage,
    Reconstruction,
    read_colmap_model,
    write_colmap_model,
)
from epi360.jobs.cubes.cube_faces import (
    FACES,
    CubemapOptions,
    cubemap_reconstruction,
    face_camera,
    face_from_cam,
)
from epi360.poses import Pose, rotation_from_vector

pycolmap = pytest.importorskip("pycolmap")

PANORAMA = Equirectangular(1000, 500)
FISHEYE = KannalaBrandt(200, 200, 60.0, 60.0, 100.0, 100.0, 0, 0, 0, 0, max_angle_deg=95)


def panoramas(count=4, noise_px=0.5, tilt=0.5):
    """Panoramas around 150 points that surround them, seen with noise."""
    rng = np.random.default_rng(1)
    points = rng.normal(size=(150, 3))
    points *= (3 + rng.uniform(size=150) * 2)[:, None] / np.linalg.norm(points, axis=1)[:, None]
    images, pixels = [], []
    for number in range(count):
        position = np.array([0.6 * number, 0.1 * number, 0.0])
        rotation = rotation_from_vector(tilt * rng.normal(size=3))
        pose = Pose(rotation, -rotation @ position)
        images.append(PosedImage(f"{number}.jpg", "pano", pose))
        seen = PANORAMA.pixels_from_bearings(points @ pose.rotation.T + pose.translation)
        pixels.append(np.clip(seen + noise_px * rng.normal(size=seen.shape), 0, (1000, 500)))
    observations = Observations(
        np.tile(np.arange(150), count), np.repeat(np.arange(count), 150), np.concatenate(pixels)
    )
    colors = np.zeros((150, 3), np.uint8)
    return Reconstruction({"pano": PANORAMA}, tuple(images), points, colors, observations)


def adjusted(model):
    """A model after COLMAP's bundle adjustment of poses and points alone."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_principal_point = False
    options.refine_extra_params = options.refine_sensor_from_rig = False
    options.print_summary = False
    pycolmap.bundle_adjustment(model, options)
    return model


def spread(model, source):
    """Largest deviations of the faces of a panorama from 90 degrees and from one centre."""
    turns_deg, distances = [], []
    images = {image.name: image.cam_from_world() for image in model.images.values()}
    for panorama in source.images:
        stem = panorama.name.removesuffix(".jpg")
        poses = {face: Pose.from_matrix(images[f"{stem}_{face}.jpg"].matrix()) for face in FACES}
        front = poses["front"]
        for face, pose in poses.items():
            turn = pose.rotation @ front.rotation.T @ face_from_cam(face).rotation.T
            turns_deg.append(np.degrees(np.abs(turn - np.eye(3)).max()))
            distances.append(
                np.linalg.norm(pose.inverse().translation - front.inverse().translation)
            )
    return max(turns_deg), max(distances)


def test_a_bundle_adjustment_keeps_the_faces_of_a_panorama_together(tmp_path):
    """As independent images, the same faces are torn apart by the noise of half a pixel."""
    source = panoramas()
    cube = cubemap_reconstruction(source, CubemapOptions())
    write_colmap_model(tmp_path / "rig", cube)
    apart = Reconstruction(
        cube.cameras, cube.images, cube.points, cube.colors, cube.observations
    )  # without cam_from_rig
    write_colmap_model(tmp_path / "apart", apart)
    rig = pycolmap.Reconstruction(tmp_path / "rig")
    assert (rig.num_rigs(), rig.num_frames(), rig.num_images()) == (1, 4, 24)
    before = {image.name: image.cam_from_world().matrix() for image in rig.images.values()}
    turn_deg, distance = spread(adjusted(rig), source)
    assert turn_deg < 1e-10 and distance < 1e-12
    moved = [
        np.abs(image.cam_from_world().matrix() - before[image.name]).max()
        for image in rig.images.values()
    ]
    assert max(moved) > 1e-4  # the adjustment did something
    torn_deg, torn = spread(adjusted(pycolmap.Reconstruction(tmp_path / "apart")), source)
    assert torn_deg > 0.01 and torn > 0.001


def test_every_face_has_its_pose_in_images_bin_for_readers_that_know_no_rigs(tmp_path):
    source = panoramas()
    cube = cubemap_reconstruction(source, CubemapOptions())
    write_colmap_model(tmp_path, cube)
    (tmp_path / "rigs.bin").unlink()
    (tmp_path / "frames.bin").unlink()
    model = read_colmap_model(tmp_path)
    assert len(model.images) == 24
    for image, expected in zip(model.images, cube.images, strict=True):
        np.testing.assert_allclose(
            image.cam_from_world.matrix(), expected.cam_from_world.matrix(), atol=1e-14
        )
    for index, panorama in enumerate(source.images):
        front = cube.images[6 * index].cam_from_world  # the faces of a panorama follow each other
        np.testing.assert_array_equal(front.matrix(), panorama.cam_from_world.matrix())


@pytest.mark.parametrize("text", [False, True])
def test_cameras_are_pinholes_with_two_focal_lengths(tmp_path, text):
    """The text reader of 3DGS and OpenMVS know PINHOLE only."""
    cube = cubemap_reconstruction(panoramas(), CubemapOptions(face_size=100))
    write_colmap_model(tmp_path, cube, text=text)
    cameras = pycolmap.Reconstruction(tmp_path).cameras.values()
    assert {camera.model_name for camera in cameras} == {"PINHOLE"}
    assert all(camera.params.tolist() == [50, 50, 50, 50] for camera in cameras)
    assert set(read_colmap_model(tmp_path).cameras.values()) == {
        Pinhole(100, 100, 50.0, 50.0, 50.0, 50.0)
    }


def test_points_have_the_reprojection_error_that_colmap_computes(tmp_path):
    cube = cubemap_reconstruction(panoramas(), CubemapOptions())
    write_colmap_model(tmp_path, cube)
    model = pycolmap.Reconstruction(tmp_path)
    written = {number: point.error for number, point in model.points3D.items()}
    model.update_point_3d_errors()
    for number, point in model.points3D.items():
        assert written[number] == pytest.approx(point.error, abs=1e-9)
    # Half a pixel of the panorama in both directions is 0.5 sqrt(pi / 2) on average, in a face
    # with a focal length of 125 px against 159 about 0.79 times that, and more towards its corners.
    assert 0.4 < np.mean(list(written.values())) < 1.2


def test_a_bundle_adjustment_runs_where_a_face_is_left_out(tmp_path):
    """Points of which one observation is left would stop it: track.Length() > 1."""
    source = panoramas()
    faces = ("front", "left", "right", "back")
    cube = cubemap_reconstruction(source, CubemapOptions(faces=faces))
    counts = np.bincount(cube.observations.points)
    assert len(counts) == len(cube.points) < len(source.points)
    assert counts.min() == 2
    write_colmap_model(tmp_path, cube)
    assert adjusted(pycolmap.Reconstruction(tmp_path)).compute_mean_reprojection_error() > 0


def test_cameras_of_a_rig_stay_on_it_with_their_faces(tmp_path):
    """Two fisheyes back to back: five faces each, ten sensors of one rig, a frame a moment."""
    back_from_front = Pose(rotation_from_vector([0, np.pi, 0]), np.array([0.0, 0.0, -0.03]))
    rig = {"front": Pose(np.eye(3), np.zeros(3)), "back": back_from_front}
    images = []
    for moment in range(2):
        rig_from_world = Pose(rotation_from_vector([0, 0.3 * moment, 0]), np.array([moment, 0, 0]))
        images += [
            PosedImage(f"{name}/{moment}.jpg", name, pose @ rig_from_world, frame=str(moment + 7))
            for name, pose in rig.items()
        ]
    source = Reconstruction(dict.fromkeys(rig, FISHEYE), tuple(images), cam_from_rig=rig)
    write_colmap_model(tmp_path, cubemap_reconstruction(source, CubemapOptions()))
    model = pycolmap.Reconstruction(tmp_path)
    assert (model.num_rigs(), model.num_cameras(), sorted(model.frames)) == (1, 10, [7, 8])
    centres = {image.name: image.projection_center() for image in model.images.values()}
    np.testing.assert_allclose(
        centres["front/0_up.jpg"] - centres["back/0_left.jpg"], [0, 0, 0.03], atol=1e-12
    )


def test_panoramas_of_two_sizes_are_two_rigs_and_one_face_is_none(tmp_path):
    cameras = {"1": PANORAMA, "2": Equirectangular(512, 256), "3": PANORAMA}
    pose = Pose(np.eye(3), np.zeros(3))
    images = tuple(PosedImage(f"{name}.jpg", name, pose) for name in cameras)
    source = Reconstruction(cameras, images)
    write_colmap_model(tmp_path / "six", cubemap_reconstruction(source, CubemapOptions()))
    six = pycolmap.Reconstruction(tmp_path / "six")
    assert (six.num_rigs(), six.num_cameras(), six.num_frames()) == (2, 12, 3)
    one = cubemap_reconstruction(source, CubemapOptions(faces=("front",)))
    assert len(one.cameras) == 2 and not one.cam_from_rig
    assert all(image.frame is None for image in one.images)


def test_a_native_face_has_the_resolution_of_the_panorama_in_its_middle():
    """One pixel of the panorama is 360 / 1000 of a degree; at 90 degrees W / pi is 318.3."""
    native = face_camera(PANORAMA, CubemapOptions(face_size="native"))
    assert (native.width, native.height) == (318, 318)
    middle = native.bearings_from_pixels([[159.0, 159.0], [160.0, 159.0]])
    angle_deg = np.degrees(np.arctan2(*middle[1, [0, 2]]) - np.arctan2(*middle[0, [0, 2]]))
    assert angle_deg == pytest.approx(0.36, rel=2e-3)
    smaller = face_camera(PANORAMA, CubemapOptions())
    assert smaller.width == 250
    assert smaller.fx / native.fx == pytest.approx(np.pi / 4, rel=2e-3)  # 21 % fewer
    wide = face_camera(PANORAMA, CubemapOptions(face_size="native", fov_deg=120))
    assert wide.width == 552  # 2 tan(60 degrees) 159.15 = 551.3, and sizes are even
