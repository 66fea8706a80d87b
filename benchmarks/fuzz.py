# SPDX-License-Identifier: BSD-3-Clause
"""A long attack with damaged input on every command that reads files.

    python benchmarks/fuzz.py --runs 20000 --seed 1000

Prints each fault with its seed, which `--runs 1 --seed SEED` repeats. The exit code is 1 if there
is one. A process takes about five runs a second.
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import fuzzing  # noqa: E402


def main() -> int:
    """Run the attack, print its faults, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000, help="number of runs")
    parser.add_argument("--seed", type=int, default=1000, help="seed of the first run")
    arguments = parser.parse_args()
    begun, faults = time.monotonic(), Counter[str]()
    with tempfile.TemporaryDirectory(prefix="epi360-fuzz-") as folder:
        sources = Path(folder) / "sources"
        fuzzing.write_sources(sources)
        for seed in range(arguments.seed, arguments.seed + arguments.runs):
            fault = fuzzing.run(seed, sources, Path(folder))
            if fault is not None:
                faults[fault.what.strip().splitlines()[-1]] += 1
                print(f"seed {seed}: {' '.join(fault.words)}\n{fault.what}\n", flush=True)
    print(f"{arguments.runs} runs in {time.monotonic() - begun:.0f} s, {faults.total()} faults")
    for what, count in faults.most_common():
        print(f"  {count} x {what}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
