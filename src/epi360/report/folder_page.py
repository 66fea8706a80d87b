# SPDX-License-Identifier: BSD-3-Clause
"""The report of a folder: its images, the graph of its pairs, and every pair one click away."""

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from epi360.cameras import Camera
from epi360.features import read_image
from epi360.interop import MatchGraph, Reconstruction
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.mapping.lone_branches import Branch
from epi360.jobs.matching.folder_verdicts import JudgedPairs
from epi360.jobs.matching.match_folder import MatchRun, load_matches
from epi360.jobs.matching.verify_pairs import VerifiedGraph
from epi360.report.html_page import Page, camera_record, escaped, picture_address, shrunk
from epi360.report.match_table import (
    REJECTIONS,
    branch_sentence,
    describe_judged,
    groups_sentence,
    joined_images,
    not_used,
)
from epi360.report.model_scene import model_scene
from epi360.report.pair_page import pictures_html
from epi360.report.pair_records import pair_records
from epi360.report.text import counted
from epi360.report.webgl import MISSING, find_webgl_library
from epi360.runs.inside import inside
from epi360.runs.whole_files import PathLike, write_file

SCRIPTS = ("geometry.js", "sphere.js", "pair_view.js", "scene.js", "table.js", "folder.js")
NO_PICTURES = (
    "Without the pictures no matches are shown: give the folder of the images to see them."
)
_PICTURE_BYTES = 18_000_000  # of all images together
_PICTURE_SIZES = ((1600, 80), (1280, 78), (1024, 75), (768, 72), (512, 68), (384, 62), (256, 60))
_NAMED = 10  # images of one kind that the page names


@dataclass(frozen=True)
class MapShown:
    """What the page of a map shows beside its pairs."""

    models: Sequence[Reconstruction]  # the largest first, which is drawn
    left_out: Mapping[str, str]  # image without a pose in it, and the reason
    branches: Sequence[Branch] = ()  # images that one pair alone joins to the rest
    was_tried: bool = True  # False: no pair shows a translation, so there is nothing to map


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


def write_verified_report(
    path: PathLike, verified: VerifiedGraph, pictures: PathLike | None, *, name: str
) -> None:
    """Write the report of `verify_pairs` on the matches of that name.

    Their images are shown where they are found in the folder of the ``pictures``.
    """
    write_file(path, verified_page(verified, pictures, name=name).encode())


def match_page(
    run: MatchRun, images: ImageSet, shown_map: MapShown | None = None, *, name: str | None = None
) -> Page:
    """Return the page of a folder, with its map where it was mapped."""
    shown = _Images(
        run.cameras,
        {image.name: image.camera for image in images.images},
        {image.name: image.path for image in images.images},
    )
    words = summary_sentences(run, images.skipped)
    title = f"{'Map' if shown_map else 'Pairs'} of {name or images.folder.resolve().name}"
    return _page(title, words, run, load_matches(run.folder), shown, shown_map)


def verified_page(verified: VerifiedGraph, pictures: PathLike | None, *, name: str) -> Page:
    """Return the page of given matches."""
    graph = verified.graph
    camera_of = {each: graph.images[each].camera for each in verified.images}
    paths = {} if pictures is None else _paths_below(Path(pictures), verified.images)
    shown = _Images(
        graph.cameras, {each: key for each, key in camera_of.items() if key is not None}, paths
    )
    words = summary_sentences(verified)
    if not paths:
        words.append(NO_PICTURES)
    return _page(f"Pairs of {name}", words, verified, graph, shown, None)


@dataclass(frozen=True, eq=False)
class _Images:
    """Cameras by their keys, the camera of each image, and its picture where there is one."""

    cameras: Mapping[str, Camera]
    camera_of: Mapping[str, str]
    paths: Mapping[str, Path]


def _paths_below(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    paths = {}
    for name in names:
        try:
            path = inside(folder, name)
        except ValueError:  # such a picture is not read
            continue
        if path.is_file():
            paths[name] = path
    return paths


def _page(
    title: str,
    words: Sequence[str],
    judged: JudgedPairs,
    graph: MatchGraph,
    images: _Images,
    shown_map: MapShown | None,
) -> Page:
    models = shown_map.models if shown_map else ()
    webgl = find_webgl_library() if models else None
    keys = list(images.cameras)
    data = {
        "images": [
            {
                "name": name,
                "camera": keys.index(images.camera_of[name]) if name in images.camera_of else None,
                "unreadable": name in judged.unreadable,
            }
            for name in judged.images
        ],
        "pictures": _pictures(judged.images, images.paths),
        "cameras": [camera_record(camera) for camera in images.cameras.values()],
        "pairs": pair_records(judged, graph),
        "scene": model_scene(models[0]) if models and webgl else None,
    }
    scene = _map_section(shown_map, len(judged.images), webgl is not None) if shown_map else ""
    has_pose = any(verdict.accepted for verdict in judged.verdicts)
    return Page(title, _body(title, words, scene, has_pose=has_pose), data, SCRIPTS, webgl)


def _map_section(shown_map: MapShown, num_images: int, has_webgl: bool) -> str:
    models, heading = shown_map.models, "<h2>The map</h2>"
    if not models:
        why = "COLMAP could not make a map of these pairs"
        if not shown_map.was_tried:
            why = "No pair shows a translation, so there is nothing to map"
        return f"{heading}<p>{why}.</p>"
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
    hanging = map(branch_sentence, shown_map.branches[:_NAMED])
    words += "".join(f"<p>{escaped(sentence)}.</p>" for sentence in hanging)
    if not has_webgl:
        return f"{heading}{words}<p>{escaped(MISSING)}</p>"
    return (
        f"{heading}{words}<p>Drag to turn, scroll to zoom. Each camera has its axes: x in red, y "
        'in green, z in blue.</p><div class="scene"></div>'
    )


def _body(title: str, words: Sequence[str], scene: str, *, has_pose: bool) -> str:
    summary = "".join(f"<p>{escaped(text)}</p>" for text in words)
    hint = "Point at a picture to see the match there"
    kind = " ok" if has_pose else ""
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


def summary_sentences(judged: JudgedPairs, skipped: Sequence[tuple[str, str]] = ()) -> list[str]:
    """Return what became of the images and pairs of a folder, in whole sentences."""
    accepted = [verdict for verdict in judged.verdicts if verdict.accepted]
    images, pairs = counted(len(judged.images), "image"), counted(len(judged.verdicts), "pair")
    taken = f"{counted(len(accepted), 'pair')} {'is' if len(accepted) == 1 else 'are'} accepted"
    sentences = [f"{images} gave {pairs} ({judged.how}), and {taken}."]
    counts = Counter(verdict.rejection for verdict in judged.verdicts if not verdict.accepted)
    for words, count in counts.most_common():
        refused = f"{'was' if count == 1 else 'were'} refused: {words}"
        sentences.append(f"Of the others, {count} {REJECTIONS.get(words, refused)}.")
    if judged.kept:
        had = "1 more pair has" if len(judged.kept) == 1 else f"{len(judged.kept)} more pairs have"
        sentences.append(f"{had} the pose that was there before, and no verdict.")
    sentences.append(groups_sentence(judged.images, joined_images(judged)))
    unused = not_used(judged, skipped)
    sentences += [f"Not used: {name}: {why}." for name, why in unused[:_NAMED]]
    if len(unused) > _NAMED:
        sentences.append(f"Not used: {len(unused) - _NAMED} more.")
    return sentences + describe_judged(judged)


def _pictures(names: Sequence[str], paths: Mapping[str, Path]) -> list[str | None]:
    """Return a picture of each image, None where it cannot be read; all together fit the page."""
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
