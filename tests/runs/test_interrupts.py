# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C waits until what has begun is whole."""

import os
import signal
import threading

import pytest

from epi360.runs.interrupts import interrupted_later


def press_ctrl_c():
    os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.skipif(os.name != "posix", reason="needs SIGINT")
def test_ctrl_c_comes_at_the_end_of_the_block():
    before, done = signal.getsignal(signal.SIGINT), []
    with pytest.raises(KeyboardInterrupt), interrupted_later():
        press_ctrl_c()
        done.append("whole")
    assert done == ["whole"] and signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt):
        press_ctrl_c()
        threading.Event().wait(1.0)


@pytest.mark.skipif(os.name != "posix", reason="needs SIGINT")
def test_an_error_comes_before_an_interrupt():
    with pytest.raises(ValueError, match="mine"), interrupted_later():
        press_ctrl_c()
        raise ValueError("mine")


def test_another_thread_and_another_handler_are_left_alone():
    seen = []

    def work():
        with interrupted_later():
            seen.append(signal.getsignal(signal.SIGINT))

    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        work()
    finally:
        signal.signal(signal.SIGINT, before)
    assert seen == [before, signal.SIG_IGN]
