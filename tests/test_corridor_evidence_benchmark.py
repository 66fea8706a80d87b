# SPDX-License-Identifier: BSD-3-Clause
"""The odds of poses in corridors are fitted to what pairs have shown there."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import expit

from epi360.places import corridor
from epi360.places.own_evidence import SHOWN

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import corridor_evidence

    return corridor_evidence


def test_the_fit_finds_the_odds_that_made_the_poses(benchmark):
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=(4000, 7)) * [1, 2, 1, 1, 1, 1, 1] + [0, 3, 0, 0, 0, 0, 0]
    log_odds = -1.0 + 0.8 * (numbers[:, 1] - 3.0) - 0.5 * numbers[:, 6]
    fitted = corridor.Odds(**benchmark.fitted(rng.random(4000) < expit(log_odds), numbers))
    inner = np.abs(numbers - [0, 3, 0, 0, 0, 0, 0]).max(axis=1) < 2.0
    told = np.array([fitted.of(each) for each in numbers[inner]])
    assert np.abs(told - log_odds[inner]).mean() < 0.15


def test_what_was_shown_is_measured_once(benchmark, tmp_path, monkeypatch, capsys):
    rows, walks = np.arange(16.0).reshape(2, 8), []

    class Rendered:
        name = "plain floor 7"

    def rendered(folder, floor, seed, *, photos):
        walks.append((floor, seed, photos))
        return Rendered()

    monkeypatch.setattr(benchmark, "rendered_walk", rendered)
    monkeypatch.setattr(benchmark, "_shown", lambda _: rows)
    for _ in range(2):
        np.testing.assert_array_equal(benchmark._kept(tmp_path, 7, photos=True), rows)
    assert walks == [("plain floor", 7, True)]
    assert capsys.readouterr().out == "plain floor 7: 2 poses\n"


def test_the_kept_odds_are_of_the_numbers_that_are_shown():
    path = Path(corridor.__file__).with_name(corridor.ODDS)
    record = json.loads(path.read_text(encoding="utf-8"))
    assert record["shown"] == list(SHOWN) and len(record["odds"]) == 1 + len(SHOWN)
    assert record["num_right"] > 100 and record["num_wrong"] > 100
