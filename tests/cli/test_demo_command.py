# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 demo`: what its words mean, and that it says where it listens and ends when told so."""

import os
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest
from command_line import assert_help_names, assert_wrong_use

needs_demo = pytest.mark.skipif(
    any(not __import__("importlib.util").util.find_spec(name) for name in ("nicegui", "uvicorn")),
    reason="the extra [demo] is not installed",
)


def test_help_names_the_address_and_the_limits(capsys):
    assert_help_names(
        capsys, "demo", "--host", "--port", "--no-open", "--max-megabytes", "--max-megapixels",
        "--workers", "--max-waiting", "--time-limit-s",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["--port", "70000"], "--port must be between 0 and 65535"),
        (["--max-megabytes", "nan"], "--max-megabytes must be between"),
        (["--max-megapixels", "0"], "--max-megapixels must be between"),
        (["--workers", "0"], "--workers must be between 1 and 64"),
        (["--time-limit-s", "0"], "--time-limit-s must be between"),
        (["picture.jpg"], "picture.jpg"),
    ],
)
def test_wrong_words_are_one_line(capsys, words, fragment):
    assert_wrong_use(capsys, ["demo", *words], fragment)


@needs_demo
def test_a_port_that_is_taken_is_one_line(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert_wrong_use(capsys, ["demo", "--port", port], f"at port {port}: ", "in use")


def test_without_the_extra_the_command_says_how_to_install_it(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "nicegui", None)
    assert_wrong_use(capsys, ["demo"], "demo pages need nicegui: pip install 'epi360[demo]'")


@needs_demo
@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX")
@pytest.mark.parametrize("how", ["SIGINT", "SIGHUP"], ids=["Ctrl-C", "closed terminal"])
def test_the_page_answers_where_the_command_says_and_leaves_nothing_behind(tmp_path, how):
    process = subprocess.Popen(
        [sys.executable, "-m", "epi360", "demo", "--port", "0", "--no-open"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        env=os.environ | {"TMPDIR": str(tmp_path)},
        # Under nohup, a closed terminal ends no command that it starts.
        preexec_fn=lambda: signal.signal(signal.Signals[how], signal.SIG_DFL),
    )  # fmt: skip
    try:
        address = process.stdout.readline().split()[2]
        with urllib.request.urlopen(address, timeout=60) as answer:
            assert b"epi360 demo" in answer.read()
        assert len(list(tmp_path.iterdir())) == 1
        process.send_signal(signal.Signals[how])
        rest, complaints = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (rest, complaints) == ("", "")
    assert process.returncode == (0 if how == "SIGINT" else -signal.SIGTERM)
    assert list(tmp_path.iterdir()) == []


@needs_demo
@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX")
def test_a_demo_that_is_ended_when_it_says_its_address_leaves_nothing_behind(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "epi360", "demo", "--port", "0", "--no-open"],
        stdout=subprocess.PIPE, text=True, cwd=tmp_path,
        env=os.environ | {"TMPDIR": str(tmp_path)},
    )  # fmt: skip
    try:
        assert "http://127.0.0.1:" in process.stdout.readline()
        process.terminate()
        process.communicate(timeout=60)
    finally:
        process.kill()
    assert list(tmp_path.iterdir()) == []
