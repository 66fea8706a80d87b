# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 convert``: matches and reconstructions from the files of one tool to another's."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from epi360.cli.command import FAILURE, FILES, SUCCESS, Flag, app
from epi360.cli.report_option import check_report

if TYPE_CHECKING:
    from epi360.interop import MatchGraph, Reconstruction
    from epi360.interop.descriptors import DescriptorsOf

FormatName = Literal[
    "colmap",
    "colmap-text",
    "opensfm",
    "opensfm-folder",
    "nerfstudio",
    "tum",
    "colmap-database",
    "hloc",
]
MATCH_FOLDER = "epi360"  # what `epi360 match` writes; it is read, not written


@Parameter(name="*", group=Group("Verdicts", sort_key=1))
@dataclass(frozen=True)
class Verdicts:
    """Whether the pairs of matches are judged, and where the verdicts are written."""

    verify: Flag = False
    """Estimate the pose of each pair of matches that has none, and judge all of them together:
    COLMAP's mapper and its triangulation use verified pairs only."""
    verify_again: Flag = False
    """The same for all pairs of matches, also for those that have a pose."""
    change_cameras: Flag = False
    """Verify by other angles of the lenses, where many pairs agree on them, and write these.
    Without it the command only says what they agree on."""
    table: Path | None = None
    """Write a row for each pair that was judged, with the columns that epi360 match gives its
    pairs.csv: verdict, reason, pose, sigmas and probability; .csv."""
    report: Path | None = None
    """Write a page that a browser opens offline: the graph of the pairs, a table that sorts and
    filters, and each pair; with --images the matches in its pictures, too; .html."""

    @property
    def are_wanted(self) -> bool:
        """Whether pairs are judged."""
        return self.verify or self.verify_again

    @property
    def files(self) -> list[Path]:
        """What is written of them."""
        return [path for path in (self.table, self.report) if path is not None]


NO_VERDICTS = Verdicts()


@app.command(group=FILES, sort_key=3)
def convert(
    source: Path,
    target: Path,
    /,
    *,
    images: str | None = None,
    camera: str | None = None,
    output_format: Annotated[FormatName | None, Parameter(name="--format")] = None,
    features: Path | None = None,
    pairs: Path | None = None,
    verdicts: Verdicts = NO_VERDICTS,
    no_descriptors: Flag = False,
    fps: float | None = None,
) -> int:
    """Convert a reconstruction or a match database to the format of another tool.

    Reconstructions: COLMAP model (folder), OpenSfM project (folder) or its reconstruction.json
    alone, nerfstudio transforms.json, TUM trajectory (.txt or .tum). Matches: COLMAP database
    (.db), hloc (.h5) and, to read, what epi360 match wrote. The output folder of epi360 map is the
    one or the other, as the target needs. Nothing that is there is replaced. Exit code 0 when the
    target is written, 1 if it is and pairs were judged of which none has a pose, 2 for wrong use.

    Parameters
    ----------
    source
        What is converted; its format is found from its content.
    target
        What is written; its name says the format: without extension it is a COLMAP model, .db is a
        COLMAP database, .h5 hloc matches, .txt and .tum a TUM trajectory; transforms.json is for
        nerfstudio, reconstruction.json for OpenSfM.
    images
        Folder of the images. Beside transforms.json it is "images" by default: names of images do
        not have it, the paths of nerfstudio do. An OpenSfM project gets links to its pictures. With
        --verify their pictures tell rooms apart that look alike.
    camera
        Calibration file for images whose camera the source does not know (TUM, hloc), or, with
        --verify, in place of a database's own; FILE:NAME where it holds several.
    output_format
        Format of the target where its name does not say it: opensfm-folder for an OpenSfM project
        with observations, colmap-text for a model in text files.
    features
        hloc's file of key points, beside the one of the matches; read or written.
    pairs
        hloc's file of the pairs that were matched, beside the others; read or written. Without it
        the names of the matches must say which images they are of: hloc writes "-" for "/".
    no_descriptors
        Leave the descriptors out: a seventh of the size or less, but new images cannot be matched
        with these.
    fps
        Frames a second: times for a TUM trajectory of images without, in the order of their names.
    """
    from epi360.cli.convert_matches import (
        check_nothing_verified,
        judged_matches,
        tell_of_matches,
        write_verdicts,
    )
    from epi360.interop.convert import files_written, write_matches, write_reconstruction
    from epi360.interop.formats import format_of_name
    from epi360.interop.reconstruction import Reconstruction
    from epi360.runs.input_files import as_file

    target_name = output_format or format_of_name(target)
    folder = images if images is not None and target_name != "opensfm-folder" else "images"
    with as_file(source) as file:  # a pipe gives its content once: to find the format, or to read
        source_name = _format_of_source(file, target_name)
        _check_kinds(source, source_name, target, target_name)
        verify = verdicts.are_wanted
        named = None if verify else images  # pictures to compare, not a part of the target
        _check_options((source_name, target_name), named, camera, features, pairs, verify=verify)
        if fps is not None and target_name != "tum":
            raise ValueError("--fps is for a TUM trajectory, whose rows have times")
        _check_match_options(
            target_name,
            verify=verify,
            change_cameras=verdicts.change_cameras,
            no_descriptors=no_descriptors,
        )
        _check_verdicts(verdicts, source_name, images)
        outputs = [*files_written(target, target_name, features, pairs), *verdicts.files]
        _check_free(outputs, target_name)
        keeps_descriptors = not no_descriptors
        content = _read(
            file,
            source_name,
            target_name,
            folder,
            camera,
            features,
            pairs,
            keeps_descriptors,
            for_poses=verify,
        )
    if not content.images:
        raise ValueError(f"{source} holds no images: there is nothing to convert")
    if isinstance(content, Reconstruction):
        if target_name == "nerfstudio":
            images = _images_beside(target, images)
        write_reconstruction(target, target_name, content, images=images, fps=fps)
        print(_summary(target, target_name, content))
        return SUCCESS
    changes = (camera is not None and source_name == "colmap-database", verdicts.change_cameras)
    if any(changes) and not verdicts.verify_again:
        check_nothing_verified(content, "--camera" if changes[0] else "--change-cameras")
    graph, verified = judged_matches(
        content,
        target_name,
        images=images,
        verify=verify,
        again=verdicts.verify_again,
        change_cameras=verdicts.change_cameras,
    )
    descriptors = _descriptors(source, source_name, keeps_descriptors)
    write_matches(
        target, target_name, graph, features=features, pairs=pairs, descriptors=descriptors
    )
    print(_summary(target, target_name, graph))
    tell_of_matches(content, graph, verified, (source_name, target_name), images)
    if verified is not None:
        write_verdicts(verified, verdicts.table, verdicts.report, images, source)
        if verified.verdicts and not any(verdict.accepted for verdict in verified.verdicts):
            return FAILURE
    return SUCCESS


def _images_beside(target: Path, images: str | None) -> str | None:
    """Folder of the images as seen from transforms.json; it may be given as seen from here."""
    if images is None or (target.parent / images).is_dir():
        return images
    if Path(images).is_dir():
        from epi360.interop.nerfstudio import seen_from

        return seen_from(target.parent, images)
    looked_for = target.parent / images
    warnings.warn(
        f"nerfstudio will look for images in {looked_for}, which is no folder", stacklevel=2
    )
    return images


def _check_match_options(
    target_name: str, *, verify: bool, change_cameras: bool, no_descriptors: bool
) -> None:
    from epi360.interop.formats import FORMATS

    if FORMATS[target_name].kind == "matches":
        if change_cameras and target_name == "hloc":
            raise ValueError(
                "--change-cameras is for a COLMAP database; hloc's files keep no cameras"
            )
        return
    if verify:
        raise ValueError(
            "--verify and --verify-again are for matches; the poses of a reconstruction are not "
            "judged"
        )
    if no_descriptors:
        raise ValueError("--no-descriptors is for matches; a reconstruction has none")


def _check_verdicts(verdicts: Verdicts, source_name: str, images: str | None) -> None:
    """Raise where pairs cannot be judged, or the verdicts not be written."""
    from epi360.report.files import check_writable

    if not verdicts.are_wanted:
        if verdicts.files:
            raise ValueError("--table and --report are for --verify, which judges the pairs")
        if verdicts.change_cameras:
            raise ValueError("--change-cameras is for --verify, which judges the pairs")
        return
    if verdicts.table is not None:
        if verdicts.table.suffix.lower() != ".csv":
            raise ValueError(f"--table must end in .csv, got {str(verdicts.table)!r}")
        check_writable(verdicts.table, name="--table")
    if verdicts.report is not None:
        check_report(verdicts.report)
    if images is not None and not Path(images).is_dir():
        raise ValueError(f"--images must be the folder of the pictures; {images} is none")
    if verdicts.verify_again and source_name == MATCH_FOLDER:
        raise ValueError(
            "--verify-again is for the matches of others; epi360 match has judged its own, with "
            "their pictures"
        )


def _descriptors(source: Path, name: str, keeps: bool) -> DescriptorsOf | None:
    """Where the descriptors come from, if not from the images of the graph."""
    from epi360.jobs.matching.match_result import descriptors_of

    return descriptors_of(source) if name == MATCH_FOLDER and keeps else None


def _read(
    source: Path,
    name: str,
    target_name: str,
    images: str,
    camera: str | None,
    features: Path | None,
    pairs: Path | None,
    keeps_descriptors: bool,
    *,
    for_poses: bool,
) -> MatchGraph | Reconstruction:
    from epi360.interop.formats import FORMATS

    wanted = FORMATS[target_name]
    if wanted.kind == "matches":
        with_descriptors = keeps_descriptors and "descriptors" in wanted.keeps
        return _read_matches(
            source, name, camera, features, pairs, with_descriptors, for_poses=for_poses
        )
    return _read_reconstruction(source, name, images, camera)


def _format_of_source(source: Path, target_name: str) -> str:
    """Format of the source; of what `epi360 map` wrote, what the target needs: model or matches."""
    from epi360.interop.formats import (
        FORMATS,
        colmap_model_folder,
        format_of_file,
        holds_colmap_model,
        holds_opensfm_project,
    )
    from epi360.jobs.records.match_store import MARKER

    was_matched = (source / MARKER).is_file()
    holds_project = holds_opensfm_project(source) and not was_matched
    if not source.is_dir() or holds_colmap_model(source) or holds_project:
        return format_of_file(source)
    needs_poses = FORMATS[target_name].kind == "reconstruction"
    return "colmap" if needs_poses and colmap_model_folder(source) else MATCH_FOLDER


def _check_kinds(source: Path, source_name: str, target: Path, target_name: str) -> None:
    from epi360.interop.formats import FIRST_MODEL, FORMATS

    kind = "matches" if source_name == MATCH_FOLDER else FORMATS[source_name].kind
    wanted = FORMATS[target_name]
    if source_name == target_name == "hloc":
        raise ValueError(f"{source} and {target} are both hloc's: there is nothing to convert")
    if kind == wanted.kind:
        return
    if source_name == MATCH_FOLDER:
        raise ValueError(
            f"folder {source} holds no COLMAP model (images.bin or images.txt), nor {FIRST_MODEL} "
            f"with one, so no poses for {target}; from what epi360 match wrote, make a model first "
            "with epi360 map"
        )
    if kind == "matches":
        raise ValueError(
            f"{source} holds matches, {target} ({wanted.title}) needs the poses of all images in "
            "one world; make a reconstruction first, with epi360 map or COLMAP's mapper"
        )
    raise ValueError(
        f"{source} holds a reconstruction, {target} ({wanted.title}) needs key points and matches; "
        "make them from the images with epi360 match"
    )


def _check_options(
    names: tuple[str, str],
    images: str | None,
    camera: str | None,
    features: Path | None,
    pairs: Path | None,
    *,
    verify: bool,
) -> None:
    """Raise where an option is missing or says nothing about these formats."""
    if images is not None and "nerfstudio" not in names and names[1] != "opensfm-folder":
        raise ValueError(
            "--images is for nerfstudio's transforms.json, a new OpenSfM project and --verify; the "
            "others have no folder"
        )
    if features is not None and "hloc" not in names:
        raise ValueError("--features is for hloc, which keeps key points in a file of their own")
    if pairs is not None and "hloc" not in names:
        raise ValueError("--pairs is for hloc, which puts '-' for '/' into the names of pairs")
    if features is None and "hloc" in names:
        raise ValueError("hloc keeps key points in a file of their own; name it with --features")
    keeps_cameras = names[0] == MATCH_FOLDER or (names[0] == "colmap-database" and not verify)
    if camera is not None and keeps_cameras:
        raise ValueError(
            "--camera is for images without one, and for --verify of a database; these have theirs"
        )


def _read_matches(
    source: Path,
    name: str,
    camera: str | None,
    features: Path | None,
    pairs: Path | None,
    with_descriptors: bool,
    *,
    for_poses: bool,
) -> MatchGraph:
    from epi360.interop.convert import read_matches
    from epi360.jobs.folder.given_cameras import read_given_cameras
    from epi360.jobs.matching.match_folder import load_matches

    if name == MATCH_FOLDER:
        return load_matches(source)
    return read_matches(
        source,
        name,
        features=features,
        pairs=pairs,
        cameras=None if camera is None else read_given_cameras(camera).cameras,
        with_descriptors=with_descriptors,
        for_poses=for_poses,
    )


def _read_reconstruction(
    source: Path, name: str, images: str, camera: str | None
) -> Reconstruction:
    from epi360.interop.convert import read_reconstruction, with_camera
    from epi360.jobs.folder.given_cameras import read_given_cameras

    given = None if camera is None else read_given_cameras(camera)
    reconstruction = read_reconstruction(source, name, images=images)
    if given is None:
        return reconstruction
    return with_camera(reconstruction, next(iter(given.cameras)), given.only())


def _check_free(outputs: list[Path], name: str) -> None:
    """Raise where something is there already; only a folder that is to be filled may be, empty."""
    from epi360.interop.convert import FOLDERS

    if len(set(outputs)) < len(outputs):
        raise ValueError(f"the outputs must be different files, got {outputs[0]} twice")
    for path in outputs:
        if not path.parent.is_dir():
            raise ValueError(f"folder {path.parent} does not exist; create it first")
        is_folder = name in FOLDERS and path.is_dir()
        if is_folder and not any(path.iterdir()):
            continue
        if path.exists() or path.is_symlink():
            raise ValueError(f"{path} is there already and is not replaced; choose another name")


def _summary(target: Path, name: str, content: Reconstruction | MatchGraph) -> str:
    from epi360.interop.convert import lost
    from epi360.interop.formats import FORMATS
    from epi360.interop.reconstruction import Reconstruction

    counts = {"image": len(content.images)}
    if isinstance(content, Reconstruction):
        counts |= {"point": len(content.points), "camera": len(content.cameras)}
    else:
        counts |= {"pair": len(content.pairs), "camera": len(content.cameras)}
    left_out = lost(content, name)
    words = [
        f"{count} {word}{'' if count == 1 else 's'}"
        for word, count in counts.items()
        if count and f"{word}s" not in left_out
    ]
    line = f"wrote {target} ({FORMATS[name].title}): {', '.join(words)}"
    return line + (f"; not kept: {', '.join(left_out)}" if left_out else "")
