# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from written_scenes import rotation_about_z, write_png

from epi360.cameras import Equirectangular
from epi360.poses import Pose
from epi360_paper.datasets import ImageSequence, SkipRule, steady_segments


def sequence_of(folder, degrees, brightness=None, missing=()):
    """One frame per 0.1 s, turned about z; grey images."""
    brightness = brightness or [100] * len(degrees)
    paths = tuple(folder / f"{index}.png" for index in range(len(degrees)))
    for path, value in zip(paths, brightness, strict=True):
        write_png(path, np.full((8, 16), value, np.uint8))
    poses = [
        None if index in missing else Pose(rotation_about_z(angle), np.zeros(3))
        for index, angle in enumerate(degrees)
    ]
    times = 0.1 * np.arange(len(degrees))
    return ImageSequence("grey", Equirectangular(16, 8), paths, times, tuple(poses))


def test_calm_sequence_is_one_segment(tmp_path):
    sequence = sequence_of(tmp_path, [0, 5, 10, 15])
    assert steady_segments(sequence, SkipRule()) == [range(0, 4)]


def test_fast_turn_splits_the_sequence(tmp_path):
    sequence = sequence_of(tmp_path, [0, 5, 18, 23])  # 130 deg/s in the middle
    assert steady_segments(sequence, SkipRule()) == [range(0, 2), range(2, 4)]
    assert steady_segments(sequence, SkipRule(max_rotation_deg_per_s=140)) == [range(0, 4)]


@pytest.mark.parametrize("brightness", [[100, 100, 130, 130], [130, 130, 100, 100]])
def test_change_of_light_splits_the_sequence(tmp_path, brightness):
    sequence = sequence_of(tmp_path, [0, 0, 0, 0], brightness)
    assert steady_segments(sequence, SkipRule()) == [range(0, 2), range(2, 4)]
    assert steady_segments(sequence, SkipRule(max_brightness_ratio=1.4)) == [range(0, 4)]


def test_frames_without_a_pose_are_left_out(tmp_path):
    sequence = sequence_of(tmp_path, [0, 0, 0, 0, 0, 0], missing=(0, 3))
    assert steady_segments(sequence) == [range(1, 3), range(4, 6)]


def test_single_frames_are_no_segment(tmp_path):
    sequence = sequence_of(tmp_path, [0, 20, 40, 60])
    assert steady_segments(sequence, SkipRule()) == []


@pytest.mark.parametrize("options", [{"max_rotation_deg_per_s": 0}, {"max_brightness_ratio": 1}])
def test_rule_out_of_range_is_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        SkipRule(**options)


def test_sequence_needs_one_pose_per_image(tmp_path):
    sequence = sequence_of(tmp_path, [0, 5])
    with pytest.raises(ValueError, match="2 images, 2 timestamps, 1 poses"):
        ImageSequence("grey", sequence.camera, sequence.image_paths, np.zeros(2), (None,))
