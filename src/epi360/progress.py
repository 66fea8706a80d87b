# SPDX-License-Identifier: BSD-3-Clause
"""How long work tells whoever watches how far it is."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with (what is running, pieces done, pieces in all), from the process that was started."""


def no_progress(stage: str, done: int, total: int) -> None:
    """Nothing: the progress of a run that nobody watches."""
