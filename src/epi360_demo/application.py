# SPDX-License-Identifier: BSD-3-Clause
"""The web application without its elements: what is shared, uploads, results, the page's files."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from typing import Any

from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.requests import ClientDisconnect

from epi360_demo.examples import EXAMPLES, example_paths
from epi360_demo.limits import Limits, RefusedError
from epi360_demo.pair_job import RECORD, REPORT
from epi360_demo.pictures import check_picture
from epi360_demo.visitors import Upload, Visitor, Visitors
from epi360_demo.waiting_line import WaitingLine
from epi360_demo.worker_process import WorkerProcess

_SECONDS_BETWEEN_SWEEPS = 60.0
_MAX_LOOKS = 2  # settings of sliders that are worked on at a time
# Scripts and styles of the page, ours and those that we share with the report.
_PAGE_FILES = {
    "demo.css": "epi360_demo", "pictures.js": "epi360_demo", "paper.js": "epi360_demo",
    "colors.css": "epi360.report", "geometry.js": "epi360.report", "ball.js": "epi360.report",
}  # fmt: skip


class Demo:
    """What all open pages share."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.visitors = Visitors(limits)
        self.examples = self.visitors.root / "examples"
        self.examples.mkdir()
        self.looks = asyncio.Semaphore(_MAX_LOOKS)
        self._line: WaitingLine | None = None

    @property
    def line(self) -> WaitingLine:
        """The line before the workers; it is there while the server runs."""
        assert self._line is not None
        return self._line

    @asynccontextmanager
    async def running(self, _: FastAPI) -> AsyncIterator[None]:
        """Workers and the deletion of old files, from the start of the server to its end."""
        self._line = WaitingLine(self.limits, lambda: WorkerProcess(self.limits))
        sweeper = asyncio.create_task(self._sweep())
        try:
            yield
        finally:
            sweeper.cancel()
            await self._line.close()
            self.visitors.close()

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(_SECONDS_BETWEEN_SWEEPS)
            self.visitors.forget_idle()


def make_application(demo: Demo) -> FastAPI:
    """Return the application with everything but the page itself."""
    app = FastAPI(lifespan=demo.running, docs_url=None, redoc_url=None, openapi_url=None)
    _add_uploads(app, demo)
    _add_files(app, demo)
    return app


def _add_uploads(app: FastAPI, demo: Demo) -> None:
    @app.put("/pictures/{token}/{slot}")
    async def receive(request: Request, token: str, slot: str, name: str) -> Response:
        """Store a picture or a lens file and say what is wrong with it, if anything is."""
        try:
            visitor = demo.visitors.find(token)
            upload = await _received(demo, visitor, slot, name, request)
        except RefusedError as refusal:
            # The rest of what a browser sends is read and thrown away: it reads no answer before.
            await _drain(request, demo.limits.max_file_bytes)
            return JSONResponse({"sentence": str(refusal)}, status_code=422)
        except ClientDisconnect:
            return Response(status_code=400)
        return JSONResponse({"name": upload.name})

    @app.delete("/pictures/{token}/{slot}")
    async def remove(token: str, slot: str) -> Response:
        """Forget what a slot holds: the page shows something else in its place."""
        with suppress(RefusedError):
            visitor = demo.visitors.find(token)
            visitor.remove(slot)
            visitor.on_change()
        return Response(status_code=204)


async def _received(demo: Demo, visitor: Visitor, slot: str, name: str, request: Request) -> Upload:
    """Return an upload that was stored and looked at; the page hears of it, used or refused."""
    try:
        upload = await demo.visitors.receive(visitor, slot, name, request.stream())
        try:
            if slot != "lens":
                check_picture(upload.path, upload.name, demo.limits.max_pixels)
        except RefusedError:
            visitor.remove(slot)
            raise
        return upload
    finally:  # what the slot held before is gone in any case
        visitor.on_change()


async def _drain(request: Request, most: int) -> None:
    num_bytes = 0
    try:
        async for chunk in request.stream():
            num_bytes += len(chunk)
            if num_bytes > most:
                return
    except (ClientDisconnect, RuntimeError):  # there is no more
        return


def _add_files(app: FastAPI, demo: Demo) -> None:
    @app.get("/results/{token}/{name}")
    async def result(token: str, name: str, save: bool = False) -> Response:
        """Send the report or the record of the latest estimate."""
        try:
            path = demo.visitors.find(token).results / name
        except RefusedError as refusal:
            return PlainTextResponse(str(refusal), status_code=404)
        if name not in (REPORT, RECORD) or not path.is_file():
            return PlainTextResponse("There is no result of that name.", status_code=404)
        saved_as: dict[str, Any] = {"filename": f"epi360-{name}"} if save else {}
        return FileResponse(path, headers={"cache-control": "no-store"}, **saved_as)

    @app.get("/examples/{name}/{number}")
    async def example(name: str, number: int) -> Response:
        """Send a rendered picture."""
        if name in EXAMPLES and number in (1, 2):
            path = example_paths(demo.examples, name)[number - 1]
            if path.is_file():
                return FileResponse(path)
        return PlainTextResponse("There is no such picture.", status_code=404)

    @app.get("/demo/{name}")
    async def page_file(name: str) -> Response:
        """Send a script or a style of the page."""
        if name not in _PAGE_FILES:
            return PlainTextResponse("There is no such file.", status_code=404)
        text = (files(_PAGE_FILES[name]) / "page" / name).read_text(encoding="utf-8")
        kind = "text/css" if name.endswith(".css") else "text/javascript"
        return Response(text, media_type=kind, headers={"cache-control": "no-cache"})
