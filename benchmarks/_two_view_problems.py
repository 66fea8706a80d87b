# SPDX-License-Identifier: BSD-3-Clause
"""Problems of the two-view benchmark: cells by name, and seeded matches with known truth."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose
from epi360.synthetic import sample_relative_pose, sample_von_mises_fisher, two_view_scene

Array = NDArray[np.float64]

# Scene of a cell to the layout of its landmarks.
LAYOUTS = {
    "room": "room",
    "uniform": "sphere",
    "cone": "cone",
    "near": "room",
    "rotation": "room",
    "plane": "plane",
    "patch": "cone",
}
CONE_HALF_ANGLE_DEG = 30.0
PATCH_HALF_ANGLE_DEG = 12.0
NEAR_BASELINE_M = 0.2
FULL_SPHERE_DEG = 360

# The noise is disturbed in view 2 only, as in the paper, so the Sampson residual's standard
# deviation is sigma / sqrt(2) and the gate 2.8 times that. Between 1.5 and 4 sigma this is where
# pycolmap is best over all cells (the aims of the project were measured at 2 and 3 sigma).
GATE_PER_SIGMA = 2.0
KAPPA_500_SIGMA_DEG = float(np.degrees(500.0**-0.5))

_NAME = re.compile(
    r"(?P<scene>[a-z]+)-(?P<matches>\d+)-(?P<outliers>\d+)-(?P<noise>k500|[\d.]+)"
    r"(?:-fisheye(?P<fov>\d+))?(?P<both>-both)?"
)


@dataclass(frozen=True)
class Cell:
    """One kind of problem.

    Attributes
    ----------
    scene : str
        Key of ``LAYOUTS``.
    num_matches, outlier_percent : int
        Outliers are exactly this share of the matches.
    noise : str
        Standard deviation in degrees per tangent axis, or "k500" for kappa = 500.
    fov_deg : int
        360, or the full angle that a fisheye lens sees.
    in_both_views : bool
        Whether view 1 is disturbed too.
    """

    scene: str
    num_matches: int
    outlier_percent: int
    noise: str
    fov_deg: int = FULL_SPHERE_DEG
    in_both_views: bool = False

    @property
    def name(self) -> str:
        """Scene-matches-outliers-noise, as ``room-400-50-0.1``, and how it is no panorama."""
        fisheye = "" if self.fov_deg == FULL_SPHERE_DEG else f"-fisheye{self.fov_deg}"
        both = "-both" if self.in_both_views else ""
        numbers = f"{self.num_matches}-{self.outlier_percent}-{self.noise}"
        return f"{self.scene}-{numbers}{fisheye}{both}"

    @property
    def noise_deg(self) -> float:
        """Standard deviation of the noise per tangent axis."""
        return KAPPA_500_SIGMA_DEG if self.noise == "k500" else float(self.noise)

    @property
    def mean_angle_deg(self) -> float:
        """Mean angle between a bearing and its disturbed one: sigma sqrt(pi / 2)."""
        return self.noise_deg * float(np.sqrt(np.pi / 2.0))

    @property
    def gate_deg(self) -> float:
        """Inlier threshold of all methods that are given one."""
        return GATE_PER_SIGMA * self.noise_deg

    @property
    def has_truth(self) -> bool:
        """Whether there is a pose to find: not among random matches, nor in a patch that lies."""
        return self.outlier_percent < 100 and self.scene != "patch"

    @property
    def has_direction(self) -> bool:
        """Whether the truth has a direction of translation."""
        return self.has_truth and self.scene != "rotation"


@dataclass(frozen=True)
class Problem:
    """Matches of two views; row i of both arrays is match i, (N, 3) unit."""

    cell: Cell
    index: int
    bearings1: Array
    bearings2: Array
    inlier_mask: NDArray[np.bool_]
    cam2_from_cam1: Pose  # unit translation; NaN what cannot be found


NAMED_CELLS = (
    "room-400-0-0.1",
    "room-400-20-0.1",
    "room-400-50-0.05",
    "room-400-50-0.1",
    "room-1000-50-0.1",
    "room-5000-50-0.1",
    "room-400-50-0.5",
    "room-400-50-0.5-both",
    "room-100-50-0.5",
    "room-400-50-k500",
    "room-400-70-0.5",
    "room-400-80-0.5",
    "room-400-85-0.1",
    "uniform-400-50-0.1",
    "uniform-400-50-k500",
    "cone-400-0-k500",
    "cone-400-30-k500",
    "near-400-0-0.1",
    "near-400-30-0.5",
    "rotation-400-0-0.5",
    "rotation-400-30-0.5",
    "plane-400-30-0.5",
    "room-400-50-0.1-fisheye180",
    "room-400-50-0.5-fisheye200",
    "uniform-400-100-0.1",
    "patch-100-60-0.1",
)


def cell_from_name(name: str) -> Cell:
    """Cell of a name like ``room-400-50-0.1-fisheye180-both``.

    Raises
    ------
    ValueError
        If the name is of another form.
    """
    match = _NAME.fullmatch(name)
    if match is None or match["scene"] not in LAYOUTS:
        raise ValueError(
            f"cell must be SCENE-MATCHES-OUTLIERS-NOISE[-fisheyeFOV][-both] with a scene of "
            f"{', '.join(LAYOUTS)}, got {name!r}"
        )
    return Cell(
        scene=match["scene"],
        num_matches=int(match["matches"]),
        outlier_percent=int(match["outliers"]),
        noise=match["noise"],
        fov_deg=int(match["fov"] or FULL_SPHERE_DEG),
        in_both_views=match["both"] is not None,
    )


def grid_cells() -> list[Cell]:
    """Every cell of the full grid: noise, outliers, matches, scene and field of view."""
    axes: list[Any] = [
        ("room", "uniform", "cone", "near", "rotation", "plane"),
        (100, 400, 1000, 5000),
        (0, 20, 50, 70, 85),
        ("0.05", "0.1", "0.5", "k500"),
        (FULL_SPHERE_DEG, 180, 200),
    ]
    return [Cell(*values) for values in product(*axes)]


def chosen_cells(patterns: str | None, *, full: bool) -> list[Cell]:
    """Named cells or the grid, or those of a comma-separated list of names and patterns.

    Raises
    ------
    ValueError
        If a pattern fits no cell.
    """
    known = grid_cells() if full else [cell_from_name(name) for name in NAMED_CELLS]
    if patterns is None:
        return known
    cells: dict[str, Cell] = {}
    for pattern in patterns.split(","):
        if any(letter in pattern for letter in "*?["):
            found = [cell for cell in known if fnmatchcase(cell.name, pattern)]
        else:
            found = [cell_from_name(pattern)]
        if not found:
            raise ValueError(f"no cell is called {pattern}; named cells: {', '.join(NAMED_CELLS)}")
        cells |= {cell.name: cell for cell in found}
    return list(cells.values())


def make_problem(cell: Cell, index: int, seed: int) -> Problem:
    """Problem ``index`` of a cell: the same for equal arguments, whatever else is run."""
    rng = np.random.Generator(np.random.PCG64([seed, zlib.crc32(cell.name.encode()), index]))
    pose = _pose(cell, rng)
    bearings1, bearings2 = _visible_landmarks(cell, pose, rng)
    kappa = 1.0 / np.radians(cell.noise_deg) ** 2
    bearings2 = sample_von_mises_fisher(rng, bearings2, kappa)
    if cell.in_both_views:
        bearings1 = sample_von_mises_fisher(rng, bearings1, kappa)
    num_outliers = round(cell.num_matches * cell.outlier_percent / 100)
    outliers = rng.choice(cell.num_matches, num_outliers, replace=False)
    bearings2[outliers] = _outlier_directions(cell, pose, rng, num_outliers)
    if cell.scene == "patch":  # the other matches are everywhere in both views
        bearings1[outliers] = _outlier_directions(cell, pose, rng, num_outliers)
    inlier_mask = np.ones(cell.num_matches, dtype=np.bool_)
    inlier_mask[outliers] = False
    return Problem(cell, index, bearings1, bearings2, inlier_mask, _truth(cell, pose))


def front_hemisphere(problem: Problem) -> Problem:
    """Matches with z > 0 in both views: all that a pinhole camera can be given."""
    kept = (problem.bearings1[:, 2] > 0.0) & (problem.bearings2[:, 2] > 0.0)
    return replace(
        problem,
        bearings1=problem.bearings1[kept],
        bearings2=problem.bearings2[kept],
        inlier_mask=problem.inlier_mask[kept],
    )


def _pose(cell: Cell, rng: np.random.Generator) -> Pose:
    pose = sample_relative_pose(rng)
    if cell.scene == "rotation":
        return Pose(pose.rotation, np.zeros(3))
    if cell.scene == "near":
        t = pose.translation
        return Pose(pose.rotation, NEAR_BASELINE_M * t / np.linalg.norm(t))
    return pose


def _truth(cell: Cell, pose: Pose) -> Pose:
    if not cell.has_truth:
        return Pose.nan()
    if not cell.has_direction:
        return Pose(pose.rotation, np.full(3, np.nan))
    return Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))


def _visible_landmarks(cell: Cell, pose: Pose, rng: np.random.Generator) -> tuple[Array, Array]:
    """Exact bearings of landmarks that both views see."""
    half_angle = PATCH_HALF_ANGLE_DEG if cell.scene == "patch" else CONE_HALF_ANGLE_DEG
    kept1, kept2 = np.empty((0, 3)), np.empty((0, 3))
    while len(kept1) < cell.num_matches:
        scene = two_view_scene(
            int(rng.integers(2**32)),
            num_matches=cell.num_matches,
            layout=LAYOUTS[cell.scene],  # type: ignore[arg-type]
            cone_half_angle_deg=half_angle,
            cam2_from_cam1=pose,
        )
        seen = _is_seen(cell, scene.bearings1) & _is_seen(cell, scene.bearings2)
        kept1 = np.concatenate([kept1, scene.bearings1[seen]])
        kept2 = np.concatenate([kept2, scene.bearings2[seen]])
    # A patch may be anywhere, at a pole too; nobody asks for its pose.
    turn = _random_rotation(rng) if cell.scene == "patch" else np.eye(3)
    return kept1[: cell.num_matches] @ turn.T, kept2[: cell.num_matches] @ turn.T


def _random_rotation(rng: np.random.Generator) -> Array:
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.asarray(Q * np.linalg.det(Q))


def _is_seen(cell: Cell, bearings: Array) -> NDArray[np.bool_]:
    angles = np.arctan2(np.hypot(bearings[:, 0], bearings[:, 1]), bearings[:, 2])
    return np.asarray(angles <= np.radians(min(cell.fov_deg, 360) / 2.0))


def _outlier_directions(cell: Cell, pose: Pose, rng: np.random.Generator, num: int) -> Array:
    """Uniform over what view 2 sees; in a cone over the cone turned with the camera."""
    half_angle = np.radians(CONE_HALF_ANGLE_DEG if cell.scene == "cone" else cell.fov_deg / 2.0)
    z = 1.0 - rng.random(num) * (1.0 - np.cos(half_angle))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, num)
    radius = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    directions = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
    return directions @ pose.rotation.T if cell.scene == "cone" else directions
