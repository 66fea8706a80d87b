# SPDX-License-Identifier: BSD-3-Clause
"""The images of a folder, their cameras, masks and key points."""
