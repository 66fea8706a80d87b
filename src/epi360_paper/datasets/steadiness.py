# SPDX-License-Identifier: BSD-3-Clause
"""Which frames of a sequence can be tracked, and the rule that skips violent motion."""

from dataclasses import dataclass

import numpy as np

from epi360.poses import rotation_error_deg
from epi360_paper.datasets.intensities import mean_brightness
from epi360_paper.datasets.sequence import ImageSequence


@dataclass(frozen=True)
class SkipRule:
    """When the step from one frame to the next is too violent to be tracked.

    The paper (section 5.3) skips frames of TUM-VI "due to drastic camera movements and severe
    changes in illumination" and gives no numbers; these are ours: at 20 images per second 120 deg/s
    are 6 deg or 20 px of TUM-VI's 512-pixel images per frame, and about 1 px of blur in 3 ms of
    exposure. ``max_brightness_ratio`` compares the mean grey values of the two frames, the brighter
    to the darker. A rate that is not positive or a ratio not above 1 raises ``ValueError``.
    """

    max_rotation_deg_per_s: float = 120.0
    max_brightness_ratio: float = 1.25

    def __post_init__(self) -> None:
        if not self.max_rotation_deg_per_s > 0:
            rate = self.max_rotation_deg_per_s
            raise ValueError(f"max_rotation_deg_per_s must be positive, got {rate}")
        if not self.max_brightness_ratio > 1:
            ratio = self.max_brightness_ratio
            raise ValueError(f"max_brightness_ratio must be above 1, got {ratio}")


def steady_segments(sequence: ImageSequence, rule: SkipRule | None = None) -> list[range]:
    """Runs of at least two frames with known poses between which every step is calm.

    By default only a missing pose ends a run. The frame after a violent step starts a new one. The
    images are read, and may be found damaged, if the rule has a brightness ratio to test.
    """
    starts = [0]
    brightness = np.nan
    for index in range(len(sequence)):
        known = sequence.world_from_cam[index] is not None
        before, brightness = brightness, np.nan
        if known and rule is not None:
            brightness = mean_brightness(sequence.image_paths[index], sequence.mask)
        calm = index > 0 and known and _is_calm(sequence, index, before, brightness, rule)
        if not calm:
            starts.append(index)
    ends = [*starts[1:], len(sequence)]
    return [range(start, end) for start, end in zip(starts, ends, strict=True) if end - start > 1]


def _is_calm(
    sequence: ImageSequence,
    index: int,
    brightness_before: float,
    brightness: float,
    rule: SkipRule | None,
) -> bool:
    before, after = sequence.world_from_cam[index - 1 : index + 1]
    if before is None or after is None:
        return False
    if rule is None:
        return True
    seconds = float(sequence.timestamps_s[index] - sequence.timestamps_s[index - 1])
    dark, bright = sorted((brightness_before, brightness))
    return (
        rotation_error_deg(before, after) <= rule.max_rotation_deg_per_s * seconds
        and bright <= rule.max_brightness_ratio * dark
    )
