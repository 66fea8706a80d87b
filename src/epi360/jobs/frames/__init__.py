# SPDX-License-Identifier: BSD-3-Clause
"""Frames of videos and of folders: which to keep, and as images of a folder."""
