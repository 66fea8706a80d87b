# SPDX-License-Identifier: BSD-3-Clause
"""Key points on a grid agree exactly on what may be wrong: their noise is that of rounding."""

import numpy as np
import pytest
from noisy_problems import random_directions

from epi360 import _core, estimate_relative_pose
from epi360.cameras import Equirectangular, Pinhole
from epi360.estimation.grid_noise_reference import grid_noise, least_noise
from epi360.poses import Pose, translation_error_deg

internals = _core.internals
PANORAMA = Equirectangular(2048, 1024)
PHOTOGRAPH = Pinhole(1000, 750, fx=600.0, fy=600.0, cx=500.0, cy=375.0)


def rounded(pixels, cells=1.0):
    return (np.floor(pixels / cells) + 0.5) * cells


def of_pyramid(pixels, rng):
    """Pixels as ORB rounds them, in pictures of eight sizes."""
    times = 1.2 ** np.arange(8.0)
    sizes = rng.choice(times, len(pixels), p=(1.0 / times) / np.sum(1.0 / times))
    return rounded(pixels, sizes[:, None])


def small_step(seed, step, num=400, noise_deg=0.02):
    """Pixels of a room, a tenth of them of wrong matches, before and after a small level step."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (num, 3)) * [3.0, 1.4, 3.0]
    walls = rng.integers(0, 3, num)
    rows = np.arange(num)
    points[rows, walls] = np.sign(points[rows, walls]) * np.array([3.0, 1.4, 3.0])[walls]
    moved = step * random_directions(seed, 1)[0]
    views = []
    for each in (points, points - moved):
        seen = each / np.linalg.norm(each, axis=1, keepdims=True)
        views.append(seen + np.radians(noise_deg) * rng.normal(size=seen.shape))
    wrong = rng.random(num) < 0.1
    views[1][wrong] = random_directions(seed + 1, int(wrong.sum()))
    pixels = [PANORAMA.pixels_from_bearings(each) for each in views]
    return *pixels, Pose(np.eye(3), -moved / step)


def bearings(*pixels, camera=PANORAMA):
    return [camera.bearings_from_pixels(each) for each in pixels]


@pytest.mark.parametrize("cells", [1.0, 4.0, 16.0])
@pytest.mark.parametrize("num", [100, 400, 3000])
def test_the_noise_of_a_grid_is_that_of_rounding(num, cells):
    pixels1, pixels2, _ = small_step(0, 0.1, num)
    views = bearings(rounded(pixels1, cells), rounded(pixels2, cells))
    noise = internals.grid_noise(*views)
    assert noise == pytest.approx(grid_noise(*views), rel=1e-9)
    if cells > 1.0 or num > 100:  # else hardly two points share a row
        assert noise == pytest.approx(cells * 2.0 * np.pi / 2048 / np.sqrt(12.0), rel=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_pictures_of_several_sizes_are_grids_too(seed):
    pixels1, pixels2, _ = small_step(seed, 0.1, 1500)
    rng = np.random.default_rng(seed)
    views = bearings(of_pyramid(pixels1, rng), of_pyramid(pixels2, rng))
    noise = internals.grid_noise(*views)
    assert noise == pytest.approx(grid_noise(*views), rel=1e-9)
    assert noise == pytest.approx(2.0 * np.pi / 2048 / np.sqrt(12.0), rel=0.4)


@pytest.mark.parametrize("num", [60, 400, 5000])
def test_other_key_points_are_on_no_grid(num):
    pixels1, pixels2, _ = small_step(1, 0.1, num)
    views = bearings(pixels1, pixels2)
    in_32_bits = [each.astype(np.float32).astype(float) for each in views]
    dense = bearings(rounded(pixels1), pixels2)  # flow from each pixel: only view 1 is on a grid
    mirror = np.diag([-1.0, 1.0, 1.0])
    mirrored = [np.vstack([each, each @ mirror]) for each in views]
    twice = [each[np.arange(num) // 2] for each in views]
    for each in (views, in_32_bits, dense, mirrored, twice):
        assert internals.grid_noise(*each) == grid_noise(*each) == 0.0


def test_pixels_of_a_photograph_are_a_grid():
    rng = np.random.default_rng(2)
    pixels = rng.uniform(0.0, 1.0, (2, 400, 2)) * [1000.0, 750.0]
    views = bearings(*rounded(pixels), camera=PHOTOGRAPH)
    noise = internals.grid_noise(*views)
    assert noise == pytest.approx(grid_noise(*views), rel=1e-9)
    assert 0.6 < noise * 600.0 * np.sqrt(12.0) < 1.0  # cells are smaller away from the axis
    assert internals.grid_noise(*bearings(*pixels, camera=PHOTOGRAPH)) == 0.0


@pytest.mark.parametrize("cells", [1.0, 16.0])
def test_a_step_of_two_cells_is_found_as_with_other_noise(cells):
    step = 3.6 * cells * 2.0 * np.pi / 2048
    right = 0
    for seed in range(12):
        pixels1, pixels2, truth = small_step(seed, step)
        result = estimate_relative_pose(*bearings(rounded(pixels1, cells), rounded(pixels2, cells)))
        assert result.noise_deg > 0.2 * cells * 360.0 / 2048
        if result.status != "ok":
            continue
        error = translation_error_deg(result.cam2_from_cam1, truth)
        assert error < 4.0 * result.translation_sigma_deg
        right += error < 12.0
    assert right >= 4


def test_a_step_that_no_cell_tells_is_a_rotation_with_the_noise_of_rounding():
    pixels1, pixels2, _ = small_step(3, 1e-4)
    views = bearings(rounded(pixels1), rounded(pixels2))
    result = estimate_relative_pose(*views)
    assert result.status == "pure_rotation"
    assert result.noise_deg > 0.2 * 360.0 / 2048
    same = estimate_relative_pose(views[0], views[0])  # a picture that stands still is exact
    assert same.status == "pure_rotation" and same.noise_deg < 1e-9


def lattice(num, low, high):
    steps = np.linspace(low, high, num)
    return np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)


BOARD = np.stack(np.meshgrid(0.1 * np.arange(9), 0.1 * np.arange(6), [1.0]), -1).reshape(-1, 3)
EXACT = {
    "lattice": lattice(6, -2.0, 2.0) + [0.0, 0.0, 6.0],
    "room": lattice(4, -2.0, 2.0),  # around the camera
    "boards": np.vstack([BOARD, BOARD + [0.05, 0.03, 0.7]]) - [0.4, 0.25, 0.0],
    "cube": lattice(2, -1.0, 1.0) + [0.0, 0.0, 4.0],
}


@pytest.mark.parametrize("step", [(0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.3, 0.11, 0.2)])
@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("share_wrong", [0.0, 0.2])
def test_exact_scenes_whose_points_share_rows_stay_exact(name, step, share_wrong):
    points = EXACT[name]
    rng = np.random.default_rng(0)
    views = [points / np.linalg.norm(points, axis=1, keepdims=True)]
    moved = points + step
    views.append(moved / np.linalg.norm(moved, axis=1, keepdims=True))
    wrong = rng.permutation(len(points))[: int(share_wrong * len(points))]
    views[1][wrong] = random_directions(1, len(wrong))
    result = estimate_relative_pose(*views)
    if name == "cube" and share_wrong:
        return  # seven matches say little
    assert result.status == "ok" and result.noise_deg < 1e-6
    truth = Pose(np.eye(3), np.array(step) / np.linalg.norm(step))
    assert translation_error_deg(result.cam2_from_cam1, truth) < 1e-5


@pytest.mark.parametrize("noise_px", [0.0, 0.05])
def test_disparities_between_pixels_are_better_than_pixels(noise_px):
    """A rectified stereo pair: rows are whole pixels, and columns sixteenths in view 2."""
    rng = np.random.default_rng(1)
    left = rounded(rng.uniform(0.0, 1.0, (1500, 2)) * [1000.0, 750.0])
    disparity = 0.04 * 600.0 / rng.uniform(2.0, 10.0, 1500) + noise_px * rng.normal(size=1500)
    right = left - np.stack([np.round(16.0 * disparity) / 16.0, np.zeros(1500)], axis=1)
    result = estimate_relative_pose(*bearings(left, right, camera=PHOTOGRAPH))
    truth = Pose(np.eye(3), np.array([-1.0, 0.0, 0.0]))
    assert result.status == "ok"
    assert translation_error_deg(result.cam2_from_cam1, truth) < 0.1


@pytest.mark.parametrize("cells", [1.0, 16.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_twin_doubts_what_the_core_has_doubted(seed, cells):
    """An answer that the core gives is one that its twin does not doubt."""
    pixels1, pixels2, _ = small_step(seed, 3.6 * cells * 2.0 * np.pi / 2048)
    views = bearings(rounded(pixels1, cells), rounded(pixels2, cells))
    result = estimate_relative_pose(*views)
    if result.status == "ok":
        assert least_noise(*views, result) == 0.0


def test_exact_bearings_stay_exact():
    pixels1, pixels2, truth = small_step(4, 0.5, noise_deg=0.0)
    result = estimate_relative_pose(*bearings(pixels1, pixels2))
    assert result.status == "ok" and result.noise_deg < 1e-9
    assert translation_error_deg(result.cam2_from_cam1, truth) < 1e-6
