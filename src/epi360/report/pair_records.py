# SPDX-License-Identifier: BSD-3-Clause
"""The pairs of a folder as its page holds them: words, numbers and some of the matches."""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.epipolar import essential_from_pose, sampson_residuals
from epi360.interop import MatchedPair, MatchGraph
from epi360.interop.match_graph import REFUSED
from epi360.jobs.matching.folder_verdicts import JudgedPairs
from epi360.jobs.matching.pair_verdicts import PairVerdict
from epi360.poses import Pose
from epi360.report.pairs_table import verdict_reason
from epi360.report.text import describe_explanations

Array = NDArray[np.float64]

_MATCHES = 200_000  # of all pairs together
_MOST_MATCHES, _FEWEST_MATCHES = 300, 20  # of one pair
_SCALE = 65535  # places in a picture, and residuals up to three times the gate, are 16 bits
_GATE_SIGMAS = 3.0  # the residuals of a pair are coloured up to so many times its noise


def pair_records(judged: JudgedPairs, graph: MatchGraph) -> list[dict[str, Any]]:
    """Return a record of each verdict, with matches of the pair where it has a geometry."""
    places = {name: index for index, name in enumerate(judged.images)}
    rows = {(pair.image1, pair.image2): row for row, pair in enumerate(graph.pairs)}
    most = _MATCHES // max(len(judged.verdicts), 1)
    most = min(max(most, _FEWEST_MATCHES), _MOST_MATCHES)
    records = []
    for verdict in judged.verdicts:
        record = {
            "i": places[verdict.image1],
            "j": places[verdict.image2],
            "kind": _kind(verdict),
            "reason": verdict_reason(verdict, judged),
            "words": pair_sentences(verdict, judged),
            "numbers": [
                _rounded(verdict.probability),
                _rounded(verdict.rotation_sigma_deg),
                _rounded(verdict.translation_sigma_deg),
                verdict.num_inliers,
                verdict.num_matches,
                _rounded(verdict.noise_deg),
                _rounded(verdict.parallax_deg),
            ],
        }
        row = rows.get((verdict.image1, verdict.image2))
        if row is not None:
            record |= _matches_record(graph.pairs[row], verdict, graph, most)
        records.append(record)
    return records


def _matches_record(
    pair: MatchedPair, verdict: PairVerdict, graph: MatchGraph, most: int
) -> dict[str, Any]:
    """Return some of the matches, those that agree first, as shares of the pictures."""
    assert pair.geometry is not None
    inliers = pair.geometry.inliers
    agreeing = {(int(a), int(b)) for a, b in inliers}
    others = np.array(
        [row for row in pair.matches.tolist() if tuple(row) not in agreeing], dtype=np.int64
    ).reshape(-1, 2)
    num_others = min(len(others), most // 3)
    chosen = [_spread(inliers, most - num_others), _spread(others, num_others)]
    rows = np.concatenate(chosen)
    cameras, pixels, shares = [], [], []
    for column, name in enumerate((pair.image1, pair.image2)):
        image = graph.images[name]
        assert image.camera is not None
        camera = graph.cameras[image.camera]
        cameras.append(camera)
        pixels.append(image.keypoints[rows[:, column]])
        shares.append(_sixteen_bits(pixels[-1] / (camera.width, camera.height)))
    pose = pair.geometry.cam2_from_cam1
    gate = _GATE_SIGMAS * verdict.noise_deg
    return {
        "pixels": shares,
        "agreeing": len(chosen[0]),
        **_geometry_record(pose, cameras, pixels, gate),
    }


def _geometry_record(
    pose: Pose, cameras: Sequence[Camera], pixels: Sequence[Array], gate_deg: float
) -> dict[str, Any]:
    """Return E and the residuals in shares of three gates; nothing where there is no pose."""
    if not (np.isfinite(pose.translation).all() and np.isfinite(gate_deg) and gate_deg > 0):
        return {}
    E = essential_from_pose(pose)
    bearings = [
        camera.bearings_from_pixels(each) for camera, each in zip(cameras, pixels, strict=True)
    ]
    residuals = np.degrees(np.abs(sampson_residuals(E, *bearings)))
    return {
        "E": [round(float(value), 7) for value in E.ravel()],
        "gate": round(gate_deg, 6),
        "residuals": _sixteen_bits(np.nan_to_num(residuals, nan=np.inf) / (3.0 * gate_deg)),
    }


def _spread(rows: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    if len(rows) <= count:
        return rows
    return rows[np.linspace(0, len(rows) - 1, count).astype(int)] if count else rows[:0]


def _sixteen_bits(shares: Array) -> str:
    """Return numbers from 0 to 1 as little-endian 16-bit integers in base64."""
    values = np.round(np.clip(shares, 0.0, 1.0) * _SCALE).astype("<u2")
    return base64.b64encode(values.tobytes()).decode("ascii")


def _rounded(value: float) -> float | None:
    return float(f"{value:.4g}") if np.isfinite(value) else None


def pair_sentences(verdict: PairVerdict, judged: JudgedPairs) -> list[str]:
    """Return the verdict on one pair of a folder, and how certain it is."""
    reason = verdict_reason(verdict, judged)
    because = f": {reason}" if reason else ""
    sentences = [f"This pair is {_kind(verdict)}{because}."]
    if _kind(verdict) == "no pose":
        sentences = [f"This pair has no pose{because}."]
    share = f" ({verdict.num_inliers / verdict.num_matches:.0%})" if verdict.num_matches else ""
    sentences.append(
        f"{verdict.num_inliers} of {verdict.num_matches} matches{share} agree with one pose."
    )
    if np.isfinite(verdict.rotation_sigma_deg) and np.isfinite(verdict.translation_sigma_deg):
        sentences.append(
            f"The error to expect is {verdict.rotation_sigma_deg:.2g}° in the rotation and "
            f"{verdict.translation_sigma_deg:.2g}° in the direction of the translation (one sigma)."
        )
    if np.isfinite(verdict.probability):
        sure = f"{100 * verdict.probability:.1f}" if verdict.probability < 0.999 else "over 99.9"
        sentences.append(
            f"The pose, with what its surroundings say, has a probability of {sure} %."
        )
    explained = describe_explanations(verdict.explanations)
    if explained:
        sentences.append(f"What may explain the matches: {explained}.")
    if verdict.num_triangles:
        sentences.append(
            f"It forms {verdict.num_triangles} triangles with other pairs, and "
            f"{verdict.num_contradicted or 'none'} of them contradict it."
        )
    if verdict.prior and not verdict.has_other_pose:  # its warning says that
        sentences.append(f"What was known beforehand: {verdict.prior}.")
    warnings = (text for text in verdict.warnings if text != reason)
    return sentences + [f"{text[0].upper()}{text[1:]}." for text in warnings]


def _kind(verdict: PairVerdict) -> str:
    if verdict.accepted:
        return "accepted"
    return REFUSED if verdict.status == REFUSED else "no pose"
