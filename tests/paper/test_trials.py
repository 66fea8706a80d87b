# SPDX-License-Identifier: BSD-3-Clause
"""The runner: the same numbers on any number of workers, interrupted or not."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from measured import is_timing

from epi360.cli import GOES_ON
from epi360.progress import no_progress
from epi360_paper.options import ReproduceOptions
from epi360_paper.parts import Trials
from epi360_paper.trials import Trial, run_trials, without_interrupts

CELLS = {"low": 1.0, "high": 10.0}


def draw(scale, trial):
    rng = trial.rng()
    return {
        "value": scale * rng.normal(),
        "scene": trial.scene_rng().normal(),
        "count": int(rng.integers(100)),
        "odd": bool(trial.index % 2),
        "note": 'a "quoted", word',
        "time_s": time.perf_counter(),
    }


def draw_threads(scale, trial):
    return {"threads": int(os.environ.get("OMP_NUM_THREADS", 0))}


def draw_two_rows(scale, trial):
    return [{"method": method, "value": scale * trial.index} for method in ("a", "b")]


def fail(scale, trial):
    raise AssertionError("this trial was computed again")


def die(scale, trial):
    os._exit(1)


class InterruptAt:
    """Draws until a trial, then is interrupted."""

    def __init__(self, index):
        self.index = index

    def __call__(self, scale, trial):
        if trial.index == self.index:
            raise KeyboardInterrupt
        return draw(scale, trial)


def run(folder, function=draw, num_trials=25, *, progress=no_progress, **options):
    given = ReproduceOptions(out=folder, **{"jobs": 1, **options})
    return run_trials("demo", CELLS, function, num_trials, given, progress, chunk_size=10)


def assert_same_numbers(a: Trials, b: Trials):
    assert list(a.columns) == list(b.columns)
    for name in a.columns:
        if not is_timing(name):
            np.testing.assert_array_equal(a[name], b[name])


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    return run(tmp_path_factory.mktemp("reference"))


def test_rows_come_in_the_order_of_cells_and_trials_with_their_types(reference):
    assert len(reference) == 50
    assert reference["cell"].tolist() == ["low"] * 25 + ["high"] * 25
    assert reference["trial"].tolist() == [*range(25)] * 2
    assert [reference[name].dtype.kind for name in ("value", "count", "odd")] == ["f", "i", "i"]
    assert set(reference["note"]) == {'a "quoted", word'}
    assert reference.where(cell="high", odd=1)["trial"].tolist() == [*range(1, 25, 2)]
    assert reference.seconds >= 0


def test_trials_are_random_but_their_scene_is_that_of_the_other_cells(reference):
    low, high = reference.where(cell="low"), reference.where(cell="high")
    assert len(set(low["value"])) == 25
    assert not np.isclose(10 * low["value"], high["value"]).any()
    np.testing.assert_array_equal(low["scene"], high["scene"])
    assert not np.isclose(low["scene"], low["value"]).any()


def test_two_workers_give_the_numbers_of_one(reference, tmp_path):
    assert_same_numbers(run(tmp_path, jobs=2), reference)


def test_each_worker_computes_on_one_thread(tmp_path):
    assert set(run(tmp_path, draw_threads, jobs=2)["threads"]) == {1}


def test_another_seed_gives_other_numbers(reference, tmp_path):
    assert not np.isclose(run(tmp_path, seed=1)["value"], reference["value"]).any()


def test_a_trial_may_give_several_rows(tmp_path):
    trials = run(tmp_path, draw_two_rows, num_trials=3)
    assert trials.where(cell="high", method="b")["value"].tolist() == [0.0, 10.0, 20.0]


def test_an_interrupted_run_goes_on_where_it_was(reference, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, InterruptAt(20))
    parts = sorted(path.name for path in (tmp_path / "demo" / "parts").iterdir())
    assert parts == ["low_000000-000010.csv", "low_000010-000020.csv"]
    calls = []
    again = run(tmp_path, progress=lambda *call: calls.append(call))
    assert calls[0] == ("demo", 20, 50)
    assert calls[-1] == ("demo", 50, 50)
    assert_same_numbers(again, reference)


def test_a_killed_worker_is_said_in_one_sentence(tmp_path):
    with pytest.raises(ChildProcessError, match="worker process was killed.* fewer --jobs"):
        run(tmp_path, die, jobs=2)


def test_finished_trials_are_not_computed_again(reference, tmp_path):
    run(tmp_path)
    assert_same_numbers(run(tmp_path, fail), reference)
    more = run(tmp_path, num_trials=35)  # full chunks are kept, the broken one is made anew
    np.testing.assert_array_equal(more.where(cell="low")["value"][:25], reference["value"][:25])


def test_a_damaged_part_is_made_again(reference, tmp_path):
    run(tmp_path)
    part = tmp_path / "demo" / "parts" / "low_000000-000010.csv"
    part.write_text("half a li", encoding="utf-8")
    assert_same_numbers(run(tmp_path), reference)


@pytest.mark.parametrize("change", [{"seed": 1}, {"protocol": "authors"}])
def test_parts_of_another_run_are_refused_in_one_sentence(tmp_path, change, monkeypatch):
    monkeypatch.setattr(ReproduceOptions, "folder", lambda self, name: self.out / name)
    run(tmp_path)
    with pytest.raises(ValueError, match=f"another run .{next(iter(change))} .*--out") as caught:
        run(tmp_path, **change)
    assert "\n" not in str(caught.value)


def test_parts_of_other_settings_or_cells_are_refused(tmp_path):
    given = ReproduceOptions(out=tmp_path, jobs=1)
    run_trials("demo", {"low": 1.0}, draw, 5, given, settings="width 512")
    with pytest.raises(ValueError, match="settings 'width 512', not 'width 64'"):
        run_trials("demo", {"low": 1.0}, draw, 5, given, settings="width 64")
    with pytest.raises(ValueError, match=r"value '1\.0', not '2\.0'"):
        run_trials("demo", {"low": 2.0}, draw, 5, given, settings="width 512")


def test_each_protocol_has_a_folder_of_its_own(tmp_path):
    folders = {
        ReproduceOptions(out=tmp_path, protocol=protocol).folder("fig4a").name
        for protocol in ("printed", "authors", "corrected")
    }
    assert folders == {"fig4a", "fig4a-authors", "fig4a-corrected"}


@pytest.mark.parametrize(
    ("rows", "words"),
    [([], "must give a row"), ([{"a": 1}, {"b": 1}], r"must have \['cell', 'trial', 'a'\]")],
)
def test_uneven_rows_are_refused(tmp_path, rows, words):
    with pytest.raises(ValueError, match=words):
        run(tmp_path, lambda scale, trial: rows)


@pytest.mark.parametrize(
    "wrong", [{"protocol": "x"}, {"trials": 0}, {"jobs": 0}, {"seed": -1}, {"image_width": 2}]
)
def test_options_out_of_range_are_refused_by_name(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ReproduceOptions(**wrong)


def test_generators_differ_between_experiments_cells_and_trials():
    trials = [Trial(0, "a", 0, 0), Trial(0, "b", 0, 0), Trial(0, "a", 1, 0), Trial(0, "a", 0, 1)]
    assert len({trial.rng().random() for trial in [*trials, Trial(1, "a", 0, 0)]}) == 5


INTERRUPTED_SCRIPT = """
import sys, time
from pathlib import Path

if __name__ != "__main__":  # a worker, which loads this script before it works
    Path(sys.argv[1]).mkdir(exist_ok=True)
    Path(sys.argv[1], "loading").touch()
    time.sleep(float(sys.argv[2]))

from epi360 import cli
from epi360_paper.options import Outcome
from epi360_paper.trials import run_trials

def slow(value, trial):
    time.sleep(0.05)
    return {"x": 1.0}

def run(options, progress):
    run_trials("fig1", {"a": 0}, slow, 1000, options, progress, chunk_size=5)
    return Outcome("fig1", ())

if __name__ == "__main__":
    sys.modules["epi360_paper.fig1"] = sys.modules["__main__"]
    sys.exit(cli.main(["reproduce", "fig1", "--jobs", "2", "--out", sys.argv[1]]))
"""


def interrupted(folder: Path, until: Callable[[], object], loading_s: float) -> tuple[int, str]:
    """Exit status and messages of a run that gets Ctrl-C as soon as there is what `until` finds."""
    script = folder / "run.py"
    script.write_text(INTERRUPTED_SCRIPT, encoding="utf-8")
    command = [sys.executable, str(script), str(folder / "out"), str(loading_s)]
    # A session of its own: like a terminal, the signal goes to the command and to its workers.
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    deadline = time.monotonic() + 30  # a few seconds; margin for a busy machine
    while not until() and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    errors = process.communicate(timeout=30)[1]
    return process.returncode, errors


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGINT, which Windows has not")
def test_ctrl_c_ends_the_command_with_130_and_keeps_finished_chunks(tmp_path):
    parts = tmp_path / "out" / "fig1" / "parts"
    status, errors = interrupted(tmp_path, lambda: list(parts.glob("*.csv")), loading_s=0.0)
    assert status == 130
    assert errors == f"epi360: interrupted; {GOES_ON}\n"
    assert all(part.read_text().count("\n") == 7 for part in parts.glob("*.csv"))
    assert list(parts.glob("*.csv"))


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGINT, which Windows has not")
def test_ctrl_c_while_the_workers_load_is_answered_once(tmp_path):
    status, errors = interrupted(tmp_path, (tmp_path / "out" / "loading").exists, loading_s=2.0)
    assert status == 130
    assert errors == f"epi360: interrupted; {GOES_ON}\n"


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGINT, which Windows has not")
def test_ctrl_c_that_another_thread_gets_waits_until_all_workers_have_been_started():
    """It blocks no signal, as those of numerical libraries do not."""
    ended, done = threading.Event(), []
    thread = threading.Thread(target=ended.wait)
    thread.start()
    try:
        with pytest.raises(KeyboardInterrupt), without_interrupts():
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(100):  # Python looks for signals between two steps
                time.sleep(0.001)
            done.append("all")
    finally:
        ended.set()
        thread.join()
    assert done == ["all"]
