# SPDX-License-Identifier: BSD-3-Clause
"""The line before the workers: who comes first is served first, and nobody waits without end."""

import asyncio

import pytest

from epi360_demo.limits import Limits, RefusedError
from epi360_demo.waiting_line import WaitingLine


class FakeWorker:
    """Answers a request when its gate is opened; notes what it began and how often it was ended."""

    def __init__(self):
        self.begun, self.num_killed = [], 0

    async def run(self, request, on_progress):
        self.begun.append(request["name"])
        on_progress("thinking")
        await request["gate"].wait()
        if "error" in request:
            raise request["error"]
        return {"name": request["name"]}

    def kill(self):
        self.num_killed += 1

    async def close(self):
        self.kill()


def request(name, **more):
    return {"name": name, "gate": asyncio.Event(), **more}


async def settled():
    """Let everything run that can."""
    for _ in range(20):
        await asyncio.sleep(0)


async def line_of(worker, **limits):
    return WaitingLine(Limits(num_workers=1, **limits), lambda: worker)


def nobody(ticket):
    """Hear of changes and do nothing."""


def test_a_page_that_cannot_hear_of_its_ticket_does_not_stop_the_line(capsys):
    async def story():
        worker = FakeWorker()
        line = await line_of(worker)

        def broken(ticket):
            raise RuntimeError("the page is gone")

        tickets = [line.join(request(name), hears) for name, hears in
                   (("first", broken), ("second", nobody), ("third", broken))]  # fmt: skip
        for ticket in tickets:
            ticket.request["gate"].set()
        await settled()
        assert [ticket.state for ticket in tickets] == ["done"] * 3
        await line.close()

    asyncio.run(story())
    assert "the page is gone" in capsys.readouterr().err


def test_positions_move_up_as_those_before_are_served_or_leave():
    async def story():
        worker, heard = FakeWorker(), []
        line = await line_of(worker)
        first = line.join(request("first"), nobody)
        await settled()
        second, third, fourth = (
            line.join(request(name), lambda ticket: heard.append(ticket.position))
            for name in ("second", "third", "fourth")
        )
        assert [ticket.position for ticket in (second, third, fourth)] == [1, 2, 3]
        assert first.progress == "thinking"
        line.leave(second)
        assert [ticket.position for ticket in (third, fourth)] == [1, 2]
        first.request["gate"].set()
        await settled()
        assert (first.state, first.answer) == ("done", {"name": "first"})
        assert (third.state, fourth.position) == ("running", 1)
        assert worker.begun == ["first", "third"]
        await line.close()

    asyncio.run(story())


def test_a_full_line_refuses_in_a_sentence_and_has_room_again_later():
    async def story():
        line = await line_of(FakeWorker(), max_waiting=1)
        line.join(request("running"), nobody)
        await settled()
        waiting = line.join(request("waiting"), nobody)
        with pytest.raises(RefusedError, match=r"The waiting line is full \(1\); try again"):
            line.join(request("one too many"), nobody)
        line.leave(waiting)
        line.join(request("fits"), nobody)
        await line.close()

    asyncio.run(story())


def test_no_more_estimates_run_than_there_are_workers():
    async def story():
        workers = [FakeWorker(), FakeWorker()]
        line = WaitingLine(Limits(num_workers=2), iter(workers).__next__)
        tickets = [line.join(request(str(k)), nobody) for k in range(10)]
        await settled()
        assert [ticket.state for ticket in tickets] == ["running"] * 2 + ["waiting"] * 8
        await line.close()

    asyncio.run(story())


def test_what_takes_too_long_is_ended_and_the_next_one_served():
    async def story():
        worker = FakeWorker()
        line = await line_of(worker, time_limit_s=0.01)
        slow = line.join(request("slow"), nobody)
        quick = line.join(request("quick"), nobody)
        quick.request["gate"].set()
        while quick.state != "done":
            await asyncio.sleep(0.01)
        assert slow.state == "failed"
        assert "longer than 0.01 seconds, the limit" in slow.sentence
        assert worker.num_killed == 1
        await line.close()

    asyncio.run(story())


def test_a_visitor_who_goes_away_ends_the_estimate():
    async def story():
        worker = FakeWorker()
        line = await line_of(worker)
        ticket = line.join(request("left"), nobody)
        await settled()
        line.leave(ticket)
        await settled()
        assert (ticket.state, worker.num_killed) == ("left", 1)
        await line.close()

    asyncio.run(story())


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (RefusedError("a.txt is no picture."), "a.txt is no picture."),
        (TypeError("inside"), "Something went wrong in the demo itself (TypeError)."),
    ],
)
def test_a_failure_is_a_sentence_and_the_worker_goes_on(error, sentence):
    async def story():
        line = await line_of(FakeWorker())
        bad = line.join(request("bad", error=error), nobody)
        good = line.join(request("good"), nobody)
        for ticket in (bad, good):
            ticket.request["gate"].set()
        await settled()
        assert (bad.state, bad.sentence, good.state) == ("failed", sentence, "done")
        await line.close()

    asyncio.run(story())
