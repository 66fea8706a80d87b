# SPDX-License-Identifier: BSD-3-Clause
"""The first tab: two pictures or an example, options, the verdict and the report."""

import html
import json
from contextlib import suppress
from functools import partial
from typing import Any

from nicegui import ui

from epi360_demo.application import Demo
from epi360_demo.examples import EXAMPLES
from epi360_demo.limits import RefusedError, megabytes, megapixels
from epi360_demo.pair_job import RECORD, REPORT
from epi360_demo.pair_options import PairOptions
from epi360_demo.visitors import Visitor
from epi360_demo.waiting_line import Ticket

_ACCEPTED = "image/jpeg,image/png,image/tiff,image/webp,image/bmp"


class PairTab:
    """The elements of the tab on one open page, and the estimate that it waits for."""

    def __init__(self, demo: Demo, visitor: Visitor) -> None:
        self._demo, self._visitor = demo, visitor
        self._ticket: Ticket | None = None
        self._example: str | None = None
        self._num_results = 0
        visitor.on_change = self._uploads_changed
        visitor.on_forgotten = partial(self._run, "pictures.clear()")

    def build(self) -> None:
        """Make the elements."""
        self._client = ui.context.client
        limits = self._demo.limits
        hint = (
            "Drop two files at once, or one at a time. JPEG, PNG, TIFF, WebP or BMP, up to "
            f"{megabytes(limits.max_file_bytes)} and {megapixels(limits.max_pixels)} each."
        )
        slots = "".join(_slot_html(number) for number in ("1", "2"))
        ui.html(
            f'<div class="slots">{slots}</div><p class="soft">{hint}</p><h2>Or an example</h2>',
            sanitize=False,
        )
        with ui.element("div").classes("examples"):
            for name, example in EXAMPLES.items():
                with ui.element("button").classes("example").props(f'type=button id="{name}"') as b:
                    ui.html(f"<b>{example.title}</b><span>{example.words}</span>", sanitize=False)
                b.on("click", partial(self._take_example, name))
        self._options = PairOptions()
        with ui.element("div").classes("actions"):
            self._start = ui.button("Estimate the pose", on_click=self._estimate)
            self._stop = ui.button("Stop", on_click=self._give_up).props("outline")
            self._clear = ui.button("Remove the pictures", on_click=self._remove).props("flat")
        self._status = ui.label().classes("status").props("role=status aria-live=polite")
        self._verdict = ui.html("", sanitize=False)
        self._frame = (
            ui.element("iframe")
            .classes("report")
            .props('title="Report of the pair" onload="fitReport(this)"')
        )
        self._frame.set_visibility(False)
        self._uploads_changed()
        self._run(f"pictures.start({json.dumps(self._visitor.token)}, {limits.max_file_bytes})")

    def leave(self) -> None:
        """Give up what this page waits for: it is gone."""
        self._end_work()

    def _run(self, script: str) -> None:
        self._client.run_javascript(script)

    def _uploads_changed(self) -> None:
        """After a file came or went: an answer to other pictures must not stand beside it."""
        uploads = self._visitor.uploads
        if self._example is not None and ("1" in uploads or "2" in uploads):
            self._example = None
            missing = [slot for slot in ("1", "2") if slot not in uploads]
            self._run("".join(f"pictures.say('{slot}', 'Drop a picture');" for slot in missing))
        if self._example is None:
            self._end_work()
            self._say("")
            self._show_result(None)
        self._show_buttons()

    def _show_buttons(self) -> None:
        uploads = self._visitor.uploads
        busy = self._ticket is not None
        ready = self._example is not None or ("1" in uploads and "2" in uploads)
        self._start.set_enabled(ready and not busy)
        self._stop.set_visibility(busy)
        self._clear.set_visibility(bool(uploads) and not busy)

    def _take_example(self, name: str) -> None:
        if self._ticket is not None:
            return
        self._remove()
        self._example = name
        title = EXAMPLES[name].title
        self._run(f"for (const k of ['1', '2']) pictures.say(k, {json.dumps(title)})")
        self._estimate()

    def _remove(self) -> None:
        self._example = None
        self._visitor.remove_all()
        self._run("pictures.clear()")
        self._uploads_changed()

    def _give_up(self) -> None:
        self._end_work()
        self._say("Stopped.")
        self._show_buttons()

    def _end_work(self) -> None:
        ticket, self._ticket = self._ticket, None
        if ticket is not None:
            self._demo.line.leave(ticket)

    def _estimate(self) -> None:
        try:
            request = self._request()
            self._visitor.results.mkdir(parents=True, exist_ok=True)
            self._show_result(None)
            self._ticket = self._demo.line.join(request, self._ticket_changed)
            self._run("document.querySelector('.status').scrollIntoView({block: 'nearest'})")
        except RefusedError as refusal:
            self._fail(str(refusal))
        self._show_buttons()

    def _request(self) -> dict[str, Any]:
        uploads = self._visitor.uploads
        request: dict[str, Any] = {
            "choices": self._options.choices().record(),
            "out": str(self._visitor.results),
            "max_pixels": self._demo.limits.max_pixels,
        }
        if self._example is not None:
            return request | {"example": self._example, "examples": str(self._demo.examples)}
        given = {slot: {"path": str(up.path), "name": up.name} for slot, up in uploads.items()}
        if "1" not in given or "2" not in given:
            raise RefusedError("Drop two pictures first, or pick an example.")
        return request | {"pictures": [given["1"], given["2"]], "lens": given.get("lens")}

    def _ticket_changed(self, ticket: Ticket) -> None:
        if ticket is not self._ticket and self._ticket is not None:
            return
        if ticket.state == "waiting":
            others = ticket.position - 1
            before = {0: "You are next", 1: "One other is before you"}
            self._say(f"Waiting: {before.get(others, f'{others} others are before you')}.")
        elif ticket.state == "running":
            self._say(f"Working: {ticket.progress or 'starting'} …")
        elif ticket.state in ("done", "failed"):
            self._ticket = None
            if ticket.answer is None:
                self._fail(ticket.sentence)
            else:
                self._say("")
                self._show_result(ticket.answer)
            self._show_buttons()

    def _say(self, words: str) -> None:
        self._status.classes(remove="problem").set_text(words)

    def _fail(self, sentence: str) -> None:
        self._status.classes(add="problem").set_text(sentence)

    def _show_result(self, answer: dict[str, Any] | None) -> None:
        self._frame.set_visibility(answer is not None)
        if answer is None:
            self._verdict.set_content("")
            with suppress(KeyError):
                del self._frame.props["src"]
            return
        if self._example is not None:
            self._show_example(self._example)
        self._num_results += 1
        base = f"/results/{self._visitor.token}"
        self._verdict.set_content(_verdict_html(answer, base))
        self._frame.props["src"] = f"{base}/{REPORT}?number={self._num_results}"
        self._frame.update()

    def _show_example(self, name: str) -> None:
        title = EXAMPLES[name].title
        for number in (1, 2):
            words = json.dumps(f"{title}, view {number}")
            self._run(f"pictures.show('{number}', '/examples/{name}/{number}', {words})")


def _slot_html(number: str) -> str:
    which = {"1": "first", "2": "second"}[number]
    empty = f"Drop the {which} picture here, or choose it"
    return (
        f'<label class="slot" data-slot="{number}"><input type="file" accept="{_ACCEPTED}" '
        f'multiple aria-label="The {which} picture"><img alt="">'
        f'<span class="words" data-empty="{empty}">{empty}</span></label>'
    )


def _verdict_html(answer: dict[str, Any], base: str) -> str:
    kind = " ok" if answer["status"] == "ok" else ""
    sentences = "".join(f"<p>{html.escape(text)}</p>" for text in answer["sentences"])
    if answer["truth"]:
        sentences += f'<p class="truth">{html.escape(answer["truth"])}</p>'
    return (
        f'<section class="verdict{kind}"><h2>{html.escape(answer["headline"])}</h2>{sentences}'
        f'<p class="links"><a href="{base}/{REPORT}?save=true" download>Save the report</a> '
        f'<a href="{base}/{RECORD}?save=true" download>Save the JSON</a> '
        f'<a href="{base}/{REPORT}" target="_blank">Open the report alone</a></p></section>'
    )
