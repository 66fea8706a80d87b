# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 match` into an object store: what a folder would have, stopped and gone on with."""

import uuid

import numpy as np
import pytest
from rendered_views import NAMES, image_set, write_views

from epi360 import cli
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching import match_job
from epi360.jobs.matching.match_folder import MatchOptions, load_matches, match_images
from epi360.report.pairs_table import pairs_csv

fsspec = pytest.importorskip("fsspec")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_views(tmp_path_factory.mktemp("views"))


@pytest.fixture(scope="module")
def local(folder, tmp_path_factory):
    output = tmp_path_factory.mktemp("local") / "out"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(match_job, "PAIRS_PER_PART", 2)
        return output, match_images(find_images(folder), output)


@pytest.fixture
def bucket(monkeypatch):
    """A URL below which nothing is."""
    monkeypatch.setattr(match_job, "PAIRS_PER_PART", 2)
    url = f"memory://{uuid.uuid4().hex}"
    yield url
    files = fsspec.filesystem("memory")
    if files.exists(url):
        files.rm(url, recursive=True)


def content(output):
    """Files by their names below an output, but the hashes of the pictures."""
    files, root = fsspec.core.url_to_fs(str(output))
    root = root.rstrip("/")
    named = {path[len(root) + 1 :]: files.cat_file(path) for path in files.find(root)}
    return {name: data for name, data in named.items() if name != "digests.json"}


def stop_at(stage, call):
    calls = []

    def progress(name, done, total):
        calls.append(name)
        if calls.count(stage) > call:
            raise KeyboardInterrupt

    return progress


@pytest.mark.parametrize("stage", ["features", "pairs"])
def test_a_url_gets_the_bytes_of_a_folder_also_after_a_stop(folder, local, bucket, stage):
    with pytest.raises(KeyboardInterrupt):
        match_images(find_images(folder), bucket, progress=stop_at(stage, 2))
    before = content(bucket)
    assert any(name.startswith(stage) for name in before)
    with pytest.raises(FileNotFoundError, match=r"memory://.* holds no complete result"):
        load_matches(bucket)
    run = match_images(find_images(folder), bucket)
    assert before.items() <= content(bucket).items()
    assert content(bucket) == content(local[0])
    assert pairs_csv(run) == pairs_csv(local[1])


def test_the_graph_behind_a_url_is_that_of_the_folder(folder, local, bucket):
    match_images(find_images(folder), bucket)
    there, here = load_matches(bucket), load_matches(local[0])
    assert list(there.images) == list(here.images)
    assert there.cameras == here.cameras
    for one, other in zip(there.pairs, here.pairs, strict=True):
        assert (one.image1, one.image2) == (other.image1, other.image2)
        np.testing.assert_array_equal(one.matches, other.matches)


def test_damaged_files_behind_a_url_are_made_again(folder, local, bucket):
    match_images(find_images(folder), bucket)
    files, root = fsspec.core.url_to_fs(bucket)
    for damaged, num_found in (("features", 6), ("pairs", 0)):
        for path in files.find(f"{root}/{damaged}"):
            files.pipe_file(path, files.cat_file(path)[:-50])
        with pytest.raises(ValueError, match=r"damaged; run epi360 match"):
            load_matches(bucket)
        run = match_images(find_images(folder), bucket)
        assert run.num_found == num_found
        assert pairs_csv(run) == pairs_csv(local[1])
        assert content(bucket) == content(local[0])


def test_other_options_are_refused_behind_a_url_until_asked(folder, bucket):
    images = image_set(folder, NAMES[:2])
    match_images(images, bucket)
    with pytest.raises(ValueError, match=r"memory://.* was made with seed 0, now it is 1"):
        match_images(images, bucket, MatchOptions(seed=1))
    assert match_images(images, bucket, MatchOptions(seed=1), restart=True).num_found == 0
    assert match_images(images, bucket, MatchOptions(seed=1)).num_found == 1


def test_a_url_with_something_else_is_left_alone(folder, bucket):
    files, root = fsspec.core.url_to_fs(bucket)
    files.pipe_file(f"{root}/notes.txt", b"mine")
    with pytest.raises(ValueError, match=r"memory://.* was not made by epi360 match"):
        match_images(find_images(folder), bucket)
    assert content(bucket) == {"notes.txt": b"mine"}


def test_the_command_writes_its_table_to_the_url(folder, local, bucket, tmp_path, capsys):
    report = tmp_path / "report.html"
    words = ["match", str(folder), "--output", bucket, "--report", str(report)]
    assert cli.main(words) == 0
    assert f"wrote {bucket}/pairs.csv" in capsys.readouterr().out
    files, root = fsspec.core.url_to_fs(bucket)
    assert files.cat_file(f"{root}/pairs.csv") == pairs_csv(local[1])
    assert report.is_file()


def test_images_behind_a_url_are_refused_in_a_sentence(capsys):
    assert cli.main(["match", "s3://bucket/images", "--output", "memory://out"]) == 2
    assert "only --output may be a URL" in capsys.readouterr().err


def test_a_video_needs_a_folder(tmp_path, capsys):
    video = tmp_path / "walk.mp4"
    video.write_bytes(b"")
    assert cli.main(["match", str(video), "--output", "memory://out"]) == 2
    assert "epi360 frames first" in capsys.readouterr().err
