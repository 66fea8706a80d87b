# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 localize``: the poses of new images in an existing model."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from epi360.cli.command import FAILURE, OUT_NAMES, POSES, SUCCESS, app, show_bars
from epi360.cli.report_option import check_report

if TYPE_CHECKING:
    from epi360.cameras import Camera
    from epi360.jobs.folder.given_cameras import GivenCameras
    from epi360.jobs.localization import LocalizationMap, LocalizationResult
    from epi360.jobs.localization.localize_files import LocalizedFiles

_TABLE, _RECORD, _TRAJECTORIES = ".csv", ".json", (".txt", ".tum")


@Parameter(name="*", group=Group("Map", sort_key=1))
@dataclass(frozen=True)
class MapFeatures:
    """What the images of the map look like."""

    images: Path | None = None
    """Folder of the map's images: they are searched for features anew. For a model that was made
    from learned features, or without its database."""
    features: Path | None = None
    """hloc's features file, which holds the map's images and the new ones."""
    database: Path | None = None
    """COLMAP database with the SIFT descriptors of the map; database.db beside the model by
    default."""


OF_MAP = MapFeatures()


@app.command(group=POSES, sort_key=5)
def localize(
    model: Annotated[Path, Parameter(name="MAP")],
    image: Annotated[Path, Parameter(name="IMAGE")],
    /,
    *others: Annotated[Path, Parameter(name="IMAGE")],
    of_map: MapFeatures = OF_MAP,
    camera: str | None = None,
    mask: Path | None = None,
    mask_nadir_deg: float = 0.0,
    max_views: int = 16,
    seed: int = 0,
    known_place: Annotated[bool, Parameter(negative=())] = False,
    keep_cameras: Annotated[bool, Parameter(negative=())] = False,
    keep: Path | None = None,
    out: Annotated[list[Path] | None, Parameter(name=OUT_NAMES, negative=())] = None,
    report: Path | None = None,
) -> int:
    """Poses of new panoramas or fisheye images in an existing map.

    The map is what epi360 map wrote, or a COLMAP model of pycolmap or hloc. Each pose comes with a
    status, a probability and its uncertainty in the unit of the map. Exit code 0 where an image has
    a pose, 1 where none has, 2 for wrong use.

    Parameters
    ----------
    model
        Output folder of epi360 map, or a COLMAP model (folder).
    image
        New images, or folders of them.
    others
        More of them.
    camera
        Calibration file of the new images. Where it holds several cameras, FILE:NAME, or the
        sub-folder of an image names its camera. Without it, images are panoramas, or of the map's
        only camera of their size.
    mask
        Mask for all new images, or a folder with one for each; white = use.
    mask_nadir_deg
        Ignore this angle around straight down in the new images.
    max_views
        Match with so many images of the map at most, those that look most like the new one first.
    seed
        Random seed; the same seed gives the same result.
    known_place
        The map has every place that the images show: poses are accepted even where most of a place
        has changed. Without it such a pose is ambiguous, because it may be that of a room that
        looks alike.
    keep_cameras
        Lenses stay as they are given, also where the points of the map agree better with another
        focal length.
    keep
        Folder that keeps the result of each image. A run that was stopped, or has new images, takes
        from there what is done and unchanged.
    out
        File to write, by its name: .csv a table, .json everything, .txt or .tum a TUM trajectory, a
        name without extension a COLMAP model with the new images in it. May be given several times.
    report
        HTML file with the map from above, the new images in it, and a table of them.
    """
    from epi360.jobs.localization import LocalizationOptions, load_map
    from epi360.jobs.localization.localize_files import localize_files

    outputs = [] if out is None else out
    _check_outputs(outputs)
    if report is not None:
        check_report(report)
    if keep is not None and (keep.is_file() or not keep.parent.is_dir()):
        raise ValueError(f"keep must be a folder, or the name of a new one, got {keep}")
    options = LocalizationOptions(max_views, mask_nadir_deg, seed, known_place, keep_cameras)
    world = load_map(
        model, images=of_map.images, features=of_map.features, database=of_map.database
    )
    files = _files_by_name([image, *others])
    given = None if camera is None else _cameras(camera, files)
    with show_bars() as progress:
        found = localize_files(
            files, world, camera=given, mask=mask, options=options, keep=keep, progress=progress
        )
    _print(found)
    if not found.results:
        raise ValueError("none of the images could be used")
    _write(outputs, found, files, world, str(model))
    if report is not None:
        from epi360.report.localize_page import write_localize_report

        name = model.resolve().name
        write_localize_report(report, name, world.model, found.results, files, found.reasons)
        print(f"wrote {report}")
    return SUCCESS if any(each.success for each in found.results.values()) else FAILURE


def _cameras(camera: str, files: Mapping[str, Path]) -> Camera | dict[str, Camera]:
    """The one camera of all images, or that of each, which is the name of its folder."""
    from epi360.jobs.folder.given_cameras import read_given_cameras

    given = read_given_cameras(camera)
    if len(given.cameras) == 1:
        return given.only()
    return {name: given.cameras[_called(given, path)] for name, path in files.items()}


def _called(given: GivenCameras, image: Path) -> str:
    """Name of the camera that is the innermost folder around an image of all that are called so."""
    path = image.absolute().as_posix()
    called = {path.rfind(f"/{camera}/"): camera for camera in given.cameras}
    innermost = max(called)
    return called[innermost] if innermost >= 0 else given.name_of(image.as_posix())


def _files_by_name(paths: Sequence[Path]) -> dict[str, Path]:
    """Files of all paths by a name that tells them apart."""
    from epi360.image_folders import IMAGE_SUFFIXES
    from epi360.jobs.folder.folder_files import files_below

    files: list[tuple[str, Path]] = []
    for path in paths:
        if path.is_dir():
            found = [each for each in files_below(path) if each[1].suffix.lower() in IMAGE_SUFFIXES]
            if not found:
                raise FileNotFoundError(f"folder {path} has no images")
            files += found
        elif not path.exists():
            raise FileNotFoundError(f"image {path} does not exist")
        else:
            files.append((path.name, path))
    counts = Counter(name for name, _ in files)
    named: dict[str, Path] = {}
    for name, path in files:
        unique = name if counts[name] == 1 else path.as_posix().lstrip("/")
        if unique in named:
            raise ValueError(f"image {path} is given twice")
        named[unique] = path
    return named


def _print(found: LocalizedFiles) -> None:
    width = max(map(len, (*found.results, *found.reasons)))
    for name, result in found.results.items():
        print(f"{name:{width}}  {_described(result)}")
    for name, reason in found.reasons.items():
        print(f"epi360: {name} was not used: {reason}", file=sys.stderr)
    if found.num_kept:
        print(f"{found.num_kept} done already")


def _described(result: LocalizationResult) -> str:
    counts = f"{result.num_inliers} inliers, {result.num_matches} matches"
    if not result.success:
        line = f"{result.status}: {result.num_matches} matches, probability "
        return "; ".join([f"{line}{result.probability:.0%}", *result.warnings])
    x, y, z = result.cam_from_world.inverse().translation
    line = (
        f"ok: at ({x:.4g}, {y:.4g}, {z:.4g}) sigma {result.position_sigma:.2g}, rotation sigma "
        f"{result.rotation_sigma_deg:.2g} deg, {counts}, near {result.map_images[0]}"
    )
    return "; ".join([line, *result.warnings])


def _is_trajectory(path: Path) -> bool:
    return path.suffix.lower() in _TRAJECTORIES


def _check_outputs(outputs: Sequence[Path]) -> None:
    """Raise before the work where something could not be written."""
    from epi360.interop.tum import names_path

    written = [*outputs, *map(names_path, filter(_is_trajectory, outputs))]
    if len(set(written)) < len(written):
        raise ValueError(
            "out must name different files, got one twice (a trajectory has a second one, "
            "NAME_names.txt)"
        )
    for path in written:
        suffix = path.suffix.lower()
        if suffix not in ("", _TABLE, _RECORD, *_TRAJECTORIES):
            raise ValueError(
                f"out must end with .csv, .json, .txt or .tum, or be a folder, got {path.name}"
            )
        if not path.parent.is_dir():
            raise ValueError(f"folder {path.parent} does not exist; create it first")
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            raise ValueError(f"{path} is there already and is not replaced; choose another name")


def _write(
    outputs: Sequence[Path],
    found: LocalizedFiles,
    files: Mapping[str, Path],
    world: LocalizationMap,
    source: str,
) -> None:
    from epi360.interop import write_colmap_model, write_tum_trajectory
    from epi360.interop.tum import names_path, write_tum_names
    from epi360.jobs.localization.outputs import model_with, record_of, table_of, trajectory_of
    from epi360.report.records import write_json
    from epi360.runs.whole_files import write_file

    results = found.results
    located = any(result.success for result in results.values())
    for path in outputs:
        suffix = path.suffix.lower()
        if suffix == _TABLE:
            write_file(path, table_of(results, found.reasons))
        elif suffix == _RECORD:
            write_json(path, record_of(results, found.reasons, source))
        elif not located:
            print(f"{path} was not written: no image has a pose")
            continue
        elif _is_trajectory(path):
            trajectory = trajectory_of(results, _times(files))
            write_tum_trajectory(path, trajectory)
            write_tum_names(names_path(path), trajectory)
            print(f"wrote {names_path(path)}")
        else:
            model, names = model_with(world.model, results)
            write_colmap_model(path, model)
            renamed = [f"{new} for {name}" for name, new in names.items() if new != name]
            if renamed:
                print(f"{path} had images of the same name: {', '.join(renamed)}")
        print(f"wrote {path}")


def _times(files: Mapping[str, Path]) -> dict[str, float]:
    """Times of images from the frames.csv beside them, if all have one, or else their numbers."""
    from epi360.jobs.frames.frame_source import read_frame_table

    numbers: dict[str, float] = {name: number for number, name in enumerate(files)}
    times: dict[str, float] = {}
    tables: dict[Path, Mapping[str, float | None]] = {}
    for name, path in files.items():
        table = path.parent / "frames.csv"
        if not table.is_file():
            return numbers
        if table not in tables:
            tables[table] = read_frame_table(table)
        time_s = tables[table].get(path.name)
        if time_s is None:
            return numbers
        times[name] = time_s
    return times
