# SPDX-License-Identifier: BSD-3-Clause
"""A relative pose in plain words."""

import textwrap
from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.result import (
    Explanations,
    ImagePairResult,
    RelativePoseResult,
    SamePlace,
    Status,
    pose_sigmas_deg,
)
from epi360.poses import Pose, rotation_error_deg, translation_error_deg

Array = NDArray[np.float64]

CONVENTION = "x2 = R x1 + t, x right, y down, z forward"
UNKNOWN = "not determined"
LABEL_WIDTH, LINE_WIDTH = 14, 100

STATUS_SENTENCES: dict[Status, str] = {
    "ok": "the matches determine the pose",
    "too_few_matches": (
        "fewer than five usable matches; use images that overlap, are sharp and textured, and "
        "check that the masks keep the scene (white = use)"
    ),
    "too_few_inliers": (
        "no pose explains enough of the matches, in enough directions; check that both images show "
        "the same place and that the camera models fit, or move the viewpoints closer together"
    ),
    "pure_rotation": (
        "the camera turned without moving, as far as the matches can tell: the rotation is valid, "
        "the translation is not determined; take the second image from another place"
    ),
    "planar_ambiguous": (
        "two poses explain the matches about equally well, as on a scene close to one plane, or "
        "where half of the matches are on something that moves, or in a place that repeats itself; "
        "the more likely is shown; use images that share more of the scene"
    ),
    "concentrated_inliers": (
        "the matches that agree are on too small a part of the surroundings for a trustworthy "
        "pose, or on a few things with most of the key points that the rest contradicts; use "
        "images that share more of the surroundings, or mask what moves"
    ),
    "another_place": (
        "the matches agree on a pose, but too little of what both cameras must see around them "
        "looks as it says: the images may show two places with the same things, or something that "
        "moves; mask what moves, or let epi360 match judge all images of the place together"
    ),
}


EXPLANATION_WORDS = {
    "nothing": "the images have nothing in common",
    "rotation": "the camera only turned",
    "surface": "this pose, of matches on one surface",
    "motion": "this pose",
    "rival": "another pose",
}
PLACE_WORDS = {
    "here": "as the pose says",
    "elsewhere": "as in another place, or around a thing that moves",
    "copy": "as in a copy of the place",
}
_DOUBT = 0.001  # an explanation less probable than this is not worth a word


def describe_pair(result: RelativePoseResult, truth: Pose | None = None) -> str:
    """Plain-text lines that tell a person the pose, its uncertainty and the verdict.

    ``truth`` is the true ``cam2_from_cam1``, of any scale: it is printed beside the estimate with
    the errors. What is NaN reads "not determined". Directions are azimuth (positive to the right of
    the optical axis, or of the image centre of a panorama) and elevation (positive up).
    """
    rows = [("Status", describe_status(result.status))]
    rows += [("Warning", warning) for warning in result.warnings]
    rows += [*_pose_rows(result), *_evidence_rows(result)]
    is_answer = bool(np.isfinite(result.E).all()) or result.status == "pure_rotation"
    for pose in result.alternatives:
        rows.append(
            (
                "Also fits" if is_answer else "Refused",
                f"{_rotation_text(pose)}; t = {_vector_text(pose.translation)}",
            )
        )
    lines = [wrapped(label, value) for label, value in rows]
    if truth is not None:
        lines += ["", *_truth_lines(result.cam2_from_cam1, truth)]
    return "\n".join(lines)


def describe_status(status: Status) -> str:
    """Status with its reason and, where there is one, the remedy, in one line."""
    return f"{status}: {STATUS_SENTENCES[status]}"


def describe_explanations(explanations: Explanations) -> str:
    """The explanations of the matches with their probabilities; empty if there is no doubt."""
    named = _named(asdict(explanations), EXPLANATION_WORDS)
    return ", ".join(named) if len(named) > 1 else ""


def describe_place(result: RelativePoseResult) -> str:
    """What both cameras must see around the matches; empty if it was not compared."""
    place = result.place if isinstance(result, ImagePairResult) else SamePlace()
    named = ", ".join(_named(asdict(place), PLACE_WORDS))
    return f"look {named}" if named else ""


def _named(shares: Mapping[str, float], words: Mapping[str, str]) -> list[str]:
    """What is not too improbable, the most probable first, in words."""
    named = sorted(((p, name) for name, p in shares.items() if p >= _DOUBT), reverse=True)
    return [f"{words[name]} ({_percent(p)})" for p, name in named]


def describe_direction(direction: Array) -> str:
    """Azimuth and elevation of a direction, such as "azimuth +34.2 deg (right), elevation ..."."""
    if not np.isfinite(direction).all():
        return UNKNOWN
    azimuth, elevation = azimuth_elevation_deg(direction)
    if abs(elevation) > 89.0:  # the azimuth of a pole means nothing
        return "straight up" if elevation > 0 else "straight down"
    vertical = "level" if abs(elevation) < 0.05 else "up" if elevation > 0 else "down"
    azimuth_text = f"azimuth {_signed(azimuth)} deg ({_side(azimuth)})"
    return f"{azimuth_text}, elevation {_signed(elevation)} deg ({vertical})"


def azimuth_elevation_deg(direction: Array) -> tuple[float, float]:
    """Azimuth (positive to the right) and elevation (positive up) of a direction."""
    x, y, z = direction
    return float(np.degrees(np.arctan2(x, z))), float(np.degrees(np.arctan2(-y, np.hypot(x, z))))


def rotation_axis_angle(rotation: Array) -> tuple[Array, float]:
    """Axis and angle in degrees; the axis is NaN if the angle is too small for one."""
    w, *xyz = Pose(rotation, np.zeros(3)).quaternion_wxyz
    vector = np.array(xyz)
    length = float(np.linalg.norm(vector))
    # Below 1e-6 degrees the vector part is rounding of the matrix.
    axis = vector / length if length > 1e-8 else np.full(3, np.nan)
    return axis, float(np.degrees(2.0 * np.arctan2(length, w)))


def _pose_rows(result: RelativePoseResult) -> list[tuple[str, str]]:
    pose = result.cam2_from_cam1
    rotation_sigma, translation_sigma = pose_sigmas_deg(result)
    position = describe_direction(-pose.rotation.T @ pose.translation)
    return [
        ("Rotation", _rotation_text(pose) + _sigma_text(rotation_sigma)),
        ("Translation", _vector_text(pose.translation) + _sigma_text(translation_sigma)),
        ("Camera 2 at", position + ("" if position == UNKNOWN else ", seen from camera 1")),
        ("  looking to", _heading_text(pose.rotation)),
    ]


def _evidence_rows(result: RelativePoseResult) -> list[tuple[str, str]]:
    gate = number_text(result.inlier_threshold_deg, "{:.3f} deg")
    share = f" ({result.num_inliers / result.num_matches:.0%})" if result.num_matches else ""
    noise = number_text(result.noise_deg, "{:.3f} deg per axis and view")
    parallax = number_text(result.parallax_deg, "{:.2f} deg, median over the inliers")
    coverage = number_text(result.sphere_coverage, "inliers in {:.0%} of the sphere")
    explained = describe_explanations(result.explanations)
    around = describe_place(result)
    return [
        ("Inliers", f"{result.num_inliers} of {result.num_matches} matches{share}, gate {gate}"),
        ("Probability", _probability_text(result.probability)),
        *((("Explained by", explained),) if explained else ()),
        *((("Surroundings", around),) if around else ()),
        ("Noise", noise),
        ("Parallax", parallax),
        ("Coverage", coverage),
        ("Convention", f"{CONVENTION}; |t| = 1, two views fix no scale"),
    ]


def _truth_lines(pose: Pose, truth: Pose) -> list[str]:
    length = float(np.linalg.norm(truth.translation))
    unit_truth = Pose(truth.rotation, truth.translation / length if length else truth.translation)
    rotation_error = number_text(rotation_error_deg(pose, truth), "{:.3f} deg")
    translation_error = number_text(translation_error_deg(pose, truth), "{:.3f} deg")
    poses = (pose, unit_truth)
    rows = [
        ("", "estimate", "truth", "error"),
        ("Rotation", *map(_rotation_text, poses), rotation_error),
        ("Translation", *(_vector_text(pose.translation) for pose in poses), translation_error),
    ]
    widths = [LABEL_WIDTH, *(max(len(row[column]) for row in rows) + 3 for column in (1, 2)), 0]
    return ["".join(f"{c:<{w}}" for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def _rotation_text(pose: Pose) -> str:
    axis, angle = rotation_axis_angle(pose.rotation)
    if np.isnan(angle):
        return UNKNOWN
    about = "" if np.isnan(axis).any() else f" about {_vector_text(axis)}"
    return f"{angle:.3f} deg{about}"


def _heading_text(rotation: Array) -> str:
    """Where camera 2 looks, seen from camera 1, and how it leans about that direction."""
    if not np.isfinite(rotation).all():
        return UNKNOWN
    cam1_from_cam2 = rotation.T
    # R^T = Ry(azimuth) Rx(elevation) Rz(roll), so that row 1 holds cos(elevation) (sin, cos)(roll).
    roll = float(np.degrees(np.arctan2(cam1_from_cam2[1, 0], cam1_from_cam2[1, 1])))
    lean = "clockwise" if roll > 0 else "counter-clockwise"
    rolled = "" if abs(roll) < 0.05 else f", rolled {abs(roll):.1f} deg {lean}"
    return describe_direction(cam1_from_cam2[:, 2]) + rolled


def _side(azimuth_deg: float) -> str:
    size = abs(azimuth_deg)
    if size < 0.05:
        return "ahead"
    if size > 179.95:
        return "behind"
    side = "right" if azimuth_deg > 0 else "left"
    return f"{side}, behind" if size > 90.0 else side


def _signed(angle_deg: float) -> str:
    rounded = round(angle_deg, 1)
    return f"{rounded:+.1f}" if rounded else "0.0"


def _vector_text(vector: Array) -> str:
    if not np.isfinite(vector).all():
        return UNKNOWN
    return "(" + ", ".join(f"{value + 0.0:.4f}" for value in np.round(vector, 4)) + ")"


def wrapped(label: str, value: str) -> str:
    """Label and value; lines that continue a long value are indented as far as it is."""
    first, indent = f"{label:<{LABEL_WIDTH}}", " " * LABEL_WIDTH
    return textwrap.fill(
        value, LINE_WIDTH, initial_indent=first, subsequent_indent=indent, break_long_words=False
    )


def _probability_text(probability: float) -> str:
    if not np.isfinite(probability):
        return UNKNOWN
    return f"{_percent(probability)} that the pose is right"


def _percent(probability: float) -> str:
    # Nothing is certain.
    return "over 99.9 %" if probability > 0.999 else f"{100.0 * probability:.1f} %"


def _sigma_text(sigma_deg: float) -> str:
    return f", 1 sigma {sigma_deg:.3f} deg" if np.isfinite(sigma_deg) else ""


def counted(number: int, noun: str) -> str:
    """A number with its noun."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def number_text(value: float, template: str) -> str:
    """A number in a format such as ``"{:.3f} deg"``, or "not determined" if it is not finite."""
    return template.format(value) if np.isfinite(value) else UNKNOWN
