# SPDX-License-Identifier: BSD-3-Clause
"""A video or a folder of frames to a trajectory and a map."""
