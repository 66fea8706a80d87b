# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from written_scenes import textured, write_png

from epi360.cameras import KannalaBrandt
from epi360_paper.datasets import load_image_folder


def test_numbers_in_names_count_as_numbers(tmp_path):
    for name in ("img10.png", "img2.png", "img1b.png", "img1.png"):
        write_png(tmp_path / name, textured(8, 16))
    (tmp_path / "notes.txt").write_text("no image")
    sequence = load_image_folder(tmp_path, frames_per_s=10)
    names = [path.name for path in sequence.image_paths]
    assert names == ["img1.png", "img1b.png", "img2.png", "img10.png"]
    np.testing.assert_allclose(sequence.timestamps_s, [0, 0.1, 0.2, 0.3])
    assert sequence.world_from_cam == (None,) * 4


def test_camera_of_other_images_is_given(tmp_path):
    write_png(tmp_path / "a.png", textured(20, 20))
    camera = KannalaBrandt(20, 20, 6.0, 6.0, 10.0, 10.0)
    assert load_image_folder(tmp_path, camera).camera == camera
    with pytest.raises(ValueError, match="2:1"):
        load_image_folder(tmp_path)


def test_wrong_arguments_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="has no JPEG"):
        load_image_folder(tmp_path)
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        load_image_folder(tmp_path / "nowhere")
    write_png(tmp_path / "a.png", textured(8, 16))
    with pytest.raises(ValueError, match="frames_per_s must be positive"):
        load_image_folder(tmp_path, frames_per_s=0)
    with pytest.raises(ValueError, match="is a file, expected a folder"):
        load_image_folder(tmp_path / "a.png")
