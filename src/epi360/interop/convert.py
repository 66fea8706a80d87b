# SPDX-License-Identifier: BSD-3-Clause
"""Reading and writing by the name of a format: what `epi360 convert` is made of."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from epi360.cameras import Camera
from epi360.interop.colmap_database import read_colmap_database, write_colmap_database
from epi360.interop.colmap_model import read_colmap_model, write_colmap_model
from epi360.interop.colmap_model_rigs import keeps_rigs
from epi360.interop.formats import FORMATS
from epi360.interop.hloc import read_hloc, write_hloc
from epi360.interop.match_graph import MatchGraph
from epi360.interop.nerfstudio import POINTS_FILE, read_nerfstudio, write_nerfstudio
from epi360.interop.opensfm import read_opensfm, write_opensfm
from epi360.interop.reconstruction import Reconstruction
from epi360.interop.tum import read_tum_trajectory, write_tum_trajectory

PathLike = str | os.PathLike[str]
COLMAP_MODELS = "colmap", "colmap-text"


def read_reconstruction(path: PathLike, name: str, *, images: str = "images") -> Reconstruction:
    """Reconstruction of a file or folder in one of the formats.

    Parameters
    ----------
    path : path-like
        The file or folder.
    name : str
        Key of `FORMATS`, of kind "reconstruction".
    images : str
        As in `read_nerfstudio`.

    Returns
    -------
    Reconstruction

    Raises
    ------
    ValueError, FileNotFoundError, ImportError
        As the reader of the format.
    """
    if name in COLMAP_MODELS:
        return read_colmap_model(path)
    if name == "opensfm":
        return read_opensfm(path)
    if name == "nerfstudio":
        return read_nerfstudio(path, images=images)
    return read_tum_trajectory(path)


def write_reconstruction(
    path: PathLike, name: str, reconstruction: Reconstruction, *, images: str = "images"
) -> None:
    """Write a reconstruction in one of the formats.

    Parameters
    ----------
    path : path-like
        File or, for COLMAP, folder.
    name : str
        Key of `FORMATS`, of kind "reconstruction".
    reconstruction : Reconstruction
        What the format has no place for is left out: see `lost`.
    images : str
        As in `write_nerfstudio`.

    Raises
    ------
    ValueError, OSError, ImportError
        As the writer of the format.
    """
    if name in COLMAP_MODELS:
        write_colmap_model(path, reconstruction, text=name == "colmap-text")
    elif name == "opensfm":
        write_opensfm(path, reconstruction)
    elif name == "nerfstudio":
        write_nerfstudio(path, reconstruction, images=images)
    else:
        write_tum_trajectory(path, reconstruction)


def read_matches(
    path: PathLike,
    name: str,
    *,
    features: PathLike | None = None,
    pairs: PathLike | None = None,
    cameras: Mapping[str, Camera] | None = None,
    with_descriptors: bool = False,
) -> MatchGraph:
    """Match graph of a file in one of the formats.

    Parameters
    ----------
    path : path-like
        COLMAP database, or matches file of hloc.
    name : str
        Key of `FORMATS`, of kind "matches".
    features, pairs : path-like, optional
        Features file and pairs file of hloc.
    cameras : mapping of str to Camera, optional
        As in `read_hloc`.
    with_descriptors : bool
        Read them too, mostly the largest part of the files.

    Returns
    -------
    MatchGraph

    Raises
    ------
    ValueError, FileNotFoundError, ImportError
        As the reader of the format; ``ValueError`` also if hloc's features are not given.
    """
    if name == "colmap-database":
        return read_colmap_database(path, with_descriptors=with_descriptors)
    if features is None:
        raise ValueError(f"{path} holds hloc's matches; give its features file too")
    return read_hloc(
        features, path, pairs=pairs, cameras=cameras, with_descriptors=with_descriptors
    )


def write_matches(
    path: PathLike,
    name: str,
    graph: MatchGraph,
    *,
    features: PathLike | None = None,
    pairs: PathLike | None = None,
) -> None:
    """Write a match graph in one of the formats.

    Parameters
    ----------
    path : path-like
        COLMAP database, or matches file of hloc.
    name : str
        Key of `FORMATS`, of kind "matches".
    graph : MatchGraph
        What the format has no place for is left out: see `lost`.
    features, pairs : path-like, optional
        Features file and pairs file of hloc, written as well.

    Raises
    ------
    ValueError, OSError, ImportError
        As the writer of the format; ``ValueError`` also if hloc's features have no name.
    """
    if name == "colmap-database":
        write_colmap_database(path, graph)
    elif features is None:
        raise ValueError(f"hloc keeps key points beside {path}; name the features file too")
    else:
        write_hloc(features, path, graph, pairs=pairs)


def with_camera(reconstruction: Reconstruction, name: str, camera: Camera) -> Reconstruction:
    """Reconstruction whose images without a camera have this one.

    Parameters
    ----------
    reconstruction : Reconstruction
        Of a trajectory, for example.
    name : str
        What the camera is called.
    camera : Camera
        The camera.

    Returns
    -------
    Reconstruction

    Raises
    ------
    ValueError
        If no image is without a camera, or another one is called so.
    """
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
    """What is there and has no place in a format, in words.

    Parameters
    ----------
    content : Reconstruction or MatchGraph
        What is to be written.
    name : str
        Key of `FORMATS`.

    Returns
    -------
    words : list of str
    """
    if isinstance(content, Reconstruction):
        seen = content.observations
        there = {
            "cameras": bool(content.cameras),
            "points": len(content.points) > 0,
            "observations": seen is not None and len(seen.points) > 0,
            "time stamps": any(image.timestamp_s is not None for image in content.images),
            "rigs": bool(content.cam_from_rig),
            "parts of rigs": name in COLMAP_MODELS and not keeps_rigs(content),
        }
    else:
        there = {
            "cameras": bool(content.cameras),
            "descriptors": any(image.descriptors is not None for image in content.images.values()),
            "poses of pairs": any(pair.geometry is not None for pair in content.pairs),
            "rig": bool(content.cam_from_rig),
        }
    return [
        word for word, is_there in there.items() if is_there and word not in FORMATS[name].keeps
    ]


def files_written(path: PathLike, name: str, *besides: PathLike | None) -> list[Path]:
    """Files that may be written, so that none that is there need be replaced.

    Parameters
    ----------
    path : path-like
        Output.
    name : str
        Key of `FORMATS`.
    *besides : path-like or None
        Features file and pairs file of hloc.

    Returns
    -------
    paths : list of Path
        Of a COLMAP model its folder; nerfstudio's PLY also where there will be no points.
    """
    paths = [Path(path)]
    if name == "nerfstudio":
        paths.append(paths[0].parent / POINTS_FILE)
    if name == "hloc":
        paths += [Path(file) for file in besides if file is not None]
    return paths
