# SPDX-License-Identifier: BSD-3-Clause
"""What other programs' own readers make of the files in `client_files.write_scene`.

A program that no registry has is taken from a folder with its source (``snapshots``). Nothing of
them is trained or built: parts that only training needs (CUDA kernels, camera raw) are replaced by
empty modules. `NotInstalledError` says what is missing.
"""

import contextlib
import importlib
import importlib.metadata
import io
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from client_files import Scene
from numpy.typing import NDArray

from epi360.poses import Pose, rotation_error_deg

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])


class NotInstalledError(Exception):
    """A program, or a module that it needs, is not there."""


@dataclass(frozen=True)
class Loaded:
    """What a program has read: poses cam_from_world by name in the written world, and points."""

    version: str
    poses: Mapping[str, Pose] = field(default_factory=dict)
    points: NDArray[np.float64] | None = None
    remarks: tuple[str, ...] = ()


def pycolmap_cubes(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The model of the cube faces; its rigs and frames."""
    pycolmap = _module("pycolmap")
    model = pycolmap.Reconstruction(scene.folder / "cube" / "sparse" / "0")
    remark = f"{model.num_rigs()} rig, {model.num_frames()} frames"
    return Loaded(pycolmap.__version__, _colmap_poses(model), _colmap_points(model), (remark,))


def pycolmap_panoramas(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The model of the panoramas; the mean error that it finds against the one that we wrote."""
    pycolmap = _module("pycolmap")
    model = pycolmap.Reconstruction(scene.folder / "panorama_model")
    model.update_point_3d_errors()
    remark = f"mean error {model.compute_mean_reprojection_error():.2g} px"
    return Loaded(pycolmap.__version__, _colmap_poses(model), _colmap_points(model), (remark,))


def evo(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The trajectory, whose rows are in the order of the names."""
    interface = _module("evo.tools.file_interface")
    path = interface.read_tum_trajectory_file(str(scene.folder / "trajectory.txt"))
    names = [image.name for image in scene.panoramas.images]  # in the order of their names
    poses = {
        name: Pose.from_matrix(matrix).inverse()
        for name, matrix in zip(names, path.poses_se3, strict=True)
    }
    seconds = f"{path.timestamps[0]:g} to {path.timestamps[-1]:g} s"
    return Loaded(_version("evo"), poses, None, (seconds,))


def open3d(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The points of transforms.json, which nerfstudio too reads with Open3D."""
    library = _module("open3d")
    cloud = library.io.read_point_cloud(str(scene.folder / "points.ply"))
    colors = np.round(np.asarray(cloud.colors) * 255).astype(int)
    remark = _equal_colors(colors, scene)
    return Loaded(library.__version__, {}, np.asarray(cloud.points), (remark,))


def trimesh(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The points, and their colors."""
    library = _module("trimesh")
    cloud = library.load(scene.folder / "points.ply")
    remark = _equal_colors(np.asarray(cloud.colors)[:, :3], scene)
    return Loaded(library.__version__, {}, np.asarray(cloud.vertices), (remark,))


def nerfstudio_cubes(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """transforms.json of the cube faces, without an option that orients the scene."""
    return _nerfstudio_transforms(scene.folder / "cube", snapshots, "images")


def nerfstudio_panoramas(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """transforms.json of the panoramas as they are."""
    return _nerfstudio_transforms(scene.folder, snapshots, "panoramas")


def nerfstudio_colmap(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The COLMAP model of the cube faces by nerfstudio's ``colmap`` reader, with masks."""
    with _nerfstudio(snapshots) as version:
        parsers = importlib.import_module("nerfstudio.data.dataparsers.colmap_dataparser")
        config = parsers.ColmapDataParserConfig(
            data=scene.folder / "cube",
            colmap_path=Path("sparse/0"),
            masks_path=Path("masks"),
            downscale_factor=1,
            orientation_method="none",
            eval_mode="all",
        )
        found = config.setup().get_dataparser_outputs("train")
    return _of_nerfstudio(version, found, scene.folder / "cube" / "images")


def gsplat(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The cube faces by the reader of gsplat's ``examples/simple_trainer.py``, factor 1."""
    root = _snapshot("gsplat", snapshots)
    with _quiet(), _path(root / "examples", forget=("datasets", "exif")):
        parser = _module("datasets.colmap").Parser(str(scene.folder / "cube"), factor=1)
        version = _version_in(root / "gsplat" / "version.py")
    poses = {
        name: Pose.from_matrix(np.linalg.inv(matrix))
        for name, matrix in zip(parser.image_names, parser.camtoworlds, strict=True)
    }
    errors = f"errors {parser.points_err.min():.1g} to {parser.points_err.max():.1g} px"
    return Loaded(version, poses, parser.points.astype(float), (errors,))


def gaussian_splatting(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The cube faces by the reader of the original 3DGS, binary."""
    return _gaussian_splatting(scene.folder / "cube", snapshots)


def gaussian_splatting_text(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The same as text, of which its reader takes PINHOLE cameras only."""
    return _gaussian_splatting(scene.folder / "text", snapshots)


def hloc(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """Key points and matches."""
    root = _snapshot("hloc", snapshots)
    with _quiet(), _path(root, forget=("hloc",)):
        files = _module("hloc.utils.io")
        version = sys.modules["hloc"].__version__
    one, other = (image.name for image in scene.panoramas.images[:2])
    matches, _ = files.get_matches(scene.folder / "matches.h5", one, other)
    keypoints = files.get_keypoints(scene.folder / "features.h5", one)
    seen = scene.panoramas.observations
    assert seen is not None
    # hloc adds the half pixel itself where it hands key points to COLMAP.
    offset = np.abs(keypoints + 0.5 - seen.pixels[seen.images == 0]).max()
    remark = f"{len(matches)} matches, {len(keypoints)} key points off by {offset:.1g} px"
    return Loaded(version, {}, None, (remark,))


def opensfm(scene: Scene, snapshots: Mapping[str, Path]) -> Loaded:
    """The project's folder, with its tracks; needs OpenSfM's compiled modules."""
    with _quiet(), _path(snapshots.get("opensfm"), forget=()):
        types = _module("opensfm.io")
        pymap = _module("opensfm.pymap")
    folder = scene.folder / "opensfm"
    with (folder / "reconstruction.json").open(encoding="utf-8") as file:
        (reconstruction,) = types.reconstructions_from_json(types.json_load(file))
    tracks = pymap.TracksManager.instanciate_from_file(str(folder / "tracks.csv"))
    reconstruction.add_correspondences_from_tracks_manager(tracks)
    name_of = {image.name.rpartition("/")[2]: image.name for image in scene.panoramas.images}
    poses = {
        name_of[name]: Pose.from_matrix(shot.pose.get_Rt())
        for name, shot in reconstruction.shots.items()
    }
    names = sorted(reconstruction.points, key=int)
    points = np.array([reconstruction.points[name].coordinates for name in names])
    return Loaded(_version("opensfm"), poses, points, (f"{tracks.num_tracks()} tracks",))


READERS: dict[str, Callable[[Scene, Mapping[str, Path]], Loaded]] = {
    "pycolmap, cube faces": pycolmap_cubes,
    "pycolmap, panoramas": pycolmap_panoramas,
    "evo, trajectory": evo,
    "Open3D, points": open3d,
    "trimesh, points": trimesh,
    "nerfstudio, transforms.json of faces": nerfstudio_cubes,
    "nerfstudio, transforms.json of panoramas": nerfstudio_panoramas,
    "nerfstudio, COLMAP model of faces": nerfstudio_colmap,
    "gsplat, cube faces": gsplat,
    "3DGS, cube faces": gaussian_splatting,
    "3DGS, cube faces as text": gaussian_splatting_text,
    "hloc, matches": hloc,
    "OpenSfM, project": opensfm,
}


def differences(loaded: Loaded, scene: Scene) -> tuple[float, float, float]:
    """Largest differences of rotations in degrees, of centres, of points; NaN if none is read."""
    written = {image.name: image.cam_from_world for image in scene.panoramas.images}
    expected_points = scene.panoramas.points
    if not loaded.poses.keys() <= written.keys():
        written = {image.name: image.cam_from_world for image in scene.faces.images}
        expected_points = scene.faces.points
    if loaded.poses and loaded.poses.keys() != written.keys():
        raise ValueError(f"{len(loaded.poses)} of {len(written)} images were read")
    turns = [rotation_error_deg(pose, written[name]) for name, pose in loaded.poses.items()]
    centres = [
        np.abs(pose.inverse().translation - written[name].inverse().translation).max()
        for name, pose in loaded.poses.items()
    ]
    points = [] if loaded.points is None else [np.abs(loaded.points - expected_points).max()]
    turn, centre, point = (float(max(each, default=np.nan)) for each in (turns, centres, points))
    return turn, centre, point


def _equal_colors(colors: NDArray[Any], scene: Scene) -> str:
    return f"colors {'' if np.array_equal(colors, scene.panoramas.colors) else 'not '}equal"


def _colmap_poses(model: Any) -> dict[str, Pose]:
    images = (model.images[number] for number in model.reg_image_ids())
    return {image.name: Pose.from_matrix(image.cam_from_world().matrix()) for image in images}


def _colmap_points(model: Any) -> NDArray[np.float64]:
    return np.array([model.points3D[number].xyz for number in sorted(model.points3D)])


@contextlib.contextmanager
def _nerfstudio(snapshots: Mapping[str, Path]) -> Iterator[str]:
    """nerfstudio can be imported; its version. It opens camera raw files, which we have none of."""
    raw = ModuleType("newrawpy")
    raw.imread = None  # type: ignore[attr-defined]
    with _quiet(), _path(snapshots.get("nerfstudio"), forget=()), _modules({"newrawpy": raw}):
        _module("nerfstudio.data.dataparsers.nerfstudio_dataparser")
        yield _version("nerfstudio")


def _nerfstudio_transforms(folder: Path, snapshots: Mapping[str, Path], images: str) -> Loaded:
    with _nerfstudio(snapshots) as version:
        parsers = importlib.import_module("nerfstudio.data.dataparsers.nerfstudio_dataparser")
        config = parsers.NerfstudioDataParserConfig(
            data=folder, downscale_factor=1, eval_mode="all", load_3D_points=True
        )
        found = config.setup().get_dataparser_outputs("train")
    return _of_nerfstudio(version, found, folder / images)


def _of_nerfstudio(version: str, found: Any, images: Path) -> Loaded:
    """Poses and points, moved and scaled back to the written world."""
    names = [Path(path).relative_to(images).as_posix() for path in found.image_filenames]
    out_from_world = np.eye(4)
    out_from_world[:3] = found.dataparser_transform.numpy().astype(float)
    world_from_out = Pose(*_split(np.linalg.inv(out_from_world)))
    poses = {}
    for name, matrix in zip(names, found.cameras.camera_to_worlds.numpy(), strict=True):
        out_from_opengl = np.eye(4)
        out_from_opengl[:3] = matrix
        out_from_opengl[:3, 3] /= found.dataparser_scale
        rotation, translation = _split(out_from_opengl)
        poses[name] = (world_from_out @ Pose(rotation @ OPENCV_FROM_OPENGL, translation)).inverse()
    points = found.metadata["points3D_xyz"].numpy().astype(float) / found.dataparser_scale
    in_world = points @ world_from_out.rotation.T + world_from_out.translation
    ups = found.cameras.camera_to_worlds.numpy()[:, :3, 1]
    level = [up for name, up in zip(names, ups, strict=True) if not name.endswith("_up.jpg")]
    tilt = max(np.degrees(np.arctan2(np.hypot(x, y), z)) for x, y, z in level)
    masks = found.mask_filenames
    remarks = [f"up is z to {tilt:.1g} deg"]
    if masks is not None:
        there = sum(Path(path).is_file() for path in masks)
        remarks.append(f"{there} of {len(names)} masks")
    return Loaded(version, poses, in_world, tuple(remarks))


def _split(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Exact rotation and the translation of a matrix in single precision."""
    left, _, right = np.linalg.svd(matrix[:3, :3])
    return left @ right, matrix[:3, 3]


def _gaussian_splatting(folder: Path, snapshots: Mapping[str, Path]) -> Loaded:
    root = _snapshot("3dgs", snapshots)
    kernels = {"simple_knn": ModuleType("simple_knn"), "simple_knn._C": ModuleType("_C")}
    kernels["simple_knn._C"].distCUDA2 = None  # type: ignore[attr-defined]
    with _quiet(), _modules(kernels), _path(root, forget=("scene", "utils", "arguments")):
        _empty_package("scene", root / "scene")  # whose __init__ imports the whole trainer
        readers = _module("scene.dataset_readers")
        found = readers.readColmapSceneInfo(str(folder), "images", "", False, False)
    poses = {
        camera.image_name: Pose(*_split(_matrix(camera.R.T, camera.T)))
        for camera in found.train_cameras
    }
    return Loaded("source", poses, np.asarray(found.point_cloud.points, dtype=float))


def _matrix(rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


def _empty_package(name: str, folder: Path) -> None:
    package = ModuleType(name)
    package.__path__ = [str(folder)]
    sys.modules[name] = package


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise NotInstalledError(str(error)) from None


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "source"


def _version_in(path: Path) -> str:
    """What a Python file gives to ``__version__``."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return next(line.split('"')[1] for line in lines if line.startswith("__version__"))


def _snapshot(name: str, snapshots: Mapping[str, Path]) -> Path:
    if name not in snapshots:
        raise NotInstalledError(f"no registry has it; give --snapshot {name}=FOLDER")
    return snapshots[name]


@contextlib.contextmanager
def _path(folder: Path | None, forget: tuple[str, ...]) -> Iterator[None]:
    """Import from a folder first; its top-level modules with common names are forgotten after."""
    if folder is None:
        yield
        return
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        for name in [name for name in sys.modules if name.partition(".")[0] in forget]:
            del sys.modules[name]


@contextlib.contextmanager
def _modules(modules: Mapping[str, ModuleType]) -> Iterator[None]:
    """Empty modules in place of parts that reading does not need."""
    new = {name: module for name, module in modules.items() if name not in sys.modules}
    sys.modules.update(new)
    try:
        yield
    finally:
        for name in new:
            sys.modules.pop(name, None)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield
