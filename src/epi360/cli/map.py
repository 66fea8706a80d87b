# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 map``: a folder of images to a COLMAP model; ``epi360 cubemap``: a model to pinholes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from epi360.cli.command import (
    FAILURE,
    FILES,
    OUTPUT_NAMES,
    POSES,
    SUCCESS,
    Flag,
    app,
    show_bars,
)
from epi360.cli.match import (
    DEFAULT_WORK,
    NO_INPUT,
    MatchInput,
    MatchWork,
    default_output,
    images_of,
    match_options,
    write_report,
)
from epi360.cli.report_option import check_report

if TYPE_CHECKING:
    from epi360.interop import Reconstruction
    from epi360.jobs.cubes.cube_faces import CubemapOptions
    from epi360.jobs.folder.image_set import ImageSet
    from epi360.jobs.mapping.map_attempts import Attempt
    from epi360.jobs.mapping.map_folder import MapOptions, MapRun
    from epi360.report.folder_page import MapShown

Face = Literal["front", "right", "back", "left", "up", "down"]
ALL_FACES: tuple[Face, ...] = ("front", "right", "back", "left", "up", "down")
NAMED = 20  # images that a message lists one by one


@Parameter(name="*", group=Group("Mapping", sort_key=3))
@dataclass(frozen=True)
class Mapping:
    """How COLMAP maps."""

    mapper: Literal["incremental", "global"] = "incremental"
    """COLMAP's mapper that is tried first: one image after the other, or all at once."""
    no_track: Flag = False
    """Do not start a sequence (a video, or numbered images that can be tracked) from the poses of
    epi360 track."""
    refine_cameras: Flag = False
    """Refine focal length and distortion of fisheye and pinhole cameras."""
    mapper_threads: int | None = None
    """One per core by default; with 1, the same images give the same model to the last digit."""
    no_descriptors: Flag = False
    """Leave the descriptors out of database.db, most of its size (1 MB of 8,000 key points): COLMAP
    cannot match new images with the map then. epi360 localize does not need them there."""


@Parameter(name="*", group=Group("Cube faces", sort_key=4))
@dataclass(frozen=True)
class CubeFaces:
    """How panoramas and fisheye images are cut into faces."""

    face_size: int | Literal["native"] | None = None
    """Pixels; by default as many as the image has in the angle of a face, for 90 degrees of a
    panorama a quarter of its width. native keeps the resolution in the middle of a face, where the
    default loses 21 %: 0.318 of the width."""
    fov_deg: float = 90.0
    """Field of view of a face; more than 90 makes neighbours overlap."""
    faces: Annotated[tuple[Face, ...], Parameter(consume_multiple=True, negative=())] = ALL_FACES
    """Only these, as in --faces front right back left; an operator is in down."""
    image_format: Literal["jpg", "png"] = "jpg"
    """File format of the faces."""
    jpeg_quality: int = 95
    """Quality of JPEG faces, 1 to 100."""
    flat: Flag = False
    """Names of faces without sub-folders, inner dots and spaces, for programs that drop them."""
    alpha: Flag = False
    """Masks also as the alpha channel of the faces; with --image-format png."""


MAPPING, CUBE_FACES = Mapping(), CubeFaces()
OUTPUT = Parameter(group=Group("Output", sort_key=5))


@app.command(name="map", group=POSES, sort_key=3)
def map_folder(
    folder: Path,
    /,
    *,
    given: MatchInput = NO_INPUT,
    work: MatchWork = DEFAULT_WORK,
    mapping: Mapping = MAPPING,
    cube_faces: CubeFaces = CUBE_FACES,
    output: Annotated[Path | None, OUTPUT, Parameter(name=OUTPUT_NAMES)] = None,
    cubemap: Annotated[Flag, OUTPUT] = False,
    restart: Annotated[Flag, OUTPUT] = False,
    report: Annotated[Path | None, OUTPUT] = None,
) -> int:
    """Map a video or a folder of panoramas or fisheye images: COLMAP model, transforms.json.

    Matches pairs of images, verifies them and gives them to COLMAP's mapper. A sequence starts from
    the poses of epi360 track. If few are placed, other ways are tried, and the output says so. A
    run that was stopped goes on with the pairs that are left; while it chose frames of a video,
    tracked or mapped, it begins that again. Exit code 0 with a model, 1 when fewer than two images
    register, 2 for wrong use.

    Parameters
    ----------
    folder
        Panoramas, or images of the given camera; sub-folders too. Or a video, whose frames are
        chosen as epi360 frames does and written into OUTPUT/frames.
    output
        Folder for the results. Default: NAME-epi360, as of epi360 match: what was matched there is
        used.
    cubemap
        Also cut the images into cube faces, for tools that know pinhole cameras only.
    restart
        Throw away the pairs in the output that were made with other options, and a video's frames.
        Needed, too, where the output holds the result of other images, which is replaced.
    report
        Write a page that a browser opens offline: the map in 3D, the graph of the pairs, a table
        that sorts and filters, and each pair with its matches; .html.

    Returns
    -------
    code
        Exit code.
    """
    from epi360.jobs.cubes.cubemap import check_cubemap_folder
    from epi360.jobs.folder.image_set import find_images
    from epi360.jobs.mapping.map_folder import map_images
    from epi360.report.pairs_table import write_pairs_table

    if cube_faces != CUBE_FACES and not cubemap:
        raise ValueError("--face-size, --fov-deg, --faces and the like need --cubemap")
    if report is not None:
        check_report(report)
    output = default_output(folder) if output is None else output
    options = _map_options(given, work, mapping)
    cutting = _cubemap_options(cube_faces)
    if cubemap:
        check_cubemap_folder(
            output / "cubemap",
            cutting,
            given.mask_nadir_deg,
            remedy=f"delete the folder {output / 'cubemap'}, and it is cut anew; the map is kept",
        )
    source, folder = folder, images_of(folder, output, given, restart=restart)
    images = find_images(folder, camera=given.camera, mask=given.mask)
    with show_bars() as progress:
        run = map_images(
            images,
            output,
            options,
            video=None if source == folder else source,
            mask=given.mask,
            restart=restart,
            progress=progress,
        )
    write_pairs_table(run.matched)
    print(_describe(run, images), flush=True)
    if report is not None:
        write_report(report, source, run.matched, images, _shown_map(run))
    old_cube = output / "cubemap"
    if not run.models:
        if old_cube.exists():
            print(f"{old_cube} is of an earlier map, which is gone")
        return FAILURE
    print(f"wrote {run.models[0].folder}")
    if cubemap:
        masks = {image.name: image.mask for image in images.images}
        model = run.models[0].reconstruction
        _cut(folder, model, old_cube, cutting, masks, given.mask_nadir_deg)
    elif old_cube.exists() and not run.was_mapped:
        print(f"{old_cube} is of an earlier map: --cubemap cuts it again")
    return SUCCESS


@app.command(group=FILES, sort_key=2)
def cubemap(
    model: Path,
    images: Path,
    output: Path,
    /,
    *,
    mask: Path | None = None,
    mask_nadir_deg: float = 0.0,
    keep_world: Flag = False,
    cube_faces: CubeFaces = CUBE_FACES,
) -> int:
    """Cut the panoramas and fisheye images of a model into cube faces, for pinhole-only tools.

    Writes images, masks, a COLMAP model and transforms.json with the poses of the faces. A run that
    was stopped goes on where it was.

    Parameters
    ----------
    model
        COLMAP model (folder), output folder of epi360 map, nerfstudio's transforms.json, OpenSfM's
        project (folder) or its reconstruction.json.
    images
        Folder that the names of the images start from.
    output
        New folder.
    mask
        Mask for all images, white = use; or a folder with a mask for each image.
    mask_nadir_deg
        Mask this angle around straight down.
    keep_world
        Leave the axes of the model as they are. Without it the world is turned upright, as the
        cameras stand in it.

    Returns
    -------
    code
        Exit code.
    """
    from epi360.interop.convert import read_reconstruction
    from epi360.interop.formats import FORMATS, format_of_file
    from epi360.interop.nerfstudio import seen_from
    from epi360.jobs.folder.masks import MaskSource
    from epi360.runs.input_files import as_file

    options = _cubemap_options(cube_faces)
    with as_file(model) as file:  # a pipe gives its content once
        name = format_of_file(file)
        if FORMATS[name].kind != "reconstruction":
            raise ValueError(
                f"{model} holds matches; a cubemap needs poses, as epi360 map finds them"
            )
        reconstruction = read_reconstruction(file, name)
        seen = f"{seen_from(model.parent, images)}/"
        if all(image.name.startswith(seen) for image in reconstruction.images):
            # transforms.json has paths from where it is.
            reconstruction = read_reconstruction(file, name, images=seen)
    source = MaskSource(mask)
    masks = {image.name: source.mask_of(image.name) for image in reconstruction.images}
    source.check_used(list(masks.values()))
    _cut(images, reconstruction, output, options, masks, mask_nadir_deg, keep_world=keep_world)
    return SUCCESS


def _shown_map(run: MapRun) -> MapShown:
    from epi360.report.folder_page import MapShown

    models = [model.reconstruction for model in run.models]
    return MapShown(models, run.unregistered, run.branches, was_tried=bool(run.attempts))


def _map_options(given: MatchInput, work: MatchWork, mapping: Mapping) -> MapOptions:
    from epi360.jobs.mapping.map_folder import MapOptions

    match = match_options(given, work)
    return MapOptions(
        match,
        mapping.mapper,
        mapping.refine_cameras,
        mapping.mapper_threads,
        not mapping.no_track,
        not mapping.no_descriptors,
    )


def _cubemap_options(cube_faces: CubeFaces) -> CubemapOptions:
    from epi360.jobs.cubes.cube_faces import CubemapOptions

    return CubemapOptions(
        face_size=cube_faces.face_size,
        fov_deg=cube_faces.fov_deg,
        faces=cube_faces.faces,
        image_format=cube_faces.image_format,
        jpeg_quality=cube_faces.jpeg_quality,
        flat=cube_faces.flat,
        alpha=cube_faces.alpha,
    )


def _describe(run: MapRun, images: ImageSet) -> str:
    """Lines for people: what registered, what did not and why, and how long it took."""
    from epi360.report.match_table import (
        branch_sentence,
        describe_agreed,
        describe_level,
        describe_noise,
        describe_others,
        describe_rig,
        no_translation_sentence,
    )

    num_registered = len(run.models[0].reconstruction.images) if run.models else 0
    lines = [f"registered   {num_registered} of {run.num_images} images"]
    if not (run.models or run.attempts):
        lines.append(f"no map       {no_translation_sentence(run.matched)}")
    if run.models:
        model = run.models[0]
        lines += [
            f"points       {len(model.reconstruction.points)}, seen in "
            f"{model.mean_track_length:.1f} images on average",
            f"error        {model.mean_error_px:.2f} px mean reprojection error",
        ]
    if run.track is not None:
        lines += _describe_track(run.track, run.num_images)
    if len(run.attempts) > 1:
        lines += [_describe_attempt(attempt, run.num_images) for attempt in run.attempts]
    if len(run.models) > 1:
        sizes = ", ".join(str(len(model.reconstruction.images)) for model in run.models)
        lines += [
            f"models       {len(run.models)} that do not connect: {sizes} images; all but COLMAP's "
            "own files are of the first",
            f"             another one: epi360 cubemap {run.models[1].folder} {images.folder} NEW, "
            f"epi360 convert {run.models[1].folder} NEW.json",
        ]
    lines += [f"one pair     {branch_sentence(branch)}" for branch in run.branches[:NAMED]]
    times = ", ".join(f"{name} {value:.1f} s" for name, value in run.seconds.items())
    lines.append(f"time         {times}" + (" (by an earlier run)" if run.was_mapped else ""))
    reasons = [*run.unregistered.items(), *images.skipped]
    lines += [f"not used     {name}: {reason}" for name, reason in reasons[:NAMED]]
    if len(reasons) > NAMED:
        lines.append(f"not used     and {len(reasons) - NAMED} more")
    for describe in (
        describe_rig,
        describe_noise,
        describe_agreed,
        describe_level,
        describe_others,
    ):
        lines += describe(run.matched)
    lines += run.remarks
    return "\n".join(lines)


def _describe_track(track: dict[str, Any], num_images: int) -> list[str]:
    """Line about the odometry that came first."""
    if track["reason"]:
        return [f"no track     {track['reason']}; mapped without"]
    frames = f"{track['num_tracked']} of {track['num_frames']} frames"
    return [
        f"track        {frames}; the map starts from {track['num_images']} of {num_images} poses"
    ]


def _describe_attempt(attempt: Attempt, num_images: int) -> str:
    """Line about one way of mapping."""
    found = f"{attempt.num_registered} of {num_images} images"
    if attempt.num_unconfirmed:
        found += f", {attempt.num_unconfirmed} more at places that nothing confirms"
    return f"tried        {attempt.how}: {found}" + ("; kept" if attempt.kept else "")


def _cut(
    images: Path,
    reconstruction: Reconstruction,
    output: Path,
    options: CubemapOptions,
    masks: dict[str, Path | None],
    mask_nadir_deg: float,
    *,
    keep_world: bool = False,
) -> None:
    """Cut the images of a model into cube faces, and say so."""
    from epi360.jobs.cubes.cubemap import export_cubemap

    with show_bars() as progress:
        cube = export_cubemap(
            images,
            reconstruction,
            output,
            options,
            masks=masks,
            mask_nadir_deg=mask_nadir_deg,
            keep_world=keep_world,
            progress=progress,
        )
    if cube.turned_deg:
        print(f"turned the world upright, by {cube.turned_deg:.3g} degrees (--keep-world: not)")
    kept = f", {cube.num_kept} images were there" if cube.num_kept else ""
    print(f"wrote {output} ({len(cube.reconstruction.images)} cube faces{kept})")
