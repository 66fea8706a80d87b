# SPDX-License-Identifier: BSD-3-Clause
"""The figures and tables of Robust 360-8PA (2021), one module each, loaded when it runs."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from epi360.progress import Progress
    from epi360_paper.options import Outcome, ReproduceOptions

    Experiment = Callable[[ReproduceOptions, Progress], Outcome]

# Where each experiment lives, in the paper's order.
_HOMES = {
    "fig1": "fig1:run",
    "fig2": "fig2:run",
    "fig3": "fig3:run",
    "fig4a": "fig4:run_a",
    "fig4b": "fig4:run_b",
    "fig4c": "fig4:run_c",
    "table1": "table1:run",
    "table2": "table2:run",
    "table3": "table3:run",
    "table4": "table4:run",
}
EXPERIMENTS = tuple(_HOMES)


def load_experiment(name: str) -> Experiment:
    """Function that runs an experiment; ``ValueError`` if `EXPERIMENTS` has no such name."""
    if name not in _HOMES:
        raise ValueError(f"name must be one of {', '.join(EXPERIMENTS)}, got {name!r}")
    module, _, function = _HOMES[name].partition(":")
    run: Experiment = getattr(import_module(f"{__name__}.{module}"), function)
    return run
