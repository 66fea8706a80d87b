# SPDX-License-Identifier: BSD-3-Clause
"""What pairs have shown is kept between runs of a benchmark that takes hours."""

from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import own_evidence

    return own_evidence


def test_what_was_shown_is_measured_once(benchmark, tmp_path):
    shown = [
        benchmark.Shown("30", "rendered", "copy", np.array([0.1, -2.5])),
        benchmark.Shown("30", "photographed", "one room", np.empty(0)),
    ]
    calls = []

    def measure(options):
        calls.append(options)
        yield from shown

    options = Namespace(out=tmp_path / "new")
    for _ in range(2):
        kept = benchmark._kept("homes", measure, options)
        assert [each[:3] for each in kept] == [each[:3] for each in shown]
        for each, expected in zip(kept, shown, strict=True):
            np.testing.assert_array_equal(each.numbers, expected.numbers)
    assert calls == [options]
    benchmark._kept("others", measure, options)
    assert len(calls) == 2
