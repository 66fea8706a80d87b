# SPDX-License-Identifier: BSD-3-Clause
"""Fig. 4 and Table 4 on a few trials: what is written and what must hold."""

import csv
import re

import numpy as np
import pytest

from epi360.poses import Pose, rotation_from_vector
from epi360.progress import no_progress
from epi360.synthetic import two_view_scene
from epi360_paper import load_experiment
from epi360_paper.methods import METHODS, estimate_pose, pose_errors
from epi360_paper.options import ReproduceOptions
from epi360_paper.protocols import PROTOCOLS

pytestmark = pytest.mark.usefixtures("tiny_landmarks")
NUMBER = re.compile(r"\d")


def reproduce(name, out, **options):
    given = ReproduceOptions(out=out, jobs=1, **options)
    return load_experiment(name)(given, no_progress)


def rows_of(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("protocol", sorted(PROTOCOLS))
@pytest.mark.parametrize(
    ("name", "cells"), [("fig4a", None), ("fig4b", None), ("fig4c", 8), ("table4", 2)]
)
def test_tables_compare_paper_and_ours_without_nan(tmp_path, name, cells, protocol):
    trials = 12 if name == "fig4a" else 2
    outcome = reproduce(name, tmp_path, trials=trials, protocol=protocol)
    assert ": paper" in outcome.summary
    assert ": ours" in outcome.summary
    assert "nan" not in outcome.summary.lower().replace("nanometre", "")
    written = {path.name for path in outcome.files}
    figure = set() if name == "table4" else {"figure.png", "curves.csv"}
    assert written - {"trials.parquet"} == {"trials.csv", "table.md"} | figure
    assert all(path.stat().st_size > 0 for path in outcome.files)
    rows = rows_of(outcome.files[0])
    assert rows
    if cells:
        assert len(rows) == cells * trials
        assert len({row["cell"] for row in rows}) == cells
    for method in METHODS:
        assert all(0 <= float(row[f"rotation_{method}"]) <= 1 for row in rows)


def test_fig4a_draws_8_to_200_points_and_20_percent_outliers(tmp_path):
    rows = rows_of(reproduce("fig4a", tmp_path, trials=60).files[0])
    points = [int(row["num_points"]) for row in rows]
    assert 8 <= min(points) < 40
    assert 170 < max(points) <= 200
    for row in rows:
        assert float(row["outlier_share"]) == pytest.approx(
            round(0.2 * int(row["num_points"])) / int(row["num_points"])
        )


def test_fig4b_has_the_protocols_levels_and_no_outliers(tmp_path):
    rows = rows_of(reproduce("fig4b", tmp_path, trials=1, protocol="corrected").files[0])
    assert [row["cell"] for row in rows] == ["50", "200", "500", "1000", "2000", "10000"]
    assert {row["num_points"] for row in rows} == {"200"}
    assert {float(row["outlier_share"]) for row in rows} == {0.0}


def test_less_noise_and_fewer_outliers_give_smaller_errors(tmp_path):
    for name in ("fig4b", "fig4c"):
        outcome = reproduce(name, tmp_path, trials=10, protocol="corrected")
        curve = [
            float(row["q50_1e-3"])
            for row in rows_of(tmp_path / f"{name}-corrected" / "curves.csv")
            if (row["error"], row["method"]) == ("rotation", "8pa")
        ]
        ends = curve if name == "fig4c" else curve[::-1]
        assert ends[0] < 0.5 * ends[-1], outcome.summary


def test_table4_states_what_the_printed_thresholds_would_keep(tmp_path):
    outcome = reproduce("table4", tmp_path, trials=4)
    assert "By eq. 13 as printed, only" in outcome.summary
    tight, loose = (
        [row for row in rows_of(outcome.files[0]) if row["cell"] == cell]
        for cell in ("tight", "loose")
    )
    assert {row["iterations"] for row in tight} == {"590"}
    assert {row["iterations"] for row in loose} == {"66"}
    for row in (*tight, *loose):
        assert int(row["within_by_eq13"]) < 20 < int(row["kept"])
        assert float(row["rotation_estimate"]) < 0.1
        assert float(row["time_8pa_s"]) >= float(row["time_ransac_s"])
    assert np.mean([float(row["outliers_left"]) for row in tight]) < np.mean(
        [float(row["outliers_left"]) for row in loose]
    )


@pytest.mark.parametrize("protocol", sorted(PROTOCOLS))
@pytest.mark.parametrize("method", METHODS)
def test_every_method_is_exact_on_exact_matches(method, protocol):
    scene = two_view_scene(4, num_matches=60, baseline_m=1.0)
    pose = estimate_pose(method, scene.bearings1, scene.bearings2, PROTOCOLS[protocol])
    # Share of half a turn. The iterative searches stop at about 1e-8 of a radian.
    assert max(pose_errors(pose, scene.cam2_from_cam1)) < 1e-6


def test_fewer_than_eight_matches_have_no_pose():
    scene = two_view_scene(0, num_matches=7)
    pose = estimate_pose("gsm", scene.bearings1, scene.bearings2, PROTOCOLS["printed"])
    assert np.isnan(pose_errors(pose, scene.cam2_from_cam1)).all()


def test_errors_are_angles_as_shares_of_half_a_turn():
    truth = Pose(np.eye(3), (0.0, 0.0, 2.0))
    estimate = Pose(rotation_from_vector((0.0, np.pi / 2, 0.0)), (0.0, 1.0, 0.0))
    np.testing.assert_allclose(pose_errors(estimate, truth), (0.5, 0.5))
