# SPDX-License-Identifier: BSD-3-Clause
import csv

import cv2
import numpy as np
import pytest

from epi360.epipolar import angular_residuals, eight_point, essential_from_pose, pose_from_essential
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360.progress import no_progress
from epi360.synthetic import two_view_scene
from epi360_paper import fig1, fig2, fig3
from epi360_paper.options import ReproduceOptions
from epi360_paper.ovoid_plots import Eye, draw_ovoid, great_circle
from epi360_paper.plots import draw_top_view, new_figure, png_of, spread_indices
from epi360_paper.tracked_pair import MIN_BASELINE_M, track_pair
from epi360_paper.trials import Trial
from epi360_scenes import furnished_room

WIDTH = 192


@pytest.fixture(scope="module")
def pair():
    options = ReproduceOptions(image_width=WIDTH, seed=0)
    return track_pair(furnished_room(), options, lambda done, total: None)


@pytest.fixture(scope="module")
def options(pair, tmp_path_factory):
    """Options of a quick run: one tracked pair for all, few values of S and K, two problems."""
    with pytest.MonkeyPatch.context() as patch:
        for module, scene in ((fig1, "scene"), (fig2, "furnished_room")):
            patch.setattr(module, "track_pair", lambda *_: pair)
            patch.setattr(module, scene, lambda *_: None)
        patch.setattr(fig3, "SURFACE_VALUES", 2.0 ** np.arange(-1.0, 1.5, 0.5))
        out = tmp_path_factory.mktemp("out")
        yield ReproduceOptions(trials=2, jobs=1, image_width=WIDTH, out=out)


@pytest.fixture(scope="module")
def outcomes(options):
    """Outcome and reported stages of each figure by its name."""
    results = {}
    for module in (fig1, fig2, fig3):
        stages = []
        outcome = module.run(options, lambda *stage, seen=stages: seen.append(stage))
        results[outcome.name] = outcome, stages
    return results


def columns_of(path):
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


@pytest.mark.parametrize(
    ("name", "size"), [("fig1", (1400, 1020)), ("fig2", (1500, 690)), ("fig3", (1500, 990))]
)
def test_a_figure_is_written_with_its_numbers(name, size, options, outcomes):
    outcome, stages = outcomes[name]
    folder = options.folder(name)
    assert {path.name for path in outcome.files} >= {"trials.csv", "table.md", "figure.png"}
    assert all(path.is_file() and path.parent == folder for path in outcome.files)
    assert outcome.summary == (folder / "table.md").read_text(encoding="utf-8")
    assert "| ---" in outcome.summary and "nan" not in outcome.summary
    assert stages[-1][1] == stages[-1][2]
    assert cv2.imread(str(folder / "figure.png")).shape[1::-1] == size


def test_a_second_run_gives_the_same_bytes(options, outcomes):
    files = outcomes["fig3"][0].files
    before = [path.read_bytes() for path in files]
    fig3.run(options, no_progress)
    assert [path.read_bytes() for path in files] == before


def test_key_points_of_a_tracked_pair_fit_the_depth_and_the_true_pose(pair):
    assert np.linalg.norm(pair.cam2_from_cam1.translation) >= MIN_BASELINE_M
    assert 50 < len(pair.keypoints1) <= 200
    E = essential_from_pose(pair.cam2_from_cam1)
    residuals_deg = np.degrees(angular_residuals(E, pair.bearings1, pair.bearings2))
    pixel_deg = 360.0 / WIDTH
    # A tracker is good to a fraction of a pixel: measured 0.32 and, on two other paths, up to 0.55.
    assert np.median(np.abs(residuals_deg)) < 0.6 * pixel_deg
    # Landmarks come from the depth at whole pixels: the second view sees them 0.94 pixels off.
    turned = pair.landmarks @ pair.cam2_from_cam1.rotation.T + pair.cam2_from_cam1.translation
    cosines = np.sum(turned * pair.bearings2, axis=1) / np.linalg.norm(turned, axis=1)
    assert np.median(np.degrees(np.arccos(np.minimum(cosines, 1.0)))) < 1.5 * pixel_deg


def test_figure_1_tells_landmarks_bearings_and_ovoid_of_every_key_point(options, outcomes, pair):
    columns = columns_of(options.folder("fig1") / "trials.csv")
    N = eight_point(pair.bearings1, pair.bearings2, "sk").normalizer1
    bearings = np.stack([columns[f"bearing1_{axis}"] for axis in "xyz"], axis=1)
    ovoid = np.stack([columns[f"ovoid1_{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(bearings, pair.bearings1, atol=1e-8)
    np.testing.assert_allclose(ovoid, pair.bearings1 @ N.T, atol=1e-8)


def test_the_error_surface_depends_on_the_ratio_of_k_and_s_alone():
    scene = two_view_scene(1, kappa=500, outlier_ratio=0.2)
    surface = fig3.error_surface(scene, np.array([0.5, 1.0, 2.0]))
    # Equal K/S lie on a diagonal. 1e-6 deg: eigenvectors of nine numbers, 2 digits to spare.
    for errors in (surface.rotation_deg, surface.translation_deg):
        np.testing.assert_allclose(np.diag(errors), errors[1, 1], atol=1e-6)
        np.testing.assert_allclose(errors[1, 0], errors[2, 1], atol=1e-6)
    pose = pose_from_essential(
        eight_point(scene.bearings1, scene.bearings2).E, scene.bearings1, scene.bearings2
    )
    assert surface.found["start"][2] == pytest.approx(
        translation_error_deg(pose, scene.cam2_from_cam1), abs=1e-6
    )


def test_a_problem_of_figure_3_has_its_grid_and_both_searches():
    rows = fig3.problem_rows(None, Trial(0, "fig3", 0, 0))
    assert [row["kind"] for row in rows] == ["grid"] * len(fig3.RATIOS) + ["line", "lm"]
    start = next(row for row in rows if row["kind"] == "grid" and row["K"] == 1.0)
    assert all(row["mean_residual"] <= start["mean_residual"] for row in rows[-2:])


def test_parallax_is_that_of_a_triangle_and_grows_where_the_ovoid_is_stretched():
    scene = two_view_scene(0, num_matches=50, layout="room")
    R, t = scene.cam2_from_cam1.rotation, scene.cam2_from_cam1.translation
    # The angle at the landmark between the directions to both cameras.
    to1, to2 = scene.points @ R.T, scene.points @ R.T + t
    cross = np.linalg.norm(np.cross(to1, to2), axis=1)
    expected = np.degrees(np.arctan2(cross, np.sum(to1 * to2, axis=1)))
    np.testing.assert_allclose(fig3.parallax_deg(scene, 1.0, 1.0), expected, atol=1e-8)
    np.testing.assert_allclose(
        fig3.parallax_deg(scene, 2.0, 2.0), fig3.parallax_deg(scene, 1.0, 1.0), atol=1e-8
    )
    assert np.ptp(fig3.parallax_deg(scene, 1.0, 2.0)) > np.ptp(expected)


def test_an_eye_has_right_handed_axes_and_sees_down_as_down():
    axes = Eye(azimuth_deg=-38.0, elevation_deg=18.0).axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    paper, depth = Eye(0.0, 0.0).project(np.eye(3))
    np.testing.assert_allclose(paper, [[1, 0], [0, -1], [0, 0]], atol=1e-12)
    np.testing.assert_allclose(depth, [0, 0, 1], atol=1e-12)


def test_the_dots_of_an_ovoid_that_face_the_reader_are_in_front():
    figure = new_figure(2.0, 2.0)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    front, back = -Eye().axes[2], Eye().axes[2]
    dots = draw_ovoid(axes, np.stack([front, back]), np.diag([2.0, 2.0, 2.0]))
    np.testing.assert_allclose(dots.get_offsets(), [[0.0, 0.0]], atol=1e-12)
    assert png_of(figure) == png_of(figure)


def test_a_great_circle_is_across_its_normal():
    normal = np.array([0.3, -2.0, 0.5])
    circle = great_circle(normal)
    np.testing.assert_allclose(circle @ normal, 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), 1.0, atol=1e-12)


def test_the_top_view_shows_the_highest_point_below_the_ceiling():
    # In one cell from the floor (y down) upwards: red, green, and blue above the cut.
    points = np.array([[[1.0, 1.0, 2.0], [1.0, 0.0, 2.0], [1.0, -2.0, 2.0], [-1.0, 1.0, -2.0]]])
    colours = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]]], np.uint8)
    axes = new_figure(2.0, 2.0).add_axes((0.0, 0.0, 1.0, 1.0))
    draw_top_view(axes, colours, points, np.zeros((1, 3)))
    seen = {tuple(colour) for colour in axes.images[0].get_array().reshape(-1, 3).tolist()}
    assert seen == {(0, 255, 0), (9, 9, 9), (255, 255, 255)}


def test_spread_rows_are_far_from_each_other_and_never_repeated():
    bearings = np.array([[1.0, 0, 0], [0.999, 0.04, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert spread_indices(bearings, 4).tolist() == [0, 2, 3, 4]
    assert spread_indices(bearings, 9).tolist() == [0, 2, 3, 4, 1]
    assert spread_indices(bearings[:0], 3).tolist() == []


def test_errors_of_a_problem_are_those_of_its_poses():
    scene = fig3.make_problem(Trial(0, "fig3", 0, 3))
    solution = eight_point(scene.bearings1, scene.bearings2, (1.0, 2.0))
    pose = pose_from_essential(solution.E, scene.bearings1, scene.bearings2)
    row = next(row for row in fig3.problem_rows(None, Trial(0, "fig3", 0, 3)) if row["K"] == 2.0)
    assert row["rotation_deg"] == pytest.approx(rotation_error_deg(pose, scene.cam2_from_cam1))
