# SPDX-License-Identifier: BSD-3-Clause
"""What the experiments count: errors by eq. 16, thresholds, pairs, shares of outliers."""

import numpy as np
import pytest

from epi360.poses import Pose, rotation_from_vector
from epi360.synthetic import two_view_scene
from epi360_paper import (
    method_rows,
    methods,
    options,
    parts,
    protocols,
    sources,
    table1,
    table4,
    trials,
)

PROTOCOLS = protocols.PROTOCOLS


def turned(degrees, direction=(0.0, 0.0, 1.0)):
    return Pose(rotation_from_vector([0.0, np.radians(degrees), 0.0]), np.array(direction))


@pytest.mark.parametrize(
    ("degrees", "share"), [(0.0, 0.0), (45.0, 0.25), (90.0, 0.5), (180.0, 1.0)]
)
def test_a_rotation_error_is_its_share_of_half_a_turn(degrees, share):
    rotation, translation = methods.pose_errors(turned(degrees), turned(0.0))
    assert rotation == pytest.approx(share, abs=1e-12)
    assert translation == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("length", [1e-3, 1.0, 50.0])
def test_the_length_of_a_translation_is_no_error(length):
    sideways = turned(0.0, (length, 0.0, 0.0))
    assert methods.pose_errors(sideways, turned(0.0)) == pytest.approx((0.0, 0.5), abs=1e-12)
    opposite = turned(0.0, (0.0, 0.0, -length))
    assert methods.pose_errors(opposite, turned(0.0)) == pytest.approx((0.0, 1.0), abs=1e-12)


@pytest.mark.parametrize("protocol", sorted(PROTOCOLS))
def test_every_method_finds_the_pose_of_exact_matches_under_every_protocol(protocol):
    scene = two_view_scene(3, num_matches=60)
    names = [*methods.METHODS]
    found = methods.method_errors(
        names, scene.bearings1, scene.bearings2, scene.cam2_from_cam1, PROTOCOLS[protocol]
    )
    assert list(found) == [
        f"{kind}_{name}" for name in names for kind in ("rotation", "translation")
    ]
    assert max(found.values()) < 1e-8


def test_seven_matches_give_no_method_a_pose():
    scene = two_view_scene(3, num_matches=7)
    found = methods.method_errors(
        ["8pa", "gsm"], scene.bearings1, scene.bearings2, scene.cam2_from_cam1, PROTOCOLS["printed"]
    )
    assert len(found) == 4 and np.isnan([*found.values()]).all()


def test_a_threshold_is_printed_for_the_residual_of_the_authors():
    setting = table4.Setting("printed", 2.3e-4, 590)
    assert table4.ransac_threshold(setting, PROTOCOLS["authors"]) == 2.3e-4
    # Eq. 13 is not divided by the norm over 400 matches: the sine of 5.3 degrees.
    sine = table4.ransac_threshold(setting, PROTOCOLS["corrected"])
    assert np.degrees(np.arcsin(sine)) == pytest.approx(5.28, abs=0.01)


@pytest.mark.parametrize(("wanted", "expected"), [(None, 2000), (1, 1), (7, 7)])
def test_sequences_are_as_many_as_the_wanted_pairs_need(wanted, expected):
    per_sequence = method_rows.PAIRS_PER_SEQUENCE
    count = method_rows.num_sequences(options.ReproduceOptions(trials=wanted))
    assert (count - 1) * per_sequence < expected <= count * per_sequence


def test_names_and_folders_of_runs_do_not_meet(tmp_path, monkeypatch):
    one_row = parts.Trials({"trial": np.array([0]), "pair": np.array([0])})
    monkeypatch.setattr(method_rows, "run_trials", lambda *args, **options: one_row)
    monkeypatch.setattr(method_rows, "_comparison_sections", lambda *args: [])
    monkeypatch.setattr(method_rows, "run_line", lambda options, count, trials, unit: unit)
    monkeypatch.setattr(method_rows, "save_outcome", lambda name, title, run, *rest: (name, run))
    folders = set()
    for protocol in PROTOCOLS:
        for landmarks in (False, True):
            given = options.ReproduceOptions(protocol=protocol, landmarks=landmarks, out=tmp_path)
            name, unit = method_rows.run_comparison(table1.TABLE, given, lambda *args: None)
            folders.add(given.folder(name))
            assert ("landmarks" in name) == landmarks
            assert unit == ("scenes" if landmarks else "rendered sequences")
    assert len(folders) == 6 and {folder.parent for folder in folders} == {tmp_path}


@pytest.mark.parametrize(("jobs", "expected"), [(1, 1), (3, 3)])
def test_workers_are_as_many_as_asked(jobs, expected):
    assert options.ReproduceOptions(jobs=jobs).num_workers == expected
    assert options.ReproduceOptions().num_workers >= 1


@pytest.fixture
def tiny_cloud(monkeypatch):
    """Landmarks around the camera, at once: no room is rendered."""
    directions = np.random.default_rng(0).normal(size=(5000, 3))
    cloud = 3.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    monkeypatch.setattr(protocols, "landmark_clouds", lambda density: (cloud,))


@pytest.mark.parametrize("name", sorted(PROTOCOLS))
def test_landmarks_are_one_pair_a_trial_the_same_each_time(name, tiny_cloud):
    source = sources.LandmarkPairs(name)
    (pair,), (again,) = (source.pairs(trials.Trial(0, "any", 0, 4)) for _ in range(2))
    (other,) = source.pairs(trials.Trial(0, "any", 0, 5))
    assert pair.bearings1.shape == pair.bearings2.shape == (sources.NUM_POINTS, 3)
    np.testing.assert_array_equal(pair.bearings2, again.bearings2)
    assert np.abs(pair.bearings2 - other.bearings2).max() > 0.1
    assert np.abs(pair.cam2_from_cam1.rotation - other.cam2_from_cam1.rotation).max() > 1e-3


@pytest.mark.parametrize("ratio", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("name", ["printed", "corrected"])
def test_the_share_of_outliers_is_the_one_asked_for(name, ratio, tiny_cloud):
    rngs = np.random.default_rng(1), np.random.default_rng(2)
    scene = protocols.draw_scene(PROTOCOLS[name], 200, 500.0, ratio, *rngs)
    assert (~scene.inlier_mask).sum() == round(200 * ratio)
    assert len(scene.bearings1) == len(scene.bearings2) == 200


def test_a_line_on_pairs_counts_each_pair_once_whatever_the_methods():
    rows = [
        {"cell": "a", "trial": trial, "method": method, "num_tracks": 100 + trial,
         "turn_deg": 2.0, "noise_deg": 0.1, "off_share": 0.25}
        for trial in (0, 1, 1)
        for method in ("8pa", "gsm")
    ]  # fmt: skip
    columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    line = method_rows.pairs_line(parts.Trials(columns), "scenes")
    assert line.startswith("3 pairs of 2 scenes; medians: 101 matches, 2.0° of turn, 0.10°")
    assert line.endswith("25.0 % of the matches are more than 1° out of it.")
