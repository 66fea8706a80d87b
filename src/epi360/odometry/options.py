# SPDX-License-Identifier: BSD-3-Clause
"""Options of the odometry."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OdometryOptions:
    """How a sequence is tracked.

    Parameters
    ----------
    max_points : int
        Most points that are followed at a time.
    key_frame_parallax_deg : float
        A frame becomes a key frame when half of the points have moved by this angle, turning
        apart, since the key frame before.
    min_survival : float
        It also becomes one when fewer than this share of the points of the key frame before are
        left.
    max_width : int
        Wider frames are tracked at this width; pixels stay those of the frames.
    window : int
        So many of the last key frames are adjusted together.
    start_sigma_deg : float
        The map begins when the direction of motion since the first frame is known to this standard
        deviation.
    min_inliers : int
        A frame with fewer points that agree with its pose is lost. Fewer than 30 must also be at
        least half of the points in view that the map knows; more of them, 30 percent.
    loop_closure : bool
        Whether places that are seen again correct the trajectory.

    Raises
    ------
    ValueError
        If an option is out of range.
    """

    max_points: int = 800
    key_frame_parallax_deg: float = 3.0
    min_survival: float = 0.7
    max_width: int = 1600
    window: int = 8
    start_sigma_deg: float = 2.0
    min_inliers: int = 15
    loop_closure: bool = True

    def __post_init__(self) -> None:
        for name in ("max_points", "key_frame_parallax_deg", "start_sigma_deg"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not 0 < self.min_survival < 1:
            raise ValueError(f"min_survival must be between 0 and 1, got {self.min_survival}")
        if self.max_width < 64:
            raise ValueError(f"max_width must be at least 64 pixels, got {self.max_width}")
        if self.window < 3:
            raise ValueError(f"window must be at least 3 key frames, got {self.window}")
        if self.min_inliers < 8:
            raise ValueError(f"min_inliers must be at least 8, got {self.min_inliers}")
