# SPDX-License-Identifier: BSD-3-Clause
"""The report of many pairs: how many are ok, how certain they are, and a table of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.report.batch_rows import BatchRows, listed_rows, names_of, read_batch_rows
from epi360.report.histograms import histogram
from epi360.report.html_page import Page, escaped
from epi360.report.pair_words import FEWEST_INLIERS, SMALLEST_PARALLAX, SMALLEST_PROBABILITY
from epi360.report.text import STATUS_SENTENCES
from epi360.runs.whole_files import PathLike, write_file

Array = NDArray[np.float64]

SCRIPTS = ("geometry.js", "table.js", "batch.js")
MOST_ROWS = 20_000  # more make the page slow; with names of 100 letters they are 6 MB
_LEAST_DOUBT = 1e-6  # nothing is more certain in a histogram
_LARGE_SIGMA_DEG = 5.0  # of the direction of an ok pose: it hardly says where camera 2 is
_PROBABILITIES = (0.0, 0.5, 0.9, 0.99, 0.999, 0.9999, 1.0)


def write_batch_report(path: PathLike, output: str) -> None:
    """Write the report of the poses that `run_batch` has written."""
    write_file(path, batch_page(output).encode())


def batch_page(output: str) -> Page:
    """Return the page of a Parquet file of poses."""
    rows = read_batch_rows(output)
    chosen = listed_rows(rows, MOST_ROWS)
    data = {"names": names_of(output, chosen), **_columns(rows, chosen)}
    title = f"Poses of {output.rpartition('/')[2]}"
    return Page(title, _body(title, rows, len(chosen)), data, SCRIPTS)


def _columns(rows: BatchRows, chosen: NDArray[np.intp]) -> dict[str, Any]:
    known = list(dict.fromkeys(rows.statuses[chosen].tolist()))
    place = {status: index for index, status in enumerate(known)}
    numbers: tuple[tuple[Array, str], ...] = (
        (rows.num_inliers, ".0f"),
        (rows.num_matches, ".0f"),
        (rows.noise_deg, ".4g"),
        (rows.parallax_deg, ".4g"),
        (rows.rotation_sigma_deg, ".3g"),
        (rows.direction_sigma_deg, ".3g"),
        (rows.probability, ".6f"),
    )
    return {
        "kinds": known,
        "statuses": [place[status] for status in rows.statuses[chosen].tolist()],
        "numbers": [
            [float(format(each, form)) if np.isfinite(each) else None for each in values[chosen]]
            for values, form in numbers
        ],
    }


def _body(title: str, rows: BatchRows, num_listed: int) -> str:
    kind = " ok" if rows.is_ok.any() else ""
    summary = "".join(f"<p>{escaped(text)}</p>" for text in batch_sentences(rows))
    kinds = "".join(f"<option>{escaped(each)}</option>" for each in Counter(rows.statuses.tolist()))
    return f"""<h1>{escaped(title)}</h1>
<section class="verdict{kind}">{summary}</section>
<h2>What became of the pairs</h2>
{_bars(rows)}
<h2>What is odd about pairs that are ok</h2>
{_warnings(rows)}
<h2>How the pairs are spread</h2>
<p>Pairs that are ok are drawn below the others. Point at a bar for its numbers. The few pairs
beyond an end of a histogram are counted in the bar at that end.</p>
{_histograms(rows)}
<h2>How reliable the ok poses say they are</h2>
{_reliability(rows)}
<h2>The pairs</h2>
{_listed_words(rows, num_listed)}
<div class="table"><div class="filters">
<label>Name contains <input type="search" name="text"></label>
<label>Status <select name="status"><option value="">all</option>{kinds}</select></label>
<label>Probability at most <input type="number" name="probability" min="0" max="1" step="any"
placeholder="1"></label></div>
<p class="count" aria-live="polite"></p>
<div class="wide"><table class="batch"><thead></thead><tbody></tbody></table></div>
<p><button name="more">Show more pairs</button></p></div>"""


ALONE = (
    "Each pair was judged by itself, and two images cannot tell a place from its copy: rooms that "
    "look alike are not counted in that. Images of one place judge each other with epi360 match, "
    "or with epi360 convert --verify."
)


def batch_sentences(rows: BatchRows) -> list[str]:
    """Return what became of the pairs in whole sentences."""
    count, ok = len(rows.statuses), rows.is_ok
    if not count:
        return ["There are no pairs."]
    sentences = [f"{_share(int(ok.sum()), count)} pairs have a pose that can be used."]
    if not ok.any():
        return sentences
    middle = [
        float(np.median(values[ok]))
        for values in (rows.num_inliers, rows.rotation_sigma_deg, rows.direction_sigma_deg)
    ]
    sentences.append(
        f"Their median: {middle[0]:.0f} matches that agree, an error to expect of {middle[1]:.2g}° "
        f"in the rotation and of {middle[2]:.2g}° in the direction of the translation (one sigma)."
    )
    known = rows.probability[ok & np.isfinite(rows.probability)]
    if len(known):
        wrong = float((1.0 - known).sum())
        amount = f"about {wrong:.0f}" if wrong >= 1.5 else "about one" if wrong >= 0.5 else "none"
        sentences.append(
            f"By the probabilities that they state, {amount} of these {len(known):,} poses should "
            "be wrong."
        )
        sentences.append(ALONE)
    return sentences


@dataclass(frozen=True)
class _Oddity:
    """What may be odd about a pair that is ok, and what it means."""

    is_odd: Callable[[BatchRows], NDArray[np.bool_]]
    what: str
    meaning: str


_ODDITIES = (
    _Oddity(
        lambda rows: rows.probability < SMALLEST_PROBABILITY,
        f"a stated probability below {SMALLEST_PROBABILITY:.0%}",
        "other matches could make such a pose by chance; check it against other pairs, or leave "
        "it out",
    ),
    _Oddity(
        lambda rows: rows.num_inliers < FEWEST_INLIERS,
        f"fewer than {FEWEST_INLIERS} matches that agree",
        "little evidence holds the pose; match more densely, or use images that share more",
    ),
    _Oddity(
        lambda rows: rows.parallax_deg < SMALLEST_PARALLAX * rows.noise_deg,
        f"a parallax below {SMALLEST_PARALLAX:.0f} times the noise",
        "the camera hardly moved; the rotation is good, the direction of the translation less so",
    ),
    _Oddity(
        lambda rows: rows.direction_sigma_deg > _LARGE_SIGMA_DEG,
        f"an error to expect above {_LARGE_SIGMA_DEG:.0f}° in the direction of the translation",
        "give such a pose little weight, or use its rotation alone",
    ),
)


def _warnings(rows: BatchRows) -> str:
    ok = rows.is_ok
    items = []
    for each in _ODDITIES:
        count = int((each.is_odd(rows) & ok).sum())
        if count:
            have = "has" if count == 1 else "have"
            items.append(
                f"<li>{_share(count, int(ok.sum()))} ok pairs {have} {escaped(each.what)}: "
                f"{escaped(each.meaning)}.</li>"
            )
    if not ok.any():
        return "<p>No pair is ok.</p>"
    if not items:
        return "<p>Nothing: all have enough matches, parallax and certainty.</p>"
    return f"<ul>{''.join(items)}</ul>"


def _bars(rows: BatchRows) -> str:
    counts = Counter(rows.statuses.tolist()).most_common()
    most = max((count for _, count in counts), default=1)
    items = "".join(
        f'<li class="{"good" if status == "ok" else "poor"}"><b>{escaped(status)}</b>'
        f'<i style="width:{max(100.0 * count / most, 0.3):.1f}%"></i>'
        f"<span>{_share(count, len(rows.statuses))}</span>"
        f"<small>{escaped(STATUS_SENTENCES.get(status, ''))}</small></li>"
        for status, count in counts
    )
    return f'<ul class="bars">{items}</ul>'


def _histograms(rows: BatchRows) -> str:
    ok = rows.is_ok
    doubt = np.maximum(1.0 - rows.probability, _LEAST_DOUBT)
    charts = (
        histogram(rows.num_inliers, ok, "matches that agree"),
        histogram(rows.noise_deg, ok, "noise per axis and view (degrees)", powers=True),
        histogram(rows.rotation_sigma_deg, ok, "sigma of the rotation (degrees)", powers=True),
        histogram(rows.direction_sigma_deg, ok, "sigma of the direction (degrees)", powers=True),
        histogram(rows.parallax_deg, ok, "median parallax (degrees)", powers=True),
        histogram(doubt, ok, "one minus the stated probability", powers=True),
    )
    return f'<div class="columns three">{"".join(filter(None, charts))}</div>'


def _reliability(rows: BatchRows) -> str:
    known = rows.probability[rows.is_ok & np.isfinite(rows.probability)]
    if not len(known):
        return "<p>No pair is ok.</p>"
    lines = []
    for low, high in zip(_PROBABILITIES[:-1], _PROBABILITIES[1:], strict=True):
        inside = known[(known >= low) & ((known < high) | (high == 1.0))]
        if len(inside):
            wrong = float((1.0 - inside).sum())
            lines.append(
                f"<tr><td>{low:g} to {high:g}</td><td>{len(inside)}</td><td>{wrong:.2g}</td></tr>"
            )
    return (
        "<p>Each ok pose states the probability that it is right. Added up, they say how many "
        "wrong ones to expect; only a comparison with a truth or with other pairs shows which.</p>"
        '<table class="reliability"><thead><tr><th>stated probability</th><th>ok pairs</th>'
        f"<th>wrong ones to expect</th></tr></thead><tbody>{''.join(lines)}</tbody></table>"
    )


def _listed_words(rows: BatchRows, num_listed: int) -> str:
    count = len(rows.statuses)
    if num_listed == count:
        return "<p>All pairs are listed.</p>"
    return (
        f"<p>The page lists {num_listed} of {count} pairs: the ok pairs with the lowest "
        "probability, pairs that are not ok, and a cross-cut of all others. The Parquet file has "
        "all of them.</p>"
    )


def _share(count: int, total: int) -> str:
    return f"{count:,} of {total:,} ({count / max(total, 1):.1%})"
