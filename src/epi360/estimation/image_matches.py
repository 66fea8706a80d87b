# SPDX-License-Identifier: BSD-3-Clause
"""What is known of matches of key points in images: how they are sampled, and how good they are."""

from typing import TypedDict

from epi360.estimation.options import RansacOptions

# Key points are good to a third of a pixel. If the two fisheye cameras are swapped, the noise is
# about two pixels.
MAX_NOISE_PX = 1.5
# No key points are better than that: of 513 rendered pairs in homes, whose pictures have no noise
# at all, five had less, four of these by chance, from 15 inliers and fewer.
MIN_NOISE_PX, _MOST_OF_LEAST_DEG = 0.05, 0.02  # bearings without pictures may have any camera
# Fifteen to twenty inliers is what careful tools ask of an image pair. Beside the features sampling
# costs nothing, and real matches have near misses that a few more samples see through.
IMAGE_OPTIONS = RansacOptions(
    min_num_inliers=15, min_iterations=50, confidence=0.9999, shared_error=1.0
)


class KeypointNoise(TypedDict):
    """What the noise of key points is at least and at most, in degrees."""

    min_noise_deg: float
    max_noise_deg: float


def noise_of_keypoints(pixel_deg: float) -> KeypointNoise:
    """Arguments of the estimator for matches of images whose smaller pixel has that size."""
    least = min(MIN_NOISE_PX * pixel_deg, _MOST_OF_LEAST_DEG)
    return {"min_noise_deg": least, "max_noise_deg": MAX_NOISE_PX * pixel_deg}
