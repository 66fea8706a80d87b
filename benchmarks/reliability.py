# SPDX-License-Identifier: BSD-3-Clause
"""Whether stated probabilities are kept, of all poses that several runs of ``trust.py`` judged.

``python benchmarks/reliability.py out/a.json out/b.json --picture reliability.png`` reads what
``trust.py --json`` has written, prints the table, and draws the diagram.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from _summary import text_table
from _trust_records import Judged, of_json
from _trust_reliability import draw_reliability, held, held_rows, stated_probabilities
from _trust_synthetic import Trial

from epi360.report.files import check_writable


def main() -> int:
    """Read the files, print the table and draw; exit code 2 for wrong use."""
    parser = argparse.ArgumentParser(description="Whether stated probabilities are kept.")
    parser.add_argument("runs", type=Path, nargs="+", help="files of trust.py --json")
    parser.add_argument("--picture", type=Path, help="PNG file for the reliability diagram")
    options = parser.parse_args()
    try:
        if options.picture is not None:
            check_writable(options.picture, name="--picture")
        documents = [_read(path) for path in options.runs]
    except (ValueError, OSError) as error:
        print(f"reliability.py: {error}", file=sys.stderr)
        return 2
    judged = [each for document in documents for each in document[0]]
    trials = [each for document in documents for each in document[1]]
    found = held(stated_probabilities(judged, trials))
    print(text_table(held_rows(found)))
    if options.picture is not None:
        draw_reliability(found, options.picture)
    return 0


def _read(path: Path) -> tuple[list[Judged], list[Trial]]:
    """Verdicts on pairs, and on synthetic matches."""
    try:
        document = json.loads(path.read_text("utf-8"))
        judged = list(map(Judged.of_record, document["verdicts"]))
        return judged, [Trial(**of_json(each)) for each in document.get("synthetic", [])]
    except (UnicodeDecodeError, json.JSONDecodeError, AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is not a file of trust.py --json: {error!r}") from error


if __name__ == "__main__":
    sys.exit(main())
