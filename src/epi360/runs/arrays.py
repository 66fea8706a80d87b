# SPDX-License-Identifier: BSD-3-Clause
"""Arrays in npz files that are whole or count as missing."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.runs.remote_path import AnyPath

Arrays = dict[str, NDArray[Any]]


def npz_bytes(arrays: Arrays) -> bytes:
    """Content of an npz file; the same arrays give the same bytes."""
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def read_arrays(path: AnyPath) -> Arrays | None:
    """All arrays of an npz file; None if it is missing or its checksums show damage."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except Exception:  # what a flipped bit makes zipfile and numpy raise is not documented
        return None
