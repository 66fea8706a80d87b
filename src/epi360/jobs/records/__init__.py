# SPDX-License-Identifier: BSD-3-Clause
"""Finished pairs of a match run on disk, and as a graph in little memory."""
