# SPDX-License-Identifier: BSD-3-Clause
"""The verdict on a pair in whole sentences: what it is, what speaks for it and what against it."""

from dataclasses import dataclass

import numpy as np

from epi360.estimation.image_matches import IMAGE_OPTIONS, MAX_NOISE_PX
from epi360.estimation.result import RelativePoseResult, pose_sigmas_deg
from epi360.poses import Pose
from epi360.report.text import (
    STATUS_SENTENCES,
    describe_direction,
    describe_explanations,
    describe_place,
    rotation_axis_angle,
)

# What is less than this, or more noise, speaks against a pose. The estimate of images asks for the
# first two; the others only sort the sentences of a report.
FEWEST_INLIERS = IMAGE_OPTIONS.min_num_inliers
LARGEST_NOISE_PX = MAX_NOISE_PX
SMALLEST_SHARE = 0.2
SMALLEST_COVERAGE = 0.2
SMALLEST_PROBABILITY = 0.99
SMALLEST_PARALLAX = 10.0  # times the noise


@dataclass(frozen=True)
class Evidence:
    """One sentence, and whether it speaks for the pose."""

    speaks_for: bool
    sentence: str


def verdict_headline(status: str) -> str:
    """Return the verdict in one short sentence."""
    if status == "ok":
        return "The pose can be used."
    if status == "pure_rotation":
        return "Only the rotation can be used."
    if status == "planar_ambiguous":
        return "Two poses are possible, so neither should be used as it is."
    return "There is no pose to use."


def verdict_sentences(result: RelativePoseResult) -> list[str]:
    """Return the reason of the verdict, the pose in words and how wrong it may be."""
    reason = STATUS_SENTENCES[result.status]
    return [f"{reason[0].upper()}{reason[1:]}.", *_rotation_words(result), *_place_words(result)]


def evidence_of(result: RelativePoseResult, pixel_deg: float) -> list[Evidence]:
    """Return what speaks for and against the pose; ``pixel_deg`` is the angle of one pixel."""
    evidence = [
        _inliers(result),
        *_noise(result, pixel_deg),
        *_parallax(result),
        *_coverage(result),
        *_probability(result),
        *_explanations(result),
        *_surroundings(result),
        *_alternatives(result),
    ]
    said = {each.sentence for each in evidence}
    warnings = (f"{warning[0].upper()}{warning[1:]}." for warning in result.warnings)
    return evidence + [Evidence(False, text) for text in warnings if text not in said]


def _rotation_words(result: RelativePoseResult) -> list[str]:
    axis, angle = rotation_axis_angle(result.cam2_from_cam1.rotation)
    if not np.isfinite(angle):
        return []
    about = f" about the axis {_vector(axis)}" if np.isfinite(axis).all() else ""
    sigma = pose_sigmas_deg(result)[0]
    error = f" The error to expect is {_amount(sigma)} (one sigma)." if np.isfinite(sigma) else ""
    return [f"Between the views the camera turned by {angle:.2f}°{about}.{error}"]


def _place_words(result: RelativePoseResult) -> list[str]:
    pose = result.cam2_from_cam1
    if not np.isfinite(pose.translation).all():
        return []
    where = describe_direction(-pose.rotation.T @ pose.translation).replace(" deg", "°")
    sigma = pose_sigmas_deg(result)[1]
    error = f" The error to expect is {_amount(sigma)} (one sigma)." if np.isfinite(sigma) else ""
    return [
        f"Seen from camera 1, camera 2 is at {where}.{error}",
        "Two views do not fix the scale: the distance between the cameras is called 1 here.",
    ]


def _inliers(result: RelativePoseResult) -> Evidence:
    count, total = result.num_inliers, result.num_matches
    if not total:
        return Evidence(False, "No matches were found between the images.")
    share = count / total
    good = count >= FEWEST_INLIERS and share >= SMALLEST_SHARE
    only = "" if good else "Only "
    gate = result.inlier_threshold_deg
    within = f" to within {gate:.3f}°" if np.isfinite(gate) else ""
    return Evidence(
        good, f"{only}{count} of {total} matches ({share:.0%}) agree with one pose{within}."
    )


def _noise(result: RelativePoseResult, pixel_deg: float) -> list[Evidence]:
    if not np.isfinite(result.noise_deg):
        return []
    pixels = result.noise_deg / pixel_deg
    return [
        Evidence(
            pixels <= LARGEST_NOISE_PX,
            f"The matches that agree scatter by {result.noise_deg:.3f}° per axis and view, "
            f"which is {pixels:.1f} pixels.",
        )
    ]


def _parallax(result: RelativePoseResult) -> list[Evidence]:
    parallax, noise = result.parallax_deg, result.noise_deg
    if not np.isfinite(parallax):
        return []
    sentence = (
        f"The median parallax, by which the directions to the points differ, is {parallax:.2f}°"
    )
    if not noise > 0:  # exact matches, or none
        return [Evidence(parallax > 0.01, sentence + ".")]
    ratio = parallax / noise
    times = f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.1f}"
    return [Evidence(ratio >= SMALLEST_PARALLAX, f"{sentence}, {times} times the noise.")]


def _coverage(result: RelativePoseResult) -> list[Evidence]:
    coverage = result.sphere_coverage
    if not np.isfinite(coverage):
        return []
    good = coverage >= SMALLEST_COVERAGE
    only = "" if good else "only "
    return [Evidence(good, f"The matches that agree cover {only}{coverage:.0%} of the sphere.")]


def _probability(result: RelativePoseResult) -> list[Evidence]:
    probability = result.probability
    if not np.isfinite(probability):
        return []
    # Nothing is certain.
    amount = "over 99.9" if probability > 0.999 else f"{100 * probability:.1f}"
    pose = "the pose" if result.success else "the pose which was found"
    text = f"The probability that {pose} is right is {amount} %."
    return [Evidence(probability >= SMALLEST_PROBABILITY, text)]


def _explanations(result: RelativePoseResult) -> list[Evidence]:
    explained = describe_explanations(result.explanations)
    text = f"What may explain the matches: {explained}."
    return [Evidence(result.success, text)] if explained else []


def _surroundings(result: RelativePoseResult) -> list[Evidence]:
    around = describe_place(result)
    text = f"The surroundings of the matches {around}."
    return [Evidence(result.success and not result.warnings, text)] if around else []


def _alternatives(result: RelativePoseResult) -> list[Evidence]:
    if result.success and not result.alternatives:
        return [Evidence(True, "No other pose explains the matches about as well.")]
    if result.status == "pure_rotation":
        begin = "Other matches agree on a motion:"
    elif np.isfinite(result.E).all():
        begin = "Another pose fits about as well:"
    else:
        begin = "A pose was found and refused:"
    return [Evidence(False, f"{begin} {_pose_words(pose)}.") for pose in result.alternatives]


def _pose_words(pose: Pose) -> str:
    angle = rotation_axis_angle(pose.rotation)[1]
    if not np.isfinite(pose.translation).all():
        return f"a turn by {angle:.2f}°"
    where = describe_direction(-pose.rotation.T @ pose.translation).replace(" deg", "°")
    return f"a turn by {angle:.2f}°, with camera 2 at {where}"


def _amount(angle_deg: float) -> str:
    return f"{angle_deg:.2g}°" if angle_deg >= 0.001 else "less than 0.001°"


def _vector(vector: np.ndarray) -> str:
    return "(" + ", ".join(f"{value + 0.0:.3f}" for value in np.round(vector, 3)) + ")"
