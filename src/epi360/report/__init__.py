# SPDX-License-Identifier: BSD-3-Clause
"""Results for people and programs: text, JSON records and figures.

`epi360.report.figure` is imported on its own: it needs matplotlib, which is slow to import.
"""

from epi360.report.files import check_writable
from epi360.report.records import pair_record, pose_record, write_json
from epi360.report.text import describe_pair, describe_status
from epi360.runs.whole_files import write_file

__all__ = [
    "check_writable", "describe_pair", "describe_status", "pair_record", "pose_record",
    "write_file", "write_json",
]  # fmt: skip
