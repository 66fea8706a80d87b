# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 demo``: a local page for two images, and the paper to play with."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Group, Parameter

from epi360.cli.command import SUCCESS, TO_TRY, app


@Parameter(name="*", group=Group("Address", sort_key=1))
@dataclass(frozen=True)
class DemoAddress:
    """Where the demo listens."""

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 lets everybody in who reaches this machine, without a
    password."""
    port: int | None = None
    """Port; by default the first free one from 8360 on, and 0 is any free one."""
    public_name: str | None = None
    """Name that the demo answers to besides, where a web server passes requests on to it."""
    open: Annotated[bool | None, Parameter(negative="--no-open")] = None
    """Open the page in the browser; by default where there is a screen."""


@Parameter(name="*", group=Group("Limits", sort_key=2))
@dataclass(frozen=True)
class DemoLimits:
    """How much visitors may ask for."""

    max_megabytes: float = 64.0
    """Largest picture file."""
    max_megapixels: float = 100.0
    """Most pixels of a picture."""
    workers: int | None = None
    """Estimates at a time; by default half the number of cores, four at most."""
    max_waiting: int = 20
    """Most visitors who wait for an estimate."""
    time_limit_s: float = 120.0
    """An estimate that takes longer is ended."""


LOCAL, USUAL = DemoAddress(), DemoLimits()


@app.command(group=TO_TRY, sort_key=1)
def demo(*, address: DemoAddress = LOCAL, limit: DemoLimits = USUAL) -> int:
    """Start a local page: two images to a pose with its report, and the paper to play with.

    It serves until Ctrl-C. Uploaded pictures are decoded in a process of their own and deleted
    when their page is closed.
    """
    from epi360.extras import extra_library

    _check(address, limit)
    for library in ("nicegui", "fastapi", "uvicorn"):
        extra_library(library, extra="demo", purpose="demo pages")
    from epi360_demo.limits import Limits, default_num_workers
    from epi360_demo.server import serve

    limits = Limits(
        max_file_bytes=round(limit.max_megabytes * 2**20),
        max_pixels=round(limit.max_megapixels * 1e6),
        num_workers=limit.workers or default_num_workers(),
        max_waiting=limit.max_waiting,
        time_limit_s=limit.time_limit_s,
    )
    opens = _has_screen() if address.open is None else address.open

    def say(page: str) -> None:
        print(f"epi360 demo: {page}  (Ctrl-C ends it)", flush=True)

    try:
        serve(
            address.host, address.port, limits, public_name=address.public_name,
            opens_browser=opens, say=say,
        )  # fmt: skip
    except KeyboardInterrupt:  # how a demo ends
        pass
    return SUCCESS


def _check(address: DemoAddress, limit: DemoLimits) -> None:
    """Raise ``ValueError`` for numbers with which nothing could be served."""
    if address.port is not None and not 0 <= address.port <= 65535:
        raise ValueError(f"--port must be between 0 and 65535, got {address.port}")
    for name, value, low, high in (
        ("max-megabytes", limit.max_megabytes, 0.01, 4096.0),
        ("max-megapixels", limit.max_megapixels, 0.01, 268.0),
        ("workers", 1 if limit.workers is None else limit.workers, 1, 64),
        ("max-waiting", limit.max_waiting, 1, 1000),
        ("time-limit-s", limit.time_limit_s, 1.0, 86400.0),
    ):
        if not low <= value <= high:  # also NaN
            raise ValueError(f"--{name} must be between {low:g} and {high:g}, got {value:g}")


def _has_screen() -> bool:
    """Whether a browser would have a window to open."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
