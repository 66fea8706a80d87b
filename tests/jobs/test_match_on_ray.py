# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 match` on Ray: the bytes of the local engine, whatever is killed on the way."""

import dataclasses
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from ray_workers import busy_workers, wait_until_gone, wait_until_idle
from rendered_views import NAMES, write_views

import epi360
from epi360 import cli
from epi360.jobs import ray_tasks
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching import match_job, match_on_ray
from epi360.jobs.matching.match_folder import (
    MatchOptions,
    _open_work,
    load_matches,
    match_images,
    open_engine,
)
from epi360.jobs.records.match_store import keys_by_part
from epi360.report.pairs_table import pairs_csv

NUM_PAIRS, PAIRS_PER_PART = 6, 2


@pytest.fixture(scope="module", autouse=True)
def small_parts():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(match_job, "PAIRS_PER_PART", PAIRS_PER_PART)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_views(tmp_path_factory.mktemp("views"))


@pytest.fixture(scope="module")
def local(folder, tmp_path_factory):
    """Output of the local engine, and what the run returned."""
    output = tmp_path_factory.mktemp("local") / "out"
    return output, match_images(find_images(folder), output)


def stored(output):
    """Every file but the hashes of the pictures, which only save time."""
    files = [path for path in output.rglob("*") if path.is_file() and path.name != "digests.json"]
    return {path.relative_to(output): path.read_bytes() for path in files}


@pytest.mark.slow
def test_ray_writes_what_the_local_engine_writes(folder, local, ray_session, tmp_path):
    told = []
    run = match_images(
        find_images(folder), tmp_path, engine="ray", progress=lambda *call: told.append(call)
    )
    assert stored(tmp_path) == stored(local[0])
    assert len(list((tmp_path / "pairs").iterdir())) == NUM_PAIRS // PAIRS_PER_PART
    assert pairs_csv(run) == pairs_csv(local[1])
    assert [call for call in told if call[0] == "pairs"] == [("pairs", n, 6) for n in (0, 2, 4, 6)]
    assert [call[1] for call in told if call[0] == "features"] == list(range(len(NAMES) + 1))
    # Each engine goes on with what the other has left.
    assert match_images(find_images(folder), tmp_path).num_found == NUM_PAIRS


@pytest.mark.slow
def test_ray_writes_to_a_url(folder, local, ray_session, tmp_path):
    pytest.importorskip("fsspec")
    url = f"local://{tmp_path / 'bucket'}"  # a disk by way of fsspec
    run = match_images(find_images(folder), url, engine="ray")
    assert pairs_csv(run) == pairs_csv(local[1])
    assert stored(tmp_path / "bucket") == stored(local[0])


@pytest.mark.slow
def test_pairs_of_a_level_folder_are_verified_again_on_ray(folder, local, ray_session, tmp_path):
    level = Level(1.0, 5.0)
    written = []
    for engine in ("local", "ray"):
        output = tmp_path / engine
        match_images(find_images(folder), output)
        work = _open_work(find_images(folder), output, MatchOptions(num_threads=1), restart=False)
        for index in range(len(NAMES)):
            work.find_key(index)
        pairs = [(a, b) for a in range(len(NAMES)) for b in range(a + 1, len(NAMES))]
        pair_of = {work.keys_of(pair): pair for pair in pairs}
        parts = {name: {k: pair_of[k] for k in keys} for name, keys in keys_by_part(output)}
        with open_engine(work, engine, None) as opened:
            found = [each for part in opened.verify_again(parts, level) for each in part]
        assert {verdict.prior for _, verdict in found} == {"level, one height"}
        written.append(stored(output))
    assert len(written[0]) == len(stored(local[0])) + len(parts)
    assert written[0] == written[1]


@pytest.mark.slow
def test_an_image_that_cannot_be_read_costs_only_its_pairs_on_ray(ray_session, tmp_path):
    images = find_images(write_views(tmp_path / "views"))
    victim = tmp_path / "views" / NAMES[1]
    victim.write_bytes(victim.read_bytes()[:1000])
    runs = [match_images(images, tmp_path / each, engine=each) for each in ("local", "ray")]
    assert list(runs[1].unreadable) == [NAMES[1]]
    assert pairs_csv(runs[0]) == pairs_csv(runs[1])
    assert stored(tmp_path / "local") == stored(tmp_path / "ray")


@pytest.mark.slow
def test_killed_workers_change_nothing(folder, local, ray_session, tmp_path):
    killed, ended = {}, threading.Event()

    def kill_one_of_each():
        while not ended.wait(0.002):
            for task in {"_find_features", "_verify"} - killed.keys():
                for worker in busy_workers(os.getpid(), task)[:1]:
                    killed[task] = worker
                    os.kill(worker, signal.SIGKILL)

    killer = threading.Thread(target=kill_one_of_each)
    killer.start()
    try:
        run = match_images(find_images(folder), tmp_path, engine="ray")
    finally:
        ended.set()
        killer.join()
    assert killed.keys() == {"_find_features", "_verify"}
    assert pairs_csv(run) == pairs_csv(local[1])
    assert stored(tmp_path) == stored(local[0])


PROGRAM = f"""
import sys, time
from epi360.cli import main
from epi360.jobs.matching import match_job, match_folder
match_job.PAIRS_PER_PART = {PAIRS_PER_PART}
match_folder.write_index = lambda *_: time.sleep(60)  # it never ends before the blow
sys.exit(main(sys.argv[1:]))
"""


def start(folder, output, *words):
    """`epi360 match` on Ray as a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(Path(epi360.__file__).parents[1])}
    command = [sys.executable, "-c", PROGRAM, "match", str(folder), "--output", str(output)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    words = ["--engine", "ray", *words]
    return subprocess.Popen([*command, *words], env=environment, **pipes)


def wait_for_a_file(child, output, sub_folder, *, timeout_s=60.0):
    deadline = time.monotonic() + timeout_s
    while not list((output / sub_folder).glob("*.npz")):
        assert child.poll() is None, child.communicate()
        assert time.monotonic() < deadline, "nothing was finished"
        time.sleep(0.002)


@pytest.mark.slow
def test_killed_and_interrupted_drivers_lose_nothing(folder, local, ray_session, tmp_path):
    output, before = tmp_path / "out", {}
    for blow, sub_folder in ((signal.SIGKILL, "features"), (signal.SIGINT, "pairs")):
        child = start(folder, output, "--address", ray_session)
        wait_for_a_file(child, output, sub_folder)
        workers = set(busy_workers(os.getpid(), "_"))
        child.send_signal(blow)
        _, said = child.communicate(timeout=60)
        assert child.returncode == (-signal.SIGKILL if blow is signal.SIGKILL else 130), said
        assert "Traceback" not in said
        wait_until_gone(workers)
        wait_until_idle(os.getpid(), "_")
        with pytest.raises(FileNotFoundError, match="no complete result"):
            load_matches(output)
        now = {path: path.stat().st_ino for path in output.glob("*/*.npz")}
        assert before.items() < now.items()
        before = now
    run = match_images(find_images(folder), output)
    assert run.num_found >= PAIRS_PER_PART
    assert pairs_csv(run) == pairs_csv(local[1])
    assert stored(output) == stored(local[0])
    assert before.items() <= {path: path.stat().st_ino for path in output.glob("*/*.npz")}.items()


@pytest.mark.slow
def test_an_image_that_kills_every_worker_is_named(folder, ray_session, tmp_path, monkeypatch):
    monkeypatch.setattr(ray_tasks, "_MAX_RETRIES", 0)
    ended = threading.Event()

    def kill_all():
        while not ended.wait(0.002):
            for worker in busy_workers(os.getpid(), "_find_features"):
                os.kill(worker, signal.SIGKILL)

    killer = threading.Thread(target=kill_all)
    killer.start()
    try:
        with pytest.raises(ChildProcessError, match=r"gave up .*\.png after 1 tries"):
            match_images(find_images(folder), tmp_path, engine="ray")
    finally:
        ended.set()
        killer.join()


@pytest.mark.slow
def test_workers_of_another_version_are_refused(folder, ray_session, tmp_path, monkeypatch):
    monkeypatch.setattr(match_on_ray, "package_version", lambda: "99.0")
    with pytest.raises(ValueError, match=r"must have epi360 99\.0, the Ray worker"):
        match_images(find_images(folder), tmp_path, engine="ray")


@pytest.mark.parametrize("missing", ["picture", "features"])
def test_a_worker_that_does_not_see_the_files_says_so(folder, local, tmp_path, missing):
    work = _open_work(find_images(folder), local[0], MatchOptions(), restart=False)
    for index in (0, 1):
        work.find_key(index)
    inputs, versions = work.inputs.only([0, 1]), match_on_ray._versions()
    with pytest.raises(FileNotFoundError, match=r"not there for the Ray worker on .* must see"):
        if missing == "picture":
            moved = dataclasses.replace(inputs.images[0], path=tmp_path / "there.png")
            away = dataclasses.replace(inputs, images={0: moved})
            match_on_ray._find_features(away, 0, versions)
        else:
            cache = dataclasses.replace(inputs.cache, folder=tmp_path)
            away = dataclasses.replace(inputs, cache=cache)
            match_on_ray._verify(away, [(0, 1)], versions)


def test_an_output_that_only_the_workers_see_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="must be where all machines of the cluster see"):
        ray_tasks.check_is_seen(str(tmp_path / "features" / "key.npz"))


def test_a_cluster_that_does_not_answer_is_said(folder, tmp_path, monkeypatch):
    ray = pytest.importorskip("ray")
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    with pytest.raises(ConnectionError, match=r"no Ray cluster answers at 127\.0\.0\.1:1"):
        match_images(find_images(folder), tmp_path, engine="ray", address="127.0.0.1:1")


def test_an_address_of_another_kind_is_wrong_use(folder, tmp_path, capsys):
    pytest.importorskip("ray")
    words = ["--engine", "ray", "--address", "nonsense://x"]
    assert cli.main(["match", str(folder), "--output", str(tmp_path / "out"), *words]) == 2
    assert "address must be HOST:PORT, ray://HOST:PORT or auto" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--address", "auto"], "--address goes with --engine ray"),
        (["--engine", "ray", "--num-threads", "2"], "--num-threads goes with --engine local"),
    ],
)
def test_options_of_the_other_engine_are_refused(folder, tmp_path, capsys, words, message):
    output = tmp_path / "out"
    assert cli.main(["match", str(folder), "--output", str(output), *words]) == 2
    assert message in capsys.readouterr().err
    assert not output.exists()


def test_without_ray_the_message_says_what_to_install(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    output = tmp_path / "out"
    assert cli.main(["match", str(folder), "--output", str(output), "--engine", "ray"]) == 2
    assert "pip install 'epi360[cluster]'" in capsys.readouterr().err


def test_an_unknown_engine_is_refused(folder, tmp_path):
    with pytest.raises(ValueError, match="engine must be one of local, ray, got 'slurm'"):
        match_images(find_images(folder), tmp_path, engine="slurm")
