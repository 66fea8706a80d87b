# SPDX-License-Identifier: BSD-3-Clause
"""Damaged input of every kind for every command that reads files, and what must never happen."""

import io
import json
import random
import re
import shutil
import sqlite3
import struct
import sys
import time
import traceback
import warnings
from contextlib import closing, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from written_map import write_map
from written_videos import noise_frames, write_video

from epi360 import cli
from epi360.cameras import Equirectangular
from epi360.features.picture_writing import encode_picture
from epi360.interop import (
    MatchedImage,
    MatchedPair,
    MatchGraph,
    Observations,
    PosedImage,
    Reconstruction,
    write_colmap_model,
    write_nerfstudio,
    write_opensfm,
    write_tum_trajectory,
)
from epi360.poses import Pose, rotation_from_vector

PROGRESS = re.compile(r"epi360: (?!error)[a-z ]+: \d+ of \d+.*")
LONGEST_MESSAGE = 1100
LONGEST_WORK_S, LONGEST_S = 20.0, 300.0  # of processor time, and of a clock on a busy machine
VALUES = [
    "/dev/zero", "/etc/passwd", "../../victim.png", "VICTIM", "x" * 5000, "", ".", "a\0b", "ä/\n",
    None, True, [], {}, [[]], 0, -1, 1e308, 1e-308, -1e300, 10**30, float("nan"), float("inf"),
]  # fmt: skip
UPLOAD = "(upload)"  # no command: two pictures sent to the demo
TARGETS = ["model", "transforms.json", "reconstruction.json", "poses.tum"]
CALIBRATION = "cameras:\n  left: {model: KannalaBrandt, width: 64, height: 48, fx: 20, fy: 20, "
CALIBRATION += "cx: 32, cy: 24, k1: 0.0, k2: 0.0, k3: 0.0, k4: 0.0}\n"


@dataclass(frozen=True)
class Fault:
    """What went wrong in a run, and the words of the command."""

    seed: int
    words: list[str]
    what: str


def write_sources(folder: Path) -> None:
    """Small whole files of all kinds."""
    images = folder / "images"
    images.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for number, ending in enumerate((".png", ".jpg", ".tiff")):
        pixels = rng.integers(0, 255, (32, 64, 3), np.uint8)
        (images / f"{number}{ending}").write_bytes(encode_picture(pixels, ending))
    posed = tuple(
        PosedImage(path.name, "1", Pose(rotation_from_vector([0, index, 1]), [index, 0, 1]))
        for index, path in enumerate(sorted(images.iterdir()))
    )
    seen = Observations(np.array([0, 1]), np.array([0, 2]), np.array([[1.0, 2.0], [3.0, 4.0]]))
    points = rng.random((2, 3)), np.ones((2, 3), np.uint8)
    cameras = {"1": Equirectangular(64, 32)}
    reconstruction = Reconstruction(cameras, posed, *points, seen)
    write_colmap_model(folder / "model", reconstruction)
    write_colmap_model(folder / "text", reconstruction, text=True)
    write_nerfstudio(folder / "transforms.json", reconstruction)
    write_opensfm(folder / "reconstruction.json", reconstruction)
    write_tum_trajectory(folder / "poses.tum", reconstruction)
    (folder / "camera.yaml").write_text(CALIBRATION)
    (folder / "pairs.txt").write_text("0.png 1.jpg\n1.jpg 2.tiff\n")
    (folder / "frames.csv").write_text(
        "image,timestamp_s\n" + "".join(f"{image.name},{k}\n" for k, image in enumerate(posed))
    )
    _write_matches(folder, cameras)
    write_map(folder / "map")
    (folder / "frames").mkdir()
    for number, frame in enumerate(noise_frames(4, (32, 64))):
        (folder / "frames" / f"{number}.png").write_bytes(encode_picture(frame, ".png"))
    with suppress(ImportError):
        write_video(folder / "walk.mp4", noise_frames(6, (64, 128)))


def _write_matches(folder: Path, cameras: dict) -> None:
    rng = np.random.default_rng(1)
    images = {name: MatchedImage(name, "1", 30 * rng.random((20, 2))) for name in ("a", "b", "c")}
    matches = np.stack([np.arange(15)] * 2, axis=1)
    pairs = tuple(MatchedPair(*names, matches) for names in (("a", "b"), ("b", "c")))
    graph = MatchGraph(cameras, images, pairs)
    with suppress(ImportError):
        from epi360.interop import write_colmap_database

        write_colmap_database(folder / "matches.db", graph)
    with suppress(ImportError):
        from epi360.interop import write_hloc

        write_hloc(folder / "features.h5", folder / "matches.h5", graph)


def run(seed: int, sources: Path, folder: Path) -> Fault | None:
    """Damage a copy of the sources, run a command on it, and return what must not be."""
    rng = random.Random(seed)
    work = folder / f"run-{seed}"
    shutil.copytree(sources, work / "in")
    (work / "victim.png").write_bytes(b"theirs")
    (work / "victim_front.jpg").write_bytes(b"theirs")
    (work / "out").mkdir()
    words = [str(word) for word in _command(rng, work / "in", work / "out")]
    _spoil(rng, work)
    before = _contents(work)
    what = _fault(words) or _traces(work, before)
    shutil.rmtree(work)
    return None if what is None else Fault(seed, words, what)


def _command(rng: random.Random, given: Path, out: Path) -> list[object]:
    images = given / "images"
    sources = ["model", "text", "transforms.json", "reconstruction.json", "poses.tum"]
    picked = given / rng.choice(sources)
    pictures = [rng.choice(sorted(images.iterdir())) for _ in range(2)]
    commands: list[list[object]] = [
        ["convert", picked, out / rng.choice(TARGETS)],
        ["convert", picked, out / rng.choice(TARGETS), "--camera", given / "camera.yaml"],
        ["cubemap", picked, images, out / "cube"],
        ["pair", *pictures, "--json", out / "pair.json"],
        ["pair", *pictures, "--camera", given / "camera.yaml", "--mask", pictures[0]],
        ["match", images, "--output", out / "matches", "--pairs", given / "pairs.txt"],
        ["evaluate", picked, given / "poses.tum", "--json", out / "errors.json"],
        ["evaluate", picked, given / "model", "--frames", given / "frames.csv"],
        ["localize", given / "map", given / "map" / "new", "--out", out / "a.json"],
        ["track", given / "frames", "--out", out / "track"],
        ["match", given / "frames", "--output", out / "near", "--pairs", "near", "--positions",
         picked],
        [UPLOAD, *pictures],
        ["render", out / "walk", "--num-frames", 1, "--supersample", 1, "--camera",
         given / "camera.yaml"],
    ]  # fmt: skip
    if find_spec("pycolmap"):
        commands.append(["map", images, "--output", out / "map", "--mapper-threads", 1])
    if (given / "walk.mp4").exists():
        video = given / "walk.mp4"
        commands.append(["frames", video, out / "frames", "--every", 2])
        commands.append(["frames", video, out / "frames", "--mask", pictures[0]])
    if (given / "matches.db").exists():
        files = ["--features", out / "f.h5"]
        commands.append(["convert", given / "matches.db", out / "m.h5", *files])
        commands.append(["batch", given / "matches.db", "--output", out / "poses.parquet"])
    if (given / "map" / "features.h5").exists():
        files = ["--features", given / "map" / "features.h5"]
        commands.append(["localize", given / "map", given / "map" / "new" / "new.png", *files])
        commands.append(
            ["localize", given / "map", given / "map" / "new", "--out", out / "located", *files]
        )
    if (given / "matches.h5").exists():
        files = ["--features", given / "features.h5"]
        commands.append(["convert", given / "matches.h5", out / "m.db", *files])
        commands.append(["batch", given / "matches.h5", "--output", out / "p.parquet", *files])
    return rng.choice(commands)


def _spoil(rng: random.Random, work: Path) -> None:
    """Damage some files, those whose values are known at a value more often than anywhere."""
    for path in sorted(path for path in (work / "in").rglob("*") if path.is_file()):
        data = path.read_bytes()
        if path.suffix == ".json" and rng.random() < 0.8:
            path.write_text(json.dumps(_with_another_value(rng, json.loads(data), work)))
        elif path.suffix == ".db" and rng.random() < 0.5:
            _change_a_cell(rng, path)
        elif rng.random() < 0.6:
            path.write_bytes(_damaged(rng, data))


def _with_another_value(rng: random.Random, document: object, work: Path) -> object:
    """The document with one value, at any depth, replaced or removed."""
    if isinstance(document, dict | list) and document and rng.random() < 0.85:
        places = list(document) if isinstance(document, dict) else range(len(document))
        place = rng.choice(places)
        if rng.random() < 0.1:
            del document[place]
        else:
            document[place] = _with_another_value(rng, document[place], work)
        return document
    value = rng.choice(VALUES)
    return str(work / "victim.png") if value == "VICTIM" else value


def _change_a_cell(rng: random.Random, path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, suppress(sqlite3.Error), database:
        query = "SELECT name FROM sqlite_master WHERE type = 'table'"
        table = rng.choice([name for (name,) in database.execute(query)])
        columns = [name for _, name, *_ in database.execute(f"PRAGMA table_info({table})")]
        value = rng.choice([None, "x", -1, 2**62, 1e308, b"", b"\xff" * 80, "/etc/passwd"])
        database.execute(f"UPDATE {table} SET {rng.choice(columns)} = ?", (value,))


def _damaged(rng: random.Random, data: bytes) -> bytes:
    """Content that is cut, has a word replaced, or has bytes changed."""
    kind, place = rng.randrange(4), rng.randrange(len(data))
    if kind == 0:
        return data[:place]
    if kind == 1:
        words = [b"1e999", b"-1", b"NaN", b"9" * 20, b"9" * 5000, b"\n", b" ", b"\0", b"!!int ''"]
        words += [struct.pack("<d", 1e200), struct.pack("<Q", 0x7FF0000000000001)]  # signalling NaN
        return data[:place] + rng.choice(words) + data[place + rng.choice((0, 1, 4, 8)) :]
    if kind == 2:
        return data[:place] + rng.choice([b"\0", b"\xff"]) * 30 + data[place + 30 :]
    changed = bytearray(data)
    for _ in range(rng.choice((1, 4, 32))):
        changed[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(changed)


def _fault(words: list[str]) -> str | None:
    """What is wrong with the answer of a command."""
    said, begun, worked = io.StringIO(), time.monotonic(), time.process_time()
    try:
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()), redirect_stderr(said):
            warnings.simplefilter("error", RuntimeWarning)
            code = _upload(words[1:]) if words[0] == UPLOAD else cli.main(words)
    except BaseException:
        return traceback.format_exc()
    lines = [line for line in said.getvalue().splitlines() if not PROGRESS.fullmatch(line)]
    seconds, worked = time.monotonic() - begun, time.process_time() - worked
    if seconds > LONGEST_S or worked > LONGEST_WORK_S:
        return f"it took {seconds:.0f} s, {worked:.0f} s of processor time"
    if code not in (0, 1, 2):
        return f"exit code {code}"
    if code == 2 and not (lines and lines[-1].startswith("epi360: error: ")):
        return f"exit code 2 without an error line: {lines}"
    if code == 2 and sum(line.startswith("epi360: error: ") for line in lines) > 1:
        return f"several error lines: {lines}"
    if any(len(line) > LONGEST_MESSAGE for line in lines):
        return f"a message of {max(map(len, lines))} characters"
    return None


def _upload(paths: list[str]) -> int:
    """Answer of the demo to two uploads, as an exit code."""
    from epi360_demo.limits import Limits, RefusedError
    from epi360_demo.pair_job import run_pair
    from epi360_demo.pictures import check_picture

    most = Limits().max_pixels
    pictures = [{"path": path, "name": Path(path).name} for path in paths]
    request = {"pictures": pictures, "lens": None, "choices": {}, "max_pixels": most}
    out = Path(paths[0]).parents[2] / "out"
    try:
        for picture in pictures:
            check_picture(Path(picture["path"]), picture["name"], most)
        run_pair({**request, "out": str(out)}, lambda _: None)
    except RefusedError as error:
        print(f"epi360: error: {error}", file=sys.stderr)
        return 2
    return 0


def _contents(work: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in _files(work) if (work / "out") not in path.parents}


def _files(work: Path) -> list[Path]:
    return [path for path in work.rglob("*") if path.is_file()]


def _traces(work: Path, before: dict[Path, bytes]) -> str | None:
    """What a command left where it must not."""
    if _contents(work) != before:
        return "it changed files outside of the output"
    left = [path.name for path in _files(work) if path.name.endswith((".tmp", ".lock"))]
    return f"it left {left}" if left else None
