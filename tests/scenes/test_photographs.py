# SPDX-License-Identifier: BSD-3-Clause
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from epi360_scenes import photographs
from epi360_scenes.photographs import photograph_tour, photographed
from epi360_scenes.tours import render_tour

WIDTH = 256


@pytest.fixture(scope="module")
def picture():
    rng = np.random.default_rng(5)
    coarse = rng.integers(40, 200, (16, 32, 3), dtype=np.uint8)
    return cv2.resize(coarse, (WIDTH, WIDTH // 2), interpolation=cv2.INTER_CUBIC)


@pytest.fixture
def nothing_happens(monkeypatch):
    for name in ("STOPS", "TINT", "CONTRAST", "BLUR_DEG", "NOISE", "STITCHING_DEG"):
        monkeypatch.setattr(photographs, f"MOST_{name}", 0.0)
    for name in ("PEOPLE", "THINGS"):
        monkeypatch.setattr(photographs, f"MEAN_{name}", 0.0)
    monkeypatch.setattr(photographs, "WORST_JPEG", 92)


def taken(picture, seed):
    content = np.frombuffer(photographed(picture, np.random.default_rng(seed)), np.uint8)
    return cv2.cvtColor(cv2.imdecode(content, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def error(picture, seed):
    return np.abs(taken(picture, seed).astype(float) - picture)


def test_a_picture_stays_what_it_is_where_nothing_happens(nothing_happens, picture):
    assert error(picture, 0).mean() < 3.0  # JPEG loses some of the colours


def test_equal_seeds_make_equal_photographs(picture):
    assert (taken(picture, 3) == taken(picture, 3)).all()
    assert np.abs(taken(picture, 3).astype(float) - taken(picture, 4)).mean() > 5


def test_what_has_come_covers_a_part_at_and_below_the_horizon(
    nothing_happens, monkeypatch, picture
):
    monkeypatch.setattr(photographs, "MEAN_PEOPLE", 3.0)
    changed = np.max([error(picture, seed) > 30 for seed in range(20)], axis=(0, -1))
    rows, _ = np.nonzero(changed)
    assert 0.01 < changed.mean() < 0.5
    assert rows.mean() > WIDTH // 4


def test_stitching_moves_things_by_about_what_it_says(nothing_happens, monkeypatch):
    monkeypatch.setattr(photographs, "MOST_STITCHING_DEG", 4.0)
    places = []
    for seed in range(12):
        point = np.zeros((WIDTH // 2, WIDTH, 3), np.uint8)
        cv2.circle(point, (WIDTH // 2, WIDTH // 4), 3, (255, 255, 255), -1)
        weights = taken(point, seed)[:, :, 0].astype(float)
        weights[weights < 40] = 0.0
        rows, columns = np.mgrid[: WIDTH // 2, :WIDTH]
        places.append([np.average(each, weights=weights) for each in (columns, rows)])
    moved_deg = (np.array(places) - [WIDTH // 2, WIDTH // 4]) * 360 / WIDTH
    # Each strength up to the largest is as likely, so the mean square is a third of the largest.
    assert np.sqrt(np.mean(np.square(moved_deg))) == pytest.approx(4.0 / 3.0**0.5, rel=0.5)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Three panoramas of a tour."""
    tour = render_tour(tmp_path_factory.mktemp("rendered"), 0, is_level=True, width=64)
    return replace(tour, panoramas=tour.panoramas[:3])


def pictures_in(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.jpg")}


def test_a_photographed_tour_keeps_its_poses_and_its_pictures(rendered, tmp_path):
    first = photograph_tour(rendered, tmp_path / "photographed", 1)
    assert first.panoramas == rendered.panoramas and first.overlaps == rendered.overlaps
    contents = pictures_in(first.folder)
    assert contents.keys() == {one.name for one in rendered.panoramas}
    name, *_ = contents
    (first.folder / name).write_bytes(b"as it was left")
    photograph_tour(rendered, first.folder, 1)
    assert pictures_in(first.folder) == {**contents, name: b"as it was left"}


def test_photographs_of_other_pictures_or_by_another_seed_are_taken_again(rendered, tmp_path):
    folder = tmp_path / "photographed"
    contents = pictures_in(photograph_tour(rendered, folder, 1).folder)
    by_another = pictures_in(photograph_tour(rendered, folder, 2).folder)
    assert all(by_another[name] != contents[name] for name in contents)
    shutil.copytree(rendered.folder, tmp_path / "changed")
    changed = replace(rendered, folder=tmp_path / "changed")
    first, *others = (one.name for one in rendered.panoramas)
    shutil.copy(changed.folder / others[0], changed.folder / first)
    of_others = pictures_in(photograph_tour(changed, folder, 2).folder)
    assert of_others[first] != by_another[first]
    assert of_others == pictures_in(photograph_tour(changed, tmp_path / "new", 2).folder)
