# SPDX-License-Identifier: BSD-3-Clause
"""No other web page talks to the demo, by its own name or by one that was bent to our address."""

import asyncio

import pytest

pytest.importorskip("starlette", reason="the extra [demo] is not installed")

from epi360_demo.guard import LARGEST_BODY, Guard, host_rule

OURS = "127.0.0.1:8360"


async def application(scope, receive, send):
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"inside"})


def ask(headers, *, kind="http", method="GET", path="/", host="127.0.0.1", name=None):
    """Messages that the guard of a demo on an address sends to a request."""
    scope = {
        "type": kind, "method": method, "path": path, "query_string": b"",
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }  # fmt: skip
    sent = []

    async def receive():
        return {"type": "websocket.connect" if kind == "websocket" else "http.request", "body": b""}

    async def send(message):
        sent.append(message)

    asyncio.run(Guard(application, host_rule(host, name))(scope, receive, send))
    return sent


def status_of(headers, **request):
    return ask(headers, **request)[0]["status"]


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "[::1]", "127.8.9.1", "LOCALHOST"])
def test_names_of_this_machine_are_answered(name):
    assert status_of({"host": f"{name}:8360"}) == 200
    assert status_of({"host": name}) == 200


@pytest.mark.parametrize("name", ["evil.example", "127.0.0.1.evil.example", "192.168.0.7", "", "["])
def test_a_name_that_may_be_bent_to_our_address_is_refused(name):
    assert status_of({"host": f"{name}:8360"}) == 403


def test_a_demo_for_everybody_answers_to_addresses_and_still_to_no_foreign_name():
    assert status_of({"host": "192.168.0.7:8360"}, host="0.0.0.0") == 200
    assert status_of({"host": "evil.example:8360"}, host="0.0.0.0") == 403


def test_a_web_server_before_the_demo_passes_its_own_name_on():
    headers = {"host": "demo.example.org", "origin": "https://demo.example.org"}
    assert status_of(headers, method="PUT", path="/pictures/x/1", name="demo.example.org") == 200
    assert status_of(headers, method="PUT", path="/pictures/x/1") == 403


@pytest.mark.parametrize(
    "origin", ["https://evil.example", "http://127.0.0.1:9999", "http://localhost:8360", "null", ""]
)
@pytest.mark.parametrize("method", ["GET", "POST", "PUT"])
def test_what_another_page_sends_is_refused(origin, method):
    assert status_of({"host": OURS, "origin": origin}, method=method, path="/pictures/x/1") == 403


def test_what_our_own_page_sends_is_taken():
    headers = {"host": OURS, "origin": f"http://{OURS}", "sec-fetch-site": "same-origin"}
    assert status_of(headers, method="PUT", path="/pictures/x/1") == 200


def test_another_page_opens_no_websocket():
    ours = ask({"host": OURS, "origin": f"http://{OURS}"}, kind="websocket")
    assert ours[0]["type"] == "websocket.accept"
    other = ask({"host": OURS, "origin": "https://evil.example"}, kind="websocket")
    assert [message["type"] for message in other] == ["websocket.close"]


def test_a_link_elsewhere_may_open_the_page_but_nothing_may_load_it_or_frame_it():
    link = {"host": OURS, "sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
    assert status_of(link | {"sec-fetch-dest": "document"}) == 200
    assert status_of(link | {"sec-fetch-dest": "iframe"}) == 403
    assert status_of(link | {"sec-fetch-mode": "no-cors", "sec-fetch-dest": "script"}) == 403
    assert status_of(link | {"sec-fetch-dest": "document"}, method="POST") == 403


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"content-length": str(LARGEST_BODY + 1)}, 413),
        ({"content-length": "-1"}, 413),
        ({"transfer-encoding": "chunked"}, 411),
        ({"content-length": "1000"}, 200),
    ],
)
def test_long_bodies_are_refused_but_for_uploads_which_count_for_themselves(headers, status):
    assert status_of({"host": OURS} | headers, method="POST", path="/_nicegui_ws/") == status
    assert status_of({"host": OURS} | headers, method="PUT", path="/pictures/x/1") == 200


def test_the_browser_is_told_to_load_nothing_from_elsewhere():
    headers = dict(ask({"host": OURS})[0]["headers"])
    policy = headers[b"content-security-policy"].decode()
    assert policy.startswith("default-src 'self';")
    assert "http" not in policy and "*" not in policy
    assert headers[b"x-frame-options"] == b"SAMEORIGIN"
