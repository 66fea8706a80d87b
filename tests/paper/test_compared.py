# SPDX-License-Identifier: BSD-3-Clause
"""The paper's errors beside ours, read back from the pages of a run."""

import math

import pytest

from epi360_paper import EXPERIMENTS
from epi360_paper.captions import CAPTIONS
from epi360_paper.compared import compared_errors, read_pages

TABLE_1 = """## Table 1: eight-point methods, synthetic landmarks

Run.

| method | time, ms: paper | time, ms: ours | Rot-e, 1e-3: paper | Rot-e, 1e-3: ours | \
Tran-e, 1e-3: paper | Tran-e, 1e-3: ours |
| --- | ---: | ---: | ---: | ---: | ---: | ---: |
| 8-PA | 40 | 0.1 | 13.4 | 30.1 | 32.4 | 41.0 |
| ours | – | 0.1 | – | 3.1 | – | 4.1 |
"""
TABLE_3 = """## Table 3: quartiles

### Rendered panoramas (paper: MP3D-VO)

| Rot-e, 1e-3 | 8-PA: paper | 8-PA: ours | GSM: paper | GSM: ours |
| --- | ---: | ---: | ---: | ---: |
| Q75 | 9 | 9 | 9 | 9 |
| Q50 | 1 | 2 | 3 | 4 |

| Tran-e, 1e-3 | 8-PA: paper | 8-PA: ours | GSM: paper | GSM: ours |
| --- | ---: | ---: | ---: | ---: |
| Q50 | 5 | 6 | 7 | 8 |
"""
FIG_4 = """## Fig. 4 (b): errors against the noise

| noise | A vs B, R: paper | A vs B, R: ours | A vs B, T: paper | A vs B, T: ours |
| --- | ---: | ---: | ---: | ---: |
| κ 100 | 20 | 2 | 20 | -1 |
"""


@pytest.fixture
def out(tmp_path):
    pages = {"table1-landmarks": TABLE_1, "table3": TABLE_3, "fig4b-authors": FIG_4}
    for name, text in pages.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "table.md").write_text(text, encoding="utf-8")
    (tmp_path / "fig4b-authors" / "figure.png").write_bytes(b"png")
    return tmp_path


def test_pages_come_in_the_papers_order_with_their_protocol_and_figure(out):
    pages = read_pages(out)
    assert [page.name for page in pages] == ["fig4b", "table1", "table3"]
    assert pages[0].title == "Fig. 4 (b): errors against the noise (authors)"
    assert pages[0].figure is not None and pages[1].figure is None
    assert not pages[1].text.startswith("#")


def test_errors_and_gains_are_read_with_the_rows_and_what_the_paper_lacks(out):
    gains, table1, table3 = compared_errors(read_pages(out))
    assert gains.title == "Fig. 4 (b) (authors): A vs B"
    assert gains.series["ours T"] == (-1.0,) and gains.series["paper R"] == (20.0,)
    assert table1.title == "Table 1, synthetic landmarks"
    assert table1.rows == ("8-PA", "ours")
    assert table1.series["ours R"] == (30.1, 3.1)
    assert table1.series["paper T"][0] == 32.4 and math.isnan(table1.series["paper T"][1])
    assert table3.title == "Table 3, rendered panoramas, medians"
    assert table3.rows == ("8-PA", "GSM")
    assert table3.series["ours R"] == (2.0, 4.0) and table3.series["paper T"] == (5.0, 7.0)


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(ValueError, match="must hold tables, found none"):
        read_pages(tmp_path)


def test_every_experiment_has_a_caption():
    assert tuple(CAPTIONS) == EXPERIMENTS
