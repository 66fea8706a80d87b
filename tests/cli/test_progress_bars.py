# SPDX-License-Identifier: BSD-3-Clause
"""Bars of progress: rates are of this run, and a stage that is done once more begins anew."""

import pytest

from epi360.cli.command import _BarPerStage


class _Bars:
    """What a bar is told in place of a terminal."""

    def __init__(self):
        self.shown = {}
        self.num_resets = 0

    def add_task(self, stage, **fields):
        return stage

    def reset(self, task, **fields):
        self.num_resets += 1

    def update(self, task, **fields):
        self.shown = fields


@pytest.fixture
def bars():
    return _Bars()


@pytest.fixture
def at(monkeypatch):
    """Sets what the clock says."""

    def set_clock(seconds):
        monkeypatch.setattr("epi360.cli.command.time.monotonic", lambda: seconds)

    return set_clock


def test_the_bar_shows_the_rate_of_this_run(bars, at):
    bar = _BarPerStage(bars)
    at(100.0)
    bar("fig4a", 500, 1000)  # left by an earlier run
    at(102.0)
    bar("fig4a", 600, 1000)
    assert bars.shown == {"completed": 600, "total": 1000, "rate": "50.0/s"}


def test_a_clock_that_stands_still_shows_no_rate(bars, at):
    bar = _BarPerStage(bars)
    at(100.0)
    bar("images", 0, 10)
    bar("images", 10, 10)
    assert bars.shown["rate"] == ""


def test_a_stage_that_is_done_once_more_has_a_rate_of_its_own(bars, at):
    bar = _BarPerStage(bars)
    at(0.0)
    bar("places", 0, 10)
    at(100.0)
    bar("places", 10, 10)
    at(1000.0)
    bar("places", 0, 4)
    at(1001.0)
    bar("places", 4, 4)
    assert bars.shown == {"completed": 4, "total": 4, "rate": "4.0/s"}
    assert bars.num_resets == 1
