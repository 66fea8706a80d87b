# SPDX-License-Identifier: BSD-3-Clause
"""A folder of images to a COLMAP model."""
