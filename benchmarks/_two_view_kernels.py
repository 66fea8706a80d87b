# SPDX-License-Identifier: BSD-3-Clause
"""Microseconds of the solvers and of the refinement alone, beside the peers' in the same run."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from _machine import fact_lines, load_average
from _peers import PANORAMA_WIDTH, PINHOLE_FOCAL_PX, pycolmap_camera
from _summary import markdown_table, text_table
from _two_view_problems import Problem, cell_from_name, make_problem
from numpy.typing import NDArray

import epi360
from epi360 import _core
from epi360.poses import Pose, rotation_from_vector
from epi360.runs.whole_files import write_file

Array = NDArray[np.float64]
Kernel = Callable[[], Any]

SIZES = (100, 200, 400, 1000, 5000)
NUM_ROUNDS, ROUND_SECONDS = 9, 0.02
START_ERROR_DEG = 1.0


def kernel_report(options: argparse.Namespace, facts: dict[str, Any]) -> None:
    """Write ``kernels.md``."""
    table = [["kernel", "points", "epi360 us", "peer", "peer us", "epi360 / peer"]]
    remarks = []
    for label, size, ours, peers in _comparisons(options.seed):
        try:
            times = _microseconds({"epi360": ours, **peers})
        except (AttributeError, TypeError, ImportError) as error:
            remarks.append(f"{label} left out: {error}.")
            continue
        for name in peers:
            row = [label, str(size), f"{times['epi360']:.2f}", name, f"{times[name]:.2f}"]
            table.append([*row, f"{times['epi360'] / times[name]:.2f}"])
    text = "\n\n".join(
        [
            "# Kernels",
            "\n".join(f"- {line}" for line in fact_lines(facts)),
            f"Median of {NUM_ROUNDS} rounds in which all take turns, called from Python on "
            f"prepared arrays, one thread; load at the end {load_average()}. PoseLib's relpose_5pt "
            "also makes poses of the matrices and tests their depths. The refinement starts "
            f"{START_ERROR_DEG:g} degree off, on matches without outliers (noise 0.5 degrees) in a "
            "cone of 30 degrees, which a pinhole camera sees whole; ours is the public call with "
            "its covariance.",
            *remarks,
            markdown_table(table),
        ]
    )
    write_file(options.out / "kernels.md", (text + "\n").encode())
    print("\n" + "\n".join([*remarks, text_table(table)]), flush=True)


def _comparisons(seed: int) -> list[tuple[str, int, Kernel, dict[str, Kernel]]]:
    """Label, number of points, our kernel and the peers'."""
    import poselib

    spread = {size: _clean(f"room-{size}-0-0.1", seed) for size in SIZES}
    five1, five2 = (b[:5].copy() for b in spread[100])
    three1, three2 = (b[:3].copy() for b in spread[100])
    down = np.array([0.0, 1.0, 0.0])  # both cameras of PoseLib's solver are upright
    comparisons: list[tuple[str, int, Kernel, dict[str, Kernel]]] = [
        (
            "five-point",
            5,
            lambda: _core.five_point(five1, five2),
            {
                "poselib.relpose_5pt": lambda: poselib.relpose_5pt(five1, five2),
                "poselib.essential_matrix_5pt": lambda: poselib.essential_matrix_5pt(five1, five2),
            },
        ),
        (
            "upright three-point",
            3,
            lambda: _core.upright_three_point(three1, three2, down, down),
            {"poselib.relpose_upright_3pt": lambda: poselib.relpose_upright_3pt(three1, three2)},
        ),
    ]
    for size, (b1, b2) in spread.items():
        comparisons.append(
            (
                "eight-point",
                size,
                lambda b1=b1, b2=b2: _core.eight_point(b1, b2),
                {
                    "poselib.essential_matrix_8pt": (
                        lambda b1=b1, b2=b2: poselib.essential_matrix_8pt(b1, b2)
                    )
                },
            )
        )
    for size in SIZES:
        problem = make_problem(cell_from_name(f"cone-{size}-0-0.5"), 0, seed)
        comparisons.append(("refinement", size, _ours_refining(problem), _peers_refining(problem)))
    return comparisons


def _clean(name: str, seed: int) -> tuple[Array, Array]:
    problem = make_problem(cell_from_name(name), 0, seed)
    return np.ascontiguousarray(problem.bearings1), np.ascontiguousarray(problem.bearings2)


def _start(problem: Problem) -> Pose:
    """Truth, turned and pushed by the starting error."""
    rng = np.random.default_rng(problem.index)
    turn, push = np.radians(START_ERROR_DEG) * rng.normal(size=(2, 3)) / np.sqrt(3.0)
    t = problem.cam2_from_cam1.translation + push
    R = rotation_from_vector(turn) @ problem.cam2_from_cam1.rotation
    return Pose(R, t / np.linalg.norm(t))


def _ours_refining(problem: Problem) -> Kernel:
    start, b1, b2 = _start(problem), problem.bearings1, problem.bearings2
    return lambda: epi360.refine_pose(b1, b2, start, residual="sampson", loss="squared")


def _peers_refining(problem: Problem) -> dict[str, Kernel]:
    import poselib
    import pycolmap

    start, b1, b2 = _start(problem), problem.bearings1, problem.bearings2
    ours, camera, _ = pycolmap_camera(problem.cell)
    pixels1, pixels2 = ours.pixels_from_bearings(b1), ours.pixels_from_bearings(b2)
    rigid = pycolmap.Rigid3d(pycolmap.Rotation3d(start.rotation), start.translation)
    mask = np.ones(len(b1), dtype=np.bool_)

    front = (b1[:, 2] > 0.0) & (b2[:, 2] > 0.0)
    size = PANORAMA_WIDTH
    plane1, plane2 = (PINHOLE_FOCAL_PX * b[front, :2] / b[front, 2:] + size / 2 for b in (b1, b2))
    pinhole = {
        "model": "SIMPLE_PINHOLE",
        "width": size,
        "height": size,
        "params": [PINHOLE_FOCAL_PX, size / 2, size / 2],
    }
    pose = poselib.CameraPose()
    pose.R, pose.t = start.rotation, start.translation
    options = {"loss_type": "TRIVIAL"}
    return {
        "pycolmap.refine_relative_pose": lambda: pycolmap.refine_relative_pose(
            rigid, camera, pixels1, camera, pixels2, mask
        ),
        f"poselib.refine_relative_pose ({np.count_nonzero(front)} points in front)": (
            lambda: poselib.refine_relative_pose(plane1, plane2, pose, pinhole, pinhole, options)
        ),
    }


def _microseconds(kernels: dict[str, Kernel]) -> dict[str, float]:
    """Median over rounds of the mean time of a call, the kernels taking turns."""
    counts, means = {}, {name: [] for name in kernels}
    for name, kernel in kernels.items():
        kernel()
        start = time.perf_counter()
        kernel()
        counts[name] = max(1, int(ROUND_SECONDS / (time.perf_counter() - start)))
    for _ in range(NUM_ROUNDS):
        for name, kernel in kernels.items():
            start = time.perf_counter()
            for _ in range(counts[name]):
                kernel()
            means[name].append((time.perf_counter() - start) / counts[name])
    return {name: 1e6 * float(np.median(values)) for name, values in means.items()}
