# SPDX-License-Identifier: BSD-3-Clause
"""hloc's features and matches (HDF5) to a match graph and back; the layout: `hloc_layout`."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.features.matching import rounded_descriptors
from epi360.interop.descriptors import Descriptors, DescriptorsOf, is_sift_bytes, unit_descriptors
from epi360.interop.hdf5_writing import new_hdf5_files
from epi360.interop.hloc_layout import HLOC_TO_CONTINUOUS, group_of
from epi360.interop.hloc_pairs import HlocPairs
from epi360.interop.match_graph import MatchedImage, MatchedPair, MatchGraph
from epi360.interop.pairs_file import write_pairs_file
from epi360.runs.whole_files import PathLike

__all__ = ["HlocPairs", "camera_of_image", "read_hloc", "write_hloc"]


def read_hloc(
    features: PathLike,
    matches: PathLike,
    *,
    pairs: PathLike | None = None,
    cameras: Mapping[str, Camera] | None = None,
    with_descriptors: bool = False,
) -> MatchGraph:
    """Return the images, key points and matches of hloc's files.

    The graph has all images of the features file, sorted by name, also those that are in no pair.

    Parameters
    ----------
    features, matches : path-like
        hloc's HDF5 files.
    pairs : path-like, optional
        The pairs file that was matched: only its pairs are read, in its order. Without it all pairs
        of the matches file are read, sorted.
    cameras : mapping of str to Camera, optional
        Cameras by the name of an image or of a folder that it lies in, such as "front" or
        "rig/front". A single camera is used for all images of its size. An image without a camera
        is a full panorama if it is 2:1, else its camera is None.
    with_descriptors : bool, optional
        Whether to read the descriptors too, by far the largest part of the features.

    Raises
    ------
    FileNotFoundError
        If a file does not exist.
    ValueError
        If a file is damaged or has another layout, a pair has no matches or names an unknown image,
        matches name key points that do not exist, the name of a pair may mean several pairs of
        images, or a camera does not have the size of its image.
    ImportError
        If h5py is missing; the message holds the command that installs it.

    Notes
    -----
    Unless told otherwise, hloc writes key points in half precision, which is exact to 1 px from
    column 1024 on, to 2 px from column 2048 on and to 4 px from column 4096 on.
    """
    all_cameras = dict(cameras or {})
    images: dict[str, MatchedImage] = {}
    with HlocPairs(features, matches, pairs=pairs) as files:
        for name in files.images():
            key, camera = camera_of_image(name, files.image_size(name), cameras or {})
            if key is not None and camera is not None:
                all_cameras[key] = camera
            images[name] = MatchedImage(
                name=name,
                camera=key,
                keypoints=files.keypoints(name),
                descriptors=files.descriptors(name) if with_descriptors else None,
            )
        matched = tuple(MatchedPair(*pair, files.matches(*pair)) for pair in files.pairs())
    return MatchGraph(all_cameras, images, matched)


def camera_of_image(
    name: str, size: tuple[int, int] | None, cameras: Mapping[str, Camera]
) -> tuple[str | None, Camera | None]:
    """Return name and camera of an image by its name, folders or size; None if it has none."""
    parts = name.split("/")  # the innermost folder with a camera counts
    for key in ("/".join(parts[:count]) for count in range(len(parts), 0, -1)):
        if key in cameras:
            camera = cameras[key]
            if size is not None and size != (camera.width, camera.height):
                raise ValueError(
                    f"camera {key!r} must have the size of image {name}, {size[0]}x{size[1]}, "
                    f"got {camera.width}x{camera.height}"
                )
            return key, camera
    if len(cameras) == 1:
        key, camera = next(iter(cameras.items()))
        if size is None or size == (camera.width, camera.height):
            return key, camera
    if size is None:
        return None, None
    try:
        return f"panorama_{size[0]}x{size[1]}", Equirectangular.for_image(*size)
    except ValueError:
        return None, None


def write_hloc(
    features: PathLike,
    matches: PathLike,
    graph: MatchGraph,
    *,
    pairs: PathLike | None = None,
    descriptors: DescriptorsOf | None = None,
) -> None:
    """Write the key points and matches of a graph as hloc's two files, both or neither.

    Files that exist are replaced. They hold no poses, and only the image sizes of the cameras.
    Every match is written, not only the inliers of a pose. ``pairs`` is a pairs file to write as
    well, which hloc needs beside the other two.

    Descriptors are those of the images, or what ``descriptors`` returns for the name of an image,
    which need not all be in memory. They have unit length in hloc's files: SIFT in bytes is divided
    by its length. Half precision, hloc's default, is used where it holds them exactly.

    Raises
    ------
    ValueError
        If hloc's layout cannot hold the graph: a pair matches a key point of image 1 twice, two
        pairs have the same name once "/" becomes "-", or HDF5 would change a name ("./a", "a//b").
    OSError
        If a file cannot be written.
    ImportError
        If h5py is missing; the message holds the command that installs it.
    """
    if os.path.realpath(features) == os.path.realpath(matches):
        raise ValueError(f"features and matches must be two files, got {features} twice")
    with new_hdf5_files(Path(features), Path(matches)) as (features_file, matches_file):
        for image in graph.images.values():
            found = image.descriptors if descriptors is None else descriptors(image.name)
            _write_image(features_file, image, graph.cameras, found)
        for pair in graph.pairs:
            _write_pair(matches_file, pair, len(graph.images[pair.image1].keypoints))
        if pairs is not None:
            write_pairs_file(pairs, ((pair.image1, pair.image2) for pair in graph.pairs))


def _write_image(
    file: Any,
    image: MatchedImage,
    cameras: Mapping[str, Camera],
    descriptors: Descriptors | None,
) -> None:
    if not {"", "."}.isdisjoint(image.name.split("/")):  # HDF5 drops these parts of a path
        raise ValueError(f"image name {image.name!r} cannot stand in hloc's files; rename it")
    group = file.create_group(image.name)
    keypoints = image.keypoints - HLOC_TO_CONTINUOUS
    group["keypoints"] = keypoints.astype(np.float32)  # half precision, hloc's own, is too coarse
    if descriptors is not None:
        group["descriptors"] = _in_few_bytes(descriptors).T
    if image.camera is not None:
        camera = cameras[image.camera]
        group["image_size"] = np.array([camera.width, camera.height])


def _in_few_bytes(descriptors: Descriptors) -> NDArray[Any]:
    if is_sift_bytes(descriptors):
        descriptors = rounded_descriptors(unit_descriptors(descriptors))
    half = descriptors.astype(np.float16)
    return half if (half == descriptors).all() else descriptors


def _write_pair(file: Any, pair: MatchedPair, num_keypoints1: int) -> None:
    what = f"pair {pair.image1} {pair.image2}"
    path = group_of(pair.image1, pair.image2)
    if path in file:
        raise ValueError(
            f"{what}: another pair is called {path!r} as well in hloc's files, which put '-' for "
            "'/'; rename the images"
        )
    matches0 = np.full(num_keypoints1, -1, np.int32)
    matches0[pair.matches[:, 0]] = pair.matches[:, 1]
    if np.count_nonzero(matches0 >= 0) < len(pair.matches):
        raise ValueError(
            f"{what} matches a key point of {pair.image1} twice; hloc's files hold one match a key "
            "point"
        )
    file[f"{path}/matches0"] = matches0
    # hloc needs scores. The graph has none, so that all matches count as equally good.
    file[f"{path}/matching_scores0"] = (matches0 >= 0).astype(np.float32)
