# SPDX-License-Identifier: BSD-3-Clause
"""What stands before the application: no other web page may talk to it.

NiceGUI takes messages from pages of any origin. A page that a visitor opens elsewhere could send
some to a demo on the loopback address, or read its answers through a name of its own that suddenly
means 127.0.0.1 (DNS rebinding). Names that may be such ones, and requests that come from other
pages, are refused; the headers of the answers keep the page from asking anybody else.
"""

import ipaddress
import socket
from collections.abc import Callable, MutableMapping
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

# Of everything but uploads, which count for themselves.
LARGEST_BODY = 2**20
UPLOADS = "/pictures/"
RESULTS = "/results/"
# Reports have a stricter policy of their own, inside the file.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; "
    "connect-src 'self'; object-src 'none'; base-uri 'self'; form-action 'self'; "
    "frame-ancestors 'self'"
)
_HEADERS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "SAMEORIGIN",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}


def host_rule(host: str, public_name: str | None = None) -> Callable[[str], bool]:
    """Return which names the demo answers to when it listens on an address.

    On the loopback address it answers to loopback addresses and ``localhost``. Elsewhere it also
    answers to every IP address and the names of this machine: an address cannot be rebound. The
    public name is that of a web server that stands before it.
    """
    own = {"localhost", host.lower()} | ({public_name.lower()} if public_name else set())
    if not _is_loopback(host):
        name = socket.gethostname().lower()
        own |= {name, f"{name}.local", socket.getfqdn().lower()}

    def is_ours(name: str) -> bool:
        if name.lower() in own:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return address.is_loopback or not _is_loopback(host)

    return is_ours


class Guard:
    """An ASGI application around another one."""

    def __init__(self, app: ASGIApp, is_our_name: Callable[[str], bool]) -> None:
        self._app = app
        self._is_our_name = is_our_name

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope, Headers(scope=scope))
        if refusal is None:
            await self._app(scope, receive, _with_headers(scope, send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": refusal[1][:100]})
        else:
            await PlainTextResponse(refusal[1], status_code=refusal[0])(scope, receive, send)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        host = headers.get("host", "")
        if not self._is_our_name(_name_of(host)):
            return 403, "This demo does not answer to that name; open it by its address."
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return 403, "Another web page may not talk to this demo."
        if _is_from_elsewhere(scope, headers):
            return 403, "Another web page may not talk to this demo."
        if scope["type"] == "http" and not scope["path"].startswith(UPLOADS):
            return _body_refusal(headers)
        return None


def _body_refusal(headers: Headers) -> tuple[int, str] | None:
    if "transfer-encoding" in headers:
        return 411, "The length of what is sent must be known."
    length = headers.get("content-length", "0")
    if not length.isdigit() or int(length) > LARGEST_BODY:
        return 413, "This is more than the demo takes."
    return None


def _is_from_elsewhere(scope: Scope, headers: Headers) -> bool:
    """Whether a browser says that another site asks, except for opening the page by a link."""
    if headers.get("sec-fetch-site", "none") in ("none", "same-origin"):
        return False
    opens_page = (
        scope["type"] == "http"
        and scope["method"] == "GET"
        and headers.get("sec-fetch-mode") == "navigate"
        and headers.get("sec-fetch-dest") == "document"
    )
    return not opens_page


def _with_headers(scope: Scope, send: Send) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=_as_scope(message))
            for name, value in _HEADERS.items():
                headers[name] = value
            if not scope["path"].startswith(RESULTS):
                headers["content-security-policy"] = _POLICY
        await send(message)

    return send_with_headers


def _as_scope(message: Message) -> MutableMapping[str, Any]:
    message.setdefault("headers", [])
    return message


def _name_of(host: str) -> str:
    """Return the name of a Host header without its port; the brackets of IPv6 go."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _is_loopback(host: str) -> bool:
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
