# SPDX-License-Identifier: BSD-3-Clause
"""What results were made from: records beside them, hashes, and whether both are still the same."""

import json
from collections.abc import Mapping
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from epi360 import _core
from epi360.runs.remote_path import AnyPath
from epi360.runs.whole_files import write_file


class Difference(NamedTuple):
    """The first thing in which results differ from what is asked for now."""

    name: str
    before: Any
    now: Any


def first_difference(before: Mapping[str, Any], now: Mapping[str, Any]) -> Difference | None:
    """First value of ``now`` that was another before, as JSON keeps them; a missing one is None."""
    before, now = _as_json(before), _as_json(now)
    for name, value in now.items():
        if before.get(name) != value:
            return Difference(name, before.get(name), value)
    return None


def _as_json(values: Mapping[str, Any]) -> dict[str, Any]:
    return dict(json.loads(json.dumps(dict(values))))


def fingerprint(*pieces: object) -> str:
    """Hash of everything that a result depends on: bytes and arrays as they are, the rest as text.

    Text and numbers belong into one tuple: where one piece ends and the next begins is not hashed.
    """
    digest = blake2b(digest_size=16)
    for piece in pieces:
        if isinstance(piece, np.ndarray):
            piece = np.ascontiguousarray(piece).tobytes()
        digest.update(piece if isinstance(piece, bytes) else repr(piece).encode())
    return digest.hexdigest()


@cache
def code_fingerprint() -> str:
    """Hash of the code and the weights of this package: others may give other verdicts."""
    package = Path(__file__).parents[1]
    files = [*sorted(package.rglob("*.py")), *sorted(package.rglob("*.json")), Path(_core.__file__)]
    return fingerprint(*(path.read_bytes() for path in files))


def json_bytes(record: Mapping[str, Any]) -> bytes:
    """Content of a JSON file that people can read."""
    return (json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode()


def write_record(path: AnyPath, record: Mapping[str, Any]) -> None:
    """Write a record as a JSON file."""
    write_file(path, json_bytes(record))


def read_record(path: AnyPath, *, remedy: str) -> dict[str, Any] | None:
    """Record of a JSON file, None where there is none; ValueError with the remedy if damaged."""
    try:
        record = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except ValueError:
        record = None
    if not isinstance(record, dict):
        raise ValueError(f"{path} is damaged; {remedy}")
    return record
