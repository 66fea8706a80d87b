# SPDX-License-Identifier: BSD-3-Clause
"""What the accepted pairs of a folder say about each other."""
