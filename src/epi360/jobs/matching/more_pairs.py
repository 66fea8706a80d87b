# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of images that look alike, or were taken near each other."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.matching.match_job import MatchJob
from epi360.jobs.pairs.pair_selection import MorePairs, Pair
from epi360.jobs.pairs.positions import near_pairs, positions_of_images
from epi360.jobs.pairs.retrieval import alike_pairs
from epi360.progress import Progress


def more_pairs(
    images: ImageSet,
    job: MatchJob,
    trajectory: Path | None,
    radius: float | None,
    progress: Progress,
) -> dict[str, MorePairs]:
    """Ways to choose pairs that look into the images, as `select_pairs` takes them.

    Retrieval finds the key points of all images. "near" is within ``radius``, if that is given, in
    the unit of the trajectory; without one, by GPS in metres.
    """

    def alike(count: int, known: Collection[Pair]) -> tuple[str, list[Pair]]:
        job.find_features(range(len(images.images)))
        pairs = alike_pairs(
            job.descriptors,
            len(images.images),
            count,
            without=known,
            num_threads=job.work.num_threads,
            progress=progress,
        )
        return f"retrieval, {count} that look alike", pairs

    def near(count: int, known: Collection[Pair]) -> tuple[str, list[Pair]]:
        positions = positions_of_images(images, trajectory)
        within = "" if radius is None else f" within {radius:g}"
        within += " m" if radius is not None and trajectory is None else ""
        words = f"near, {count} nearest{within} by {positions.source}"
        if positions.num_unknown:
            words += f" ({positions.num_unknown} of {len(images.images)} images are not placed)"
        return words, near_pairs(positions.centers, count, radius, without=known)

    return {"retrieval": alike, "near": near}
