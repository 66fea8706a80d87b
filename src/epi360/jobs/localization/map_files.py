# SPDX-License-Identifier: BSD-3-Clause
"""A map in files: what `epi360 map` wrote, or a COLMAP model with the features of its images."""

from __future__ import annotations

from pathlib import Path

from epi360.cameras import load_cameras
from epi360.image_folders import existing_folder
from epi360.interop.colmap_model import read_colmap_model
from epi360.interop.colmap_pairs import ColmapPairs
from epi360.interop.formats import FIRST_MODEL, colmap_model_folder
from epi360.jobs.localization.feature_sources import (
    DatabaseFile,
    ExtractionSettings,
    FeatureSource,
    HlocFile,
    ImageFolder,
    MatchedFolder,
)
from epi360.jobs.localization.kept_index import INDEX_FILE
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.jobs.mapping.mapped_models import with_given_cameras
from epi360.runs.whole_files import PathLike

_INDEX, _CAMERAS, _DATABASE = "images.json", "cameras.json", "database.db"
_LEVELS = 2  # folders above a model in which its database may lie: DATABASE beside sparse/0


def load_map(
    path: PathLike,
    *,
    images: PathLike | None = None,
    features: PathLike | None = None,
    database: PathLike | None = None,
    max_width: int = 2048,
    max_features: int = 10000,
) -> LocalizationMap:
    """Return a map in which `localize_image` finds new images.

    Parameters
    ----------
    path : path-like
        The output folder of `epi360 map`, or a COLMAP model (folder), which pycolmap and hloc write
        as well.
    images : path-like, optional
        Folder that the names of the model's images start from: they are searched for features anew.
        Needed where the model was made from features that epi360 cannot make, such as learned ones.
    features : path-like, optional
        hloc's features file with the images of the model and the new ones.
    database : path-like, optional
        COLMAP database with the SIFT descriptors that the model was made from; by default
        ``database.db`` beside the model or up to two folders above it.
    max_width, max_features : int
        How wide images are searched and how many features are kept; a map of ours keeps its own.

    Raises
    ------
    FileNotFoundError
        If there is no such file or folder.
    ValueError
        If the folder holds no model, the model no points, or nothing says what its images look
        like.

    Notes
    -----
    The first image that is localized makes an index over the map's images, which is kept in the
    folder of the map as ``localize-index.npz``. The file may be deleted; it is made again when the
    map or its features have changed, and done without where the folder cannot be written.
    """
    path = existing_folder(Path(path), "map")
    if sum(each is not None for each in (images, features, database)) > 1:
        raise ValueError("give one of images, features and database, got several")
    folder = colmap_model_folder(path)
    if folder is None:
        raise ValueError(
            f"{path} holds no COLMAP model (images.bin or images.txt), nor {FIRST_MODEL} with one; "
            "make a map first with epi360 map"
        )
    model = read_colmap_model(folder)
    ours = _output_of_ours(path, folder)
    if ours is not None:
        model = with_given_cameras(model, load_cameras(ours / _CAMERAS))
    settings = ExtractionSettings(max_width, max_features)
    source = _source(folder, ours, images, features, database, settings)
    return LocalizationMap(model, source, str(path), (ours or path) / INDEX_FILE)


def _output_of_ours(path: Path, folder: Path) -> Path | None:
    """Output folder of `epi360 map` that a model lies in."""
    for candidate in (path, folder.parent.parent):
        if (candidate / _INDEX).is_file() and (candidate / _CAMERAS).is_file():
            return candidate
    return None


def _source(
    folder: Path,
    ours: Path | None,
    images: PathLike | None,
    features: PathLike | None,
    database: PathLike | None,
    settings: ExtractionSettings,
) -> FeatureSource:
    if images is not None:
        return ImageFolder(settings, existing_folder(Path(images), "image folder"))
    if features is not None:
        return HlocFile(Path(features))
    if database is not None:
        return DatabaseFile(settings, ColmapPairs(database))
    if ours is not None:
        return MatchedFolder.opened(ours)
    above = [folder, *folder.parents][: _LEVELS + 1]
    for candidate in (each / _DATABASE for each in above):
        if candidate.is_file():
            return DatabaseFile(settings, ColmapPairs(candidate))
    raise ValueError(
        f"nothing says what the images of {folder} look like: give their folder (--images), hloc's "
        "features (--features) or COLMAP's database (--database)"
    )
