# SPDX-License-Identifier: BSD-3-Clause
"""What ``epi360 convert`` does with matches: it judges them where that is asked, and says so."""

from __future__ import annotations

import sys
from pathlib import Path

from epi360.cli.command import show_bars
from epi360.interop.colmap_database import CONFIG_OF_STATUS
from epi360.interop.convert import without_refused
from epi360.interop.formats import FORMATS
from epi360.interop.match_graph import REFUSED, MatchGraph
from epi360.jobs.matching.verify_pairs import (
    VerifiedGraph,
    num_geometries,
    unverified_pairs,
    verify_pairs,
    without_geometries,
)
from epi360.report.match_table import describe_verified
from epi360.report.pairs_table import pairs_csv
from epi360.runs.whole_files import write_file


def check_nothing_verified(graph: MatchGraph, option: str) -> None:
    """Raise where pairs would keep poses that are by other cameras than the option gives."""
    if verified := num_geometries(graph):
        raise ValueError(
            f"{option} needs --verify-again: {_pairs_are(verified)} verified by the cameras that "
            "the source has"
        )


def judged_matches(
    graph: MatchGraph,
    target_name: str,
    *,
    images: str | None,
    verify: bool,
    again: bool,
    change_cameras: bool,
) -> tuple[MatchGraph, VerifiedGraph | None]:
    """The graph that is written, and what became of its pairs where they were to be judged.

    Without poses of pairs, as in hloc's files, refused ones are left out.
    """
    verified = None
    if verify:
        unverified = without_geometries(graph) if again else graph
        with show_bars() as progress:
            verified = verify_pairs(
                unverified,
                pictures=images,
                change_cameras=change_cameras,
                keep_panoramas=True,  # COLMAP has no part of one
                progress=progress,
            )
        graph = verified.graph
    return (without_refused(graph) if target_name == "hloc" else graph), verified


def tell_of_matches(
    given: MatchGraph,
    written: MatchGraph,
    verified: VerifiedGraph | None,
    formats: tuple[str, str],
    images: str | None,
) -> None:
    """Print what became of the pairs, and what could be done for them.

    ``formats`` are the names of those that were read and written.
    """
    if verified is not None and not verified.verdicts:
        anew = (
            "--verify-again judges them anew"
            if formats[0] in FORMATS
            else "epi360 match judged them"
        )
        print(f"All pairs have a verdict already; {anew}.")
    elif verified is not None:
        _tell_of_verified(verified, images)
    elif formats[1] == "colmap-database":
        _warn_of_unverified(written)
    elif formats[0] == "colmap-database":
        _warn_of_refused(written)
    if num_refused := len(given.pairs) - len(written.pairs):
        print(
            f"{_pairs_are(num_refused)} left out: other pairs speak against what their matches say"
        )


def write_verdicts(
    verified: VerifiedGraph,
    table: Path | None,
    report: Path | None,
    images: str | None,
    source: Path,
) -> None:
    """Write the verdicts on the matches of the source as a table and as a page, and say so."""
    if table is not None:
        write_file(table, pairs_csv(verified))
        print(f"wrote {table}")
    if report is not None:
        from epi360.report.folder_page import write_verified_report

        write_verified_report(report, verified, images, name=source.resolve().name)
        print(f"wrote {report}")


# So many are hardly all of copies.
_FEWEST_JUDGED = 3


def _tell_of_verified(verified: VerifiedGraph, images: str | None) -> None:
    print(describe_verified(verified))
    if verified.num_comparable == 0 or verified.num_not_compared:
        return
    if verified.looked_around:
        judged = [v for v in verified.verdicts if v.status in ("ok", REFUSED)]
        if len(judged) < _FEWEST_JUDGED or any(verdict.accepted for verdict in judged):
            return
        note = "nothing looks the same in the pictures; are they those of these images?"
    elif images is None:
        note = "only the pictures tell rooms that look alike apart; name their folder with --images"
    else:
        note = "the pictures were not compared, because the matches of no pair determine a pose"
    print(f"epi360: {note}", file=sys.stderr)


def _warn_of_unverified(graph: MatchGraph) -> None:
    count = len(unverified_pairs(graph))
    if count:
        print(
            f"epi360: {_pairs_are(count)} not verified: COLMAP's mapper and triangulation skip "
            "them; convert with --verify, or run pycolmap.verify_matches on the database",
            file=sys.stderr,
        )


def _warn_of_refused(graph: MatchGraph) -> None:
    """A database does not say which of these the other pairs have refused."""
    count = sum(
        pair.geometry is not None and pair.geometry.status not in CONFIG_OF_STATUS
        for pair in graph.pairs
        if len(pair.matches)
    )
    if count:
        print(
            f"epi360: {_pairs_are(count)} without a pose in the database, which hloc's files "
            "cannot say; other pairs may have refused them: --verify-again leaves those out",
            file=sys.stderr,
        )


def _pairs_are(count: int) -> str:
    return "1 pair is" if count == 1 else f"{count} pairs are"
