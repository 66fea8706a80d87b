# SPDX-License-Identifier: BSD-3-Clause
"""Parts and the output that they are joined to: written whole, known by their job, kept."""

import dataclasses
import errno
import os

import numpy as np
import pytest
from batch_inputs import array_of, columns_of, pose_rows, version_of, write_matches

from epi360 import estimate_relative_pose, estimate_relative_poses
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.jobs.batch import (
    BatchJob,
    MatchSource,
    estimate_parts,
    local_engine,
    merge_parts,
    missing_parts,
    run,
    run_batch,
)
from epi360.jobs.batch import job as job_module
from epi360.jobs.batch.sources import pair_seed
from epi360.runs import storage

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

NUM_PAIRS = 12


@pytest.fixture(scope="module")
def matches(tmp_path_factory):
    return write_matches(tmp_path_factory.mktemp("matches") / "in.parquet", columns_of(NUM_PAIRS))


@pytest.fixture
def job(matches, tmp_path):
    source = MatchSource("parquet", str(matches), pairs_per_part=5)
    return BatchJob(source, str(tmp_path / "poses.parquet"), seed=4)


@pytest.fixture(scope="module")
def expected(matches, tmp_path_factory):
    output = str(tmp_path_factory.mktemp("whole") / "poses.parquet")
    run_batch(BatchJob(MatchSource("parquet", str(matches)), output, seed=4), num_threads=1)
    return pose_rows(output)


def names_beside(job):
    return sorted(os.listdir(os.path.dirname(job.output)))


def test_the_columns_are_those_of_single_estimates_with_the_seed_of_the_pair(job):
    run_batch(job)
    columns = columns_of(NUM_PAIRS)
    names = list(zip(columns["image1"], columns["image2"], strict=True))
    alone = estimate_relative_poses(
        [
            (np.reshape(b1, (-1, 3)), np.reshape(b2, (-1, 3)))
            for b1, b2 in zip(columns["bearings1"], columns["bearings2"], strict=True)
        ],
        seed=[pair_seed(4, *pair) for pair in names],
        options=IMAGE_OPTIONS,
    )
    rows = parquet.read_table(job.output)
    assert rows.column_names == [
        "image1", "image2", "status", "rotation", "translation", "covariance",
        "num_matches", "num_inliers", "noise_deg", "parallax_deg", "seconds", "probability",
        "probability_nothing", "probability_rotation", "probability_surface",
        "probability_motion", "probability_rival",
    ]  # fmt: skip
    for name in ("status", "num_matches", "num_inliers"):
        assert rows.column(name).to_pylist() == [getattr(result, name) for result in alone]
    for name in ("noise_deg", "parallax_deg", "probability"):
        np.testing.assert_array_equal(rows.column(name), [getattr(each, name) for each in alone])
    for name in ("nothing", "rotation", "surface", "motion", "rival"):
        np.testing.assert_array_equal(
            rows.column(f"probability_{name}"), [getattr(each.explanations, name) for each in alone]
        )
    poses = [result.cam2_from_cam1 for result in alone]
    rotations = array_of(rows, "rotation", (3, 3))
    np.testing.assert_array_equal(rotations, [pose.rotation for pose in poses])
    translations = array_of(rows, "translation", (3,))
    np.testing.assert_array_equal(translations, [pose.translation for pose in poses])
    covariances = array_of(rows, "covariance", (5, 5))
    np.testing.assert_array_equal(covariances, [result.covariance for result in alone])
    assert {"ok", "too_few_matches"} == set(rows.column("status").to_pylist())
    seconds = rows.column("seconds").to_numpy()
    assert (seconds >= 0).all() and seconds[0] > seconds[-1]
    metadata = rows.schema.metadata
    assert metadata[b"epi360.seed"] == b"4"
    assert b"x2 = R x1 + t" in metadata[b"epi360.convention"]


@pytest.mark.parametrize(("size", "threads"), [(1, 1), (5, 3), (100, 2)])
def test_poses_do_not_depend_on_the_parts_or_the_threads(
    matches, tmp_path, expected, size, threads
):
    source = MatchSource("parquet", str(matches), pairs_per_part=size)
    output = str(tmp_path / "poses.parquet")
    summary = run_batch(BatchJob(source, output, seed=4), num_threads=threads)
    assert pose_rows(output) == expected
    assert summary.num_pairs == summary.num_estimated == NUM_PAIRS
    assert summary.statuses == {"ok": NUM_PAIRS - 1, "too_few_matches": 1}
    assert summary.files == (output,)


def test_another_seed_gives_other_samples(matches, tmp_path, expected):
    output = str(tmp_path / "poses.parquet")
    run_batch(BatchJob(MatchSource("parquet", str(matches)), output, seed=5))
    assert pose_rows(output)["covariance"] != expected["covariance"]


def test_a_restart_estimates_only_what_is_missing(job, expected, monkeypatch):
    assert missing_parts(job) == [0, 1, 2]
    estimate_parts(job, [1])
    assert missing_parts(job) == [0, 2]
    read = []
    monkeypatch.setattr(
        local_engine,
        "write_poses",
        lambda job, index, *rest, **named: (
            read.append(index), job_module.write_poses(job, index, *rest, **named)
        ),
    )  # fmt: skip
    calls = []
    summary = run_batch(job, progress=lambda *call: calls.append(call))
    assert read == [0, 2]
    assert calls == [
        ("checked pairs", 0, 7), ("checked pairs", 5, 7), ("checked pairs", 7, 7),
        ("pairs", 5, 12), ("pairs", 10, 12), ("pairs", 12, 12),
    ]  # fmt: skip
    assert (summary.num_pairs, summary.num_estimated) == (12, 7)
    assert pose_rows(job.output) == expected
    assert names_beside(job) == ["poses.parquet"]


def test_parts_that_are_there_are_not_estimated_again(job):
    estimate_parts(job, [1])
    before = version_of(job.part_path(1))
    estimate_parts(job, [0, 1])
    assert missing_parts(job) == [2]
    assert version_of(job.part_path(1)) == before


def test_a_finished_output_is_left_as_it_is_also_with_other_parts(job, matches):
    run_batch(job)
    before = version_of(job.output)
    for again in (job, BatchJob(MatchSource("parquet", str(matches)), job.output, seed=4)):
        summary = run_batch(again)
        assert (summary.num_pairs, summary.num_estimated, summary.files) == (12, 0, ())
    assert version_of(job.output) == before


@pytest.mark.parametrize("damage", ["truncated", "empty", "garbage", "bit"])
def test_a_damaged_part_is_estimated_again(job, expected, damage):
    for index in range(3):
        estimate_parts(job, [index])
    content = bytearray(open(job.part_path(1), "rb").read())
    if damage == "truncated":
        content = content[: len(content) // 2]
    elif damage == "empty":
        content = b""
    elif damage == "garbage":
        content = b"x" * 1000
    else:
        # Among the numbers of a column: what a page says of itself has no checksum.
        column = parquet.read_metadata(job.part_path(1)).row_group(0).column(3)
        content[column.data_page_offset + 3 * column.total_compressed_size // 4] ^= 1
    with open(job.part_path(1), "wb") as file:
        file.write(content)
    assert missing_parts(job) == [1]
    run_batch(job)
    assert pose_rows(job.output) == expected


@pytest.mark.parametrize(
    ("change", "fragment"),
    [("seed", "seed 4, now 9"), ("input", "input "), ("size", "pairs per part 5, now 3")],
)
def test_parts_of_another_job_are_an_error_and_stay(job, tmp_path, change, fragment):
    estimate_parts(job, [0])
    other = tmp_path / "other.parquet"
    write_matches(other, {name: values[1:] for name, values in columns_of(NUM_PAIRS).items()})
    source = {
        "seed": job.source,
        "input": MatchSource("parquet", str(other), pairs_per_part=5),
        "size": MatchSource("parquet", job.source.path, pairs_per_part=3),
    }[change]
    before = version_of(job.part_path(0))
    with pytest.raises(ValueError, match=f"parts holds poses of another job .*{fragment}"):
        run_batch(BatchJob(source, job.output, seed=9 if change == "seed" else 4))
    assert version_of(job.part_path(0)) == before
    assert not os.path.exists(job.output)


def test_an_output_of_another_job_is_an_error_and_stays(job):
    run_batch(job)
    before = version_of(job.output)
    with pytest.raises(ValueError, match="holds poses of another job .*seed 4, now 5.*--output"):
        run_batch(BatchJob(job.source, job.output, seed=5))
    assert version_of(job.output) == before


@pytest.mark.parametrize("content", ["text", "matches"])
def test_a_file_that_is_no_output_is_an_error_and_stays(job, matches, content):
    kept = b"my notes" if content == "text" else matches.read_bytes()
    with open(job.output, "wb") as file:
        file.write(kept)
    with pytest.raises(ValueError, match="another --output"):
        run_batch(job)
    assert open(job.output, "rb").read() == kept


def test_the_parts_of_a_run_that_was_killed_after_the_merge_are_removed(job, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(run.storage, "remove_folder", lambda folder: None)
        run_batch(job)
    assert names_beside(job) == ["poses.parquet", "poses.parquet.parts"]
    assert run_batch(job).num_estimated == 0
    assert names_beside(job) == ["poses.parquet"]


def test_the_merge_needs_all_parts_and_leaves_nothing_without_them(job):
    estimate_parts(job, [0])
    estimate_parts(job, [2])
    with pytest.raises(FileNotFoundError, match="part-000001.parquet"):
        merge_parts(job)
    assert names_beside(job) == ["poses.parquet.parts"]
    assert missing_parts(job) == [1]


def test_parts_of_two_inputs_are_not_merged(job, tmp_path):
    input_path = tmp_path / "in.parquet"
    columns = columns_of(NUM_PAIRS)
    write_matches(input_path, columns)
    source = MatchSource("parquet", str(input_path), pairs_per_part=6)
    job = BatchJob(source, job.output)
    estimate_parts(job, [0])
    columns["bearings1"][0][0] += 1e-6
    write_matches(input_path, columns)
    estimate_parts(job, [1])
    with pytest.raises(ValueError, match="part-000000.parquet holds poses of another job"):
        merge_parts(job)
    assert not os.path.exists(job.output)


def test_an_unknown_engine_is_an_error(job):
    with pytest.raises(ValueError, match="engine must be one of local, ray, got 'spark'"):
        run_batch(job, engine="spark")


def test_a_part_that_fails_leaves_those_before_it(job, monkeypatch):
    def fail_third(job, index, *rest, **named):
        if index == 2:
            raise OSError(28, "No space left on device")
        job_module.write_poses(job, index, *rest, **named)

    monkeypatch.setattr(local_engine, "write_poses", fail_third)
    with pytest.raises(OSError, match="No space"):
        run_batch(job)
    assert missing_parts(job) == [2]


class FullDisk:
    """A file that takes some bytes and no more."""

    def __init__(self, file, room):
        self.file, self.room = file, room

    def write(self, data):
        self.room -= len(data)
        if self.room < 0:
            raise OSError(28, "No space left on device")
        return self.file.write(data)

    def __getattr__(self, name):
        return getattr(self.file, name)


def test_a_disk_that_fills_up_leaves_no_half_file_and_a_clear_message(tmp_path):
    target = tmp_path / "new" / "file.parquet"
    table = pyarrow.table({"a": list(range(1000))})
    with pytest.raises(OSError, match="cannot write .No space left on device") as error:
        with storage.write_whole(str(target)) as file:
            parquet.write_table(table, FullDisk(file, 100))
    assert error.value.filename == str(target)
    assert list(target.parent.iterdir()) == []


def test_a_file_is_replaced_only_by_a_whole_one(tmp_path):
    target = tmp_path / "file"
    target.write_bytes(b"old")
    with pytest.raises(RuntimeError), storage.write_whole(str(target)) as file:
        file.write(b"half")
        raise RuntimeError
    assert target.read_bytes() == b"old"
    with storage.write_whole(str(target)) as file:
        file.write(b"new")
    assert target.read_bytes() == b"new"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_lock_of_a_killed_run_blocks_nobody(job):
    lock = os.path.join(os.path.dirname(job.output), ".poses.parquet.lock")
    with open(lock, "w") as file:
        file.write(" (process 1 on another machine)")
    assert run_batch(job).num_pairs == NUM_PAIRS
    assert names_beside(job) == ["poses.parquet"]


def test_a_disk_without_locks_is_used_without(job, monkeypatch):
    fcntl = pytest.importorskip("fcntl")

    def refuse(descriptor, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    assert run_batch(job).num_pairs == NUM_PAIRS
    assert names_beside(job) == ["poses.parquet"]


@pytest.mark.parametrize("scheme", ["memory", "file"])
def test_input_and_output_may_be_urls(matches, tmp_path, expected, scheme):
    fsspec = pytest.importorskip("fsspec")
    folder = f"memory://{tmp_path.name}" if scheme == "memory" else f"file://{tmp_path}"
    with fsspec.open(f"{folder}/in.parquet", "wb") as file:
        file.write(matches.read_bytes())
    source = MatchSource("parquet", f"{folder}/in.parquet", pairs_per_part=5)
    job = BatchJob(source, f"{folder}/poses.parquet", seed=4)
    estimate_parts(job, [1])
    assert missing_parts(job) == [0, 2]
    summary = run_batch(job)
    assert summary.num_estimated == 7
    files, name = fsspec.core.url_to_fs(folder)
    assert sorted(path.rpartition("/")[2] for path in files.ls(name, detail=False)) == [
        "in.parquet", "poses.parquet",
    ]  # fmt: skip
    local = tmp_path / "local.parquet"
    local.write_bytes(files.cat_file(f"{name}/poses.parquet"))
    assert pose_rows(local) == expected
    assert run_batch(job).num_estimated == 0


def test_upright_cameras_are_known_to_be(job):
    upright = dataclasses.replace(job, output=f"{job.output}.upright", upright_deg=2.0)
    run_batch(upright, num_threads=2)
    columns = columns_of(NUM_PAIRS)
    rows = parquet.read_table(upright.output)
    for row in range(NUM_PAIRS):
        result = estimate_relative_pose(
            np.reshape(columns["bearings1"][row], (-1, 3)),
            np.reshape(columns["bearings2"][row], (-1, 3)),
            gravity1=[0, 1, 0],
            gravity2=[0, 1, 0],
            gravity_sigma_deg=2.0,
            seed=pair_seed(4, columns["image1"][row], columns["image2"][row]),
            options=IMAGE_OPTIONS,
        )
        assert rows.column("status")[row].as_py() == result.status
        assert rows.column("num_inliers")[row].as_py() == result.num_inliers
        np.testing.assert_equal(rows.column("probability")[row].as_py(), result.probability)
    seconds = rows.column("seconds").to_numpy()
    assert (seconds >= 0).all() and seconds[0] > seconds[-1]
    other = dataclasses.replace(upright, upright_deg=1.0)
    with pytest.raises(ValueError, match="poses of another job"):
        run_batch(other)
