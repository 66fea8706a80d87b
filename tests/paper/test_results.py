# SPDX-License-Identifier: BSD-3-Clause
"""Files of results: raw trials, pages, and their collection into a document."""

import csv
from pathlib import Path

import numpy as np
import pytest

from epi360_paper.options import ReproduceOptions
from epi360_paper.parts import Trials
from epi360_paper.protocols import PROTOCOLS
from epi360_paper.report import BEGIN, END, collect_tables, insert_tables
from epi360_paper.results import (
    Compared,
    comparison_table,
    in_thousandths,
    markdown_table,
    run_line,
    save_page,
    save_trials,
)

TRIALS = Trials(
    {"cell": np.array(["a", "b,c"]), "trial": np.array([0, 1]), "x": np.array([0.1, np.nan])}, 3.0
)


def test_raw_trials_are_a_csv_that_reads_back(tmp_path):
    path = save_trials(tmp_path, TRIALS)[0]
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows == [
        {"cell": "a", "trial": "0", "x": "0.1"},
        {"cell": "b,c", "trial": "1", "x": "nan"},
    ]


def test_raw_trials_are_parquet_too_where_pyarrow_is_installed(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = save_trials(tmp_path, TRIALS)[1]
    assert parquet.read_table(path).column_names == ["cell", "trial", "x"]


def test_a_comparison_has_papers_and_our_number_side_by_side():
    table = comparison_table(
        "method", ["R"], {"8-PA": [Compared(1.5, 2.25)], "new": [Compared(None, 0.5)]}
    )
    assert table.splitlines() == [
        "| method | R: paper | R: ours |",
        "| --- | ---: | ---: |",
        "| 8-PA | 1.500 | 2.250 |",
        "| new | – | 0.500 |",
    ]


def test_a_comparison_refuses_nan():
    with pytest.raises(ValueError, match="R of 8-PA is NaN"):
        comparison_table("method", ["R"], {"8-PA": [Compared(1.0, float("nan"))]})


def test_errors_are_shares_of_half_a_turn_in_thousandths_and_no_pose_is_the_worst():
    assert in_thousandths([0.001, 0.002, 0.003]) == 2.0
    assert in_thousandths([0.001, np.nan, np.nan]) == 1000.0
    assert in_thousandths([0.0, 0.004], 0.25) == 1.0


def page(out, name, **options):
    given = ReproduceOptions(out=out, **options)
    folder = given.folder(name)
    run, table = run_line(given, 1500), markdown_table(["a"], [["1"]])
    return save_page(folder, f"About {name}", run, [table])


def test_a_page_says_how_it_was_run(tmp_path):
    path, text = page(tmp_path, "fig4a", protocol="authors", seed=7)
    assert path == tmp_path / "fig4a-authors" / "table.md"
    assert path.read_text(encoding="utf-8") == text
    assert "Protocol `authors`, 1,500 trials a cell, seed 7." in text


def test_pages_are_collected_in_the_papers_order_and_put_between_the_marks(tmp_path):
    for name in ("table4", "table1-landmarks", "fig4a"):
        page(tmp_path, name)
    text = collect_tables(tmp_path)
    places = [text.index(f"### About {name}") for name in ("fig4a", "table1-landmarks", "table4")]
    assert places == sorted(places)
    document = tmp_path / "doc.md"
    document.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    for _ in range(2):  # again changes nothing
        insert_tables(document, text)
        assert document.read_text(encoding="utf-8") == f"before\n{BEGIN}\n\n{text}\n{END}\nafter\n"


def test_collected_pages_of_another_protocol_say_so_in_their_titles(tmp_path):
    page(tmp_path, "fig4a")
    page(tmp_path, "fig4a", protocol="corrected")
    titles = [line for line in collect_tables(tmp_path).splitlines() if line.startswith("###")]
    assert titles == ["### About fig4a", "### About fig4a (`corrected`)"]


def test_the_projects_document_has_the_marks_and_the_protocols_concentrations():
    text = (Path(__file__).parents[2] / "docs" / "reproduction.md").read_text(encoding="utf-8")
    assert 0 < text.index(BEGIN) < text.index(END)
    for protocol in PROTOCOLS.values():
        kappas = [f"{level.kappa:.0f}" for level in protocol.noise_levels]
        assert f"| {', '.join(kappas)} |" in text


def test_a_document_without_marks_and_a_folder_without_tables_are_refused(tmp_path):
    with pytest.raises(ValueError, match="found none"):
        collect_tables(tmp_path)
    document = tmp_path / "doc.md"
    document.write_text("nothing\n", encoding="utf-8")
    with pytest.raises(ValueError, match="must hold the lines"):
        insert_tables(document, "text")
