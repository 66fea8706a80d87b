# SPDX-License-Identifier: BSD-3-Clause
"""Fig. 3: internal angles and parallax on the sphere and on ovoids, and the error over (S, K)."""

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar import SkCost, pose_from_essential, search_sk, stability
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360.progress import Progress
from epi360.synthetic import TwoViewScene, two_view_scene
from epi360_paper.fig3_drawing import Profile, Surface, draw_stability
from epi360_paper.options import Outcome, ReproduceOptions
from epi360_paper.parts import Trials, csv_bytes
from epi360_paper.plots import png_of
from epi360_paper.results import markdown_table, run_line, save_outcome
from epi360_paper.trials import Trial, run_trials

Array = NDArray[np.float64]

TITLE = "Fig. 3: stability of the spherical projection"
NUM_PROBLEMS = 100  # panel f shows their medians; the paper shows one problem
NUM_LANDMARKS = 200
KAPPA, OUTLIER_RATIO = 500.0, 0.2  # section 5.1
NUM_COLOURED = 600  # clean landmarks of panels b to d
# The grid of panel e is symmetric about (1, 1) and its ratios K / S are those of panel f.
SURFACE_VALUES = 2.0 ** np.linspace(-2.0, 2.0, 41)
RATIOS = 2.0 ** np.linspace(-4.0, 4.0, 41)
PANELS = {"b": (1.0, 1.0), "c": (2.0, 1.0), "d": (1.0, 2.0)}  # S and K


def run(options: ReproduceOptions, progress: Progress) -> Outcome:
    """Make figure 3 from synthetic landmarks: geometry, three ovoids, error over (S, K)."""
    num_problems = options.num_trials(NUM_PROBLEMS)
    trials = run_trials("fig3", {"problems": None}, problem_rows, num_problems, options, progress)
    shown = typical_problem(trials)
    problem = make_problem(Trial(options.seed, "fig3", 0, shown))
    surface = error_surface(problem, SURFACE_VALUES)
    clean = two_view_scene(options.seed, num_matches=NUM_COLOURED, layout="room", baseline_m=1.0)
    parallax = {panel: parallax_deg(clean, *PANELS[panel]) for panel in PANELS}
    figure = draw_stability(clean, PANELS, parallax, surface, _profile(trials), shown)
    return save_outcome(
        "fig3",
        TITLE,
        run_line(options, num_problems, trials),
        [_parallax_table(parallax), _search_table(trials), _words(trials, surface)],
        trials,
        options,
        tables={
            "surface.csv": _csv(_surface_columns(surface)),
            "parallax.csv": _csv(_parallax_columns(clean, parallax)),
        },
        figure=png_of(figure),
    )


def make_problem(trial: Trial) -> TwoViewScene:
    """Landmarks on the walls of a room with the noise and the outliers of section 5.1."""
    return two_view_scene(
        int(trial.rng().integers(2**63)),
        num_matches=NUM_LANDMARKS,
        layout="room",
        kappa=KAPPA,
        outlier_ratio=OUTLIER_RATIO,
    )


def problem_rows(cell: None, trial: Trial) -> list[dict[str, float | str]]:
    """Errors and costs of one problem over K/S (kind "grid"), and where both searches end."""
    scene = make_problem(trial)
    cost = SkCost(scene.bearings1, scene.bearings2)
    places = [("grid", 1.0, float(ratio)) for ratio in RATIOS]
    for search in ("line", "lm"):
        S, K, _, _ = search_sk(scene.bearings1, scene.bearings2, search)
        places.append((search, S, K))
    rows: list[dict[str, float | str]] = []
    for kind, S, K in places:
        rotation, translation = _errors_deg(scene, cost.essential(S, K))
        rows.append(
            {
                "kind": kind,
                "S": S,
                "K": K,
                "rotation_deg": rotation,
                "translation_deg": translation,
                "mean_residual": cost(S, K) / NUM_LANDMARKS,
            }
        )
    return rows


def typical_problem(trials: Trials) -> int:
    """Index of the problem whose error over K/S is closest to the median of all problems."""
    curves = np.log(np.maximum(_profile(trials).translation_deg, 1e-6))
    return int(np.abs(curves - np.median(curves, axis=0)).mean(axis=1).argmin())


def error_surface(scene: TwoViewScene, values: Array) -> Surface:
    """Errors of the normalised eight-point algorithm over a grid of S and K."""
    # Each solution is computed, though E depends on K / S alone: N = S diag(1, 1, K / S), and a
    # common factor of all rows of A changes no singular vector.
    cost = SkCost(scene.bearings1, scene.bearings2)

    def errors_at(S: float, K: float) -> tuple[float, float]:
        return _errors_deg(scene, cost.essential(S, K))

    errors = np.array([[errors_at(S, K) for K in values] for S in values])
    found = {"start": (1.0, 1.0, errors_at(1.0, 1.0)[1])}
    for search in ("line", "lm"):
        S, K, _, _ = search_sk(scene.bearings1, scene.bearings2, search)
        found[search] = (S, K, errors_at(S, K)[1])
    return Surface(values, errors[..., 0], errors[..., 1], found)


def parallax_deg(scene: TwoViewScene, S: float, K: float) -> Array:
    """Motion parallax in the normalised domain: angle between N R q1 and N q2, shape (N,)."""
    measured = stability(scene.bearings1, scene.bearings2, (S, K), scene.cam2_from_cam1)
    return np.asarray(np.degrees(measured.normalized_parallax_rad))


def _errors_deg(scene: TwoViewScene, E: Array) -> tuple[float, float]:
    pose = pose_from_essential(E, scene.bearings1, scene.bearings2)
    truth = scene.cam2_from_cam1
    return rotation_error_deg(pose, truth), translation_error_deg(pose, truth)


def _surface_columns(surface: Surface) -> dict[str, Array]:
    S, K = np.meshgrid(surface.values, surface.values, indexing="ij")
    return {
        "S": S.ravel(),
        "K": K.ravel(),
        "rotation_deg": surface.rotation_deg.ravel(),
        "translation_deg": surface.translation_deg.ravel(),
    }


def _parallax_columns(scene: TwoViewScene, parallax: dict[str, Array]) -> dict[str, Array]:
    columns = {f"bearing1_{name}": scene.bearings1[:, k] for k, name in enumerate("xyz")}
    for panel, (S, K) in PANELS.items():
        columns[f"parallax_S{S:g}_K{K:g}_deg"] = parallax[panel]
    return columns


def _csv(columns: dict[str, Array]) -> bytes:
    rows = zip(*columns.values(), strict=True)
    return csv_bytes(columns, ([f"{value:.9g}" for value in row] for row in rows))


def _parallax_table(parallax: dict[str, Array]) -> str:
    rows = []
    for panel, (S, K) in PANELS.items():
        values = parallax[panel]
        quartiles = " / ".join(f"{value:.1f}" for value in np.percentile(values, [25, 50, 75]))
        larger = 100.0 * np.mean(values > parallax["b"])
        rows.append(
            [f"({panel}) S = {S:g}, K = {K:g}", f"{values.mean():.2f}", quartiles, f"{larger:.0f}"]
        )
    heading = ["panel", "mean parallax (deg)", "quartiles (deg)", "larger than in (b) (%)"]
    return markdown_table(heading, rows)


def _search_table(trials: Trials) -> str:
    grid = trials.where(kind="grid")
    chosen = {
        "(1, 1): 8-PA": grid.where(K=1.0),
        "search over K/S": trials.where(kind="line"),
        "Levenberg-Marquardt": trials.where(kind="lm"),
    }
    rows = []
    for name, part in chosen.items():
        rows.append(
            [
                name,
                f"{np.median(np.abs(part['K'] / part['S'])):.3f}",  # its sign changes no E
                f"{np.median(part['rotation_deg']):.2f}",
                f"{np.median(part['translation_deg']):.2f}",
                f"{np.degrees(np.median(part['mean_residual'])):.3f}",
            ]
        )
    heading = [
        f"{NUM_LANDMARKS} landmarks, kappa {KAPPA:g}, {100 * OUTLIER_RATIO:g} % outliers", "K/S",
        "rotation error (deg)", "translation error (deg)", "mean residual (deg)",
    ]  # fmt: skip
    return "Medians over the problems:\n\n" + markdown_table(heading, rows)


def _words(trials: Trials, surface: Surface) -> str:
    S, K = np.meshgrid(surface.values, surface.values, indexing="ij")
    ratio = np.log2(K / S).round(6)
    spread = max(np.ptp(surface.translation_deg[ratio == value]) for value in np.unique(ratio))
    best = np.unravel_index(surface.translation_deg.argmin(), surface.translation_deg.shape)
    curve = np.median(_profile(trials).translation_deg, axis=0)
    ends = "; ".join(
        f"{name}: ({S_:.3f}, {K_:.3f}), K/S = {K_ / S_:.3f}, {error:.2f} deg"
        for name, (S_, K_, error) in surface.found.items()
    )
    return (
        "Panel e is one problem: the one whose error over K/S is closest to the median of "
        "all. It depends on K/S alone: along lines of equal K/S it "
        f"changes by {spread:.1e} deg at most, so that there is a line of equal solutions and no "
        f"single best (S, K). Lowest on the grid: {surface.translation_deg.min():.2f} deg at K/S = "
        f"{K[best] / S[best]:.3f}. Ends of the searches (S, K): {ends}. The median over the "
        f"problems is lowest, {curve.min():.2f} deg, at K/S = {RATIOS[curve.argmin()]:.3f}."
    )


def _profile(trials: Trials) -> Profile:
    # The rows of the grid come problem by problem, each in the order of RATIOS.
    grid = trials.where(kind="grid")
    translation = grid["translation_deg"].reshape(-1, len(RATIOS))
    residual = np.degrees(grid["mean_residual"].reshape(-1, len(RATIOS)))
    return Profile(RATIOS, translation, residual)
