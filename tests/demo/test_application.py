# SPDX-License-Identifier: BSD-3-Clause
"""What the server answers to uploads and to requests for files, without a browser."""

import warnings
from contextlib import contextmanager

import pytest
from odd_files import TEXT, jpeg, noise_picture, png_bomb

pytest.importorskip("fastapi", reason="the extra [demo] is not installed")
pytest.importorskip("httpx", reason="the extra [demo] is not installed")

with warnings.catch_warnings():  # it wants another package of the same kind
    warnings.simplefilter("ignore")
    from fastapi.testclient import TestClient

from epi360_demo.application import Demo, make_application
from epi360_demo.limits import Limits


@contextmanager
def open_page(**limits):
    """A client, a visitor and the demo, while its server runs."""
    demo = Demo(Limits(num_workers=1, **limits))
    with TestClient(make_application(demo)) as client:
        yield client, demo.visitors.arrive(), demo
    assert not demo.visitors.root.exists()


def put(client, visitor, content, *, slot="1", name="a.jpg"):
    return client.put(f"/pictures/{visitor.token}/{slot}", params={"name": name}, content=content)


def test_a_picture_is_kept_and_its_page_hears_of_it():
    with open_page() as (client, visitor, _):
        heard = []
        visitor.on_change = lambda: heard.append(sorted(visitor.uploads))
        assert put(client, visitor, jpeg(noise_picture())).json() == {"name": "a.jpg"}
        assert heard == [["1"]]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (TEXT, "a.jpg is not a JPEG"),
        (png_bomb(), "200 megapixels"),
        (b"", "a.jpg is empty."),
        (jpeg(noise_picture(256, 128)) * 10, "a.jpg is larger than 0.0954 MB, the limit."),
    ],
    ids=["text", "bomb", "empty", "large"],
)
def test_what_cannot_be_used_is_answered_in_a_sentence_and_not_kept(content, words):
    with open_page(max_file_bytes=100_000) as (client, visitor, demo):
        answer = put(client, visitor, content)
        assert answer.status_code == 422
        assert words in answer.json()["sentence"]
        assert visitor.uploads == {}
        assert [path for path in demo.visitors.root.rglob("*") if path.is_file()] == []


def test_a_page_hears_that_its_picture_went_when_the_next_one_cannot_be_used():
    with open_page() as (client, visitor, _):
        put(client, visitor, jpeg(noise_picture()))
        heard = []
        visitor.on_change = lambda: heard.append(sorted(visitor.uploads))
        assert put(client, visitor, TEXT).status_code == 422
        assert heard == [[]]


def test_a_picture_is_forgotten_when_its_page_shows_something_else_in_its_place():
    with open_page() as (client, visitor, demo):
        for slot in ("1", "2"):
            put(client, visitor, jpeg(noise_picture()), slot=slot)
        heard = []
        visitor.on_change = lambda: heard.append(sorted(visitor.uploads))
        assert client.delete(f"/pictures/{visitor.token}/1").status_code == 204
        assert heard == [["2"]]
        assert [path.name[0] for path in demo.visitors.root.rglob("*.jpg")] == ["2"]
        assert client.delete("/pictures/guess/2").status_code == 204
        assert sorted(visitor.uploads) == ["2"]


def test_a_page_that_is_gone_gets_a_sentence():
    with open_page() as (client, visitor, demo):
        demo.visitors.leave(visitor)
        assert "load it again" in put(client, visitor, TEXT).json()["sentence"]


def test_results_are_for_those_who_hold_the_token_and_have_two_names():
    with open_page() as (client, visitor, _):
        visitor.results.mkdir(parents=True)
        for name in ("report.html", "pair.json", "other.txt"):
            (visitor.results / name).write_text("content")
        base = f"/results/{visitor.token}"
        assert client.get(f"{base}/report.html").text == "content"
        saved = client.get(f"{base}/pair.json", params={"save": "true"})
        assert 'filename="epi360-pair.json"' in saved.headers["content-disposition"]
        for path in (f"{base}/other.txt", f"{base}/..%2f1.jpg", "/results/guess/report.html"):
            assert client.get(path).status_code == 404


@pytest.mark.parametrize("path", ["/demo/server.py", "/demo/..%2fserver.py", "/examples/no/1"])
def test_only_files_of_the_page_are_sent(path):
    with open_page() as (client, _, _):
        assert client.get("/demo/paper.js").headers["content-type"].startswith("text/javascript")
        assert client.get(path).status_code == 404
