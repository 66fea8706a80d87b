# SPDX-License-Identifier: BSD-3-Clause
"""A short attack with damaged input; `benchmarks/fuzz.py` is the long one."""

import fuzzing
import pytest


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz") / "sources"
    fuzzing.write_sources(folder)
    return folder


@pytest.mark.parametrize("block", range(4))
def test_damaged_input_is_used_or_refused_in_one_line(block, sources, tmp_path):
    for seed in range(10 * block, 10 * (block + 1)):
        fault = fuzzing.run(seed, sources, tmp_path)
        assert fault is None, f"seed {fault.seed}: {' '.join(fault.words)}\n{fault.what}"
