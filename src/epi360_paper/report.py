# SPDX-License-Identifier: BSD-3-Clause
"""The pages of a run collected into a document, so that no number is typed by hand."""

import os
import platform
import re
from pathlib import Path
from typing import get_args

from epi360.runs.whole_files import write_file
from epi360_paper import EXPERIMENTS
from epi360_paper.options import ProtocolName

BEGIN = "<!-- begin: epi360 reproduce report -->"
END = "<!-- end: epi360 reproduce report -->"


def collect_tables(out: Path) -> str:
    """All ``table.md`` of a run, in the paper's order, one heading level lower."""
    pages = sorted(out.glob("*/table.md"), key=lambda page: _place(page.parent.name))
    if not pages:
        raise ValueError(f"{out} must hold tables, found none; run epi360 reproduce all first")
    system = f"{platform.system()} on {platform.machine()}"
    machine = f"Collected on {system}, {os.cpu_count()} cores, Python {platform.python_version()}."
    return "\n\n".join([machine, *(_section(page) for page in pages)]) + "\n"


def insert_tables(document: Path, tables: str) -> None:
    """Replace what stands between the two marks of a document."""
    text = document.read_text(encoding="utf-8")
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{document} must hold the lines {BEGIN} and {END}")
    write_file(document, f"{head}{BEGIN}\n\n{tables}\n{END}{tail}".encode())


def _section(page: Path) -> str:
    """Page one heading level lower; its title names a protocol other than "printed"."""
    text = re.sub(r"^#", "##", page.read_text(encoding="utf-8"), flags=re.M).strip()
    protocol = page.parent.name.rpartition("-")[2]
    if protocol in get_args(ProtocolName):
        title, _, rest = text.partition("\n")
        text = f"{title} (`{protocol}`)\n{rest}"
    return text


def _place(name: str) -> tuple[int, str]:
    experiment = name.partition("-")[0]
    known = EXPERIMENTS.index(experiment) if experiment in EXPERIMENTS else len(EXPERIMENTS)
    return known, name
