# SPDX-License-Identifier: BSD-3-Clause
"""Poses of many pairs, part by part, on one machine or on many."""

from epi360.jobs.batch.job import BatchJob, estimate_parts, merge_parts, missing_parts
from epi360.jobs.batch.run import BatchSummary, run_batch
from epi360.jobs.batch.sources import MatchSource
from epi360.jobs.engines import Engine

__all__ = [
    "BatchJob",
    "BatchSummary",
    "Engine",
    "MatchSource",
    "estimate_parts",
    "merge_parts",
    "missing_parts",
    "run_batch",
]
