# SPDX-License-Identifier: BSD-3-Clause
"""Matched pairs as a summary for people."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from epi360.cameras.changed_camera import OF_LENS
from epi360.estimation.calibration_doubt import CALIBRATION_QUESTION
from epi360.estimation.verdict import NOISE_QUESTION
from epi360.jobs.graph.graph_check import groups_by
from epi360.jobs.mapping.lone_branches import Branch
from epi360.jobs.matching.folder_verdicts import JudgedPairs
from epi360.jobs.matching.match_folder import MatchRun
from epi360.jobs.matching.pair_verdicts import CONTRADICTED, PairVerdict
from epi360.jobs.matching.place_job import MOST_PAIRS
from epi360.jobs.matching.verify_pairs import VerifiedGraph
from epi360.report.text import counted, wrapped

# What is said of so many pairs, by the words of `PairVerdict.rejection`; others say it themselves.
REJECTIONS = {
    "too_few_matches": "had too few matches",
    "too_few_inliers": "had too few matches that agree with one pose",
    "pure_rotation": "showed a camera that turned without moving",
    "planar_ambiguous": "fitted two poses about equally well",
    "concentrated_inliers": "had agreeing matches on too small a part of the sphere",
    "unreadable_image": "had an image that could not be read",
    CONTRADICTED: "did not fit other pairs",
}
Row = tuple[str, str]  # label and text

_MAX_LISTED = 10
_GROUPS_NAMED = 6
_FEW_NAMED = 4
_WITH_AGREED = {
    "matched": "They were matched again by these, which cameras.json in the output has; "
    "--keep-cameras keeps those that were given.",
    "judged": "They were judged by these, which a COLMAP database keeps.",
    "tracked": "All images were tracked and matched by these, which cameras.json in the output "
    "has; --keep-cameras keeps those that were given.",
    "told": "They were judged by the given ones.",
}
_TAKES_LENSES = "--change-cameras takes the lenses that they agree on."
_DOUBTED_BY_CHANCE = 0.1  # of accepted pairs whose cameras are right; 0.02 of real ones are


def describe_match(run: MatchRun, skipped: Sequence[tuple[str, str]] = ()) -> str:
    """Lines that say how many pairs have a pose, and why other pairs and images have none."""
    there = f", {run.num_found} were there" if run.num_found else ""
    first = [
        ("Images", f"{len(run.images)}"),
        ("Pairs", f"{len(run.verdicts)} ({run.how})" + there),
    ]
    return _described(run, first, skipped)


def describe_verified(judged: VerifiedGraph) -> str:
    """Lines that say how many pairs of given matches have a pose, and why others have none."""
    had_one = f", {len(judged.kept)} more had a pose" if judged.kept else ""
    first = [("Verified", counted(len(judged.verdicts), "pair") + had_one)]
    return _described(judged, first)


def _described(
    judged: JudgedPairs, first: list[Row], skipped: Sequence[tuple[str, str]] = ()
) -> str:
    accepted = [verdict for verdict in judged.verdicts if verdict.accepted]
    rows = [*first, ("Accepted", f"{len(accepted)}")]
    if accepted:
        inliers = np.median([verdict.num_inliers for verdict in accepted])
        rows.append(("", f"median of {inliers:.0f} inliers"))
    counts = Counter(verdict.rejection for verdict in judged.verdicts if not verdict.accepted)
    rows += [("Rejected", f"{count} {_rejected(words)}") for words, count in counts.most_common()]
    rows += _listed("Not used", [f"{name}: {why}" for name, why in not_used(judged, skipped)])
    joined = joined_images(judged)
    paired = {name for names in joined for name in names}
    rows += _listed("No pair", [name for name in judged.images if name not in paired])
    if len(groups_of(joined)) > 1:
        rows.append(("Groups", groups_sentence(judged.images, joined)))
    lines = [wrapped(label, value) for label, value in rows]
    return "\n".join([*lines, *describe_judged(judged)])


def not_used(judged: JudgedPairs, skipped: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Name and reason of each image of no use; ``skipped`` were so before any was paired."""
    return sorted([*judged.unreadable.items(), *skipped])


def joined_images(judged: JudgedPairs) -> list[tuple[str, str]]:
    """Names of the images of all pairs that have a pose to use."""
    accepted = (verdict for verdict in judged.verdicts if verdict.accepted)
    kept = (names for names in judged.kept if names not in judged.questioned)
    return [*((verdict.image1, verdict.image2) for verdict in accepted), *kept]


def branch_sentence(branch: Branch) -> str:
    """What hangs on one pair of a map, and why that matters."""
    hang = "hangs" if len(branch.images) == 1 else "hang"
    pair = " - ".join(branch.pair)
    return f"{_first_few(branch.images)} {hang} on {pair} alone: nothing checks how far away"


def no_translation_sentence(judged: JudgedPairs) -> str:
    """Why there is nothing to map where no pair shows a translation."""
    turned = sum(verdict.rejection == "pure_rotation" for verdict in judged.verdicts)
    why = "pairs.csv says why"
    if turned:
        why = (
            f"in {turned:,} of {counted(len(judged.verdicts), 'pair')} the camera only turned "
            "(pure_rotation); take pictures from several places"
        )
    return f"no pair has a translation, so there is nothing to map: {why}"


def describe_questioned(judged: JudgedPairs) -> list[str]:
    """A line that names the pairs whose poses were kept though something speaks against them."""
    count = len(judged.questioned)
    if not count:
        return []
    named = _first_few([" - ".join(names) for names in judged.questioned])
    what = "1 pair keeps a pose" if count == 1 else f"{count} pairs keep poses"
    return [
        f"{what} that others or its own inliers speak against ({named}): --verify-again "
        "judges all pairs anew."
    ]


def describe_judged(judged: JudgedPairs) -> list[str]:
    """Lines that say what all pairs together have told, and what they could not tell."""
    return [
        *describe_rig(judged),
        *describe_noise(judged),
        *describe_agreed(judged),
        *describe_calibration(judged),
        *describe_level(judged),
        *describe_others(judged),
        *describe_questioned(judged),
        *describe_not_compared(judged),
    ]


def describe_rig(judged: JudgedPairs) -> list[str]:
    """Lines that name the cameras of a rig which pairs see turned otherwise than is stated."""
    return [
        f"{doubt.num_pairs:,} pairs see {' and '.join(doubt.cameras)} turned against each other "
        f"otherwise than the rig says, by {doubt.off_deg:.1f} degrees (median): do the images lie "
        "in the folders of their cameras, and is cam_from_rig right? A map follows the rig."
        for doubt in judged.rig_doubts
    ]


def describe_noise(judged: JudgedPairs) -> list[str]:
    """A line that counts accepted pairs whose noise is too large for the given cameras."""
    accepted = [verdict for verdict in judged.verdicts if verdict.accepted]
    count = sum(_asks(verdict, NOISE_QUESTION) for verdict in accepted)
    if not count:
        return []
    return [
        f"{count:,} of {counted(len(accepted), 'accepted pair')} {'has' if count == 1 else 'have'} "
        "more noise than SIFT's key points have (their warnings say how much). Learned ones may be "
        f"as coarse; if yours are not, {NOISE_QUESTION}"
    ]


def describe_calibration(judged: JudgedPairs) -> list[str]:
    """A line that counts accepted pairs which other angles of the cameras suit better."""
    accepted = [verdict for verdict in judged.verdicts if verdict.accepted]
    count = sum(_asks(verdict, CALIBRATION_QUESTION) for verdict in accepted)
    if count <= _DOUBTED_BY_CHANCE * len(accepted):
        return []
    return [
        f"{count:,} of {counted(len(accepted), 'accepted pair')} would agree better with other "
        f"angles of the cameras: {CALIBRATION_QUESTION} Their warnings say by how much."
    ]


def describe_agreed(judged: JudgedPairs) -> list[str]:
    """Lines that say which cameras are other ones than were given."""
    if not judged.agreed:
        return []
    is_of_lens = any(word in what for what in judged.agreed for word in OF_LENS)
    who = "tracks" if judged.with_agreed == "tracked" else "pairs"
    return [
        *(f"The {who} agree on other angles of {what}." for what in judged.agreed),
        _WITH_AGREED[judged.with_agreed],
        *([_TAKES_LENSES] if judged.with_agreed == "told" and is_of_lens else []),
    ]


def _asks(verdict: PairVerdict, question: str) -> bool:
    return any(question in text for text in verdict.warnings)


def describe_not_compared(judged: JudgedPairs) -> list[str]:
    """Lines that warn of rooms that look alike where nobody told them apart."""
    lines = []
    if judged.num_not_compared:
        lines.append(
            f"The surroundings of {judged.num_not_compared:,} accepted pairs were not compared, "
            f"which is done for up to {MOST_PAIRS:,}: rooms that look alike may be taken for one. "
            "Fewer pairs, or a folder for each floor, let them be compared."
        )
    if judged.gone:
        name, why = min(judged.gone.items())
        lines.append(
            f"The surroundings of {_first_few(sorted(judged.gone))} were not compared, for what "
            f"could be read at first cannot be read any more ({name}: {why}): rooms that look "
            "alike may be taken for one. Run the same command again when it is there."
        )
    return lines


def describe_level(judged: JudgedPairs) -> list[str]:
    """A line that says what a level folder brought; none where it is not level."""
    if judged.level is None:
        return []
    known = f"tilt {judged.level.gravity_sigma_deg:.1f} degrees"
    if judged.level.elevation_sigma_deg is not None:
        known += f", one height within {judged.level.elevation_sigma_deg:.1f} degrees"
    if not judged.num_gained and not judged.num_lost:
        return [f"The panoramas are level ({known})."]
    line = f"The panoramas are level ({known}): {_more_pairs(judged.num_gained)} accepted with that"
    return [line + (f", {judged.num_lost} not any more." if judged.num_lost else ".")]


def describe_others(judged: JudgedPairs) -> list[str]:
    """A line that says what pairs say about others; none where that brought nothing."""
    count = judged.num_by_others
    if not count:
        return []
    return [f"{_more_pairs(count)} accepted because of what other pairs know of the place."]


def _more_pairs(count: int) -> str:
    return "1 more pair was" if count == 1 else f"{count} more pairs were"


def groups_of(joined: Iterable[tuple[str, str]]) -> list[int]:
    """Sizes of the groups of images that pairs join, the largest first."""
    return sorted(Counter(groups_by(joined).values()).values(), reverse=True)


def groups_sentence(names: Sequence[str], joined: Iterable[tuple[str, str]]) -> str:
    """Whether accepted pairs join all images, as a sentence."""
    groups = groups_of(joined)
    alone = len(names) - sum(groups)
    if len(groups) == 1 and not alone:
        return "The accepted pairs join all images."
    if not groups:
        return "No image is joined to another one."
    sizes = " and ".join(str(size) for size in groups[:_GROUPS_NAMED])
    if len(groups) > _GROUPS_NAMED:
        sizes += " and fewer"
    what = f"one group of {sizes}" if len(groups) == 1 else f"{len(groups)} groups of {sizes}"
    left = f" and leave {counted(alone, 'image')} alone" if alone else ""
    return f"The accepted pairs join {what} images{left}."


def _rejected(words: str) -> str:
    return f"{REJECTIONS[words]} ({words})" if words in REJECTIONS else words


def _listed(label: str, lines: list[str]) -> list[Row]:
    rows = [(label, line) for line in lines[:_MAX_LISTED]]
    if len(lines) > _MAX_LISTED:
        rows.append((label, f"and {len(lines) - _MAX_LISTED} more"))
    return rows


def _first_few(names: Sequence[str]) -> str:
    more = f" and {len(names) - _FEW_NAMED} more" if len(names) > _FEW_NAMED else ""
    return ", ".join(names[:_FEW_NAMED]) + more
