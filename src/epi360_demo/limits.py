# SPDX-License-Identifier: BSD-3-Clause
"""What visitors may ask of the machine, and what they are told where they ask for more."""

import os
from dataclasses import dataclass, field


class RefusedError(ValueError):
    """Something that the demo does not do; its text is a sentence for the visitor."""


def default_num_workers() -> int:
    """Return the number of estimates that run at a time: each of them uses about two cores."""
    return max(1, min(4, (os.cpu_count() or 1) // 2))


@dataclass(frozen=True)
class Limits:
    """Bounds on bytes, pixels, time and visitors."""

    max_file_bytes: int = 64 * 2**20
    max_pixels: int = 100_000_000  # the largest consumer cameras have 72 million
    max_stored_bytes: int = 2**30  # of the pictures of all visitors
    max_visitors: int = 100
    max_idle_s: float = 3600.0
    max_gone_s: float = 20.0  # a page whose connection is gone for longer was closed
    num_workers: int = field(default_factory=default_num_workers)
    max_waiting: int = 20
    time_limit_s: float = 120.0


def as_sentence(message: str) -> str:
    """Return a message of the library on one line and with its full stop."""
    text = " ".join(message.split())
    return text if text.endswith((".", "!", "?")) else text + "."


def megabytes(num_bytes: int) -> str:
    """Return a number of bytes as people read it."""
    return f"{num_bytes / 2**20:.3g} MB"


def megapixels(num_pixels: int) -> str:
    """Return a number of pixels as people read it."""
    return f"{num_pixels / 1e6:.4g} megapixels"
