# SPDX-License-Identifier: BSD-3-Clause
"""What was said of frames, brought up to date with the maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from epi360.odometry.frame_result import FrameResult, MapPoints, Trajectory
from epi360.odometry.segment import Segment
from epi360.poses import Pose


def updated_results(
    results: Sequence[FrameResult], segments: Mapping[int, Segment], main: Segment
) -> list[FrameResult]:
    """Results with the poses of the main map; frames of other maps are lost, and say so."""
    key_frames = {each.index for each in main.map.key_frames}
    number_of = {
        index: number
        for number in sorted(segments, reverse=True)
        for index in segments[number].frames
    }
    return [_updated(result, main, key_frames, number_of.get(result.index)) for result in results]


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


def trajectory_of(results: Sequence[FrameResult]) -> Trajectory:
    """Poses of the frames that have one."""
    tracked = [result for result in results if result.status == "tracked"]
    return Trajectory(
        np.array([result.index for result in tracked], np.int64),
        np.array([result.timestamp_s for result in tracked]),
        tuple(result.cam_from_world for result in tracked),
    )


def no_points() -> MapPoints:
    """Points of a map that has not begun."""
    none = np.zeros(0, np.int64)
    return MapPoints(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), none, none, np.zeros((0, 2)))


def joined(*sentences: str) -> str:
    """One message of those sentences that say something."""
    return "; ".join(sentence for sentence in sentences if sentence)
