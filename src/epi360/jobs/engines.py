# SPDX-License-Identifier: BSD-3-Clause
"""The engines that a large job may run on."""

from typing import Literal, get_args

Engine = Literal["local", "ray"]


def check_engine(engine: str) -> None:
    """Raise ``ValueError`` for another engine."""
    if engine not in get_args(Engine):
        raise ValueError(f"engine must be one of {', '.join(get_args(Engine))}, got {engine!r}")
