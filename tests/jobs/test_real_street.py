# SPDX-License-Identifier: BSD-3-Clause
"""A real street on which a tram and cars drive along: its pairs are no copies of each other."""

import shutil

import numpy as np
import pytest
from real_data import is_picture, reference_poses

from epi360 import rotation_error_deg, translation_error_deg
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching.match_folder import MatchOptions, match_images

ALL = MatchOptions(pairs="exhaustive")


@pytest.mark.parametrize("step", [3, 5])
def test_what_drives_along_is_not_taken_for_a_copy(data_dir, tmp_path, step):
    folder = data_dir / "video_clips" / "Tram"
    if not folder.is_dir():
        pytest.skip(f"the clip Tram is not in {data_dir}")
    (tmp_path / "frames").mkdir()
    for path in sorted((folder / "frames").iterdir())[::step]:
        if not is_picture(path):
            pytest.skip(f"{path.name} of the clip Tram is damaged: not a JPEG file")
        shutil.copy(path, tmp_path / "frames")
    run = match_images(find_images(tmp_path / "frames"), tmp_path / "out", ALL)
    assert all(verdict.accepted for verdict in run.verdicts)
    poses, errors = reference_poses(folder / "poses.csv"), []
    for verdict in run.verdicts:
        truth = poses[verdict.image2].inverse() @ poses[verdict.image1]
        errors.append(
            (
                rotation_error_deg(verdict.cam2_from_cam1, truth),
                translation_error_deg(verdict.cam2_from_cam1, truth),
            )
        )
    assert (np.median(errors, axis=0) < (0.5, 1.0)).all()  # measured: 0.26 / 0.58
    assert (np.max(errors, axis=0) < (4, 12)).all()  # 2.4 / 9.7
