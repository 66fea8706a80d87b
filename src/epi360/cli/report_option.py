# SPDX-License-Identifier: BSD-3-Clause
"""The option ``--report`` of the commands that write a page."""

from pathlib import Path


def check_report(report: Path) -> None:
    """Raise before the work where the page could not be written."""
    from epi360.report.files import check_report_name, check_writable

    check_report_name(report, name="--report")
    check_writable(report, name="--report")
