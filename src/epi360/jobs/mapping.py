# SPDX-License-Identifier: BSD-3-Clause
"""A folder of images to a COLMAP model: our verified pairs, COLMAP's mapper."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from epi360.cameras import KannalaBrandt
from epi360.extras import extra_library
from epi360.files import write_file
from epi360.interop.colmap_database import CONFIG_OF_STATUS, write_colmap_database
from epi360.interop.colmap_model import read_colmap_model
from epi360.interop.match_graph import MatchGraph
from epi360.interop.nerfstudio import write_nerfstudio
from epi360.interop.reconstruction import Reconstruction
from epi360.jobs.colmap_mapper import STAGE, Mapper, MapperOptions, mapper_settings, run_mapper
from epi360.jobs.image_set import ImageSet
from epi360.jobs.matching import MatchOptions, MatchRun, load_matches, match_images
from epi360.progress import Progress, no_progress

DATABASE, MODELS, RECORD, TRANSFORMS = "database.db", "sparse", "mapping.json", "transforms.json"


@dataclass(frozen=True)
class MapOptions:
    """How a folder is mapped.

    Attributes
    ----------
    match : MatchOptions
        How pairs are found; its seed is also the mapper's.
    mapper : "incremental" or "global"
        COLMAP's mapper: one image after the other, or all at once.
    refine_cameras : bool
        Refine the focal length and distortion of fisheye and pinhole cameras; panoramas have none.
    mapper_threads : int
        More than one is faster where there are many images, but the last digits of the result
        change from run to run.

    Raises
    ------
    ValueError
        If the mapper is unknown or there is less than one thread.
    """

    match: MatchOptions = field(default_factory=MatchOptions)
    mapper: Mapper = "incremental"
    refine_cameras: bool = False
    mapper_threads: int = 1

    def __post_init__(self) -> None:
        """Check the values."""
        if self.mapper not in ("incremental", "global"):
            raise ValueError(f"mapper must be incremental or global, got {self.mapper!r}")
        if self.mapper_threads < 1:
            raise ValueError(f"mapper_threads must be 1 or more, got {self.mapper_threads}")


@dataclass(frozen=True, eq=False)
class MappedModel:
    """One connected model.

    Attributes
    ----------
    folder : Path
        COLMAP's files.
    reconstruction : Reconstruction
        Its content.
    mean_error_px : float
        Mean reprojection error over the observations, pixels of the images.
    """

    folder: Path
    reconstruction: Reconstruction
    mean_error_px: float

    @property
    def mean_track_length(self) -> float:
        """Observations a point; NaN without points."""
        seen = self.reconstruction.observations
        return np.nan if seen is None else len(seen.points) / len(self.reconstruction.points)


@dataclass(frozen=True, eq=False)
class MapRun:
    """What `map_images` found.

    Attributes
    ----------
    matched : MatchRun
        The pairs and their verdicts.
    models : tuple of MappedModel
        The one with the most images first; each has a world and a scale of its own.
    unregistered : mapping of str to str
        Image without a pose in the first model, and the reason.
    num_images : int
        Images of the folder.
    seconds : mapping of str to float
        Wall time of the "matching" of this run and of the "mapping", which may be an earlier one's.
    remarks : tuple of str
        Sentences about what could not be written.
    """

    matched: MatchRun
    models: tuple[MappedModel, ...]
    unregistered: Mapping[str, str]
    num_images: int
    seconds: Mapping[str, float]
    remarks: tuple[str, ...]


def map_images(
    images: ImageSet,
    output: str | os.PathLike[str],
    options: MapOptions | None = None,
    *,
    restart: bool = False,
    progress: Progress = no_progress,
) -> MapRun:
    """Match the images of a folder and map them with COLMAP.

    Parameters
    ----------
    images : ImageSet
        What `find_images` gives.
    output : path
        Gets what `match_images` writes, ``database.db``, the models ``sparse/0``, ``sparse/1``, ...
        and ``transforms.json`` of the first, its paths relative to the images.
    options : MapOptions, optional
    restart : bool
        Throw away pairs in the output that were matched with other options, instead of refusing.
    progress : Progress
        Told about features, pairs and mapped images.

    Returns
    -------
    MapRun

    Raises
    ------
    ValueError
        If ``output`` has a COLMAP database or model that this function did not make, or as
        `match_images`.
    OSError
        If it cannot be written.
    ImportError
        If pycolmap is missing.

    Notes
    -----
    Cameras and rigs stay as they are given. Pairs go in with their inliers and poses where the
    verdict is ok, planar_ambiguous or pure_rotation: inliers of all three are right matches. What
    was matched is not matched again, and what was mapped from the same matches with the same
    options is not mapped again.
    """
    options = options or MapOptions()
    extra_library("pycolmap", extra="colmap", purpose="maps")  # before hours of matching
    output = Path(output)
    record = _read_record(output)
    start = time.perf_counter()
    matched = match_images(images, output, options.match, restart=restart, progress=progress)
    graph = load_matches(output)
    matching_s = time.perf_counter() - start
    mapper = MapperOptions(
        options.mapper,
        options.refine_cameras,
        options.mapper_threads,
        options.match.seed,
    )
    fingerprint = _fingerprint(graph, mapper)
    if record.get("fingerprint") == fingerprint and _has_models(output, record):
        progress(STAGE, len(graph.images), len(graph.images))
    else:
        record = _map(graph, images.folder, output, mapper, fingerprint, progress)
    models = _read_models(output, record, graph)
    remarks = _write_transforms(images.folder, output, models)
    return MapRun(
        matched,
        models,
        _reasons(images, graph, models, matched.unreadable),
        len(images.images),
        {"matching": matching_s, "mapping": record["seconds"]},
        remarks,
    )


def _read_record(output: Path) -> dict[str, Any]:
    """Record of an earlier run; ValueError where its files are somebody else's."""
    path = output / RECORD
    if path.exists():
        try:
            record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            raise ValueError(f"{path} is damaged; delete it with {DATABASE} and {MODELS}") from None
        return record
    for name in (DATABASE, MODELS):
        if (output / name).exists():
            raise ValueError(
                f"{output / name} was made by something else and would be replaced; "
                "name another output folder"
            )
    return {}


def _has_models(output: Path, record: Mapping[str, Any]) -> bool:
    """Whether nobody has deleted a model since."""
    numbers = range(len(record["mean_error_px"]))
    return all((output / MODELS / str(number)).is_dir() for number in numbers)


def _fingerprint(graph: MatchGraph, options: MapperOptions) -> str:
    """Hash of everything that the models depend on."""
    digest = hashlib.sha256(f"{mapper_settings(options)} {graph.cameras}".encode())
    for camera, pose in graph.cam_from_rig.items():
        digest.update(camera.encode() + pose.matrix().tobytes())
    for image in graph.images.values():
        digest.update(f"{image.name} {image.camera} {image.frame}".encode())
        digest.update(np.ascontiguousarray(image.keypoints).tobytes())
    for pair in graph.pairs:
        digest.update(f"{pair.image1} {pair.image2}".encode())
        if pair.geometry is not None:
            digest.update(pair.geometry.status.encode() + pair.geometry.inliers.tobytes())
            digest.update(pair.geometry.cam2_from_cam1.matrix().tobytes())
    return digest.hexdigest()


def _map(
    graph: MatchGraph,
    folder: Path,
    output: Path,
    options: MapperOptions,
    fingerprint: str,
    progress: Progress,
) -> dict[str, Any]:
    """Write database and models, and the record that says from what."""
    start = time.perf_counter()
    write_file(output / RECORD, b"{}")  # from here on database and models are ours
    for name in (DATABASE, TRANSFORMS):
        (output / name).unlink(missing_ok=True)
    write_colmap_database(output / DATABASE, graph)
    found = run_mapper(
        output / DATABASE, folder, options, num_images=len(graph.images), progress=progress
    )
    temporary = output / f".{MODELS}.{os.getpid()}.tmp"
    try:
        for number, model in enumerate(found):
            (temporary / str(number)).mkdir(parents=True)
            model.write_binary(temporary / str(number))
        shutil.rmtree(output / MODELS, ignore_errors=True)
        if found:
            os.replace(temporary, output / MODELS)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    record = {
        "fingerprint": fingerprint,
        "seconds": time.perf_counter() - start,
        "mean_error_px": [model.compute_mean_reprojection_error() for model in found],
    }
    write_file(output / RECORD, json.dumps(record, indent=1).encode())
    return record


def _read_models(
    output: Path, record: Mapping[str, Any], graph: MatchGraph
) -> tuple[MappedModel, ...]:
    models = []
    for number, error_px in enumerate(record["mean_error_px"]):
        folder = output / MODELS / str(number)
        model = _with_given_cameras(read_colmap_model(folder), graph)
        models.append(MappedModel(folder, model, error_px))
    return tuple(models)


def _with_given_cameras(model: Reconstruction, graph: MatchGraph) -> Reconstruction:
    """Model whose cameras have their names again, and the limit of a lens that COLMAP lacks."""
    given = dict(enumerate(graph.cameras.items(), start=1))  # as the database numbers them
    cameras = {}
    for number, camera in model.cameras.items():
        name, original = given[int(number)]
        if isinstance(camera, KannalaBrandt) and isinstance(original, KannalaBrandt):
            camera = replace(camera, max_angle_deg=original.max_angle_deg)
        cameras[name] = camera
    images = tuple(
        replace(image, camera=given[int(str(image.camera))][0]) for image in model.images
    )
    return replace(model, cameras=cameras, images=images)


def _write_transforms(
    folder: Path, output: Path, models: tuple[MappedModel, ...]
) -> tuple[str, ...]:
    """Write the first model for nerfstudio; sentences about what it has no place for."""
    if not models:
        return ()
    images = Path(os.path.relpath(folder.resolve(), output.resolve())).as_posix()
    try:
        write_nerfstudio(output / TRANSFORMS, models[0].reconstruction, images=images)
    except ValueError as error:
        return (f"{TRANSFORMS} was not written: {error}",)
    return ()


def _reasons(
    images: ImageSet,
    graph: MatchGraph,
    models: tuple[MappedModel, ...],
    unreadable: Mapping[str, str],
) -> dict[str, str]:
    """Why each image without a pose in the first model has none."""
    model_of = {
        image.name: number
        for number, model in reversed(list(enumerate(models)))
        for image in model.reconstruction.images
    }
    tried: dict[str, Counter[str]] = {image.name: Counter() for image in images.images}
    for pair in graph.pairs:
        status = "too_few_matches" if pair.geometry is None else pair.geometry.status
        for name in (pair.image1, pair.image2):
            tried.setdefault(name, Counter())[status] += 1
    reasons = {}
    for name, statuses in tried.items():
        number = model_of.get(name)
        if number == 0:
            continue
        if name in unreadable:
            reasons[name] = unreadable[name]
        elif number is not None:
            reasons[name] = f"is in {MODELS}/{number}, which does not connect to {MODELS}/0"
        elif not CONFIG_OF_STATUS.keys() & statuses:
            counts = ", ".join(f"{count} {status}" for status, count in statuses.most_common())
            reasons[name] = f"no accepted pair ({counts or 'none tried'})"
        else:
            reasons[name] = "has accepted pairs, but COLMAP's mapper could not place it"
    return reasons
