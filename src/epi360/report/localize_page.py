# SPDX-License-Identifier: BSD-3-Clause
"""The report of images in a map: where each one is, and how much speaks for it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from epi360.features import read_image
from epi360.interop import Reconstruction
from epi360.report.html_page import Page, escaped, picture_address
from epi360.report.localize_plan import plan_of
from epi360.report.text import counted
from epi360.runs.whole_files import PathLike, write_file

if TYPE_CHECKING:
    from epi360.jobs.localization import LocalizationResult

SCRIPTS = ("geometry.js", "table.js", "localize.js")
STATUS_MEANINGS = {
    "ok": "has a pose",
    "ambiguous": "a pose was found, but another place may be as right, or this one is a copy",
    "too_few_matches": "nothing in the map looks like it",
    "too_few_inliers": "what looks alike agrees on no pose, or no more than by chance",
    "concentrated_inliers": "all that agrees is one patch, or does not determine the pose",
}
_PICTURES, _PICTURE_SIZE = 120, 640  # the first images, and pixels of their longer sides
_REASONS_SHOWN = 20


def write_localize_report(
    path: PathLike,
    name: str,
    model: Reconstruction,
    results: Mapping[str, LocalizationResult],
    files: Mapping[str, Path],
    reasons: Mapping[str, str],
) -> None:
    """Write the report of images that were localized in the map of a name.

    ``reasons`` say why other images could not be used.
    """
    write_file(path, localize_page(name, model, results, files, reasons).encode())


def localize_page(
    name: str,
    model: Reconstruction,
    results: Mapping[str, LocalizationResult],
    files: Mapping[str, Path],
    reasons: Mapping[str, str],
) -> Page:
    """Return the page of at least one image."""
    data = {
        "rows": [_row(image, result) for image, result in results.items()],
        "remarks": ["; ".join(result.warnings) for result in results.values()],
        "pictures": [_picture(files[image]) for image in list(results)[:_PICTURES]],
    }
    title = f"Images in the map {name}"
    return Page(title, _body(title, model, results, reasons), data, SCRIPTS)


def _row(name: str, result: LocalizationResult) -> list[Any]:
    """Return cells of the table; None for what is not known."""
    has_pose = bool(np.isfinite(result.cam_from_world.translation).all())
    numbers = [
        result.probability,
        result.rotation_sigma_deg if has_pose else np.nan,
        result.position_sigma if has_pose else np.nan,
        result.same_share,
        *result.cam_from_world.inverse().translation,
    ]
    shown = result.map_images[0] if has_pose and result.map_images else None
    cells = [float(f"{each:.3g}") if np.isfinite(each) else None for each in numbers]
    return [name, result.status, result.num_inliers, result.num_matches, *cells, shown]


def _picture(path: Path) -> str:
    try:
        return picture_address(read_image(path), _PICTURE_SIZE)
    except (OSError, ValueError):  # it is gone by now
        return ""


def _body(
    title: str,
    model: Reconstruction,
    results: Mapping[str, LocalizationResult],
    reasons: Mapping[str, str],
) -> str:
    counts: Counter[str] = Counter(result.status for result in results.values())
    options = "".join(f"<option>{escaped(status)}</option>" for status in counts)
    return f"""<h1>{escaped(title)}</h1>
<section class="verdict{" ok" if counts["ok"] else ""}">{_summary(model, counts, results)}</section>
<h2>Where they are</h2>
<p>The map from above: its points, and its cameras as small dots. New images have a large dot with a
nose where they look: filled if the pose is ok, hollow if it is in doubt. Click one for its picture.
</p>
<div class="side">{plan_of(model, results)}
<figure class="chosen" hidden><img alt="The chosen image"><figcaption></figcaption></figure></div>
<h2>The images</h2>
<div class="table"><div class="filters">
<label>Name contains <input type="search" name="text"></label>
<label>Status <select name="status"><option value="">all</option>{options}</select></label></div>
<p class="count" aria-live="polite"></p>
<div class="wide"><table class="localized"><thead></thead><tbody></tbody></table></div>
<p><button name="more">Show more images</button></p></div>
{_not_used(reasons)}"""


def _summary(
    model: Reconstruction, counts: Counter[str], results: Mapping[str, LocalizationResult]
) -> str:
    total, ok = len(results), [each for each in results.values() if each.success]
    first = f"{len(ok)} of {total} images have a pose that can be used"
    sentences = [f"{first}, in a map of {len(model.images)} images and {len(model.points)} points."]
    if ok:
        rotation = float(np.median([each.rotation_sigma_deg for each in ok]))
        position = float(np.median([each.position_sigma for each in ok]))
        sentences.append(
            f"Half of them are known to {rotation:.2g}° and to {position:.2g} units of the map "
            "(one sigma), or better."
        )
    items = "".join(
        f"<li><b>{status}</b>, {counted(counts[status], 'image')}: {meaning}</li>"
        for status, meaning in STATUS_MEANINGS.items()
        if counts[status]
    )
    words = "".join(f"<p>{escaped(sentence)}</p>" for sentence in sentences)
    return f'{words}<ul class="statuses">{items}</ul>'


def _not_used(reasons: Mapping[str, str]) -> str:
    if not reasons:
        return ""
    items = [f"<li>{escaped(name)}: {escaped(why)}</li>" for name, why in reasons.items()]
    if len(items) > _REASONS_SHOWN:
        items[_REASONS_SHOWN:] = [f"<li>and {len(reasons) - _REASONS_SHOWN} more</li>"]
    return f"<h2>Images that could not be used</h2><ul>{''.join(items)}</ul>"
