# SPDX-License-Identifier: BSD-3-Clause
"""A disk that gets full at any point: one line that names the file, and nothing is left behind."""

import os
import subprocess
import sys

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.interop import (
    MatchedImage,
    MatchedPair,
    MatchGraph,
    PosedImage,
    Reconstruction,
    write_colmap_model,
    write_hloc,
)
from epi360.poses import Pose

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="limits of files are POSIX")
PROGRAM = """
import resource, sys
from epi360 import cli
from epi360.extras import extra_library
extra_library("h5py", extra="hloc", purpose="hloc's files")
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), resource.RLIM_INFINITY))
sys.exit(cli.main(sys.argv[2:]))
"""


def answer_of(limit, *words):
    """Outcome of a command whose files may not grow beyond a number of bytes."""
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, str(limit), *map(str, words)],
        capture_output=True, text=True, timeout=120,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )  # fmt: skip


@pytest.fixture(scope="module")
def graph():
    """Twelve images with a hundred key points each, and all their pairs."""
    rng = np.random.default_rng(0)
    images = {
        f"{number}.jpg": MatchedImage(f"{number}.jpg", "pano", 50 * rng.random((100, 2)))
        for number in range(12)
    }
    matches = np.stack([np.arange(80)] * 2, axis=1)
    names = list(images)
    pairs = [MatchedPair(names[i], names[j], matches) for j in range(12) for i in range(j)]
    return MatchGraph({"pano": Equirectangular(100, 50)}, images, tuple(pairs))


@pytest.fixture(scope="module")
def database(graph, tmp_path_factory):
    pytest.importorskip("pycolmap")
    from epi360.interop import write_colmap_database

    path = tmp_path_factory.mktemp("database") / "in.db"
    write_colmap_database(path, graph)
    return path


@pytest.mark.parametrize("room", [0, 1000, 10_000, 30_000, 60_000])
def test_hloc_files_that_do_not_fit_end_no_process(room, database, graph, tmp_path):
    pytest.importorskip("h5py")
    files = tmp_path / "f.h5", tmp_path / "m.h5"
    write_hloc(*files, graph)
    assert max(file.stat().st_size for file in files) > room
    for file in files:
        file.unlink()
    answer = answer_of(room, "convert", database, files[1], "--features", files[0])
    assert answer.returncode == 2
    assert len(answer.stderr.splitlines()) == 1
    assert answer.stderr.startswith(f"epi360: error: {tmp_path}")
    assert "File too large" in answer.stderr
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("kind", ["colmap", "colmap-text"])
def test_a_model_that_does_not_fit_names_the_file_that_does_not(kind, tmp_path):
    images = tuple(
        PosedImage(f"{number}.jpg", "pano", Pose(np.eye(3), np.zeros(3))) for number in range(9)
    )
    points = np.random.default_rng(0).random((4000, 3)), np.zeros((4000, 3), np.uint8)
    source, target = tmp_path / "in", tmp_path / "out"
    write_colmap_model(source, Reconstruction({"pano": Equirectangular(100, 50)}, images, *points))
    answer = answer_of(20_000, "convert", source, target, "--format", kind)
    ending = "txt" if kind == "colmap-text" else "bin"
    assert answer.returncode == 2
    assert answer.stderr == f"epi360: error: {target}/points3D.{ending}: File too large\n"
    assert os.listdir(target) == []


@pytest.mark.parametrize("command", ["opensfm-folder", "database"])
def test_what_other_libraries_write_is_one_line_too(command, database, tmp_path):
    target = tmp_path / "out"
    images = (PosedImage("a.jpg", "pano", Pose(np.eye(3), np.zeros(3))),)
    if command == "database":
        answer = answer_of(8192, "convert", database, tmp_path / "out.db")
        assert f"COLMAP database {target}.db cannot be written, is there room" in answer.stderr
    else:
        source = tmp_path / "in"
        write_colmap_model(source, Reconstruction({"pano": Equirectangular(100, 50)}, images))
        answer = answer_of(40, "convert", source, target, "--format", command)
        assert "a.jpg.exif: cannot write (File too large)" in answer.stderr
    assert answer.returncode == 2
    assert len(answer.stderr.splitlines()) == 1
    assert not [path for path in tmp_path.rglob("*") if ".tmp" in path.name]
