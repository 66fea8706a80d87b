# SPDX-License-Identifier: BSD-3-Clause
"""Table 2: the gold standard method with eight kinds of weights."""

from typing import Any

from epi360.progress import Progress
from epi360_paper.method_rows import Cell, Comparison, PrintedRow, pair_rows, run_comparison
from epi360_paper.options import Outcome, ReproduceOptions
from epi360_paper.trials import Trial

PRINTED = {
    "gsm": PrintedRow("GSM", 9.1029, 19.7902, 45.318),
    "gsm_irls_xi": PrintedRow("Gaussian, not const ω_ξ", 2.0951, 5.2065, 218.598),
    "gsm_irls_sk": PrintedRow("Gaussian, not const ω_SK", 2.0943, 5.1894, 212.924),
    "gsm_w_xi": PrintedRow("Gaussian, ω_ξ", 3.9048, 9.2592, 50.279),
    "gsm_w_sk": PrintedRow("Gaussian, ω_SK", 3.6802, 7.5717, 58.651),
    "gsm_irls_xi_t": PrintedRow("t, not const ω_ξ", 9.1810, 19.8160, 48.126),
    "gsm_irls_sk_t": PrintedRow("t, not const ω_SK", 8.9496, 18.9284, 58.836),
    "gsm_w_xi_t": PrintedRow("t, ω_ξ", 9.1810, 19.8160, 50.279),
    "gsm_w_sk_t": PrintedRow("t, ω_SK", 9.0581, 19.5573, 53.795),
}
# Columns of the page, by the names in `Printed`.
ROW = {"rotation": "Rot-e, 1e-3", "translation": "Tran-e, 1e-3", "time_ms": "time, ms"}


def evaluate(cell: Cell, trial: Trial) -> list[dict[str, Any]]:
    """Rows of a trial: errors and time of the nine methods on each of its pairs."""
    return pair_rows(cell.source.pairs(trial), tuple(PRINTED), cell.protocol)


TABLE = Comparison("table2", "Table 2: weights of the gold standard method", evaluate, PRINTED, ROW)


def run(options: ReproduceOptions, progress: Progress) -> Outcome:
    """Run Table 2."""
    return run_comparison(TABLE, options, progress)
