# SPDX-License-Identifier: BSD-3-Clause
"""Starting and ending the demo's server."""

import os
import signal
import socket
import threading
import webbrowser
from collections.abc import Callable

import uvicorn
from threadpoolctl import threadpool_limits

from epi360_demo.application import Demo, make_application
from epi360_demo.guard import Guard, host_rule
from epi360_demo.limits import Limits

FIRST_PORT, NUM_PORTS = 8360, 20
_SECONDS_TO_END = 3


def serve(
    host: str,
    port: int | None,
    limits: Limits,
    *,
    public_name: str | None = None,
    opens_browser: bool,
    say: Callable[[str], None],
) -> None:
    """Serve the demo until it is interrupted.

    Without a port, the first free one from 8360 on is taken. ``say`` gets the address once it
    answers. ``ValueError`` if the address cannot be listened on.
    """
    listener = _listener(host, port)
    demo = Demo(limits)
    # Read when NiceGUI is loaded: it would keep a folder in the current one.
    os.environ["NICEGUI_STORAGE_PATH"] = str(demo.visitors.root / "nicegui")
    _end_with_terminal()
    threadpool_limits(1)  # small matrices; the cores are for the estimates
    try:
        from epi360_demo.page_frame import add_page

        app = make_application(demo)
        add_page(app, demo)
        config = uvicorn.Config(
            Guard(app, host_rule(host, public_name)), log_level="warning", server_header=False,
            ws_max_size=2**20, timeout_graceful_shutdown=_SECONDS_TO_END, limit_concurrency=1000,
        )  # fmt: skip
        address = _address(host, listener.getsockname()[1])

        def when_it_answers() -> None:
            say(address)
            if opens_browser:
                threading.Timer(0.5, webbrowser.open, [address]).start()

        _Server(config, when_it_answers).run(sockets=[listener])
    finally:
        demo.visitors.close()
        listener.close()


class _Server(uvicorn.Server):
    """A server that says when it answers; from then on a signal ends it in order."""

    def __init__(self, config: uvicorn.Config, when_it_answers: Callable[[], None]) -> None:
        super().__init__(config)
        self._when_it_answers = when_it_answers

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            self._when_it_answers()


def _end_with_terminal() -> None:
    """End as after Ctrl-C when the terminal is closed, unless started with nohup."""
    hangup = getattr(signal, "SIGHUP", None)  # Windows has none
    if hangup is not None and signal.getsignal(hangup) is signal.SIG_DFL:
        signal.signal(hangup, lambda *_: signal.raise_signal(signal.SIGTERM))


def _listener(host: str, port: int | None) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    ports = range(FIRST_PORT, FIRST_PORT + NUM_PORTS) if port is None else [port]
    problem: OSError | None = None
    for each in ports:
        try:
            return socket.create_server((host, each), family=family)
        except OSError as error:
            problem = error
    where = f"port {port}" if port is not None else f"any port from {FIRST_PORT} on"
    reason = problem.strerror if problem else "unknown"
    raise ValueError(f"--host {host} cannot be listened on at {where}: {reason}")


def _address(host: str, port: int) -> str:
    """Return an address that a browser on this machine opens."""
    shown = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
    return f"http://{shown}:{port}/"
