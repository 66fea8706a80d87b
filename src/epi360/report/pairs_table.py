# SPDX-License-Identifier: BSD-3-Clause
"""Judged pairs as a table for programs."""

import csv
import io
from collections.abc import Callable
from dataclasses import fields
from operator import attrgetter
from typing import Any

import numpy as np

from epi360.estimation.result import Explanations
from epi360.jobs.matching.folder_verdicts import JudgedPairs
from epi360.jobs.matching.match_folder import MatchRun
from epi360.jobs.matching.pair_verdicts import CONTRADICTED, PairVerdict
from epi360.report.text import STATUS_SENTENCES
from epi360.runs.remote_path import AnyPath
from epi360.runs.whole_files import write_file

PAIRS_TABLE = "pairs.csv"
Value = Callable[[PairVerdict], Any]


def pairs_csv(judged: JudgedPairs) -> bytes:
    """Table of all pairs in order, UTF-8 with a header; what is not determined is empty.

    ``probability`` is by the matches of the pair and by what other pairs know, those of the
    explanations are by its matches alone. ``prior`` is what was known beforehand: "upright", in a
    level folder "level" or "level, one height"; or "second" or "implied", if the pose is not the
    one that the matches said first.
    """
    columns = _columns(judged)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(
        [_cell(value(verdict)) for value in columns.values()] for verdict in judged.verdicts
    )
    return text.getvalue().encode()


def write_pairs_table(run: MatchRun) -> AnyPath:
    """Write the table into the folder of a run, and return its path."""
    path = run.folder / PAIRS_TABLE
    write_file(path, pairs_csv(run))
    return path


def verdict_reason(verdict: PairVerdict, judged: JudgedPairs) -> str:
    """Return why a pair has its verdict, as the table says it; empty where nothing is known."""
    if verdict.contradicted:
        return CONTRADICTED
    if verdict.refused:
        return verdict.refused
    if verdict.accepted_for:
        return verdict.accepted_for
    if verdict.status in STATUS_SENTENCES:
        return STATUS_SENTENCES[verdict.status]
    names = (verdict.image1, verdict.image2)
    return "; ".join(judged.unreadable[name] for name in names if name in judged.unreadable)


def _columns(judged: JudgedPairs) -> dict[str, Value]:
    """What each column says of a pair, in the order of the table."""
    own = ("image1", "image2", "status")
    counts = ("num_matches", "num_inliers", "noise_deg", "parallax_deg")
    sigmas = ("rotation_sigma_deg", "translation_sigma_deg")
    others = ("num_triangles", "num_contradicted")
    explained = [each.name for each in fields(Explanations)]
    return {
        **{name: attrgetter(name) for name in own},
        "accepted": lambda verdict: "yes" if verdict.accepted else "no",
        "reason": lambda verdict: verdict_reason(verdict, judged),
        **{name: attrgetter(name) for name in counts},
        **{f"q{axis}": _entry("quaternion_wxyz", k) for k, axis in enumerate("wxyz")},
        **{f"t{axis}": _entry("translation", k) for k, axis in enumerate("xyz")},
        **{name: attrgetter(name) for name in (*sigmas, *others)},
        "warnings": lambda verdict: "; ".join(verdict.warnings),
        **{name: attrgetter(name) for name in ("probability", "prior")},
        **{f"probability_{name}": attrgetter(f"explanations.{name}") for name in explained},
    }


def _entry(name: str, number: int) -> Value:
    """One of the numbers of the pose."""
    return lambda verdict: getattr(verdict.cam2_from_cam1, name)[number]


def _cell(value: Any) -> Any:
    """Numbers as the table has them; what is not finite is empty."""
    if not isinstance(value, float):
        return value
    return f"{value:.9g}" if np.isfinite(value) else ""
