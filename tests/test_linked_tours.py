# SPDX-License-Identifier: BSD-3-Clause
"""Exported virtual tours that benchmarks read: pictures from tiles, and what links say."""

import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.poses import Pose, rotation_from_vector

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
# Right, down and forward of the faces in the panorama's axes, as tours name them.
AXES = {
    "f": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "b": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    "r": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "l": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "u": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "d": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
}
TILE, SIZE, WIDTH = 96, 128, 256  # two rows and columns of tiles, the last ones narrower


@pytest.fixture
def reader(monkeypatch):
    """The module that reads exported tours."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import _linked_tours

    return _linked_tours


def colours(bearings):
    """Greys of the surroundings: smooth, but half a pixel of the panorama makes a difference."""
    grey = np.round(128 + 40 * np.sin(10 * bearings).sum(axis=-1, keepdims=True))
    return np.repeat(grey.astype(np.uint8), 3, axis=-1)


def face_of(axes):
    x, y = np.meshgrid(*[(np.arange(SIZE) + 0.5) * 2 / SIZE - 1] * 2)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.array(axes, dtype=float)
    return colours(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def write_tour(folder, azimuths_deg):
    """A tour of panoramas that show the same, with links at these azimuths."""
    names = sorted({name for pair in azimuths_deg for name in pair})
    levels = [{"tileSize": 64, "size": 64, "fallbackOnly": True}, {"tileSize": TILE, "size": SIZE}]
    scenes = []
    for name in names:
        links = [
            {"yaw": float(np.radians(azimuth)), "pitch": 0.0, "target": second}
            for (first, second), azimuth in azimuths_deg.items()
            if first == name
        ]
        scenes.append({"id": name, "levels": levels, "linkHotspots": links})
        for face, axes in AXES.items():
            pixels = face_of(axes)
            for row, column in np.ndindex(2, 2):
                part = pixels[row * TILE :, column * TILE :][:TILE, :TILE]
                path = folder / "tiles" / name / "1" / face / str(row) / f"{column}.jpg"
                path.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(path), part[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])
    (folder / "data.js").write_text(f"var APP_DATA = {json.dumps({'scenes': scenes})};\n")


def stands_at(azimuth_deg, turned_deg):
    """Pose of a second camera that stands in a direction of the first, and is turned right."""
    centre, turn = np.radians([azimuth_deg, turned_deg])
    R = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    return Pose(R, -R @ np.array([np.sin(centre), 0.0, np.cos(centre)]))


def test_panoramas_are_put_together_of_tiles(reader, tmp_path):
    write_tour(tmp_path / "tour", {("a", "b"): 0.0, ("b", "a"): 180.0})
    (tour,) = reader.linked_tours(tmp_path)
    assert tour.name == "tour" and tour.names == ["a.jpg", "b.jpg"]
    path, _ = tour.write_panoramas(tmp_path / "out", WIDTH)
    picture = cv2.imread(str(path))[..., ::-1]
    camera = Equirectangular(WIDTH, WIDTH // 2)
    centres = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(WIDTH // 2) + 0.5)
    pixels = np.stack(centres, axis=-1)
    expected = colours(camera.bearings_from_pixels(pixels.reshape(-1, 2)))
    difference = np.abs(picture.reshape(-1, 3).astype(int) - expected)
    assert difference.max() <= 6 and difference.mean() < 1.5  # JPEG


def test_a_file_of_something_else_is_no_tour(reader, tmp_path):
    (tmp_path / "data.js").write_text("var x = {'scenes': 3};")
    assert list(reader.linked_tours(tmp_path)) == []


def test_links_there_and_back_tell_right_poses(reader, tmp_path):
    # b stands at 40 degrees of a, and is turned by 100 degrees to the right.
    links = {("a", "b"): 45.0, ("b", "a"): 125.0, ("b", "c"): 10.0}
    write_tour(tmp_path, links)
    (tour,) = reader.linked_tours(tmp_path)
    right = stands_at(40.0, 100.0)
    assert tour.agrees("a.jpg", "b.jpg", right) is True
    assert tour.agrees("b.jpg", "a.jpg", right.inverse()) is True
    assert tour.agrees("a.jpg", "b.jpg", stands_at(40.0, 190.0)) is False
    assert tour.agrees("a.jpg", "b.jpg", stands_at(160.0, 100.0)) is False
    # Both links in a door beside the way are off alike; one alone says nothing.
    assert tour.agrees("a.jpg", "b.jpg", stands_at(90.0, 100.0)) is True
    assert tour.agrees("b.jpg", "c.jpg", right) is None


def test_chains_of_links_tell_how_far_cameras_are_turned(reader, tmp_path):
    links = {("a", "b"): 0.0, ("b", "a"): 90.0, ("b", "c"): 0.0, ("c", "b"): 150.0, ("d", "e"): 1.0}
    write_tour(tmp_path, {**links, ("e", "d"): 2.0})
    (tour,) = reader.linked_tours(tmp_path)
    # b is turned by 90 degrees from a, c by 30 from b.
    assert tour.turn_agrees("a.jpg", "c.jpg", stands_at(70.0, 130.0)) is True
    assert tour.turn_agrees("c.jpg", "a.jpg", stands_at(70.0, 130.0).inverse()) is True
    assert tour.turn_agrees("a.jpg", "c.jpg", stands_at(70.0, -60.0)) is False
    assert tour.turn_agrees("a.jpg", "d.jpg", stands_at(70.0, 120.0)) is None


def test_the_shortest_chain_tells_how_far_cameras_are_turned(reader, tmp_path):
    """Nobody is turned; the arrow from a to b is 60 degrees off, and a ring leads around."""
    links = {(a, b): 0.0 for a, b in ("ab", "bc", "cd", "da")}
    links |= {(b, a): 180.0 for a, b in links}
    links["a", "b"] = 60.0
    write_tour(tmp_path, links)
    (tour,) = reader.linked_tours(tmp_path)
    for names, agrees in (("cd", True), ("ad", True), ("ab", False)):
        first, second = (f"{name}.jpg" for name in names)
        assert tour.turn_agrees(first, second, stands_at(0.0, 0.0)) is agrees
        assert tour.turn_agrees(second, first, stands_at(0.0, 0.0).inverse()) is agrees


def test_loops_that_close_are_told_from_those_that_do_not(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import linked_tours

    rng = np.random.default_rng(0)
    turns = {name: rotation_from_vector(rng.normal(size=3)) for name in "abcdef"}

    def verdict(first, second, num_inliers, off=0.0):
        turn = turns[second] @ rotation_from_vector([0.0, off, 0.0]) @ turns[first].T
        return SimpleNamespace(
            image1=f"{first}.jpg",
            image2=f"{second}.jpg",
            num_inliers=num_inliers,
            cam2_from_cam1=Pose(turn, np.array([0.0, 0.0, 1.0])),
        )

    right = [verdict(*pair, 100 + row) for row, pair in enumerate(("ab", "bc", "ca", "de", "ef"))]
    assert linked_tours._loops(right) == (1, 1)
    assert linked_tours._loops([*right, verdict("c", "f", 90), verdict("a", "d", 80)]) == (2, 2)
    wrong = [verdict("a", "c", 50, off=0.3), verdict("d", "f", 30, off=2.0)]
    assert linked_tours._loops([*right, *wrong]) == (3, 1)
    assert linked_tours._loops([]) == (0, 0)
