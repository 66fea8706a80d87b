# SPDX-License-Identifier: BSD-3-Clause
"""The one place that decides whether a name from somebody's file stays inside a folder."""

import os
from pathlib import Path, PurePath
from typing import overload

from epi360.runs.remote_path import AnyPath, RemotePath

_LONGEST_QUOTE = 120  # characters of a name in a message


@overload
def inside(folder: Path, name: str) -> Path: ...
@overload
def inside(folder: RemotePath, name: str) -> RemotePath: ...
def inside(folder: AnyPath, name: str) -> AnyPath:
    """Path of a named file in a folder; ValueError where it lies elsewhere, through links too."""
    path = PurePath(name)
    if path.drive or path.root or ".." in path.parts or not path.parts or "\0" in name:
        raise _error(folder, name, 'names must be paths below the folder, without ".."')
    if isinstance(folder, RemotePath):  # which has no links
        return folder / name
    # The folder itself may be a link: whoever runs the program has named it.
    real = Path(os.path.realpath(folder / name))
    if not real.is_relative_to(os.path.realpath(folder)):
        raise _error(folder, name, f"a link leads to {real}; remove the link")
    return folder / name


def _error(folder: AnyPath, name: str, reason: str) -> ValueError:
    quoted = repr(name if len(name) <= _LONGEST_QUOTE else f"{name[:_LONGEST_QUOTE]}...")
    return ValueError(f"the name {quoted} leads out of {folder}; {reason}")
