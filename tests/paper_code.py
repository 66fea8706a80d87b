# SPDX-License-Identifier: BSD-3-Clause
"""Where the tests find the paper's experiments, so that a move of that code is two lines here."""

from epi360.datasets import intensities, trajectories
from epi360.experiments import (
    method_rows,
    methods,
    options,
    parts,
    protocols,
    sources,
    table4,
    trials,
)

__all__ = [
    "intensities",
    "method_rows",
    "methods",
    "options",
    "parts",
    "protocols",
    "sources",
    "table4",
    "trajectories",
    "trials",
]
