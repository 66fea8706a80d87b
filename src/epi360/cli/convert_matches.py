# SPDX-License-Identifier: BSD-3-Clause
"""What ``epi360 convert`` does with matches: it judges them where that is asked, and says so."""

from __future__ import annotations

import sys
from pathlib import Path

from epi360.cli.command import show_bars
from epi360.interop.convert import without_refused
from epi360.interop.match_graph import MatchGraph
from epi360.jobs.matching.place_job import FEWEST_PAIRS, MOST_PAIRS
from epi360.jobs.matching.verify_pairs import (
    VerifiedGraph,
    unverified_pairs,
    verify_pairs,
    without_geometries,
)
from epi360.report.match_table import describe_verified


def judged_matches(
    graph: MatchGraph, target_name: str, *, images: str | None, verify: bool, again: bool
) -> tuple[MatchGraph, VerifiedGraph | None]:
    """The graph that is written, and what became of its pairs where they were to be judged.

    Without poses of pairs, as in hloc's files, refused ones are left out.
    """
    if verify:
        pictures = None if images is None else Path(images)
        unverified = without_geometries(graph) if again else graph
        with show_bars() as progress:
            verified = verify_pairs(unverified, pictures=pictures, progress=progress)
        return verified.graph, verified
    return (without_refused(graph) if target_name == "hloc" else graph), None


def tell_of_matches(
    given: MatchGraph,
    written: MatchGraph,
    verified: VerifiedGraph | None,
    target_name: str,
    images: str | None,
) -> None:
    """Print what became of the pairs, and what could be done for them."""
    if verified is not None:
        _tell_of_verified(verified, images)
    elif target_name == "colmap-database":
        _warn_of_unverified(written)
    elif num_refused := len(given.pairs) - len(written.pairs):
        print(
            f"{_pairs_are(num_refused)} left out: other pairs speak against what their matches say"
        )


def _tell_of_verified(verified: VerifiedGraph, images: str | None) -> None:
    if not verified.verdicts:
        print("All pairs have a verdict already; --verify-again judges them anew.")
        return
    print(describe_verified(verified))
    if verified.num_panoramic < FEWEST_PAIRS:
        return
    if verified.looked_around:
        if any(verdict.accepted for verdict in verified.verdicts):
            return
        note = "nothing looks the same in the pictures; are they those of these images?"
    elif images is None:
        note = "only the pictures tell rooms that look alike apart; name their folder with --images"
    else:
        note = (
            "the pictures were not compared, because that takes "
            f"{FEWEST_PAIRS} to {MOST_PAIRS:,} accepted pairs of panoramas"
        )
    print(f"epi360: {note}", file=sys.stderr)


def _warn_of_unverified(graph: MatchGraph) -> None:
    count = len(unverified_pairs(graph))
    if count:
        print(
            f"epi360: {_pairs_are(count)} not verified: COLMAP's mapper and triangulation skip "
            "them; convert with --verify, or run pycolmap.verify_matches on the database",
            file=sys.stderr,
        )


def _pairs_are(count: int) -> str:
    return "1 pair is" if count == 1 else f"{count} pairs are"
