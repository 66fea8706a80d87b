# SPDX-License-Identifier: BSD-3-Clause
"""What two images with a pose show of one place."""
