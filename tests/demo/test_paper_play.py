# SPDX-License-Identifier: BSD-3-Clause
"""The numbers behind the sliders: those of the estimators, for the points that are drawn."""

import dataclasses
import json

import numpy as np
import pytest

from epi360.epipolar import search_sk, stability
from epi360.synthetic import two_view_scene
from epi360_demo.limits import RefusedError
from epi360_demo.paper_play import (
    METHODS,
    RANGES,
    SURFACE_RATIOS,
    Setting,
    draw_errors,
    look,
    medians,
    setting_from,
)

EXACT = Setting(noise_deg=0.0, outlier_percent=0.0, num_points=50)


def test_without_noise_every_estimator_finds_the_truth():
    errors = draw_errors(EXACT, 0)
    # Eight points on each side of a sphere fix E; the refinements end where steps get small.
    assert errors.shape == (len(METHODS), 2)
    assert errors.max() < 1e-3


def test_outliers_spoil_the_linear_estimators_and_not_the_robust_one():
    setting = dataclasses.replace(EXACT, noise_deg=0.2, outlier_percent=40.0, num_points=200)
    rows = dict(
        zip(
            [m.name for m in METHODS],
            medians([draw_errors(setting, k) for k in range(5)]),
            strict=True,
        )
    )
    assert rows["no normalisation"][1] > 5.0
    assert rows["five-point, RANSAC"][1] < 1.0


def test_s_and_k_of_the_sliders_are_those_of_their_row():
    plain = draw_errors(Setting(), 0)
    names = [method.name for method in METHODS]
    mine, none, best = (
        names.index(n) for n in ("your S and K", "no normalisation", "best S and K")
    )
    np.testing.assert_allclose(plain[mine], plain[none], atol=1e-6)
    scene = two_view_scene(
        0, num_matches=200, layout="cone", cone_half_angle_deg=180.0, noise_deg=1.0,
        outlier_ratio=0.1,
    )  # fmt: skip
    S, K, _, _ = search_sk(scene.bearings1, scene.bearings2)
    moved = draw_errors(Setting(S=S, K=K), 0)
    np.testing.assert_allclose(moved[mine], plain[best], atol=1e-4)


def test_the_page_gets_sigma_8_the_surface_and_the_best_ratio():
    record = look(Setting(S=1.0, K=2.0))
    scene = two_view_scene(
        0, num_matches=200, layout="cone", cone_half_angle_deg=180.0, noise_deg=1.0,
        outlier_ratio=0.1,
    )  # fmt: skip
    sigma8 = stability(scene.bearings1, scene.bearings2, (1.0, 2.0)).singular_values[7]
    assert record["sigma8"][1]["value"] == pytest.approx(sigma8)
    lowest = SURFACE_RATIOS[np.argmin(record["costs"])]
    assert abs(lowest - record["found"]) < 0.3  # two steps of the surface
    assert record["outliers"].count("1") == 20
    json.dumps(record, allow_nan=False)


@pytest.mark.parametrize("end", [0, 1])
def test_both_ends_of_all_sliders_give_numbers_that_json_can_hold(end):
    setting = setting_from({name: values[end] for name, values in RANGES.items()})
    json.dumps(look(setting), allow_nan=False)
    json.dumps(medians([draw_errors(setting, 1)]), allow_nan=False)


@pytest.mark.parametrize(
    "change",
    [{"S": 0.0}, {"num_points": 10**9}, {"noise_deg": float("nan")}, {"seed": "1"}, {"x": 1}],
)
def test_values_out_of_range_are_refused(change):
    with pytest.raises(RefusedError):
        setting_from(vars(Setting()) | change)
