# SPDX-License-Identifier: BSD-3-Clause
"""Table 3: quartiles of the errors on sequences, full panoramas and a fisheye lens."""

from pathlib import Path
from typing import Any, get_args

import numpy as np

from epi360.progress import Progress
from epi360_paper.method_rows import (
    PAPERS_PAIRS,
    Cell,
    num_sequences,
    pair_rows,
    pairs_line,
    rendered_cell,
    run_sequences,
)
from epi360_paper.methods import METHODS, TITLES
from epi360_paper.options import Outcome, ReproduceOptions
from epi360_paper.parts import Trials
from epi360_paper.results import (
    Compared,
    comparison_table,
    in_thousandths,
    run_line,
    save_page,
    save_trials,
)
from epi360_paper.sources import BLOCKS_PER_SCENE, DatasetName, dataset_sources, pair_rule
from epi360_paper.trials import Trial

# Quartile: rotation errors of the five methods in 1e-3, then translation errors.
MP3D_VO = {
    0.75: ((23.577, 20.504, 15.286, 9.909, 7.964), (91.442, 72.693, 43.707, 29.945, 20.653)),
    0.50: ((10.827, 9.515, 7.389, 3.523, 3.072), (36.814, 29.645, 19.453, 9.985, 7.966)),
    0.25: ((4.624, 4.075, 3.277, 1.638, 1.524), (14.745, 12.276, 8.501, 4.611, 4.009)),
}
TUM_VI = {
    0.75: ((44.479, 40.514, 49.291, 39.938, 38.256), (221.131, 199.042, 166.594, 169.122, 140.846)),
    0.50: ((27.211, 24.969, 27.226, 21.075, 19.241), (117.701, 104.742, 82.457, 74.661, 62.743)),
    0.25: ((15.512, 14.462, 14.595, 10.507, 9.708), (58.791, 53.283, 40.899, 33.724, 28.800)),
}
PRINTED = {"mp3d_vo": MP3D_VO, "tum_vi": TUM_VI}
HEADINGS = {
    "rendered-360": "Rendered panoramas (paper: MP3D-VO)",
    "rendered-fisheye": "Rendered fisheye images of 195° (paper: TUM-VI)",
    "mp3d_vo": "MP3D-VO",
    "tum_vi": "TUM-VI",
}


def run(options: ReproduceOptions, progress: Progress) -> Outcome:
    """Run Table 3."""
    # A wrong folder is an error now, not after the hour that the rendered sequences take.
    given: dict[DatasetName, Path | None] = {"mp3d_vo": options.mp3d_vo, "tum_vi": options.tum_vi}
    recorded = {name: _cells(name, folder, options) for name, folder in given.items() if folder}
    parts = {"table3": _rendered(options, progress)}
    for dataset, cells in recorded.items():
        name = f"table3-{dataset}"
        parts[name] = run_sequences(name, cells, evaluate, BLOCKS_PER_SCENE, options, progress)
    files = [
        file for name, part in parts.items() for file in save_trials(options.folder(name), part)
    ]
    count = num_sequences(options)
    page, text = save_page(
        options.folder("table3"),
        "Table 3: quartiles on sequences",
        run_line(options, count, parts["table3"], "rendered sequences"),
        _sections(parts),
    )
    return Outcome("table3", (*files, page), text)


def evaluate(cell: Cell, trial: Trial) -> list[dict[str, Any]]:
    """Rows of a trial: errors and time of the five methods on each of its pairs."""
    return pair_rows(cell.source.pairs(trial), METHODS, cell.protocol)


def _rendered(options: ReproduceOptions, progress: Progress) -> Trials:
    cells = {
        "rendered-360": rendered_cell("360", options),
        "rendered-fisheye": rendered_cell("fisheye", options),
    }
    count = num_sequences(options)
    return run_sequences("table3", cells, evaluate, count, options, progress)


def _cells(dataset: DatasetName, folder: Path, options: ReproduceOptions) -> dict[str, Cell]:
    sources = dataset_sources(
        dataset,
        folder,
        pair_rule(options.protocol),
        options.num_trials(PAPERS_PAIRS),
        options.out / "tracks",
    )
    return {name: Cell(source, options.protocol) for name, source in sources.items()}


def _sections(parts: dict[str, Trials]) -> list[str]:
    sections = []
    for cell, dataset in (("rendered-360", "mp3d_vo"), ("rendered-fisheye", "tum_vi")):
        trials = parts["table3"].where(cell=cell)
        sections += _quartiles(HEADINGS[cell], trials, dataset, "rendered sequences")
    for dataset in get_args(DatasetName):
        if f"table3-{dataset}" in parts:
            trials = parts[f"table3-{dataset}"]
            sections += _quartiles(HEADINGS[dataset], trials, dataset, "stretches")
    return sections


def _quartiles(heading: str, trials: Trials, dataset: str, what: str) -> list[str]:
    sections = [f"### {heading}"]
    if not len(trials):
        return [*sections, "No pair of frames had enough tracks."]
    for place, (title, column) in enumerate(
        (("Rot-e, 1e-3", "rotation_error"), ("Tran-e, 1e-3", "translation_error"))
    ):
        rows = {}
        for quartile, papers in PRINTED[dataset].items():
            ours = (in_thousandths(trials.where(method=m)[column], quartile) for m in METHODS)
            rows[f"Q{100 * quartile:.0f}"] = [
                Compared(paper, our) for paper, our in zip(papers[place], ours, strict=True)
            ]
        sections.append(comparison_table(title, [TITLES[m] for m in METHODS], rows))
    gain = _gain(trials)
    return [*sections, f"{pairs_line(trials, what)} {gain}"]


def _gain(trials: Trials) -> str:
    median = {
        (method, column): in_thousandths(trials.where(method=method)[f"{column}_error"])
        for method in METHODS
        for column in ("rotation", "translation")
    }
    texts = []
    for better, base in (("opt_sk", "8pa"), ("gsm_w_sk", "gsm"), ("gsm_w_sk", "gsm_w_xi")):
        gains = [
            100 * (1 - np.divide(median[better, column], median[base, column]))
            for column in ("rotation", "translation")
        ]
        texts.append(
            f"{TITLES[better]} against {TITLES[base]}: {gains[0]:+.0f} % / {gains[1]:+.0f} %"
        )
    return f"Error saved at the median (rotation / translation): {'; '.join(texts)}."
