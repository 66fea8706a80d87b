# SPDX-License-Identifier: BSD-3-Clause
"""The page: its head and its two tabs."""

import multiprocessing

from fastapi import FastAPI
from nicegui import run, ui

from epi360_demo.application import Demo
from epi360_demo.limits import RefusedError
from epi360_demo.pair_tab import PairTab
from epi360_demo.paper_tab import PaperTab

_ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><circle cx="16" cy="16" r="14" '
    'fill="#0b63ce"/><path d="M2 16a14 5 0 0 0 28 0M16 2a5 14 0 0 0 0 28" fill="none" '
    'stroke="#fff" stroke-width="2"/></svg>'
)
_HEAD = (
    '<link rel="stylesheet" href="/demo/colors.css">'
    '<link rel="stylesheet" href="/demo/demo.css">'
    + "".join(
        f'<script src="/demo/{name}"></script>'
        for name in ("geometry.js", "ball.js", "pictures.js", "paper.js")
    )
)  # fmt: skip


def add_page(app: FastAPI, demo: Demo) -> None:
    """Add the page to the application; NiceGUI holds one such page in a process."""

    @ui.page("/", title="epi360 demo")
    def page() -> None:
        ui.add_head_html(_HEAD)
        ui.colors(primary="#0b63ce")
        try:
            visitor = demo.visitors.arrive()
        except RefusedError as refusal:
            ui.label(str(refusal)).classes("problem")
            return
        pair = PairTab(demo, visitor)
        paper = PaperTab(demo)

        def leave() -> None:
            pair.leave()
            demo.visitors.leave(visitor)

        ui.context.client.on_delete(leave)
        with ui.element("main"):
            ui.html("<h1>epi360</h1><p class='soft'>How one camera stands to another, from two "
                    "360° or wide-angle pictures.</p>", sanitize=False)  # fmt: skip
            with ui.tabs().props("align=left no-caps inline-label") as tabs:
                first = ui.tab("pair", label="Two images")
                second = ui.tab("paper", label="The paper to play with")
            with ui.tab_panels(tabs, value=first, keep_alive=True, animated=False).classes(
                "w-full"
            ):
                with ui.tab_panel(first):
                    pair.build()
                with ui.tab_panel(second):
                    paper.build()
            tabs.on_value_change(lambda event: paper.shown() if event.value == "paper" else None)
            _footer(demo)

    # No page asks NiceGUI for a process, yet it makes ready for them. With the start method that is
    # the default since Python 3.14, the end by a signal then complains of leaked semaphores.
    if "fork" in multiprocessing.get_all_start_methods():
        run.process_pool_start_method = "fork"
    ui.run_with(
        app,
        title="epi360 demo",
        favicon=_ICON,
        dark=None,
        language="en-US",
        reconnect_timeout=demo.limits.max_gone_s,
        tailwind=False,
        show_welcome_message=False,
    )


def _footer(demo: Demo) -> None:
    minutes = demo.limits.max_idle_s / 60.0
    ui.html(
        "<footer>Pictures stay on the machine that runs this demo, in a temporary folder. They are "
        f"deleted when you remove or replace them, close the page, or do nothing for {minutes:g} "
        "minutes. The page loads nothing from elsewhere. It is made with NiceGUI (MIT licence, "
        "Zauberzeug GmbH).</footer>",
        sanitize=False,
    )
