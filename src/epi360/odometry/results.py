# SPDX-License-Identifier: BSD-3-Clause
"""What was said of frames, brought up to date with the maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from epi360.odometry.frame_result import FrameResult
from epi360.odometry.segment import Segment
from epi360.poses import Pose


def updated_results(
    results: Sequence[FrameResult], segments: Sequence[Segment], main: int
) -> list[FrameResult]:
    """Results with the poses of the main map; frames of other maps are lost, and say so."""
    key_frames = {each.index for each in segments[main].map.key_frames}
    number_of = {
        index: number
        for number, segment in reversed(list(enumerate(segments, start=1)))
        for index in segment.frames
    }
    return [
        _updated(result, segments[main], key_frames, number_of.get(result.index))
        for result in results
    ]


def _updated(
    result: FrameResult, main: Segment, key_frames: set[int], number: int | None
) -> FrameResult:
    if result.index in main.frames:
        return replace(
            result,
            status="tracked",
            cam_from_world=main.pose_of(result.index),
            num_inliers=main.frames[result.index].num_inliers,
            is_keyframe=result.index in key_frames,
        )
    if number is None:
        return result
    message = result.message or f"frame {result.index}"
    return replace(
        result,
        status="lost",
        cam_from_world=Pose.nan(),
        is_keyframe=False,
        message=f"{message} (in map {number}, which is not connected)",
    )
