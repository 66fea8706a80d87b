# SPDX-License-Identifier: BSD-3-Clause
"""Errors of a trajectory as text and as a JSON record."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from epi360.extras import package_version
from epi360.jobs.evaluation import Evaluation, PairErrors, Statistics
from epi360.report.records import plain

ALIGNMENTS = {
    "sim3": "Sim(3): rotation, translation and scale of the estimate are fitted",
    "se3": "SE(3): rotation and translation of the estimate are fitted",
    "none": "none",
}


def describe_evaluation(result: Evaluation) -> str:
    """Lines for people."""
    ate = Statistics.of(result.position_errors_m)
    turned = Statistics.of(result.orientation_errors_deg)
    share = f" = {100 * ate.rmse / result.path_m:.3f} % of the path" if result.moves else ""
    lines = [
        f"frames      {len(result.truth)} of {result.num_truth} have a pose "
        f"({100 * result.coverage:.1f} %); path {result.path_m:.4g} m",
        f"alignment   {ALIGNMENTS[result.alignment]}; scale {result.similarity.scale:.6g}",
        f"ATE         {ate.rmse:.4g} m rms{share}; "
        f"median {ate.median:.4g}, largest {ate.max:.4g} m",
        f"rotation    {turned.rmse:.3f} deg rms; median {turned.median:.3f}, "
        f"largest {turned.max:.3f} deg",
        f"RPE, frame  {_steps(result.steps)}",
    ]
    if result.moves:
        lines += [
            f"RPE, metre  {_per_metre(result)}",
            f"pairs       {_pairs(result.stretches, result.distance_m)}",
        ]
    else:
        lines.append("the true camera stands still: there are no errors per metre or of directions")
    return "\n".join(lines)


def _steps(errors: PairErrors) -> str:
    moved, turned = Statistics.of(errors.translation_m), Statistics.of(errors.rotation_deg)
    return f"{moved.rmse:.4g} m and {turned.rmse:.4f} deg rms between one frame and the next"


def _per_metre(result: Evaluation) -> str:
    errors = result.stretches
    if not len(errors.pairs):
        return f"no two frames are {result.distance_m:g} m apart on the path"
    moved = Statistics.of(errors.translation_m / errors.length_m)
    turned = Statistics.of(errors.rotation_deg / errors.length_m)
    return (
        f"{100 * moved.rmse:.3f} % and {turned.rmse:.4f} deg/m rms over {len(errors.pairs)} "
        f"stretches of {result.distance_m:.4g} m"
    )


def _pairs(errors: PairErrors, distance_m: float) -> str:
    if not len(errors.pairs):
        return "none"
    turned, pointed = Statistics.of(errors.rotation_deg), Statistics.of(errors.direction_deg)
    return (
        f"rotation {turned.median:.4f}, direction {pointed.median:.4f} deg median between frames "
        f"{distance_m:.4g} m apart (means {turned.mean:.4f}, {pointed.mean:.4f}); the "
        "errors of Robust 360-8PA (eq. 16) are the means divided by 180"
    )


def evaluation_record(result: Evaluation) -> dict[str, Any]:
    """Everything that was measured, as values that strict JSON can hold; NaN is None."""
    similarity = result.similarity
    record = {
        "epi360_version": package_version(),
        "num_truth": result.num_truth,
        "num_estimate": result.num_estimate,
        "num_matched": len(result.truth),
        "coverage": result.coverage,
        "path_m": result.path_m,
        "alignment": result.alignment,
        "truth_from_estimate": {
            "scale": similarity.scale,
            "rotation": similarity.rotation.tolist(),
            "translation": similarity.translation.tolist(),
        },
        "ate_m": asdict(Statistics.of(result.position_errors_m)),
        "ate_share_of_path": (
            Statistics.of(result.position_errors_m).rmse / result.path_m if result.moves else None
        ),
        "rotation_deg": asdict(Statistics.of(result.rotation_errors_deg)),
        "orientation_deg": asdict(Statistics.of(result.orientation_errors_deg)),
        "rpe_frame": _pair_record(result.steps),
        "rpe_distance_m": result.distance_m,
        "rpe_distance": _pair_record(result.stretches),
        "rpe_per_metre": {
            name: asdict(Statistics.of(values / result.stretches.length_m))
            for name, values in (
                ("translation", result.stretches.translation_m),
                ("rotation_deg", result.stretches.rotation_deg),
            )
        },
        "frames": list(result.truth.names),
        "position_errors_m": result.position_errors_m.tolist(),
        "rotation_errors_deg": result.rotation_errors_deg.tolist(),
        "orientation_errors_deg": result.orientation_errors_deg.tolist(),
    }
    return {key: plain(value) for key, value in record.items()}


def _pair_record(errors: PairErrors) -> dict[str, Any]:
    return {
        "num_pairs": len(errors.pairs),
        "translation_m": asdict(Statistics.of(errors.translation_m)),
        "rotation_deg": asdict(Statistics.of(errors.rotation_deg)),
        "direction_deg": asdict(Statistics.of(errors.direction_deg)),
        # Robust 360-8PA, eq. 16.
        "paper_rotation_error": Statistics.of(errors.rotation_deg).mean / 180,
        "paper_translation_error": Statistics.of(errors.direction_deg).mean / 180,
    }
