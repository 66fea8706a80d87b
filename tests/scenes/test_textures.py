# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360_scenes.painting import PAINTERS
from epi360_scenes.textures import TextureAtlas, build_atlas


@pytest.fixture(scope="module")
def atlas():
    return build_atlas(0)


def sample(atlas, name, uv, footprint):
    texture = np.full(uv.shape[1], atlas.names.index(name))
    widths = np.full(uv.shape[1], footprint, np.float32)
    return atlas.sample(texture, uv.astype(np.float32), widths)


@pytest.mark.parametrize("name", PAINTERS)
def test_painters_make_square_pictures_with_a_power_of_two_side(name):
    picture = PAINTERS[name](np.random.Generator(np.random.PCG64(3)))
    side = len(picture)
    assert picture.shape == (side, side, 3) and side & (side - 1) == 0
    assert 0 < picture.mean() < 1


def test_a_seed_paints_the_same_textures_and_another_seed_others(atlas):
    np.testing.assert_array_equal(atlas.texels, build_atlas(0).texels)
    assert (atlas.texels != build_atlas(1).texels).mean() > 0.5


def test_a_tiny_pixel_sees_single_texels_and_a_huge_one_the_mean(atlas):
    index, side = atlas.names.index("poster1"), 256
    start = atlas.starts[index, 0]
    rows, columns = np.array([10, 200, 255]), np.array([7, 100, 255])
    uv = np.stack([columns + 0.5, rows + 0.5]) / side
    texels = atlas.texels[start + rows * side + columns]
    np.testing.assert_allclose(sample(atlas, "poster1", uv, 1e-4), texels, atol=1e-4)
    mean = atlas.texels[start : start + side * side].mean(axis=0)
    np.testing.assert_allclose(sample(atlas, "poster1", uv, 1.0), np.tile(mean, (3, 1)), atol=1e-4)
    np.testing.assert_allclose(sample(atlas, "poster1", uv, 50.0), np.tile(mean, (3, 1)), atol=1e-4)


def test_textures_repeat_every_turn(atlas):
    uv = np.random.Generator(np.random.PCG64(0)).uniform(0, 1, (2, 50))
    here, there = (sample(atlas, "bricks", uv + turns, 0.02) for turns in (0, -3))
    np.testing.assert_allclose(here, there, atol=1e-3)  # float32 positions lose two bits


def test_look_up_is_linear_between_texels_and_between_levels():
    # One texture of 2 x 2 texels, black and white columns; its coarser level is grey.
    texels = np.repeat([[0.0], [1.0], [0.0], [1.0], [0.5]], 3, axis=1).astype(np.float32)
    atlas = TextureAtlas(("stripes",), texels, np.array([[0, 4]]), np.array([[2, 1]]))
    uv = np.array([[0.25, 0.375, 0.5, 0.75], [0.3, 0.3, 0.3, 0.3]])
    fine = sample(atlas, "stripes", uv, 0.5)[:, 0]
    np.testing.assert_allclose(fine, [0, 0.25, 0.5, 1], atol=1e-6)
    between = sample(atlas, "stripes", uv, np.sqrt(0.5))[:, 0]
    np.testing.assert_allclose(between, [0.25, 0.375, 0.5, 0.75], atol=1e-6)
