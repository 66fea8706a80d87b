# SPDX-License-Identifier: BSD-3-Clause
"""Files written whole or not at all: what every room that writes one calls."""

from __future__ import annotations

import os
from pathlib import Path


def write_file(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file under a temporary name beside it and rename: readers never see half of it.

    Parameters
    ----------
    path : str or path
        Written or replaced; a symbolic link is followed, a device or pipe is written to.
    data : bytes
        Content.

    Raises
    ------
    OSError
        If the folder is missing or not writable.
    """
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file():  # renaming onto /dev/null would replace the device
        path.write_bytes(data)
        return
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        if error.errno is not None:  # name what was asked for, not the temporary file
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise
    finally:
        temporary.unlink(missing_ok=True)
