# SPDX-License-Identifier: BSD-3-Clause
"""The report of a folder: its images, the graph of its pairs, and every pair one click away."""

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.epipolar import essential_from_pose, sampson_residuals
from epi360.features import read_image
from epi360.interop import MatchedPair, MatchGraph, Reconstruction
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.matching.implied_job import PRIOR as IMPLIED_PRIOR
from epi360.jobs.matching.match_folder import MatchRun, PairVerdict, load_matches
from epi360.poses import Pose
from epi360.report.html_page import Page, camera_record, escaped, picture_address, shrunk
from epi360.report.match_table import (
    REJECTIONS,
    describe_level,
    describe_others,
    groups_sentence,
    rejection,
    verdict_reason,
)
from epi360.report.model_scene import model_scene
from epi360.report.pair_page import pictures_html
from epi360.report.text import counted, describe_explanations
from epi360.report.webgl import MISSING, find_webgl_library
from epi360.runs.whole_files import PathLike, write_file

Array = NDArray[np.float64]

SCRIPTS = ("geometry.js", "sphere.js", "pair_view.js", "scene.js", "table.js", "folder.js")
# The pictures of all images together, and the matches of all pairs, stay below these.
_PICTURE_BYTES = 18_000_000
_PICTURE_SIZES = ((1600, 80), (1280, 78), (1024, 75), (768, 72), (512, 68), (384, 62), (256, 60))
_MATCHES = 200_000
_MOST_MATCHES, _FEWEST_MATCHES = 300, 20  # of one pair
_SCALE = 65535  # places in a picture, and residuals up to three times the gate, are 16 bits
_NAMED = 10  # images of one kind that the page names
_GATE_SIGMAS = 3.0  # the residuals of a pair are coloured up to so many times its noise


@dataclass(frozen=True)
class MapShown:
    """What the page of a map shows beside its pairs."""

    models: Sequence[Reconstruction]  # the largest first, which is drawn
    left_out: Mapping[str, str]  # image without a pose in it, and the reason


def write_match_report(
    path: PathLike,
    run: MatchRun,
    images: ImageSet,
    shown_map: MapShown | None = None,
    *,
    name: str | None = None,
) -> None:
    """Write the report of `match_images` on a folder, or with the map that of `map_images`.

    ``name`` is that of the folder unless it is given, as where its images are a video's frames.
    """
    write_file(path, match_page(run, images, shown_map, name=name).encode())


def match_page(
    run: MatchRun, images: ImageSet, shown_map: MapShown | None = None, *, name: str | None = None
) -> Page:
    """Return the page of a folder, with its map where it was mapped."""
    models = shown_map.models if shown_map else ()
    webgl = find_webgl_library() if models else None
    graph = load_matches(run.folder)
    names = list(run.images)
    camera_of = {image.name: image.camera for image in images.images}
    keys = list(images.cameras)
    data = {
        "images": [
            {"name": name, "camera": keys.index(camera_of[name]) if name in camera_of else None}
            for name in names
        ],
        "pictures": _pictures(names, images),
        "cameras": [camera_record(camera) for camera in images.cameras.values()],
        "pairs": _pair_records(run, graph, images, names),
        "scene": model_scene(models[0]) if models and webgl else None,
    }
    title = f"{'Map' if shown_map else 'Pairs'} of {name or images.folder.resolve().name}"
    scene = _map_section(shown_map, len(names), webgl is not None) if shown_map else ""
    return Page(title, _body(title, run, images, scene), data, SCRIPTS, webgl)


def _map_section(shown_map: MapShown, num_images: int, has_webgl: bool) -> str:
    models, heading = shown_map.models, "<h2>The map</h2>"
    if not models:
        return f"{heading}<p>COLMAP could not make a map of these pairs.</p>"
    placed, count = len(models[0].images), len(models[0].points)
    others = ""
    if len(models) > 1:
        others = f" {len(models) - 1} smaller maps of other images are not shown."
    words = f"<p>The map holds {placed} of {num_images} images and {count} points.{others}</p>"
    left_out = list(shown_map.left_out.items())
    items = [f"<li>{escaped(name)}: {escaped(why)}</li>" for name, why in left_out[:_NAMED]]
    if len(left_out) > _NAMED:
        items.append(f"<li>and {len(left_out) - _NAMED} more</li>")
    if items:
        words += f"<p>These images are not in it:</p><ul>{''.join(items)}</ul>"
    if not has_webgl:
        return f"{heading}{words}<p>{escaped(MISSING)}</p>"
    return (
        f"{heading}{words}<p>Drag to turn, scroll to zoom. Each camera has its axes: x in red, y "
        'in green, z in blue.</p><div class="scene"></div>'
    )


def _body(title: str, run: MatchRun, images: ImageSet, scene: str) -> str:
    summary = "".join(f"<p>{escaped(text)}</p>" for text in summary_sentences(run, images.skipped))
    hint = "Point at a picture to see the match there"
    kind = " ok" if any(verdict.accepted for verdict in run.verdicts) else ""
    return f"""<h1>{escaped(title)}</h1>
<section class="verdict{kind}">{summary}</section>
{scene}
<div class="columns"><section><h2>The graph of the pairs</h2>
<p>Each dot is an image, in the order of the names around the circle. Each line is a pair; click one
to open it, or a dot to see the pairs of that image.</p>
<p class="legend"><i class="accepted"></i> accepted <i class="refused"></i> refused, although
its matches have a pose <i class="none"></i> no pose</p>
<svg class="graph" role="img" aria-label="The graph of the pairs"></svg></section>
<section><h2>The images</h2>
<p>Click an image to see its pairs.</p>
<div class="thumbnails"></div></section></div>
<h2>The pairs</h2>
<div class="table"><div class="filters">
<label>Name or reason contains <input type="search" name="text"></label>
<label>Verdict <select name="verdict"><option value="">all</option><option>accepted</option>
<option>refused</option><option>no pose</option></select></label></div>
<p class="count" aria-live="polite"></p>
<div class="wide"><table class="pairs"><thead></thead><tbody></tbody></table></div>
<p><button name="more">Show more pairs</button></p></div>
<dialog><div class="bar"><strong class="pair-title"></strong>
<span><button name="earlier">Previous</button> <button name="later">Next</button>
<button name="close">Close</button></span></div>
<div class="words"></div><div class="room"></div></dialog>
<template>{pictures_html(("", ""), hint + ".")}</template>"""


def summary_sentences(run: MatchRun, skipped: Sequence[tuple[str, str]] = ()) -> list[str]:
    """Return what became of the images and pairs of a folder, in whole sentences."""
    accepted = [verdict for verdict in run.verdicts if verdict.accepted]
    images, pairs = counted(len(run.images), "image"), counted(len(run.verdicts), "pair")
    taken = f"{counted(len(accepted), 'pair')} {'is' if len(accepted) == 1 else 'are'} accepted"
    sentences = [f"{images} gave {pairs} ({run.how}), and {taken}."]
    counts = Counter(rejection(verdict) for verdict in run.verdicts if not verdict.accepted)
    for words, count in counts.most_common():
        refused = f"{'was' if count == 1 else 'were'} refused: {words}"
        sentences.append(f"Of the others, {count} {REJECTIONS.get(words, refused)}.")
    joined = [(verdict.image1, verdict.image2) for verdict in accepted]
    sentences.append(groups_sentence(run.images, joined))
    not_used = sorted([*run.unreadable.items(), *skipped])
    sentences += [f"Not used: {name}: {why}." for name, why in not_used[:_NAMED]]
    if len(not_used) > _NAMED:
        sentences.append(f"Not used: {len(not_used) - _NAMED} more.")
    return sentences + describe_level(run) + describe_others(run)


def pair_sentences(verdict: PairVerdict, run: MatchRun) -> list[str]:
    """Return the verdict on one pair of a folder, and how certain it is."""
    reason = verdict_reason(verdict, run)
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
    if verdict.prior and verdict.prior != IMPLIED_PRIOR:  # its warning says that
        sentences.append(f"What was known beforehand: {verdict.prior}.")
    return sentences + [f"{text[0].upper()}{text[1:]}." for text in verdict.warnings]


def _kind(verdict: PairVerdict) -> str:
    if verdict.accepted:
        return "accepted"
    return "refused" if verdict.contradicted or verdict.refused else "no pose"


def _pictures(names: Sequence[str], images: ImageSet) -> list[str | None]:
    """Return a picture of each image, None where it cannot be read; all together fit the page."""
    paths = {image.name: image.path for image in images.images}
    share = _PICTURE_BYTES / max(len(names), 1)

    def picture(name: str) -> str | None:
        try:
            image = read_image(paths[name])
        except (KeyError, OSError, ValueError):
            return None
        address = ""
        for size, quality in _PICTURE_SIZES:
            image = shrunk(image, size)
            address = picture_address(image, size, quality)
            if len(address) <= share:
                break
        return address

    with ThreadPoolExecutor(4) as pool:
        return list(pool.map(picture, names))


def _pair_records(
    run: MatchRun, graph: MatchGraph, images: ImageSet, names: Sequence[str]
) -> list[dict[str, Any]]:
    places = {name: index for index, name in enumerate(names)}
    rows = {(pair.image1, pair.image2): row for row, pair in enumerate(graph.pairs)}
    most = _MATCHES // max(len(run.verdicts), 1)
    most = min(max(most, _FEWEST_MATCHES), _MOST_MATCHES)
    records = []
    for verdict in run.verdicts:
        record = {
            "i": places[verdict.image1],
            "j": places[verdict.image2],
            "kind": _kind(verdict),
            "reason": verdict_reason(verdict, run),
            "words": pair_sentences(verdict, run),
            "numbers": [
                verdict.num_matches,
                verdict.num_inliers,
                _rounded(verdict.noise_deg),
                _rounded(verdict.parallax_deg),
                _rounded(verdict.probability),
            ],
        }
        row = rows.get((verdict.image1, verdict.image2))
        if row is not None:
            record |= _matches_record(graph.pairs[row], verdict, graph, images, most)
        records.append(record)
    return records


def _matches_record(
    pair: MatchedPair, verdict: PairVerdict, graph: MatchGraph, images: ImageSet, most: int
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
        camera = images.cameras[image.camera]
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
