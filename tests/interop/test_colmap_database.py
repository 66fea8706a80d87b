# SPDX-License-Identifier: BSD-3-Clause
"""Match graphs in COLMAP's database: what COLMAP reads of ours, what we read of COLMAP's."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from colmap_graphs import panoramas_of_points, relative_pose

from epi360.cameras import DoubleSphere, Pinhole
from epi360.epipolar import essential_from_pose
from epi360.interop import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.interop.colmap_database import (
    open_colmap_database,
    read_colmap_database,
    two_view_geometry_to_colmap,
    write_colmap_database,
)
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg

pycolmap = pytest.importorskip("pycolmap")
CONFIG = pycolmap.TwoViewGeometryConfiguration

POSE = Pose(rotation_from_vector([0.1, -0.2, 0.3]), [0.6, 0.0, -0.8])
NAMES = ("first.jpg", "second.jpg")
CAMERA = Pinhole(640, 480, 300, 300, 320, 240)
MATCHES = np.array([[0, 3], [1, 2], [2, 1], [3, 0]])


def graph_of_pair(name1, name2, geometry):
    images = {name: MatchedImage(name, "c", np.arange(8.0).reshape(4, 2) + 0.25) for name in NAMES}
    return MatchGraph({"c": CAMERA}, images, (MatchedPair(name1, name2, MATCHES, geometry),))


@pytest.fixture
def written(tmp_path):
    """Function that writes a graph and returns the path of the database."""

    def write(graph):
        path = tmp_path / "database.db"
        write_colmap_database(path, graph)
        return path

    return write


def assert_same_pose(pose, expected, tolerance_deg=1e-6):
    assert rotation_error_deg(pose, expected) < tolerance_deg
    assert translation_error_deg(pose, expected) < tolerance_deg
    assert np.linalg.norm(pose.translation) == pytest.approx(1)


@pytest.mark.parametrize("swapped", [False, True])
def test_colmap_gives_a_pair_back_in_its_own_order(swapped, written):
    name1, name2 = NAMES[::-1] if swapped else NAMES
    inliers = MATCHES[[0, 2]]
    path = written(graph_of_pair(name1, name2, TwoViewGeometry("ok", POSE, inliers)))
    with pycolmap.Database.open(path) as database:
        ids = [database.read_image_with_name(name).image_id for name in (name1, name2)]
        assert (ids[0] > ids[1]) == swapped
        np.testing.assert_array_equal(database.read_matches(*ids), MATCHES)
        geometry = database.read_two_view_geometry(*ids)
        np.testing.assert_array_equal(geometry.inlier_matches, inliers)
        np.testing.assert_allclose(geometry.cam2_from_cam1.matrix(), POSE.matrix()[:3], atol=1e-12)
        E = essential_from_pose(POSE)
        sign = np.sign((geometry.E * E).sum())
        np.testing.assert_allclose(sign * geometry.E, E, atol=1e-12)
    pair = read_colmap_database(path).pairs[0]
    assert (pair.image1, pair.image2) == NAMES
    expected = POSE.inverse() if swapped else POSE
    assert_same_pose(pair.geometry.cam2_from_cam1, expected)
    np.testing.assert_array_equal(pair.matches, MATCHES[:, ::-1] if swapped else MATCHES)
    np.testing.assert_array_equal(pair.geometry.inliers, inliers[:, ::-1] if swapped else inliers)


@pytest.mark.parametrize(
    ("status", "config", "read_as"),
    [
        ("ok", CONFIG.CALIBRATED, "ok"),
        ("planar_ambiguous", CONFIG.PLANAR, "planar_ambiguous"),
        ("pure_rotation", CONFIG.PANORAMIC, "pure_rotation"),
        ("too_few_inliers", CONFIG.DEGENERATE, "too_few_inliers"),
        ("too_few_matches", CONFIG.DEGENERATE, "too_few_inliers"),
        ("concentrated_inliers", CONFIG.DEGENERATE, "too_few_inliers"),
    ],
)
def test_verdict_is_kept_as_the_config(status, config, read_as, written):
    pose = POSE
    if status == "pure_rotation":
        pose = Pose(POSE.rotation, np.full(3, np.nan))
    elif config == CONFIG.DEGENERATE:
        pose = Pose.nan()
    path = written(graph_of_pair(*NAMES, TwoViewGeometry(status, pose, MATCHES)))
    with pycolmap.Database.open(path) as database:
        theirs = database.read_two_view_geometry(1, 2)
    assert theirs.config == int(config)
    geometry = read_colmap_database(path).pairs[0].geometry
    assert geometry.status == read_as
    np.testing.assert_allclose(geometry.cam2_from_cam1.matrix(), pose.matrix(), atol=1e-12)
    if config == CONFIG.DEGENERATE:
        assert theirs.cam2_from_cam1 is None and theirs.E is None
        assert len(theirs.inlier_matches) == len(geometry.inliers) == 0
    else:
        np.testing.assert_array_equal(geometry.inliers, MATCHES)


@pytest.mark.parametrize("count", [0, 4])
def test_pair_that_was_not_verified_stays_so(count, written):
    graph = graph_of_pair(*NAMES, None)
    path = written(replace(graph, pairs=(replace(graph.pairs[0], matches=MATCHES[:count]),)))
    with pycolmap.Database.open(path) as database:
        assert not database.exists_two_view_geometry(1, 2)
    pair = read_colmap_database(path).pairs[0]
    assert pair.geometry is None and pair.matches.shape == (count, 2)


def edited_geometry(path, **changes):
    """Geometry of the pair that is read after attributes of COLMAP's have been changed."""
    with pycolmap.Database.open(path) as database:
        geometry = database.read_two_view_geometry(1, 2)
        for name, value in changes.items():
            setattr(geometry, name, value)
        database.update_two_view_geometry(1, 2, geometry)
    return read_colmap_database(path).pairs[0].geometry


def test_pose_that_is_missing_comes_from_the_essential_matrix(written):
    poses, graph = panoramas_of_points(2, noise_px=0)
    path = written(graph)
    geometry = edited_geometry(path, cam2_from_cam1=None)
    # Key points of single precision: 1e-4 of a pixel.
    assert_same_pose(geometry.cam2_from_cam1, relative_pose(*poses.values()), 1e-4)
    # COLMAP before 4 stores the identity for no pose.
    geometry = edited_geometry(path, cam2_from_cam1=pycolmap.Rigid3d())
    assert_same_pose(geometry.cam2_from_cam1, relative_pose(*poses.values()), 1e-4)


@pytest.mark.parametrize("config", ["CALIBRATED", "PLANAR", "PANORAMIC", "MULTIPLE", "UNDEFINED"])
def test_geometry_without_pose_and_matrix_counts_as_not_verified(config, written):
    path = written(graph_of_pair(*NAMES, TwoViewGeometry("ok", POSE, MATCHES)))
    changes = {"config": getattr(CONFIG, config), "E": None, "cam2_from_cam1": None}
    assert edited_geometry(path, **changes) is None


def test_key_points_may_have_scale_and_shape_and_descriptors_are_read_when_asked(tmp_path):
    path = tmp_path / "a.db"
    descriptors = np.random.default_rng(0).integers(0, 256, (3, 128), np.uint8)
    with pycolmap.Database.open(path) as database:
        camera = pycolmap.Camera(model="PINHOLE", width=64, height=48, params=[30, 31, 32, 24])
        camera_id = database.write_camera(camera)
        for columns in (2, 4, 6):
            image = pycolmap.Image(name=f"{columns}.jpg", camera_id=camera_id)
            image_id = database.write_image(image)
            keypoints = np.arange(3 * columns, dtype=np.float32).reshape(3, columns)
            database.write_keypoints(image_id, keypoints)
        database.write_descriptors(
            1, pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, descriptors)
        )
        floats = pycolmap.FeatureDescriptorsFloat(
            pycolmap.FeatureExtractorType.ALIKED_N32, descriptors / np.float32(256)
        )
        database.write_descriptors(2, pycolmap.FeatureDescriptors.from_float(floats))
    images = read_colmap_database(path, with_descriptors=True).images
    for columns in (2, 4, 6):
        expected = [[0, 1], [columns, columns + 1], [2 * columns, 2 * columns + 1]]
        np.testing.assert_array_equal(images[f"{columns}.jpg"].keypoints, expected)
    np.testing.assert_array_equal(images["2.jpg"].descriptors, descriptors)
    np.testing.assert_array_equal(images["4.jpg"].descriptors, descriptors / np.float32(256))
    assert images["6.jpg"].descriptors is None
    assert read_colmap_database(path).images["2.jpg"].descriptors is None


def test_poses_of_colmaps_own_database_are_those_of_its_reconstruction(tmp_path):
    path = tmp_path / "synthetic.db"
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 1, 5, 60
    options.camera_model_id = pycolmap.CameraModelId.EQUIRECTANGULAR
    options.camera_width, options.camera_height, options.camera_params = 1000, 500, [1000, 500]
    options.two_view_geometry_has_relative_pose = True
    with pycolmap.Database.open(path) as database:
        model = pycolmap.synthesize_dataset(options, database)
    graph = read_colmap_database(path)
    assert len(graph.images) == 5 and len(graph.pairs) == 10 and not graph.cam_from_rig
    poses = {
        image.name: Pose.from_matrix(image.cam_from_world().matrix())
        for image in model.images.values()
    }
    for pair in graph.pairs:
        expected = relative_pose(poses[pair.image1], poses[pair.image2])
        assert pair.geometry.status == "ok" and len(pair.geometry.inliers) > 20
        assert_same_pose(pair.geometry.cam2_from_cam1, expected)


@pytest.mark.parametrize("mapping", ["incremental_mapping", "global_mapping"])
def test_colmap_maps_our_database(mapping, written, tmp_path):
    poses, graph = panoramas_of_points()
    path = written(graph)
    (tmp_path / "out").mkdir()
    models = getattr(pycolmap, mapping)(path, tmp_path, tmp_path / "out")
    assert len(models) == 1 and models[0].num_reg_images() == 5
    assert models[0].compute_mean_reprojection_error() < 0.5
    found = {
        image.name: Pose.from_matrix(image.cam_from_world().matrix())
        for image in models[0].images.values()
    }
    for pair in graph.pairs:
        # 0.3 px of 2000 are 0.05 degrees; 200 points on five panoramas average it.
        expected = relative_pose(poses[pair.image1], poses[pair.image2])
        pose = relative_pose(found[pair.image1], found[pair.image2])
        assert_same_pose(pose, expected, 0.1)


def rig_graph(frames=4, with_poses=True):
    """Graph of two panoramas on a rig, and a third camera alone."""
    front_from_rig = Pose(rotation_from_vector([0, 0.2, 0]), [0.1, 0, 0])
    back_from_rig = Pose(rotation_from_vector([0, 3.0, 0]), [0, 0, 0.2])
    poses, graph = panoramas_of_points(2 * frames)
    names = list(poses)
    rng = np.random.default_rng(1)
    points = rng.normal(size=(200, 3)) * 4
    images = {}
    for index, name in enumerate(names):
        rig_from_world = poses[names[index // 2]]
        cam_from_rig = back_from_rig if index % 2 else front_from_rig
        pose = cam_from_rig @ rig_from_world
        camera = graph.cameras["theta"]
        pixels = camera.pixels_from_bearings(points @ pose.rotation.T + pose.translation)
        images[name] = MatchedImage(
            name, "back" if index % 2 else "front", pixels, frame=f"at {index // 2} s"
        )
    alone = MatchedImage("alone.jpg", "alone", np.zeros((0, 2)), frame="at 0 s")
    pairs = tuple(replace(pair, geometry=None) for pair in graph.pairs)
    cameras = dict.fromkeys(("back", "alone", "front"), graph.cameras["theta"])
    rig = {"front": front_from_rig, "back": back_from_rig} if with_poses else {}
    return MatchGraph(cameras, {**images, "alone.jpg": alone}, pairs, rig)


def test_images_of_a_moment_are_a_frame_of_a_rig(written):
    graph = rig_graph()
    path = written(graph)
    with pycolmap.Database.open(path) as database:
        rigs = {rig.num_sensors(): rig for rig in database.read_all_rigs()}
        assert sorted(rigs) == [1, 2] and database.num_frames() == 5
        ids = {camera.camera_id: index for index, camera in enumerate(database.read_all_cameras())}
        assert rigs[2].ref_sensor_id.id == 3 and list(ids) == [1, 2, 3]  # front is the third
        assert all(
            frame.num_data_ids() == (1 if frame.rig_id == rigs[1].rig_id else 2)
            for frame in database.read_all_frames()
        )
        (back_from_front,) = rigs[2].non_ref_sensors.values()
    expected = graph.cam_from_rig["back"] @ graph.cam_from_rig["front"].inverse()
    np.testing.assert_allclose(back_from_front.matrix(), expected.matrix()[:3], atol=1e-12)
    again = read_colmap_database(path)
    assert set(again.cam_from_rig) == {"3", "1"}
    np.testing.assert_allclose(again.cam_from_rig["1"].matrix(), expected.matrix(), atol=1e-12)
    np.testing.assert_array_equal(again.cam_from_rig["3"].matrix(), np.eye(4))
    frames = [image.frame for image in again.images.values()]
    assert frames[-1] is None and len(set(frames[:-1])) == 4
    assert frames[0] == frames[1] != frames[2] == frames[3]


def test_without_poses_on_the_rig_every_image_is_a_frame(written):
    path = written(rig_graph(with_poses=False))
    with pycolmap.Database.open(path) as database:
        assert database.num_rigs() == 3 and database.num_frames() == 9
    graph = read_colmap_database(path)
    assert not graph.cam_from_rig and {image.frame for image in graph.images.values()} == {None}


def test_colmap_maps_our_rig(written, tmp_path):
    graph = rig_graph()
    matches = graph.pairs[0].matches
    geometry = TwoViewGeometry("ok", POSE, matches)  # the incremental mapper has its own pose
    pairs = tuple(replace(pair, geometry=geometry) for pair in graph.pairs)
    path = written(replace(graph, pairs=pairs))
    (tmp_path / "out").mkdir()
    models = pycolmap.incremental_mapping(path, tmp_path, tmp_path / "out")
    assert models[0].num_reg_images() == 8 and models[0].num_reg_frames() == 4
    assert models[0].compute_mean_reprojection_error() < 0.01


def test_frame_with_two_images_of_one_camera_is_refused(written):
    graph = rig_graph()
    images = {name: replace(image, frame="same") for name, image in graph.images.items()}
    with pytest.raises(ValueError, match="frame 'same' must have one image a camera"):
        written(replace(graph, images=images))


def test_refused_graphs_leave_no_file(tmp_path):
    graph = graph_of_pair(*NAMES, None)
    nameless = {name: replace(image, camera=None) for name, image in graph.images.items()}
    sphere = DoubleSphere(640, 480, 240, 240, 320, 240, -0.2, 0.58)
    for changes, message in (
        ({"images": nameless}, "needs the camera of image first.jpg"),
        ({"cameras": {"c": sphere}}, "no model equal to DoubleSphere"),
    ):
        with pytest.raises(ValueError, match=message):
            write_colmap_database(tmp_path / "a.db", replace(graph, **changes))
    with pytest.raises(FileNotFoundError, match="folder .* does not exist"):
        write_colmap_database(tmp_path / "none" / "a.db", graph)
    assert not list(tmp_path.iterdir())


def test_existing_file_is_not_written_over(tmp_path):
    path = tmp_path / "a.db"
    path.write_text("mine")
    with pytest.raises(ValueError, match="there already"):
        write_colmap_database(path, graph_of_pair(*NAMES, None))
    assert path.read_text() == "mine" and list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(sys.platform == "win32", reason="limits of a process are POSIX")
def test_full_disk_is_one_clear_error_and_leaves_no_file(tmp_path):
    code = """
import resource, signal, sys
from colmap_graphs import panoramas_of_points
from epi360.interop.colmap_database import write_colmap_database
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
try:
    write_colmap_database(sys.argv[1], panoramas_of_points(5, 5000)[1])
except OSError as error:
    print(error)
"""
    answer = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "a.db"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        timeout=60,
    )
    assert "cannot be written" in answer.stdout, answer.stderr
    assert not list(tmp_path.iterdir())


def test_database_is_opened_to_write_only_where_there_is_one(written, tmp_path):
    path = written(graph_of_pair(*NAMES, None))
    with open_colmap_database(path) as database:
        geometry = two_view_geometry_to_colmap(TwoViewGeometry("ok", POSE, MATCHES[:3]))
        database.write_two_view_geometry(2, 1, geometry)
    pose = read_colmap_database(path).pairs[0].geometry.cam2_from_cam1
    assert_same_pose(pose, POSE.inverse())
    with pytest.raises(FileNotFoundError, match="does not exist"):
        open_colmap_database(tmp_path / "none.db")
    assert not (tmp_path / "none.db").exists()
