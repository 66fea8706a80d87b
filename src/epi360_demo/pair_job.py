# SPDX-License-Identifier: BSD-3-Clause
"""One estimate for a visitor: two pictures to the files of a report and a verdict in words."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.upright import gravity_of
from epi360.estimation.result import ImagePairResult
from epi360.features import read_image
from epi360.features.image_cameras import find_camera, gpano_of
from epi360.poses import Pose, rotation_error_deg, translation_error_deg
from epi360.report.pair_page import write_pair_report
from epi360.report.pair_words import verdict_headline, verdict_sentences
from epi360.report.records import pair_record, truth_record, write_json
from epi360.two_view import relative_pose_of_images
from epi360_demo.examples import EXAMPLES, rendered_example
from epi360_demo.limits import RefusedError, as_sentence, megapixels
from epi360_demo.pair_choices import PairChoices, camera_of, choices_from
from epi360_demo.pictures import named

Say = Callable[[str], None]
REPORT, RECORD = "report.html", "pair.json"
_TOO_LARGE_FOR_OPENCV = "is larger than OpenCV decodes"


@dataclass(frozen=True)
class _View:
    name: str
    path: Path
    image: NDArray[np.uint8]
    camera: Camera


def run_pair(request: Mapping[str, Any], say: Say) -> dict[str, Any]:
    """Return the verdict on a pair and write its report and its record.

    ``request`` has ``out``, an existing folder; ``choices``; ``max_pixels``; and either
    ``pictures``, of which each has ``path`` and ``name``, and ``lens`` likewise or None, or the
    name of an ``example`` and the folder ``examples``. Raises `RefusedError` with a sentence.
    """
    choices = choices_from(request["choices"])
    truth = None
    if request.get("example"):
        example = rendered_example(Path(request["examples"]), request["example"], say)
        camera, truth = EXAMPLES[request["example"]].camera, example.cam2_from_cam1
        views = [_View(path.stem, path, read_image(path), camera) for path in example.paths]
    else:
        say("reading the pictures")
        views = [_read_view(request, choices, number) for number in (1, 2)]
    result = _estimate(views, choices, say)
    say("writing the report")
    out = Path(request["out"])
    names, cameras = (views[0].name, views[1].name), (views[0].camera, views[1].camera)
    write_pair_report(out / REPORT, names, (views[0].image, views[1].image), cameras, result)
    record = {"image1": names[0], "image2": names[1], **pair_record(result)}
    if truth is not None:
        record["truth"] = truth_record(result.cam2_from_cam1, truth)
    write_json(out / RECORD, record)
    return {
        "status": result.status,
        "headline": verdict_headline(result.status),
        "sentences": verdict_sentences(result),
        "truth": _truth_words(request.get("example"), truth, result),
    }


def _read_view(request: Mapping[str, Any], choices: PairChoices, number: int) -> _View:
    given = request["pictures"][number - 1]
    path, name, role = Path(given["path"]), given["name"], f"image{number}"
    lens = request.get("lens")
    try:
        image = read_image(path, max_pixels=request["max_pixels"], name=role)
        height, width = image.shape[:2]
        lens_path, lens_name = (Path(lens["path"]), lens["name"]) if lens else (None, "")
        camera = camera_of(choices, number, width, height, lens_path, lens_name)
        return _View(name, path, image, find_camera(path, image, camera, name))
    except RefusedError:
        raise
    except (ValueError, OSError) as error:
        message = named(str(error), role, path, name)
        if _TOO_LARGE_FOR_OPENCV in message:
            most = megapixels(request["max_pixels"])
            message = f"{name} has more pixels than this demo takes, {most}; reduce it first."
        raise RefusedError(message) from None


def _estimate(views: list[_View], choices: PairChoices, say: Say) -> ImagePairResult:
    try:
        gravity1, gravity2 = _gravity(views, choices.upright_deg)
        return relative_pose_of_images(
            views[0].image,
            views[1].image,
            camera1=views[0].camera,
            camera2=views[1].camera,
            mask_nadir_deg=choices.mask_nadir_deg,
            gravity1=gravity1,
            gravity2=gravity2,
            gravity_sigma_deg=choices.upright_deg or 1.0,
            inlier_threshold_deg=choices.threshold_deg or "auto",
            progress=say,
        )
    except ValueError as error:
        message = str(error).replace("image1", views[0].name).replace("image2", views[1].name)
        raise RefusedError(as_sentence(message)) from None


def _gravity(
    views: list[_View], upright_deg: float | None
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    if upright_deg is None:
        return None, None
    stated = [gpano_of(view.path) for view in views]
    down = [None if each is None else each.down for each in stated]
    return (
        gravity_of(views[0].camera, down[0], views[0].name),
        gravity_of(views[1].camera, down[1], views[1].name),
    )


def _truth_words(example: str | None, truth: Pose | None, result: ImagePairResult) -> str:
    """Return how right the answer is, which is known of rendered pictures."""
    if example in ("other", "twins"):
        if not result.success:
            return "The truth: the pictures show two rooms, so it is right to give no pose."
        return (
            "The truth: these are two rooms that are furnished alike, so this pose is wrong. "
            "epi360 match and epi360 map can tell, where the other pictures of the place "
            "contradict a pair."
        )
    if truth is None:
        return ""
    rotation = rotation_error_deg(result.cam2_from_cam1, truth)
    words = [f"its rotation is {rotation:.2g}° off"] if np.isfinite(rotation) else []
    if np.linalg.norm(truth.translation) > 0:
        direction = translation_error_deg(result.cam2_from_cam1, truth)
        words += [f"its direction {direction:.2g}°"] if np.isfinite(direction) else []
    if not words:
        return ""
    return f"The pictures were rendered, so the truth is known: {' and '.join(words)}."
