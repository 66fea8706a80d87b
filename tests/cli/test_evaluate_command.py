# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 evaluate` as a user types it."""

import json
import re

import numpy as np
import pytest
from command_line import assert_help_names, assert_wrong_use

from epi360.cameras import Equirectangular
from epi360.cli import SUCCESS, main
from epi360.interop.colmap_model import write_colmap_model
from epi360.interop.nerfstudio import write_nerfstudio
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.interop.tum import write_tum_trajectory
from epi360.poses import Pose, rotation_from_vector


def way(count=20, wobble=0.0):
    return [
        Pose(
            rotation_from_vector([0, 0.1 * k, 0]),
            np.array([0.2 * k, wobble * (-1) ** k, np.sin(0.3 * k)]),
        )
        for k in range(count)
    ]


@pytest.fixture
def files(tmp_path):
    """A true TUM trajectory, an estimated one, a COLMAP model of it, and one as a map has it."""
    for name, poses in (("truth", way()), ("estimate", way(wobble=0.01))):
        images = [PosedImage(str(k), None, p.inverse(), k / 10) for k, p in enumerate(poses)]
        write_tum_trajectory(tmp_path / f"{name}.txt", Reconstruction({}, tuple(images)))
    images = [PosedImage(f"{k}.jpg", "c", p.inverse()) for k, p in enumerate(way(wobble=0.01))]
    model = Reconstruction({"c": Equirectangular(64, 32)}, tuple(images))
    write_colmap_model(tmp_path / "model", model)
    write_colmap_model(tmp_path / "map" / "sparse" / "0", model)
    write_nerfstudio(tmp_path / "map" / "transforms.json", model, images="frames")
    rows = "".join(f"{k}.jpg,{k / 10}\n" for k in range(20))
    (tmp_path / "frames.csv").write_text(f"image,timestamp_s\n{rows}")
    return tmp_path


def test_errors_are_printed_written_and_drawn(files, capsys):
    words = ["evaluate", str(files / "estimate.txt"), str(files / "truth.txt"), "--align", "se3"]
    outputs = ["--json", str(files / "e.json"), "--figure", str(files / "e.png")]
    assert main([*words, *outputs]) == SUCCESS
    printed = capsys.readouterr().out
    assert "20 of 20 have a pose (100.0 %)" in printed
    ate = re.search(r"ATE +([\d.]+) m rms = ([\d.]+) % of the path", printed)
    assert float(ate[1]) == pytest.approx(0.01, rel=0.02)
    assert float(ate[2]) == pytest.approx(1 / 5.306, rel=0.02)
    record = json.loads((files / "e.json").read_text())
    assert record["ate_m"]["rmse"] == pytest.approx(0.01, rel=0.02)
    assert record["rpe_frame"]["translation_m"]["rmse"] == pytest.approx(0.02, rel=0.02)
    assert len(record["position_errors_m"]) == record["num_matched"] == 20
    assert "errors of Robust 360-8PA (eq. 16) are the means divided by 180" in printed
    assert (files / "e.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("model", ["model", "map", "map/transforms.json"])
def test_a_model_without_times_takes_them_from_the_table_of_frames(files, capsys, model):
    words = ["evaluate", str(files / model), str(files / "truth.txt")]
    assert main([*words, "--frames", str(files / "frames.csv")]) == SUCCESS
    assert "20 of 20 have a pose" in capsys.readouterr().out


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("jitter", [0.0, 1e-16])
def test_a_true_camera_that_stands_still_has_no_errors_per_metre(files, capsys, jitter):
    rows = "".join(f"{k / 10} {1 + jitter * (k % 3)} 2 3 0 0 0 1\n" for k in range(20))
    (files / "still.txt").write_text(rows)
    words = ["evaluate", files / "estimate.txt", files / "still.txt"]
    assert_wrong_use(capsys, words, "the truth stays in one place", "--align se3")
    outputs = ["--json", str(files / "e.json"), "--figure", str(files / "e.png")]
    assert main([*map(str, words), "--align", "se3", *outputs]) == SUCCESS
    printed = capsys.readouterr().out
    assert "%" not in printed.partition("alignment")[2] and "nan" not in printed
    assert "the true camera stands still" in printed
    record = json.loads((files / "e.json").read_text())
    assert record["ate_share_of_path"] is None and record["rpe_distance"]["num_pairs"] == 0


def test_wrong_use_is_one_line(files, capsys):
    truth, estimate = files / "truth.txt", files / "estimate.txt"
    assert_wrong_use(capsys, ["evaluate", files / "none.txt", truth], "none.txt does not exist")
    assert_wrong_use(capsys, ["evaluate", estimate, truth, "--figure", files / "e.doc"], "--figure")
    assert_wrong_use(capsys, ["evaluate", estimate, truth, "--json", truth], "--json must not be")
    assert_wrong_use(
        capsys, ["evaluate", estimate, truth, "--distance-m", "0"], "--distance-m must be positive"
    )
    write = (files / "later.txt").write_text
    write("1000 0 0 0 0 0 0 1\n1001 1 0 0 0 0 0 1\n1002 2 0 0 0 0 0 1\n")
    assert_wrong_use(capsys, ["evaluate", files / "later.txt", truth], "0 of 20 true frames")


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "evaluate", "ESTIMATE", "TRUTH", "--align", "--max-gap-s", "--distance-m",
        "--frames", "--json", "--figure",
    )  # fmt: skip
