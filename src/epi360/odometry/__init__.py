# SPDX-License-Identifier: BSD-3-Clause
"""Image sequence to trajectory and map."""
