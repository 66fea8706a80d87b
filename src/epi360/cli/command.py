# SPDX-License-Identifier: BSD-3-Clause
"""What the commands share: the application, exit codes, the line that says what is being done."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

from cyclopts import App, Parameter

SUCCESS, FAILURE, WRONG_USE, INTERRUPTED = 0, 1, 2, 130
Progress = Callable[[str], None]
Flag = Annotated[bool, Parameter(negative=())]


def _version() -> str:
    from epi360.report.records import package_version

    return package_version()


app = App(
    name="epi360",
    help="Relative pose of 360° and other wide-angle images.",
    version=_version,
    suppress_keyboard_interrupt=False,
)


@contextmanager
def show_progress() -> Iterator[Progress]:
    """Show what is being done on stderr while that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda message: None
        return
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True).status("starting") as status:
        yield lambda message: status.update(Text(message))
