# SPDX-License-Identifier: BSD-3-Clause
"""Image sequence to trajectory and map."""

from epi360.odometry.frame_result import FrameResult, MapPoints, Trajectory
from epi360.odometry.key_frames import KeyFrame
from epi360.odometry.odometry import Odometry
from epi360.odometry.options import OdometryOptions

__all__ = ["FrameResult", "KeyFrame", "MapPoints", "Odometry", "OdometryOptions", "Trajectory"]
