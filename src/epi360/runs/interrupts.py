# SPDX-License-Identifier: BSD-3-Clause
"""An interrupt that waits until what has begun is whole."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def interrupted_later() -> Iterator[None]:
    """Raise KeyboardInterrupt for Ctrl-C at the end of the block, not inside of it.

    Where Ctrl-C is handled in another way, or this is not the main thread, nothing is changed.
    """
    handles = signal.getsignal(signal.SIGINT)
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or handles is not signal.default_int_handler:
        yield
        return
    pressed: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handles)
    if pressed:
        raise KeyboardInterrupt
