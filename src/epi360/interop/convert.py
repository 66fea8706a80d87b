# SPDX-License-Identifier: BSD-3-Clause
"""Reading and writing by the name of a format: what `epi360 convert` is made of."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from epi360.cameras import Camera
from epi360.interop.colmap_database import read_colmap_database, write_colmap_database
from epi360.interop.colmap_model import read_colmap_model, write_colmap_model
from epi360.interop.colmap_model_rigs import keeps_rigs
from epi360.interop.descriptors import DescriptorsOf
from epi360.interop.formats import FORMATS, colmap_model_folder
from epi360.interop.hloc import camera_of_image, read_hloc, write_hloc
from epi360.interop.match_graph import REFUSED, MatchGraph
from epi360.interop.nerfstudio import points_file, read_nerfstudio, write_nerfstudio
from epi360.interop.opensfm import read_opensfm, write_opensfm, write_opensfm_folder
from epi360.interop.opensfm_pictures import loses_folders
from epi360.interop.reconstruction import Reconstruction
from epi360.interop.tum import (
    names_path,
    read_tum_trajectory,
    write_tum_names,
    write_tum_trajectory,
)
from epi360.runs.whole_files import PathLike

COLMAP_MODELS = "colmap", "colmap-text"
FOLDERS = (*COLMAP_MODELS, "opensfm-folder")


def read_reconstruction(path: PathLike, name: str, *, images: str = "images") -> Reconstruction:
    """Return the reconstruction in a file or folder of the named format.

    The model of a folder that `epi360 map` wrote is its ``sparse/0``.
    """
    if name in COLMAP_MODELS:
        return read_colmap_model(colmap_model_folder(path) or path)
    if name in ("opensfm", "opensfm-folder"):
        return read_opensfm(path)
    if name == "nerfstudio":
        return read_nerfstudio(path, images=images)
    if name == "tum":
        return read_tum_trajectory(path)
    raise ValueError(f"{name} is no format of reconstructions")


def write_reconstruction(
    path: PathLike,
    name: str,
    reconstruction: Reconstruction,
    *,
    images: str | None = None,
    fps: float | None = None,
) -> None:
    """Write a reconstruction in the named format, without what `lost` says.

    ``images`` is the folder of the images: beside transforms.json, or what is linked into a project
    of OpenSfM.
    """
    if name in COLMAP_MODELS:
        write_colmap_model(path, reconstruction, text=name == "colmap-text")
    elif name == "opensfm":
        write_opensfm(path, reconstruction)
    elif name == "opensfm-folder":
        write_opensfm_folder(path, reconstruction, images=images)
    elif name == "nerfstudio":
        write_nerfstudio(path, reconstruction, images="images" if images is None else images)
    elif name == "tum":
        write_tum_trajectory(path, reconstruction, fps=fps)
        write_tum_names(names_path(path), reconstruction, fps=fps)
    else:
        raise ValueError(f"{name} is no format of reconstructions")


def read_matches(
    path: PathLike,
    name: str,
    *,
    features: PathLike | None = None,
    pairs: PathLike | None = None,
    cameras: Mapping[str, Camera] | None = None,
    with_descriptors: bool = False,
    for_poses: bool = False,
) -> MatchGraph:
    """Return the match graph in a COLMAP database, or in hloc's matches and features.

    Given ``cameras`` take the place of those of a database. If it is read ``for_poses``, its
    cameras must be true ones.
    """
    if name == "colmap-database":
        is_asked = for_poses and not cameras
        graph = read_colmap_database(path, with_descriptors=with_descriptors, for_poses=is_asked)
        return with_other_cameras(graph, cameras) if cameras else graph
    if features is None:
        raise ValueError(f"{path} holds hloc's matches; give its features file too")
    return read_hloc(
        features, path, pairs=pairs, cameras=cameras, with_descriptors=with_descriptors
    )


def with_other_cameras(graph: MatchGraph, cameras: Mapping[str, Camera]) -> MatchGraph:
    """Return the graph with given cameras, by the names of images or of their folders.

    Raises ``ValueError`` where an image has none of its size, or two images of one camera of the
    graph have different ones.
    """
    found: dict[str, Camera] = {}
    for name, image in graph.images.items():
        if image.camera is None:
            continue
        before = graph.cameras[image.camera]
        camera = camera_of_image(name, (before.width, before.height), cameras)[1]
        is_given = camera in cameras.values()  # and not a panorama for its shape
        if camera is None or not is_given or found.setdefault(image.camera, camera) != camera:
            what = "has another one of" if is_given else "has none of"
            raise ValueError(
                f"{name}, an image of camera {image.camera} of {before.width}x{before.height} "
                f"pixels, {what} the given cameras: {', '.join(cameras)}"
            )
    return replace(graph, cameras={**graph.cameras, **found})


def write_matches(
    path: PathLike,
    name: str,
    graph: MatchGraph,
    *,
    features: PathLike | None = None,
    pairs: PathLike | None = None,
    descriptors: DescriptorsOf | None = None,
) -> None:
    """Write a match graph to a COLMAP database, or as hloc's matches, features and pairs."""
    if name == "colmap-database":
        write_colmap_database(path, graph, descriptors=descriptors)
    elif features is None:
        raise ValueError(f"hloc keeps key points beside {path}; name the features file too")
    else:
        write_hloc(features, path, graph, pairs=pairs, descriptors=descriptors)


def without_refused(graph: MatchGraph) -> MatchGraph:
    """The graph without pairs that others speak against, for a format without poses of pairs.

    Whoever verified their matches anew, pair by pair, would take them for right.
    """
    pairs = tuple(
        pair for pair in graph.pairs if pair.geometry is None or pair.geometry.status != REFUSED
    )
    return replace(graph, pairs=pairs)


def with_camera(reconstruction: Reconstruction, name: str, camera: Camera) -> Reconstruction:
    """Return a reconstruction whose images without a camera have this one."""
    if all(image.camera is not None for image in reconstruction.images):
        raise ValueError("a camera is for images without one, and all images have theirs")
    if name in reconstruction.cameras:
        raise ValueError(f"there is a camera {name!r} already; give this one another name")
    images = tuple(
        replace(image, camera=name) if image.camera is None else image
        for image in reconstruction.images
    )
    return replace(reconstruction, cameras={**reconstruction.cameras, name: camera}, images=images)


def lost(content: Reconstruction | MatchGraph, name: str) -> list[str]:
    """Return, in words, which parts of the content have no place in the named format."""
    if isinstance(content, Reconstruction):
        seen = content.observations
        present = {
            "cameras": bool(content.cameras),
            "points": len(content.points) > 0,
            "observations": seen is not None and len(seen.points) > 0,
            "time stamps": any(image.timestamp_s is not None for image in content.images),
            "rigs": bool(content.cam_from_rig),
            "folders in names": name == "opensfm-folder"
            and loses_folders([image.name for image in content.images]),
            "parts of rigs": name in COLMAP_MODELS and not keeps_rigs(content),
        }
    else:
        present = {
            "cameras": bool(content.cameras),
            "descriptors": any(image.descriptors is not None for image in content.images.values()),
            "poses of pairs": any(pair.geometry is not None for pair in content.pairs),
            "rig": bool(content.cam_from_rig),
        }
    return [
        word
        for word, is_present in present.items()
        if is_present and word not in FORMATS[name].keeps
    ]


def files_written(path: PathLike, name: str, *besides: PathLike | None) -> list[Path]:
    """Return the files that may be written; those of `FOLDERS` are folders."""
    paths = [Path(path)]
    if name == "nerfstudio":
        paths.append(points_file(path))  # written only if there are points
    if name == "tum":
        paths.append(names_path(path))
    if name == "hloc":
        paths += [Path(file) for file in besides if file is not None]
    return paths
