# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP databases: write a match graph to a new one, and read one as a match graph.

COLMAP 4.2's mappers skip UNDEFINED and DEGENERATE pairs and use the inliers of all other pairs, so
that a failed pair is written without inliers, and a pair that was not verified without a row. The
incremental mapper computes poses itself; the global one takes the rotation of the pose, or of E.
When a database is read, a pair counts as not verified if its row has neither pose nor E, or is
MULTIPLE or UNDEFINED.
"""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar import essential_from_pose, pose_from_essential
from epi360.interop.checks import known_camera
from epi360.interop.colmap_cameras import colmap_camera
from epi360.interop.colmap_pairs import ColmapPairs
from epi360.interop.colmap_rigs import (
    pycolmap_library,
    quiet,
    read_rigs,
    write_rigs_and_frames,
)
from epi360.interop.colmap_tables import ColmapTables
from epi360.interop.descriptors import (
    Descriptors,
    DescriptorsOf,
    colmap_descriptors,
    stored_descriptors,
)
from epi360.interop.match_graph import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.poses import Pose, pose_from_quaternion
from epi360.runs.whole_files import PathLike, whole_path

__all__ = [
    "ColmapPairs", "open_colmap_database", "read_colmap_database", "two_view_geometry_to_colmap",
    "whole_database", "write_colmap_database",
]  # fmt: skip

CONFIG_OF_STATUS = {"ok": "CALIBRATED", "planar_ambiguous": "PLANAR", "pure_rotation": "PANORAMIC"}
FAILURE = "DEGENERATE"
STATUS_OF_CONFIG = {  # the numbers are COLMAP's TwoViewGeometry::ConfigurationType
    1: "too_few_inliers",  # DEGENERATE
    2: "ok",  # CALIBRATED
    3: "ok",  # UNCALIBRATED
    4: "planar_ambiguous",  # PLANAR
    5: "pure_rotation",  # PANORAMIC
    6: "planar_ambiguous",  # PLANAR_OR_PANORAMIC
    7: "too_few_inliers",  # WATERMARK
    9: "ok",  # CALIBRATED_RIG
}


def open_colmap_database(path: PathLike) -> Any:
    """Return a database opened by pycolmap to write to it; COLMAP upgrades older tables."""
    pycolmap = pycolmap_library()
    with ColmapTables(path):
        pass
    if not os.access(path, os.W_OK):
        raise ValueError(f"COLMAP database {path} may not be written; open a copy")
    try:
        return pycolmap.Database.open(path)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"COLMAP database {path} cannot be opened by pycolmap: {reason}") from None


def two_view_geometry_to_colmap(geometry: TwoViewGeometry) -> Any:
    """Return a ``pycolmap.TwoViewGeometry`` for image 1 and image 2 in this order."""
    pycolmap = pycolmap_library()
    config = CONFIG_OF_STATUS.get(geometry.status, FAILURE)
    colmap_geometry = pycolmap.TwoViewGeometry()
    colmap_geometry.config = getattr(pycolmap.TwoViewGeometryConfiguration, config)
    if config == FAILURE:  # without inliers, which COLMAP's mappers would use
        return colmap_geometry
    pose = geometry.cam2_from_cam1
    translation = pose.translation
    if geometry.status == "pure_rotation":
        translation = np.zeros(3)
    else:
        colmap_geometry.E = essential_from_pose(pose)
    matrix = np.column_stack([pose.rotation, translation])
    colmap_geometry.cam2_from_cam1 = pycolmap.Rigid3d(matrix)
    colmap_geometry.inlier_matches = np.ascontiguousarray(geometry.inliers, np.uint32)
    return colmap_geometry


def write_colmap_database(
    path: PathLike, graph: MatchGraph, *, descriptors: DescriptorsOf | None = None
) -> None:
    """Write a match graph to a new database of COLMAP 4, the whole of it or nothing.

    COLMAP keeps key points in single precision. Cameras and images are numbered in the order of the
    graph, and image 1 of a pair in the file has the smaller number. Images that share a ``frame``
    become a frame of a rig if their cameras are in ``cam_from_rig``; every other image is a frame
    of its own. A pair with matches that nobody has verified is written without a geometry, and
    COLMAP does not use it before it has one.

    Descriptors are those of the images, or what ``descriptors`` returns for the name of an image,
    which need not all be in memory. SIFT becomes COLMAP's bytes, in steps of 1/512 of its length;
    descriptors of networks are kept as floats of undefined type.

    Raises
    ------
    ValueError
        If the file exists already, an image has no camera, COLMAP lacks the model of a camera, or a
        frame has two images of one camera.
    OSError
        If the folder does not exist, or the file cannot be written.
    ImportError
        If pycolmap is missing.
    """
    path = Path(path)
    if path.exists():
        raise ValueError(f"COLMAP database {path} is there already; give the name of a new file")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"folder {path.parent} of the COLMAP database does not exist")
    if not os.access(path.parent, os.W_OK):  # COLMAP does not say why it fails
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    pycolmap = pycolmap_library()
    try:
        # Without pycolmap.DatabaseTransaction, which ends the process if its commit fails on a full
        # disk. A hundred thousand pairs take eight seconds with and without it.
        with (
            whole_database(path) as temporary,
            quiet(pycolmap),
            pycolmap.Database.open(temporary) as database,
        ):
            _write(database, graph, descriptors)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OSError(
            f"COLMAP database {path} cannot be written, is there room on the disk? {reason}"
        ) from None


@contextmanager
def whole_database(path: Path) -> Iterator[Path]:
    """Yield a temporary file that replaces a database once all that was written is in it."""
    with whole_path(path) as temporary:
        yield temporary
        # If the disk is full, SQLite leaves the rest in its log and reports nothing.
        log = Path(f"{temporary}-wal")
        if log.exists() and log.stat().st_size:
            raise OSError(os.strerror(errno.ENOSPC))
        try:
            ColmapTables(temporary).close()
        except ValueError as error:
            raise OSError(str(error)) from None


def _write(database: Any, graph: MatchGraph, descriptors: DescriptorsOf | None) -> None:
    pycolmap = pycolmap_library()
    camera_ids: dict[str, int] = {
        name: database.write_camera(colmap_camera(camera)) for name, camera in graph.cameras.items()
    }
    image_ids: dict[str, int] = {}
    for image in graph.images.values():
        camera_id = camera_ids[known_camera(image, "a COLMAP database")]
        colmap_image = pycolmap.Image(name=image.name, camera_id=camera_id)
        image_ids[image.name] = database.write_image(colmap_image)
        database.write_keypoints(image_ids[image.name], image.keypoints.astype(np.float32))
        found = image.descriptors if descriptors is None else descriptors(image.name)
        if found is not None and len(found):
            database.write_descriptors(image_ids[image.name], _for_pycolmap(found))
    write_rigs_and_frames(database, graph, image_ids, camera_ids)
    for pair in graph.pairs:
        ids = image_ids[pair.image1], image_ids[pair.image2]
        database.write_matches(*ids, pair.matches.astype(np.uint32))
        if pair.geometry is not None:
            database.write_two_view_geometry(*ids, two_view_geometry_to_colmap(pair.geometry))


def _for_pycolmap(descriptors: Descriptors) -> Any:
    pycolmap = pycolmap_library()
    kind, stored = colmap_descriptors(descriptors)
    return pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType(kind), stored)


def read_colmap_database(
    path: PathLike, *, with_descriptors: bool = False, for_poses: bool = False
) -> MatchGraph:
    """Return the match graph of a COLMAP database, which is not changed.

    Cameras and frames of rigs are named by their id. Image 1 of a pair has the smaller id. The
    matches of a pair with a geometry but without matches are the inliers. If a geometry has no
    pose, its pose is computed from E and the bearings of its inliers. The pose of a camera is
    relative to the reference camera of its own rig.

    Parameters
    ----------
    path : path-like
        A database of COLMAP 3 or 4, to which nothing may write while it is read.
    with_descriptors : bool
        Whether to read the descriptors too, usually the largest part of the file.
    for_poses : bool
        Whether poses shall be estimated by its cameras, so that they must be true ones.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If the file is no COLMAP database, is truncated or damaged, or has a camera with a model
        that epi360 lacks; or if pycolmap has made up the camera of a panorama, and it is needed.
    """
    with ColmapPairs(path) as pairs:
        if for_poses:
            pairs.check_panoramas()
        cam_from_rig, frames = read_rigs(pairs)
        images = {
            name: MatchedImage(
                name,
                camera,
                pairs.keypoints(name),
                read_descriptors(pairs, name) if with_descriptors else None,
                frames.get(name),
            )
            for name, camera in pairs.images.items()
        }
        matches = {names: pairs.matches(index) for index, names in enumerate(pairs.names)}
        geometries = {}
        for names, inliers, geometry in _geometries(pairs):
            geometries[names] = geometry
            matches.setdefault(names, inliers)
        matched = tuple(
            MatchedPair(*names, indices, geometries.get(names))
            for names, indices in matches.items()
        )
        return MatchGraph(pairs.cameras, images, matched, cam_from_rig)


def read_descriptors(pairs: ColmapPairs, name: str) -> NDArray[np.float32] | None:
    """Descriptors (N, D) of an image as they are in the file; None if it has none."""
    has_type = pairs.has_columns("descriptors", "type")
    query = (
        f"SELECT {'type' if has_type else '0'}, rows, cols, data FROM descriptors "
        "WHERE image_id = (SELECT image_id FROM images WHERE name = ?)"
    )
    for kind, *blob in pairs.rows(query, name):
        what = f"descriptors of {name}"
        stored = pairs.array((blob[0], blob[1], blob[2]), np.uint8, what)
        if len(stored) != len(pairs.keypoints(name)):
            raise pairs.error(f"{name} must have one descriptor a key point, got {len(stored)}")
        found = stored_descriptors(kind, stored)
        if found is None:
            raise pairs.error(f"{what} must be floats of 4 bytes, got {stored.shape[1]} bytes each")
        return found
    return None


def _geometries(
    pairs: ColmapPairs,
) -> Iterator[tuple[tuple[str, str], NDArray[np.int64], TwoViewGeometry | None]]:
    columns = [
        name if pairs.has_columns("two_view_geometries", name) else f"NULL AS {name}"
        for name in ("E", "qvec", "tvec")
    ]
    query = (
        f"SELECT pair_id, config, {', '.join(columns)}, rows, cols, data "
        "FROM two_view_geometries ORDER BY pair_id"
    )
    for pair_id, config, E, quaternion, translation, *blob in pairs.rows(query):
        names = pairs.names_of(pair_id)
        inliers = pairs.checked_matches((blob[0], blob[1], blob[2]), names)
        status = STATUS_OF_CONFIG.get(config)
        geometry = None
        if status == "too_few_inliers":
            geometry = TwoViewGeometry(status, Pose.nan(), np.zeros((0, 2), np.int64))
        elif status is not None:
            pose = _stored_pose(pairs, names, status, quaternion, translation)
            if pose is None and status != "pure_rotation":
                pose = _decomposed(pairs, names, E, inliers)
            geometry = None if pose is None else TwoViewGeometry(status, pose, inliers)
        yield names, inliers, geometry


def _stored_pose(
    pairs: ColmapPairs,
    names: tuple[str, str],
    status: str,
    quaternion: bytes | None,
    translation: bytes | None,
) -> Pose | None:
    """Pose of a row, or None if it has none; older versions of COLMAP then store the identity."""
    if not quaternion or not translation:
        return None
    what = f"pose of pair {names[0]} {names[1]}"
    wxyz = pairs.array((1, 4, quaternion), np.float64, what)[0]
    t = pairs.array((1, 3, translation), np.float64, what)[0]
    with np.errstate(over="ignore", invalid="ignore"):  # numbers of 1e200, signalling NaN
        lengths = float(np.linalg.norm(wxyz)), float(np.linalg.norm(t))
    if not np.isfinite(lengths).all() or lengths[0] == 0:
        return None
    if status == "pure_rotation" and wxyz[0] != lengths[0]:
        return pose_from_quaternion(np.full(3, np.nan), wxyz / lengths[0])
    if status != "pure_rotation" and lengths[1] > 0:
        return pose_from_quaternion(t / lengths[1], wxyz / lengths[0])
    return None


def _decomposed(
    pairs: ColmapPairs, names: tuple[str, str], E: bytes | None, inliers: NDArray[np.int64]
) -> Pose | None:
    """Pose of an essential matrix, or None without a matrix or an inlier to choose it by."""
    if not E or not len(inliers):
        return None
    matrix = pairs.array((3, 3, E), np.float64, f"matrix of pair {names[0]} {names[1]}")
    if not (matrix.any() and np.isfinite(matrix).all()):
        return None
    bearings = [
        pairs.camera(name).bearings_from_pixels(pairs.keypoints(name)[indices])
        for name, indices in zip(names, inliers.T, strict=True)
    ]
    try:
        return pose_from_essential(matrix, *bearings)
    except ValueError:  # of rank 1: near no essential matrix
        return None
