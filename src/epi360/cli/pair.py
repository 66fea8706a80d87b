# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 pair``: two images to a relative pose."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cyclopts import Group, Parameter

from epi360.cli.command import FAILURE, POSES, SUCCESS, Flag, Say, app, show_progress

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from epi360.cameras import Camera
    from epi360.cameras.gpano import GPano
    from epi360.estimation.result import ImagePairResult
    from epi360.poses import Pose


@Parameter(name="*", group=Group("Images", sort_key=1))
@dataclass(frozen=True)
class PairInput:
    """What is known about the images of a pair."""

    camera: str | None = None
    """Calibration file of both images (Kalibr, ROS, basalt, COLMAP, OpenSfM or own YAML);
    FILE:NAME where it holds several cameras. Without one, an image is a full panorama, or the part
    of one that its GPano metadata describe."""
    camera1: str | None = None
    """Calibration file of the first image."""
    camera2: str | None = None
    """Calibration file of the second image."""
    mask: Path | None = None
    """Mask for both images, of their size; white = use."""
    mask1: Path | None = None
    """Mask for the first image."""
    mask2: Path | None = None
    """Mask for the second image."""


@Parameter(name="*", group=Group("Estimation", sort_key=2))
@dataclass(frozen=True)
class PairOptions:
    """How a pair is estimated."""

    mask_nadir_deg: float = 0.0
    """Ignore this angle around straight down: a tripod and its holder."""
    upright: float | None = None
    """The panoramas stand upright to so many degrees (one sigma; 1 is usual), or as the pitch and
    roll in their GPano metadata say."""
    inlier_threshold_deg: float | Literal["auto"] = "auto"
    """Largest residual of an inlier in degrees, or auto: from the noise of the matches."""
    max_width: int = 4096
    """Shrink wider images to this width to find key points."""
    seed: int = 0
    """Random seed; the same seed gives the same result."""


@Parameter(name="*", group=Group("Output", sort_key=3))
@dataclass(frozen=True)
class PairOutput:
    """Which files are written."""

    json: Path | None = None
    """Write the result with its matches for programs."""
    figure: Path | None = None
    """Draw matches, epipoles and epipolar curves; .png, .jpg, .webp, .pdf or .svg."""
    report: Path | None = None
    """Write a page that a browser opens offline: the verdict, both pictures with the matches, and
    what is behind the pose; .html."""
    save_images: Path | None = None
    """With --demo: write the two panoramas into this folder, to try the command on files."""


NO_INPUT, DEFAULT_OPTIONS, NO_OUTPUT = PairInput(), PairOptions(), PairOutput()


@dataclass(frozen=True)
class _Pair:
    """Two images as they go into the estimate, with the truth where it is known."""

    names: tuple[str, str]
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    cameras: tuple[Camera, Camera]
    masks: tuple[Path | None, Path | None] = (None, None)
    down: tuple[NDArray[np.float64] | None, NDArray[np.float64] | None] = (None, None)
    truth: Pose | None = None


@app.command(group=POSES, sort_key=1)
def pair(
    image1: Path | None = None,
    image2: Path | None = None,
    /,
    *,
    demo: Flag = False,
    given: PairInput = NO_INPUT,
    options: PairOptions = DEFAULT_OPTIONS,
    output: PairOutput = NO_OUTPUT,
) -> int:
    """Relative pose of two images, with its uncertainty and a verdict.

    Exit code 0 with a pose, 1 when the images do not determine one (the status says why), 2 for
    wrong use.

    Parameters
    ----------
    image1
        First image; a stitched panorama unless a camera is given.
    image2
        Second image.
    demo
        Run on a pair that is rendered here and print the estimate beside the truth.

    Returns
    -------
    code
        Exit code.
    """
    _check_pair_words(image1, image2, demo, given, output)
    _check_outputs(output, _files_read(image1, image2, given))
    with show_progress() as progress:
        if image1 is None or image2 is None:
            images = _demo_pair(progress)
        else:
            images = _read_pair(image1, image2, given, progress)
        result = _estimate(images, options, progress)
    from epi360.report.text import describe_pair

    print(describe_pair(result, images.truth), flush=True)  # even if a file cannot be written
    with show_progress() as progress:
        _write_outputs(images, result, output, progress)
    for path in (output.json, output.figure, output.report, output.save_images):
        if path is not None:
            print(f"wrote {path}")
    sys.stdout.flush()
    return SUCCESS if result.success else FAILURE


def _check_pair_words(
    image1: Path | None, image2: Path | None, demo: bool, given: PairInput, output: PairOutput
) -> None:
    """Raise where the words of the command do not fit together."""
    if demo and (image1 is not None or given != NO_INPUT):
        raise ValueError("--demo makes its own images; drop the image, camera and mask arguments")
    if not demo and output.save_images is not None:
        raise ValueError("--save-images needs --demo: it saves the images that the demo renders")
    if not demo and (image1 is None or image2 is None):
        raise ValueError("pair needs two images: epi360 pair A.jpg B.jpg (or try --demo)")
    if given.camera is not None and (given.camera1, given.camera2) != (None, None):
        raise ValueError("--camera is for both images; use it or --camera1 and --camera2")
    if given.mask is not None and (given.mask1, given.mask2) != (None, None):
        raise ValueError("--mask is for both images; use it or --mask1 and --mask2")


def _files_read(image1: Path | None, image2: Path | None, given: PairInput) -> dict[str, Path]:
    """List every file that the command reads, by the name a message calls it."""
    from epi360.cameras.calibration import camera_file

    files = {"the first image": image1, "the second image": image2}
    for name in ("mask", "mask1", "mask2", "camera", "camera1", "camera2"):
        source = getattr(given, name)
        files[f"--{name}"] = camera_file(source)[0] if isinstance(source, str) else source
    return {name: path for name, path in files.items() if path is not None}


def _check_outputs(output: PairOutput, files_read: dict[str, Path]) -> None:
    """Raise before the work where its results could not be written, or would destroy its input."""
    from epi360.report.files import (
        check_distinct,
        check_figure_name,
        check_report_name,
        check_writable,
    )

    written = {"--json": output.json, "--figure": output.figure, "--report": output.report}
    check_distinct({name: path for name, path in written.items() if path}, files_read)
    if output.json is not None:
        check_writable(output.json, name="--json")
    if output.figure is not None:
        check_figure_name(output.figure, name="--figure")
        check_writable(output.figure, name="--figure")
    if output.report is not None:
        check_report_name(output.report, name="--report")
        check_writable(output.report, name="--report")
    if output.save_images is not None:
        output.save_images.mkdir(exist_ok=True)


def _demo_pair(progress: Say) -> _Pair:
    from epi360_scenes.room import demo_pair

    progress("rendering two panoramas of a room")
    demo = demo_pair()
    return _Pair(
        names=("demo view 1", "demo view 2"),
        images=(demo.image1, demo.image2),
        cameras=(demo.camera, demo.camera),
        truth=demo.cam2_from_cam1,
    )


def _read_pair(image1: Path, image2: Path, given: PairInput, progress: Say) -> _Pair:
    from epi360.features.image_cameras import find_camera, gpano_of
    from epi360.features.images import read_image

    progress("reading the images")
    option1, option2 = ("--camera", "--camera") if given.camera else ("--camera1", "--camera2")
    camera1 = _read_camera(given.camera1 or given.camera, option1)
    camera2 = _read_camera(given.camera2 or given.camera, option2)
    pictures = read_image(image1, name="image1"), read_image(image2, name="image2")
    return _Pair(
        names=(str(image1), str(image2)),
        images=pictures,
        cameras=(
            camera1 or find_camera(image1, pictures[0], None, "image1"),
            camera2 or find_camera(image2, pictures[1], None, "image2"),
        ),
        masks=(given.mask1 or given.mask, given.mask2 or given.mask),
        down=(_stated_down(gpano_of(image1)), _stated_down(gpano_of(image2))),
    )


def _stated_down(gpano: GPano | None) -> NDArray[np.float64] | None:
    return None if gpano is None else gpano.down


def _read_camera(source: str | None, option: str) -> Camera | None:
    """Camera of a calibration file, by name where the file holds several."""
    if source is None:
        return None
    from epi360.jobs.folder.given_cameras import read_given_cameras

    try:
        return read_given_cameras(source).only()
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from None


def _estimate(images: _Pair, options: PairOptions, progress: Say) -> ImagePairResult:
    from epi360.two_view import relative_pose_of_images

    gravity1, gravity2 = _gravity(images, options.upright)
    return relative_pose_of_images(
        *images.images,
        camera1=images.cameras[0],
        camera2=images.cameras[1],
        mask1=images.masks[0],
        mask2=images.masks[1],
        mask_nadir_deg=options.mask_nadir_deg,
        gravity1=gravity1,
        gravity2=gravity2,
        gravity_sigma_deg=options.upright or 1.0,
        inlier_threshold_deg=options.inlier_threshold_deg,
        max_width=options.max_width,
        seed=options.seed,
        progress=progress,
    )


def _gravity(
    images: _Pair, upright_deg: float | None
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Gravity in both cameras, None without --upright."""
    if upright_deg is None:
        return None, None
    from epi360.cameras.upright import check_upright, gravity_of

    check_upright(upright_deg)
    gravity1, gravity2 = map(gravity_of, images.cameras, images.down, images.names)
    return gravity1, gravity2


def _write_outputs(
    images: _Pair, result: ImagePairResult, output: PairOutput, progress: Say
) -> None:
    if output.save_images is not None:
        _write_images(images, output.save_images)
    if output.json is not None:
        from epi360.report.records import write_json

        write_json(output.json, _record(images, result))
    if output.figure is not None:
        progress("drawing the figure")
        from epi360.report.figure import draw_pair

        draw_pair(*images.images, *images.cameras, result, path=output.figure)
    if output.report is not None:
        progress("writing the report")
        from epi360.report.pair_page import write_pair_report

        write_pair_report(output.report, images.names, images.images, images.cameras, result)


def _record(images: _Pair, result: ImagePairResult) -> dict[str, Any]:
    from epi360.report.records import pair_record, truth_record

    record = {"image1": images.names[0], "image2": images.names[1], **pair_record(result)}
    if images.truth is not None:
        record["truth"] = truth_record(result.cam2_from_cam1, images.truth)
    return record


def _write_images(images: _Pair, folder: Path) -> None:
    from epi360.features.picture_writing import encode_picture
    from epi360.runs.whole_files import write_file

    for number, image in enumerate(images.images, start=1):
        write_file(folder / f"demo{number}.png", encode_picture(image, ".png"))
