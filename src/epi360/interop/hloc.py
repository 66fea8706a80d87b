# SPDX-License-Identifier: BSD-3-Clause
"""hloc's features and matches (HDF5) to a match graph and back; the layout: `hloc_layout`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from epi360.cameras import Camera, Equirectangular
from epi360.extras import extra_library
from epi360.interop.hloc_layout import HLOC_TO_CONTINUOUS, group_of
from epi360.interop.hloc_pairs import HlocPairs
from epi360.interop.match_graph import MatchedImage, MatchedPair, MatchGraph
from epi360.interop.pairs_file import write_pairs_file
from epi360.runs.whole_files import whole_paths

__all__ = ["HlocPairs", "camera_of_image", "read_hloc", "write_hloc"]


def read_hloc(
    features: str | os.PathLike[str],
    matches: str | os.PathLike[str],
    *,
    pairs: str | os.PathLike[str] | None = None,
    cameras: Mapping[str, Camera] | None = None,
    with_descriptors: bool = False,
) -> MatchGraph:
    """Images, key points and matches of hloc's files.

    Parameters
    ----------
    features, matches : path-like
        hloc's HDF5 files.
    pairs : path-like, optional
        The pairs file that was matched; only its pairs are taken, in its order. Without it: all
        pairs of the matches file, sorted.
    cameras : mapping of str to Camera, optional
        By the name of an image or of a folder that it lies in, such as "front" or "rig/front"; a
        single one is that of all images of its size. An image without one is a full panorama if
        it is 2:1, else its camera is None.
    with_descriptors : bool, optional
        Read the descriptors as well, by far the largest part of the features.

    Returns
    -------
    MatchGraph
        All images of the features file, sorted by name, also those in no pair.

    Raises
    ------
    FileNotFoundError
        If a file does not exist.
    ValueError
        If a file is damaged or has another layout, a pair has no matches or names no image, the
        matches do not fit the key points, the name of a pair fits several pairs of images, or a
        camera has not the size of its image.
    ImportError
        If h5py is missing; the message holds the command that installs it.
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
    """Camera of an image by its name and size.

    Parameters
    ----------
    name : str
        Of the image, with "/" between its parts.
    size : (int, int) or None
        Width and height in pixels, where known.
    cameras : mapping of str to Camera
        By the name of an image or of a folder that it lies in, of which the innermost counts; a
        single one is that of all images of its size.

    Returns
    -------
    key : str or None
        Name of the camera; of a panorama that is in none of the cameras "panorama_WIDTHxHEIGHT".
    camera : Camera or None
        None where the image is not 2:1 and has no camera.

    Raises
    ------
    ValueError
        If the camera of that name has another size than the image.
    """
    parts = name.split("/")
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
    features: str | os.PathLike[str],
    matches: str | os.PathLike[str],
    graph: MatchGraph,
    *,
    pairs: str | os.PathLike[str] | None = None,
) -> None:
    """Write the key points and matches of a graph as hloc's files: both whole, or neither.

    Poses and cameras have no place in them, but for the size of the images.

    Parameters
    ----------
    features, matches : path-like
        HDF5 files, written or replaced.
    graph : MatchGraph
        Every match is written, not only the inliers of a pose.
    pairs : path-like, optional
        Pairs file, which hloc wants beside them; written as well.

    Raises
    ------
    ValueError
        If a pair matches a key point of image 1 twice, two pairs are called the same once "/"
        becomes "-", or HDF5 would change a name ("./a", "a//b"): hloc's layout has no place for
        them.
    OSError
        If a file cannot be written.
    ImportError
        If h5py is missing; the message holds the command that installs it.
    """
    if os.path.realpath(features) == os.path.realpath(matches):
        raise ValueError(f"features and matches must be two files, got {features} twice")
    with _written_together(Path(features), Path(matches)) as (features_file, matches_file):
        for image in graph.images.values():
            _write_image(features_file, image, graph.cameras)
        for pair in graph.pairs:
            _write_pair(matches_file, pair, len(graph.images[pair.image1].keypoints))
        if pairs is not None:
            write_pairs_file(pairs, ((pair.image1, pair.image2) for pair in graph.pairs))


@contextmanager
def _written_together(*paths: Path) -> Iterator[list[Any]]:
    """HDF5 files under temporary names that take the place of the real ones together."""
    h5py = extra_library("h5py", extra="hloc", purpose="hloc's files")
    for path in paths:
        if path.is_dir():
            raise IsADirectoryError(f"{path} must be a file to write, it is a folder")
    with whole_paths(*paths) as temporaries, ExitStack() as files:
        for temporary in temporaries:
            temporary.touch()  # a missing folder is told more shortly than by HDF5
        yield [files.enter_context(h5py.File(path, "w")) for path in temporaries]


def _write_image(file: Any, image: MatchedImage, cameras: Mapping[str, Camera]) -> None:
    if not {"", "."}.isdisjoint(image.name.split("/")):  # HDF5 drops these parts of a path
        raise ValueError(f"image name {image.name!r} cannot stand in hloc's files; rename it")
    group = file.create_group(image.name)
    keypoints = image.keypoints - HLOC_TO_CONTINUOUS
    group["keypoints"] = keypoints.astype(np.float32)  # half, hloc's default, is too coarse
    if image.descriptors is not None:
        group["descriptors"] = image.descriptors.T
    if image.camera is not None:
        camera = cameras[image.camera]
        group["image_size"] = np.array([camera.width, camera.height])


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
    # hloc asks for scores; the graph has none, so that all matches are equally good.
    file[f"{path}/matching_scores0"] = (matches0 >= 0).astype(np.float32)
