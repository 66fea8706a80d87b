# SPDX-License-Identifier: BSD-3-Clause
"""Images of a folder that its first model does not have, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import replace

from epi360.interop.colmap_cameras import colmap_camera
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.graph.graph_check import groups_by
from epi360.jobs.mapping.mapped_models import MODELS, MappedModel
from epi360.jobs.matching.match_folder import MatchRun


def that_colmap_takes(images: ImageSet) -> tuple[ImageSet, dict[str, str]]:
    """The images whose cameras COLMAP has, and why the others are not mapped.

    ``ValueError`` if it has none of them, or lacks one lens of a rig.
    """
    reasons = {}
    for name, camera in images.cameras.items():
        try:
            colmap_camera(camera)
        except ValueError as error:
            if images.cam_from_rig:
                raise
            reasons[name] = str(error)
    if len(reasons) == len(images.cameras):
        raise ValueError(next(iter(reasons.values())))
    kept = tuple(image for image in images.images if image.camera not in reasons)
    cameras = {name: each for name, each in images.cameras.items() if name not in reasons}
    left_out = {
        image.name: reasons[image.camera] for image in images.images if image.camera in reasons
    }
    skipped = (*images.skipped, *left_out.items())
    return replace(images, images=kept, cameras=cameras, skipped=skipped), left_out


def why_unmapped(
    images: ImageSet,
    matched: MatchRun,
    models: tuple[MappedModel, ...],
    unconfirmed: Collection[str],
) -> dict[str, str]:
    """Why each image without a pose in the first model has none."""
    model_of = {
        image.name: number
        for number, model in reversed(list(enumerate(models)))
        for image in model.reconstruction.images
    }
    tried: dict[str, Counter[str]] = {image.name: Counter() for image in images.images}
    for pair in matched.verdicts:
        for name in (pair.image1, pair.image2):
            tried[name]["ok" if pair.accepted else pair.rejection] += 1
    reasons, joined = {}, _joined_to(model_of, matched)
    for name, statuses in tried.items():
        number = model_of.get(name)
        if number == 0:
            continue
        if name in matched.unreadable:
            reasons[name] = matched.unreadable[name]
        elif number is None and name in unconfirmed:
            reasons[name] = "too few points and pairs confirm the place that was found"
        elif number is not None:
            reasons[name] = f"is in {MODELS}/{number}, which does not connect to {MODELS}/0"
        elif not statuses["ok"]:
            counts = ", ".join(f"{count} {status}" for status, count in statuses.most_common())
            reasons[name] = f"no accepted pair ({counts or 'none tried'})"
        elif name not in joined:
            reasons[name] = f"no accepted pair joins it to the images of {MODELS}/0"
        else:
            reasons[name] = "has accepted pairs, but COLMAP's mapper could not place it"
    return reasons


def _joined_to(model_of: Mapping[str, int], matched: MatchRun) -> set[str]:
    """Images that accepted pairs join to those of the first model; all where there is none."""
    accepted = [(each.image1, each.image2) for each in matched.verdicts if each.accepted]
    group_of = groups_by(accepted)
    mapped = {
        group_of[name] for name, number in model_of.items() if not number and name in group_of
    }
    return {name for name, group in group_of.items() if not mapped or group in mapped}
