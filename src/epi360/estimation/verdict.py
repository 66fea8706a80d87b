# SPDX-License-Identifier: BSD-3-Clause
"""The core's answer as a public result: its warnings as sentences, its numbers in degrees.

Which status and which warnings the matches get is decided in native/core/robust/verdict.cpp;
docs/how_it_works.md names the files that may change that where more is known than bearings.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from epi360 import _core
from epi360.epipolar.essential import essential_from_pose
from epi360.estimation.copies import copies_sentence
from epi360.estimation.result import MISSING_MATCHES, Explanations, RelativePoseResult
from epi360.poses import Pose

_HAS_TRANSLATION = ("ok", "planar_ambiguous")
# What the warning of too much noise asks, by which it is known.
NOISE_QUESTION = "do the cameras belong to these images, in this order?"
# What warnings say that need no more than the two numbers which they compare.
_SENTENCES = {
    "missing_matches": (
        "{value:.0f} of {reference:.0f} "
        f"{MISSING_MATCHES} (NaN, as of pixels outside their image, or weight 0)"
    ),
    "fixed_content": (
        "{value:.0f} of {reference:.0f} matches stand still in the images while the camera moved: "
        "something is fixed to the camera, and they were left out"
    ),
    "motion_beside": (
        "{value:.0f} matches agree that the camera has moved, and {reference:.0f} stand still in "
        "the images: these may be fixed to it, as a car is, and the motion is the first alternative"
    ),
    "one_side": (
        "{value:.0f} matches on one side of the camera say another motion than all others: "
        "something passes by, or a part of the place repeats itself"
    ),
    "only_crowd": (
        "the {value:.0f} inliers crowd on a few things, and one match of each region says another "
        "motion: what has most texture may move, or stand elsewhere"
    ),
    "mirrored": (
        "besides the {reference:.0f} inliers {value:.0f} matches fit the epipolar geometry, but "
        "lie behind a camera: one of the images may be mirrored"
    ),
    "mirrored_turn": (
        "besides the {reference:.0f} inliers of a step {value:.0f} matches behind the camera say "
        "that it has only turned, and that one of the images is mirrored"
    ),
    "displaced": (
        "besides the {reference:.0f} inliers {value:.0f} matches, all on one side of the camera, "
        "moved as if it had taken a step: the others may be far away, or something passes by"
    ),
    "partial_coverage": (
        "inliers cover {value:.0%} of the sphere, all matches {reference:.0%}: part of the scene "
        "may move or repeat itself"
    ),
}


def result_of(answer: _core.PairResult) -> RelativePoseResult:
    """Return the public result of one pair."""
    status = answer.status
    pose = Pose(answer.rotation, answer.translation)
    noise_deg = float(np.degrees(answer.noise))
    return RelativePoseResult(
        cam2_from_cam1=pose,
        E=essential_from_pose(pose) if status in _HAS_TRANSLATION else np.full((3, 3), np.nan),
        inlier_mask=answer.inlier_mask,
        residuals_rad=answer.residuals,
        noise_deg=noise_deg,
        inlier_threshold_deg=float(np.degrees(answer.threshold)),
        parallax_deg=float(np.degrees(answer.parallax)),
        sphere_coverage=answer.coverage,
        num_iterations=answer.num_iterations,
        status=status,
        covariance=answer.covariance,
        translation_basis=answer.translation_basis,
        alternatives=tuple(Pose(R, t) for R, t in answer.alternatives),
        warnings=tuple(_sentence(warning) for warning in answer.warnings),
        probability=answer.probability,
        explanations=_explanations(answer.explanations),
    )


def noise_in_pixels(result: RelativePoseResult, pixel_deg: float) -> RelativePoseResult:
    """Return the result with a warning of much noise in pixels of this size instead of degrees."""
    in_degrees = _noise_sentence(result.noise_deg, "degrees")
    in_pixels = _noise_sentence(result.noise_deg / pixel_deg, "pixels")
    warnings = (in_pixels if each == in_degrees else each for each in result.warnings)
    return replace(result, warnings=tuple(warnings))


def _explanations(found: _core.Explanations) -> Explanations:
    return Explanations(**{each.name: getattr(found, each.name) for each in fields(Explanations)})


def _sentence(warning: _core.Warning) -> str:
    value, reference = warning.value, warning.reference
    if warning.code in _SENTENCES:
        return _SENTENCES[warning.code].format(value=value, reference=reference)
    if warning.code == "copies":
        return copies_sentence(int(value), int(reference))
    if warning.code == "little_parallax":
        return (
            f"the median parallax is only {value / reference:.1f} times the noise: "
            "the direction of the translation is uncertain, the rotation is not"
        )
    if warning.code == "against_gravity":
        return (
            f"the pose tilts the cameras by {np.degrees(value):.1f} degrees against the given "
            f"gravity, which is good to {np.degrees(reference):.2g}: one of both is wrong"
        )
    if warning.code == "much_noise":
        return _noise_sentence(float(np.degrees(value)), "degrees")
    raise ValueError(f"the core's warning {warning.code} has no sentence")


def _noise_sentence(noise: float, unit: str) -> str:
    amount = f"{noise:.1f}" if unit == "pixels" else f"{noise:.3g}"
    return f"the matches agree only to {amount} {unit} (one sigma): {NOISE_QUESTION}"
