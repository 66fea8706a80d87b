# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 match``: a folder of images to verified relative poses of its pairs."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from epi360.cli.command import (
    FAILURE,
    OUTPUT_NAMES,
    POSES,
    SUCCESS,
    Flag,
    app,
    show_bars,
)
from epi360.cli.engine_options import LOCAL_ENGINE, EngineOptions
from epi360.cli.frames import folder_of
from epi360.cli.report_option import check_report

if TYPE_CHECKING:
    from epi360.jobs.folder.image_set import ImageSet
    from epi360.jobs.matching.match_folder import MatchOptions, MatchRun
    from epi360.report.folder_page import MapShown
    from epi360.runs.remote_path import AnyPath

PairsChoice = Literal["auto", "exhaustive", "sequential", "retrieval", "near"] | Path


@Parameter(name="*", group=Group("Images", sort_key=1))
@dataclass(frozen=True)
class MatchInput:
    """What is known about the images."""

    camera: str | None = None
    """Calibration file of the images (Kalibr, ROS, basalt, COLMAP, OpenSfM or own YAML);
    FILE:NAME where it holds several cameras and all images are of one. Without it, images are
    panoramas."""
    keep_cameras: Flag = False
    """Keep the angles of cameras as they are given, even where many pairs agree that they are other
    ones. epi360 map always keeps those of panoramas."""
    mask: Path | None = None
    """Mask for all images, or a folder with one for each; white = use."""
    mask_nadir_deg: float = 0.0
    """Ignore this angle around straight down: a tripod and its holder."""
    upright: float | None = None
    """The panoramas stand upright to so many degrees (one sigma; 1 is usual), or as the pitch and
    roll in their GPano metadata say. Level folders are noticed without it."""


@Parameter(name="*", group=Group("Matching", sort_key=2))
@dataclass(frozen=True)
class MatchWork:
    """How pairs are chosen and matched."""

    pairs: PairsChoice = "auto"
    """Which pairs: exhaustive, sequential (neighbours by name), retrieval (images that look alike),
    near (by GPS or --positions), several as in retrieval,sequential, or a file with two names a
    line; auto: exhaustive for up to 30 images, unless those up to 21 ahead all match well; beyond
    that retrieval, and sequential as well if the names count up."""
    overlap: int | None = None
    """Sequential: so many images that follow, and those 2, 4 and 8 times as far ahead; with 10, the
    default, image 1 is paired with 2 to 11, 21, 41 and 81."""
    neighbors: int | None = None
    """Retrieval and near: so many partners for each image, by default 20; auto takes half as many
    beside sequential."""
    positions: Path | None = None
    """Near: poses of the images (TUM trajectory, COLMAP model, transforms.json); without them the
    GPS in the images."""
    radius: float | None = None
    """Near: not farther than this, in metres or in the unit of --positions."""
    max_width: int = 2048
    """Shrink wider images to this width to find key points."""
    max_features: int = 10000
    """Keep the strongest key points of each image."""
    seed: int = 0
    """Random seed; the same seed gives the same result."""
    num_threads: Annotated[int | None, Parameter(name=("--num-threads", "--jobs"))] = None
    """Threads; one per core by default. The result does not depend on it. --jobs is the older
    name."""


_URL = re.compile(r"[a-z][a-z0-9+]+:/")  # a Path has one slash of the two
NO_INPUT, DEFAULT_WORK = MatchInput(), MatchWork()


@app.command(group=POSES, sort_key=2)
def match(
    folder: Path,
    /,
    *,
    given: MatchInput = NO_INPUT,
    work: MatchWork = DEFAULT_WORK,
    engine: EngineOptions = LOCAL_ENGINE,
    output: Annotated[
        str | None, Parameter(name=OUTPUT_NAMES, group=Group("Output", sort_key=3))
    ] = None,
    restart: Annotated[Flag, Parameter(group=Group("Output", sort_key=3))] = False,
    report: Annotated[Path | None, Parameter(group=Group("Output", sort_key=3))] = None,
) -> int:
    """Relative poses of the images of a folder, pair by pair, each with a verdict.

    The output folder gets pairs.csv, a row a pair, and what `epi360 convert` and `epi360 map` read.
    Interrupted, the command goes on from where it was, but chooses frames of a video again; new
    images are added. Exit code 0 where a pair has a pose, 1 where none has, 2 for wrong use.

    Parameters
    ----------
    folder
        Panoramas, or images of the given camera; sub-folders too. Or a video, whose frames are
        chosen as epi360 frames does and written into OUTPUT/frames.
    output
        Folder for the results; may be a URL of an object store. Default: NAME-epi360 in the current
        folder, beside the images where that is inside them.
    restart
        Throw away the pairs in the output that were made with other options, and a video's frames;
        what was made with the same ones stays.
        Needed, too, where the output holds the result of other images, which is replaced.
    report
        Write a page that a browser opens offline: the graph of the pairs, a table that sorts and
        filters, and each pair with its matches; .html.

    Returns
    -------
    code
        Exit code.
    """
    from epi360.jobs.folder.image_set import find_images
    from epi360.jobs.matching.match_folder import match_images
    from epi360.runs.remote_path import path_of

    if report is not None:
        check_report(report)
    engine.check(work.num_threads)
    options = match_options(given, work)
    target = default_output(folder) if output is None else path_of(output)
    source, folder = folder, images_of(folder, target, given, restart=restart)
    images = find_images(folder, camera=given.camera, mask=given.mask)
    begun = time.monotonic()
    with show_bars() as progress:
        run = match_images(
            images,
            target,
            options,
            restart=restart,
            progress=progress,
            engine=engine.engine,
            address=engine.address,
        )
    _report(run, images.skipped, time.monotonic() - begun)
    if report is not None:
        write_report(report, source, run, images)
    return SUCCESS if any(verdict.accepted for verdict in run.verdicts) else FAILURE


def write_report(
    path: Path,
    source: Path,
    run: MatchRun,
    images: ImageSet,
    shown_map: MapShown | None = None,
) -> None:
    """Write the page of a folder, with its map where it was mapped, and say so."""
    from epi360.report.folder_page import write_match_report

    write_match_report(path, run, images, shown_map, name=source.resolve().name)
    print(f"wrote {path}", flush=True)


def match_options(given: MatchInput, work: MatchWork) -> MatchOptions:
    """Options of `match_images` in the words of the command."""
    from epi360.jobs.matching.match_folder import MatchOptions
    from epi360.jobs.pairs.pair_selection import ways_of

    pairs: str | Path = work.pairs
    if isinstance(pairs, Path) and not pairs.exists():
        pairs = str(pairs)  # several ways with commas between them
    if not ways_of(pairs) and not isinstance(pairs, Path):
        raise FileNotFoundError(
            f"--pairs: {pairs} does not exist; give a pairs file, or auto, exhaustive, "
            "sequential, retrieval or near"
        )
    return MatchOptions(
        pairs=pairs,
        overlap=work.overlap,
        neighbors=work.neighbors,
        positions=work.positions,
        radius=work.radius,
        max_width=work.max_width,
        max_features=work.max_features,
        mask_nadir_deg=given.mask_nadir_deg,
        upright_deg=given.upright,
        keep_cameras=given.keep_cameras,
        seed=work.seed,
        num_threads=work.num_threads,
    )


def images_of(folder: Path, output: AnyPath, given: MatchInput, *, restart: bool) -> Path:
    """Return the folder of the images; the frames of a video are written into the output."""
    if _URL.match(str(folder)) and not folder.exists():
        raise ValueError(
            f"images must be in a folder of this machine, or on a disk that all machines see, got "
            f"{folder}; only --output may be a URL"
        )
    if not isinstance(output, Path):
        if folder.is_file():
            raise ValueError(
                f"the frames of {folder} need a folder, got --output {output}; choose them with "
                "epi360 frames first"
            )
        return folder
    return folder_of(
        folder,
        output,
        camera=given.camera,
        mask=given.mask,
        mask_nadir_deg=given.mask_nadir_deg,
        restart=restart,
    )


def default_output(folder: Path) -> Path:
    """NAME-epi360 in the current folder, but never among the images; NAME is that of a video."""
    if folder.is_file():
        return Path(f"{folder.stem}-epi360")
    images, here = folder.resolve(), Path.cwd()
    inside = here == images or images in here.parents
    name = f"{images.name}-epi360"
    return images.parent / name if inside else Path(name)


def _report(run: MatchRun, skipped: tuple[tuple[str, str], ...], seconds: float) -> None:
    from epi360.report.match_table import describe_match
    from epi360.report.pairs_table import write_pairs_table

    table = write_pairs_table(run)
    print(describe_match(run, skipped))
    num_new = len(run.verdicts) - run.num_found
    if num_new:
        pairs = "pair" if num_new == 1 else "pairs"
        rate = num_new / max(seconds, 1e-3)
        shown = f", {rate:.1f}/s" if rate >= 0.1 else ""
        print(f"{num_new} new {pairs} in {seconds:.1f} s with their features{shown}")
    print(f"wrote {table}", flush=True)
