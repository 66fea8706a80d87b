# SPDX-License-Identifier: BSD-3-Clause
"""The process that does the requests of visitors: a line of JSON in, lines of JSON out."""

import json
import os
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TextIO


def main() -> None:
    """Answer requests until there are no more."""
    # What libraries print must not get between the answers.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    with suppress(OSError, AttributeError):  # the page itself and the sliders come first
        os.nice(5)
    with suppress(KeyboardInterrupt):  # Ctrl-C reaches all processes of a terminal
        for line in sys.stdin:
            _write(answers, answer_to(json.loads(line), lambda words: _say(answers, words)))


def answer_to(request: dict[str, Any], say: Callable[[str], None]) -> dict[str, Any]:
    """Return ``{"answer": ...}``, or ``{"refusal": sentence}`` where there is none."""
    from epi360_demo.limits import RefusedError
    from epi360_demo.pair_job import run_pair

    try:
        return {"answer": run_pair(request, say)}
    except RefusedError as refusal:
        return {"refusal": str(refusal)}
    except MemoryError:
        return {"refusal": "There is not enough memory for this; try smaller pictures."}
    except Exception as error:  # a mistake of ours: the visitor gets a sentence, we the traceback
        traceback.print_exc()
        kind = type(error).__name__
        return {"refusal": f"Something went wrong in the demo itself ({kind})."}


def _say(answers: TextIO, words: str) -> None:
    _write(answers, {"progress": words})


def _write(answers: TextIO, record: dict[str, Any]) -> None:
    answers.write(json.dumps(record) + "\n")
    answers.flush()
