# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 batch`: summary, exit codes, progress, a stop by Ctrl-C."""

import math
import os
import subprocess
import sys
from importlib.util import find_spec

import pytest
from batch_inputs import columns_of, pose_rows, write_matches
from command_line import assert_help_names

from epi360 import cli
from epi360.jobs.batch import job as job_module
from epi360.jobs.batch import local_engine

pytest.importorskip("pyarrow")


@pytest.fixture
def words(tmp_path):
    path = write_matches(tmp_path / "in.parquet", columns_of(6))
    return ["batch", str(path), "--output", str(tmp_path / "out.parquet"), "--pairs-per-part", "2"]


def test_the_summary_says_what_was_done_and_what_came_out(words, capsys):
    assert cli.main(words) == 0
    captured = capsys.readouterr()
    first, *rest = captured.out.splitlines()
    assert first.startswith("6 pairs; ") and first.endswith(" pairs/s")
    assert rest == ["  ok: 5", "  too_few_matches: 1", f"wrote {words[3]}"]
    checked, estimated = captured.err.splitlines()
    assert checked.startswith("epi360: checked pairs: 6 of 6, ")
    assert estimated.startswith("epi360: pairs: 6 of 6, ")
    assert cli.main(words) == 0
    assert capsys.readouterr().out.splitlines() == [
        "6 pairs, 6 were there already", "  ok: 5", "  too_few_matches: 1",
        f"{words[3]} is complete, it is left as it is",
    ]  # fmt: skip


def test_the_report_counts_the_pairs_also_of_an_output_that_was_there(words, tmp_path, capsys):
    report = tmp_path / "report.html"
    for _ in range(2):
        assert cli.main([*words, "--report", str(report)]) == 0
        assert capsys.readouterr().out.splitlines()[-1] == f"wrote {report}"
        assert "5 of 6 (83.3%) pairs have a pose" in report.read_text(encoding="utf-8")
        report.unlink()


def test_a_report_that_cannot_be_written_is_refused_before_the_work(words, tmp_path, capsys):
    assert cli.main([*words, "--report", str(tmp_path / "nowhere" / "report.html")]) == 2
    assert "--report: folder" in capsys.readouterr().err
    assert not (tmp_path / "out.parquet").exists()


def test_no_pair_that_is_ok_is_exit_1_and_still_written(tmp_path, capsys):
    columns = columns_of(2)
    columns["bearings1"][0] = [math.nan] * 300
    path = write_matches(tmp_path / "in.parquet", columns)
    assert cli.main(["batch", str(path), "--output", str(tmp_path / "out.parquet")]) == 1
    assert "too_few_matches: 2" in capsys.readouterr().out
    assert (tmp_path / "out.parquet").exists()


def test_a_stop_leaves_the_finished_parts_and_the_next_run_goes_on(
    words, tmp_path, capsys, monkeypatch
):
    def stop_at_the_second(job, index, *rest, **named):
        if index == 1:
            raise KeyboardInterrupt
        job_module.write_poses(job, index, *rest, **named)

    with monkeypatch.context() as patch:
        patch.setattr(local_engine, "write_poses", stop_at_the_second)
        assert cli.main(words) == 130
    assert os.listdir(tmp_path / "out.parquet.parts") == ["part-000000.parquet"]
    assert cli.main(words) == 0
    captured = capsys.readouterr()
    assert "6 pairs, 2 were there already; " in captured.out
    assert "epi360: pairs: 6 of 6 (2 were there), " in captured.err
    other = tmp_path / "other.parquet"
    assert cli.main([*words[:3], str(other)]) == 0
    assert pose_rows(other) == pose_rows(tmp_path / "out.parquet")


PROGRAM = """
import sys
from epi360 import cli
sys.exit(cli.main(sys.argv[1:]) or 100 * ("pandas" in sys.modules))
"""


@pytest.mark.skipif(find_spec("pandas") is None, reason="pandas is not there")
def test_pandas_is_not_imported(words):
    # pyarrow does, in many of its functions: as long as all other imports together.
    assert subprocess.run([sys.executable, "-c", PROGRAM, *words]).returncode == 0


def test_without_pyarrow_the_message_says_what_to_install(words, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    assert cli.main(words) == 2
    assert "pip install 'epi360[batch]'" in capsys.readouterr().err


def test_help_names_the_inputs_and_every_option(capsys):
    assert_help_names(
        capsys, "batch", "Parquet", "COLMAP", "hloc", "--output", "--write-database", "--camera",
        "--features", "--pairs", "--engine", "--address", "--num-threads", "--seed",
        "--pairs-per-part",
    )  # fmt: skip
