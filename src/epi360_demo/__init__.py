# SPDX-License-Identifier: BSD-3-Clause
"""The page of `epi360 demo`: two images to a pose, and the paper's estimators to play with."""
