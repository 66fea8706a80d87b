"""`epi360 batch` killed, interrupted and out of disk: nothing is lost, nothing is done twice."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from ray_workers import busy_workers, wait_until_gone

import epi360
from epi360.cli import GOES_ON
from epi360.jobs import ray_tasks
from epi360.jobs.batch import BatchJob, MatchSource, ray_engine, run_batch
from epi360.synthetic import two_view_scene

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

# Five runs that are killed at most a part after their first finish fewer than these.
NUM_PARTS, PAIRS_PER_PART = 32, 2
NUM_PAIRS = NUM_PARTS * PAIRS_PER_PART
INTERRUPTED = f"epi360: interrupted; {GOES_ON}"
NEEDS_SIGNALS = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")


def hard_pair(seed):
    """Matches that take tens of milliseconds: four of five are wrong, in every fifth pair all."""
    scene = two_view_scene(seed, num_matches=100)
    rng = np.random.default_rng(seed)
    num_wrong = 100 if seed % 5 == 0 else 80
    wrong = rng.normal(size=(num_wrong, 3))
    bearings2 = scene.bearings2.copy()
    bearings2[:num_wrong] = wrong / np.linalg.norm(wrong, axis=1, keepdims=True)
    return scene.bearings1, bearings2


def easy_pair(seed):
    scene = two_view_scene(seed, num_matches=20)
    return scene.bearings1, scene.bearings2


def write_matches(path, groups):
    """One row group for each list of pairs; names count on."""
    schema = pa.schema(
        [(name, pa.string()) for name in ("image1", "image2")]
        + [(name, pa.list_(pa.float64())) for name in ("bearings1", "bearings2")]
    )
    count = 0
    with pq.ParquetWriter(path, schema) as writer:
        for pairs in groups:
            numbers = range(count, count := count + len(pairs))
            columns = {
                "image1": [f"{number}a.jpg" for number in numbers],
                "image2": [f"{number}b.jpg" for number in numbers],
                "bearings1": [pair[0].ravel() for pair in pairs],
                "bearings2": [pair[1].ravel() for pair in pairs],
            }
            writer.write_table(pa.table(columns, schema=schema))
    return path


def job_of(matches, output, **options):
    return BatchJob(MatchSource("parquet", str(matches), **options), str(output))


def poses(path):
    """Every column but the seconds, exactly: floats as they are written, NaN too."""
    return str(pq.read_table(path).drop_columns(["seconds"]).to_pylist())


def seconds_of(path):
    """Seconds by pair: a pair that is estimated again has other ones."""
    table = pq.read_table(path, columns=["image1", "image2", "seconds"]).to_pydict()
    names = zip(table["image1"], table["image2"], strict=True)
    return dict(zip(names, table["seconds"], strict=True))


def part_files(output):
    return sorted(Path(f"{output}.parts").glob("part-*.parquet"))


def seconds_of_parts(output):
    return {pair: value for path in part_files(output) for pair, value in seconds_of(path).items()}


def files_of_parts(output):
    """A file that is written again has another inode and time."""
    stats = {path.name: path.stat() for path in part_files(output)}
    return {name: (stat.st_ino, stat.st_mtime_ns) for name, stat in stats.items()}


def start(matches, output, *words, code="", **options):
    """`epi360 batch` as a process of its own, after some code that runs before it."""
    program = f"{code}\nimport sys; from epi360.cli import main; sys.exit(main(sys.argv[1:]))"
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(epi360.__file__).parents[1]),
        "PYTHONDONTWRITEBYTECODE": "1",  # half a byte-code file, where files may not grow
        "OMP_NUM_THREADS": "1",
    }
    command = [sys.executable, "-c", program, "batch", str(matches), "--output", str(output)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([*command, *words], env=environment, **pipes, **options)


def outcome(child):
    """Exit code and what was said on stderr."""
    _, said = child.communicate(timeout=120)
    return child.returncode, said


def wait_for_a_new_part(child, output, *, timeout_s=60.0):
    before, deadline = len(part_files(output)), time.monotonic() + timeout_s
    while len(part_files(output)) == before and child.poll() is None:
        assert time.monotonic() < deadline, "no part was finished"
        time.sleep(0.005)
    assert child.poll() is None, outcome(child)


@pytest.fixture(scope="module")
def matches(tmp_path_factory):
    pairs = [hard_pair(seed) for seed in range(NUM_PAIRS)]
    groups = [
        pairs[first : first + PAIRS_PER_PART] for first in range(0, NUM_PAIRS, PAIRS_PER_PART)
    ]
    return write_matches(tmp_path_factory.mktemp("matches") / "matches.parquet", groups)


@pytest.fixture(scope="module")
def matches_in_one_group(tmp_path_factory):
    """The same pairs in one row group, which Ray's tasks take in runs of parts."""
    pairs = [hard_pair(seed) for seed in range(NUM_PAIRS)]
    return write_matches(tmp_path_factory.mktemp("matches") / "one.parquet", [pairs])


@pytest.fixture(scope="module")
def uninterrupted(matches, tmp_path_factory):
    """Poses of a run that nothing disturbs, and its seconds a part on one thread."""
    output = tmp_path_factory.mktemp("whole") / "poses.parquet"
    summary = run_batch(job_of(matches, output), num_threads=1)
    return poses(output), summary.seconds / NUM_PARTS


def assert_is_whole(output, expected, finished):
    """All poses in order, finished pairs as they were, and nothing else in the folder."""
    assert poses(output) == expected
    seconds = seconds_of(output)
    assert len(seconds) == NUM_PAIRS
    assert finished.items() <= seconds.items()
    assert os.listdir(output.parent) == [output.name]


@NEEDS_SIGNALS
def test_kills_lose_nothing_and_do_nothing_twice(matches, uninterrupted, tmp_path):
    expected, part_s = uninterrupted
    moments = random.Random(6)
    output, finished, files = tmp_path / "poses.parquet", {}, {}
    for _ in range(5):
        child = start(matches, output, "--num-threads", "1")
        wait_for_a_new_part(child, output)
        time.sleep(moments.uniform(0.0, part_s))
        child.kill()
        assert outcome(child)[0] == -signal.SIGKILL
        assert not output.exists()  # it was in the middle
        assert finished.items() < seconds_of_parts(output).items()
        assert files.items() < files_of_parts(output).items()
        finished, files = seconds_of_parts(output), files_of_parts(output)
    assert outcome(start(matches, output, "--num-threads", "2"))[0] == 0
    assert_is_whole(output, expected, finished)


@NEEDS_SIGNALS
def test_an_interrupt_keeps_what_is_finished(matches, uninterrupted, tmp_path):
    output = tmp_path / "poses.parquet"
    child = start(matches, output, "--num-threads", "1")
    wait_for_a_new_part(child, output)
    child.send_signal(signal.SIGINT)
    code, said = outcome(child)
    assert (code, said.splitlines()[-1]) == (130, INTERRUPTED)
    names = {path.name for path in Path(f"{output}.parts").iterdir()}
    assert names == {path.name for path in part_files(output)} != set()


LIMIT = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, ({bytes}, resource.RLIM_INFINITY))
"""


@pytest.fixture
def growing_matches(tmp_path):
    """Three parts of one pair and one of 300, whose file is much larger."""
    pairs = [easy_pair(seed) for seed in range(303)]
    return write_matches(
        tmp_path / "growing.parquet", [pairs[:1], pairs[1:2], pairs[2:3], pairs[3:]]
    )


def assert_failed_clearly(child, path, reason):
    code, said = outcome(child)
    assert code == 2
    assert said.splitlines()[-1].startswith(f"epi360: error: {path}")
    assert reason in said.splitlines()[-1]
    assert "Traceback" not in said


def test_a_part_that_cannot_be_written_leaves_the_finished_ones(growing_matches, tmp_path):
    pytest.importorskip("resource")
    output = tmp_path / "out" / "poses.parquet"
    child = start(growing_matches, output, code=LIMIT.format(bytes=32768))
    assert_failed_clearly(child, f"{output}.parts/part-000003.parquet", "File too large")
    assert len(list(Path(f"{output}.parts").iterdir())) == 3
    finished = seconds_of_parts(output)
    summary = run_batch(job_of(growing_matches, output), num_threads=1)
    assert (summary.num_pairs, summary.num_estimated) == (303, 300)
    assert finished.items() <= seconds_of(output).items()


def test_an_output_that_cannot_be_written_leaves_all_parts(growing_matches, tmp_path):
    pytest.importorskip("resource")
    output = tmp_path / "out" / "poses.parquet"
    job = job_of(growing_matches, output)
    run_batch(job, num_threads=1)
    size = output.stat().st_size
    output.unlink()
    largest = size - 2000  # the parts have less beside their rows
    child = start(growing_matches, output, code=LIMIT.format(bytes=largest))
    assert_failed_clearly(child, output, "File too large")
    assert [path.name for path in output.parent.iterdir()] == ["poses.parquet.parts"]
    finished = seconds_of_parts(output)
    summary = run_batch(job, num_threads=1)
    assert summary.num_estimated == 0
    assert seconds_of(output) == finished


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
        tried = subprocess.run(mount, capture_output=True, text=True)
    except OSError as error:
        pytest.skip(f"cannot mount a small disk: {error}")
    if tried.returncode != 0:
        pytest.skip(f"cannot mount a small disk: {tried.stderr.strip()}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_leaves_the_finished_parts(growing_matches, small_disk):
    output = small_disk / "poses.parquet"
    child = start(growing_matches, output)
    assert_failed_clearly(child, f"{output}.parts/part-000003.parquet", "No space left on device")
    assert len(list(Path(f"{output}.parts").iterdir())) == 3


@pytest.mark.slow
def test_the_run_goes_on_when_ray_workers_are_killed(
    matches_in_one_group, uninterrupted, ray_session, tmp_path
):
    output, killed, finished = tmp_path / "poses.parquet", [], {}

    def kill_now_and_then(stage, done, total):
        if stage == "pairs" and (done, len(killed)) in ((10, 0), (30, 1)):
            workers = []
            while not workers or len(part_files(output)) < done // PAIRS_PER_PART + 2:
                time.sleep(0.005)  # until a task is in its midst
                workers = busy_workers(os.getpid())
            killed.append(workers[0])
            os.kill(killed[-1], signal.SIGKILL)
            finished.update(seconds_of_parts(output))

    job = job_of(matches_in_one_group, output, pairs_per_part=PAIRS_PER_PART)
    summary = run_batch(job, engine="ray", progress=kill_now_and_then)
    assert len(set(killed)) == 2
    assert (summary.num_pairs, summary.num_estimated) == (NUM_PAIRS, NUM_PAIRS)
    assert_is_whole(output, uninterrupted[0], finished)


@pytest.mark.slow
def test_a_part_that_kills_every_worker_ends_the_run(matches, ray_session, tmp_path, monkeypatch):
    monkeypatch.setattr(ray_tasks, "_MAX_RETRIES", 1)
    output, ended = tmp_path / "poses.parquet", threading.Event()

    def kill_all():
        while not ended.wait(0.01):
            for worker in busy_workers(os.getpid()):
                os.kill(worker, signal.SIGKILL)

    killer = threading.Thread(target=kill_all)
    killer.start()
    try:
        with pytest.raises(ChildProcessError, match=r"gave up part \d+ after 2 tries"):
            run_batch(job_of(matches, output), engine="ray")
    finally:
        ended.set()
        killer.join()


@pytest.mark.slow
def test_ray_says_what_the_local_engine_says_of_a_bad_row(ray_session, tmp_path):
    pairs = [easy_pair(seed) for seed in range(8)]
    pairs[6] = (pairs[6][0], pairs[6][1][:-1])
    matches = write_matches(tmp_path / "bad.parquet", [[pair] for pair in pairs])
    said = []
    for engine in ("local", "ray"):
        output = tmp_path / engine / "poses.parquet"
        with pytest.raises(ValueError, match="row 6") as error:
            run_batch(job_of(matches, output), engine=engine)
        said.append(str(error.value))
        assert list(output.parent.iterdir()) == []
    assert said[0] == said[1]


def test_tasks_are_longer_the_more_parts_have_one_start():
    groups = [0] * 3 + [1] * 100 + [2]
    assert ray_engine._tasks(range(3), groups, 2) == [[0], [1], [2]]
    assert ray_engine._tasks([1, *range(3, 15), 50, 103], groups, 2) == [
        [1], list(range(3, 13)), [13, 14, 50], [103],
    ]  # fmt: skip
    assert ray_engine._tasks([3, 4, 5, 6], groups, 25) == [[3, 4], [5, 6]]
    assert ray_engine._tasks([3, 4], groups, 1000) == [[3], [4]]


@pytest.mark.slow
def test_ray_refuses_workers_of_another_version(ray_session, tmp_path, monkeypatch):
    matches = write_matches(tmp_path / "matches.parquet", [[easy_pair(0)]])
    monkeypatch.setattr("epi360.jobs.batch.job.package_version", lambda: "99.0")
    with pytest.raises(ValueError, match=r"must have epi360 99\.0, the Ray worker"):
        run_batch(job_of(matches, tmp_path / "poses.parquet"), engine="ray")


def test_a_cluster_that_does_not_answer_is_said_at_once(tmp_path, monkeypatch):
    ray = pytest.importorskip("ray")
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    matches = write_matches(tmp_path / "matches.parquet", [[easy_pair(0)]])
    job = job_of(matches, tmp_path / "poses.parquet")
    with pytest.raises(ConnectionError, match=r"no Ray cluster answers at 127\.0\.0\.1:1"):
        run_batch(job, engine="ray", address="127.0.0.1:1")


@pytest.mark.slow
def test_killed_and_interrupted_drivers_of_ray_lose_nothing(
    matches, uninterrupted, ray_session, tmp_path
):
    # The first driver starts a Ray of its own, the second goes on with the one that runs.
    output, finished = tmp_path / "poses.parquet", {}
    for blow, words in ((signal.SIGKILL, []), (signal.SIGINT, ["--address", ray_session])):
        child = start(matches, output, "--engine", "ray", *words)
        wait_for_a_new_part(child, output)
        workers = set(busy_workers(os.getpid() if words else child.pid))
        child.send_signal(blow)
        code, said = outcome(child)
        # How far it is, a driver says now and then, and not before it hears of the part.
        last = [
            line for line in said.splitlines() if not line.startswith("epi360: checked pairs: ")
        ]
        assert (code, last) in ((-signal.SIGKILL, []), (130, [INTERRUPTED]))
        wait_until_gone(workers)
        assert finished.items() < seconds_of_parts(output).items()
        finished = seconds_of_parts(output)
    assert not output.exists()
    code, said = outcome(start(matches, output))
    assert code == 0, said
    assert_is_whole(output, uninterrupted[0], finished)
