# SPDX-License-Identifier: BSD-3-Clause
"""A folder of images to verified relative poses of its pairs."""
