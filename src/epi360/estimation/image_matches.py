# SPDX-License-Identifier: BSD-3-Clause
"""What is known of matches of key points in images: how they are sampled, and how good they are."""

from epi360.estimation.options import RansacOptions

# Key points are good to a third of a pixel. If the two fisheye cameras are swapped, the noise is
# about two pixels.
MAX_NOISE_PX = 1.5
# Fifteen to twenty inliers is what careful tools ask of an image pair. Beside the features sampling
# costs nothing, and real matches have near misses that a few more samples see through.
IMAGE_OPTIONS = RansacOptions(
    min_num_inliers=15, min_iterations=50, confidence=0.9999, shared_error=1.0
)
