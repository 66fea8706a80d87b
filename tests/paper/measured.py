# SPDX-License-Identifier: BSD-3-Clause
"""Which columns of raw trials change from run to run."""


def is_timing(column):
    """Whether a column holds measured times."""
    return column.startswith("time_")
