# SPDX-License-Identifier: BSD-3-Clause
"""Table 1: the eight-point algorithm under five normalisations."""

from dataclasses import dataclass
from typing import Any

from epi360.epipolar.sk_search import search_sk
from epi360.epipolar.stability import stability
from epi360.progress import Progress
from epi360_paper.method_rows import Cell, Comparison, PrintedRow, pair_rows, run_comparison
from epi360_paper.options import Outcome, ReproduceOptions
from epi360_paper.protocols import PROTOCOLS
from epi360_paper.tracks import BearingPair
from epi360_paper.trials import Trial


@dataclass(frozen=True)
class Printed(PrintedRow):
    """A row of the paper's table, and the normalisation's name in `eight_point`."""

    normalization: str
    sigma_8: float
    alpha_rad: float


PRINTED = {
    "opt_sk": Printed("Opt ε(S, K)", 11.429, 25.416, 45.52, "sk", 20.025, 0.858),
    "8pa": Printed("8-PA", 13.387, 32.367, 40.33, "none", 0.650, 0.731),
    "8pa_isotropic": Printed("isotropic (a)", 15.937, 49.414, 40.33, "isotropic", 1.232, 0.723),
    "8pa_non_isotropic": Printed(
        "non-isotropic (b)", 13.439, 34.354, 40.33, "non_isotropic", 0.012, 0.723
    ),
    "8pa_isotropic_non_isotropic": Printed(
        "(a) + (b)", 14.173, 38.808, 40.88, "isotropic+non_isotropic", 0.107, 0.879
    ),
}
MEASURED = ("sigma_8", "sigma_8_over_sigma_1", "alpha_rad")
# Columns of the page, by the names in `Printed`; the paper has no σ₈/σ₁.
ROW = {
    "sigma_8": "σ₈",
    "sigma_8_over_sigma_1": "σ₈/σ₁",
    "alpha_rad": "α, rad",
    "rotation": "Rot-e, 1e-3",
    "translation": "Tran-e, 1e-3",
    "time_ms": "time, ms",
}
SCALE = (
    "σ₈ grows with the square of the scale of N, on which E does not depend: for Opt ε(S, K) it "
    "says where the search has left S. σ₈/σ₁ is free of it. α holds the turn of the camera."
)


def evaluate(cell: Cell, trial: Trial) -> list[dict[str, Any]]:
    """Rows of a trial: stability, errors and time of the five methods on each of its pairs."""
    search = PROTOCOLS[cell.protocol].sk_search

    def measure(pair: BearingPair, method: str) -> dict[str, float]:
        return _stability(pair, PRINTED[method].normalization, search)

    pairs = cell.source.pairs(trial)
    return pair_rows(pairs, tuple(PRINTED), cell.protocol, measure, MEASURED)


TABLE = Comparison(
    "table1", "Table 1: eight-point methods", evaluate, PRINTED, ROW, MEASURED, (SCALE,)
)


def run(options: ReproduceOptions, progress: Progress) -> Outcome:
    """Run Table 1."""
    return run_comparison(TABLE, options, progress)


def _stability(pair: BearingPair, normalization: str, search: str) -> dict[str, float]:
    b1, b2 = pair.bearings1, pair.bearings2
    # The line search has S = 1; sigma_8 as printed needs the S that Levenberg-Marquardt ends at.
    domain = search_sk(b1, b2, search)[:2] if normalization == "sk" else normalization
    measures = stability(b1, b2, domain)
    values = measures.sigma_8, measures.sigma_8_over_sigma_1, measures.mean_alpha_rad
    return dict(zip(MEASURED, values, strict=True))
