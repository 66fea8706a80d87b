# SPDX-License-Identifier: BSD-3-Clause
"""Runs methods on problems: one problem after the other, all methods in turn on each."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from functools import cache
from itertools import islice

import _one_thread  # noqa: F401 - before NumPy
import cv2
import numpy as np
from _two_view_answer import Answer, errors_deg, normalised_squared_error
from _two_view_methods import METHODS
from _two_view_problems import Cell, Problem, cell_from_name, make_problem
from _two_view_records import RawTable, Row

# A method whose median is above a second a pair in a cell gets no more than five problems of it.
SLOW_SECONDS, SLOW_PROBLEMS = 1.0, 5
# A method that is known to be slow everywhere gets only these cells.
SLOW_METHODS = ("panorai",)
SLOW_METHOD_CELLS = (
    "room-400-20-0.1",
    "room-400-50-0.1",
    "room-400-50-k500",
    "cone-400-30-k500",
    "plane-400-30-0.5",
)


@dataclass(frozen=True)
class Plan:
    """What is to be run."""

    cells: Sequence[Cell]
    methods: Sequence[str]
    num_problems: int
    seed: int


def run(plan: Plan, table: RawTable, *, jobs: int) -> Iterator[int]:
    """Fill the table; yields the number of finished problems after each.

    The first problem of every cell comes first, then the second of every cell: a stopped run has
    figures of all cells, and a busy hour of the machine is spread over them.
    """
    tasks = _tasks(plan, table)
    done = 0
    if jobs == 1:
        for cell, index, methods in tasks:
            table.append(solve_problem(cell, index, plan.seed, methods))
            yield (done := done + 1)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        pending: set[Future[list[Row]]] = set()
        while True:
            for cell, index, methods in islice(tasks, 2 * jobs - len(pending)):
                pending.add(pool.submit(solve_problem, cell, index, plan.seed, methods))
            if not pending:
                return
            finished, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in finished:
                table.append(future.result())
                yield (done := done + 1)


def _tasks(plan: Plan, table: RawTable) -> Iterator[tuple[Cell, int, list[str]]]:
    """Problems with the methods that have not run on them, and are not too slow for them."""
    for index in range(plan.num_problems):
        for cell in plan.cells:
            methods = [
                name
                for name in plan.methods
                if (cell.name, index, name) not in table.rows and _may_run(cell, index, name, table)
            ]
            if methods:
                yield cell, index, methods


def _may_run(cell: Cell, index: int, method: str, table: RawTable) -> bool:
    if method in SLOW_METHODS and cell.name not in SLOW_METHOD_CELLS:
        return False
    if index < SLOW_PROBLEMS:
        return True
    first = [(cell.name, number, method) for number in range(SLOW_PROBLEMS)]
    seconds = [table.rows[key].seconds for key in first if key in table.rows]
    return bool(not seconds or np.median(seconds) <= SLOW_SECONDS)


def solve_problem(cell: Cell, index: int, seed: int, methods: Sequence[str]) -> list[Row]:
    """Rows of one problem; the method that goes first changes from problem to problem."""
    _warm_up(tuple(methods))
    problem = make_problem(cell, index, seed)
    first = index % len(methods)
    return [_measure(problem, name) for name in (*methods[first:], *methods[:first])]


@cache
def _warm_up(methods: tuple[str, ...]) -> None:
    """Run all methods once in this process, which pays for imports and first allocations."""
    cv2.setNumThreads(1)
    problem = make_problem(cell_from_name("room-100-20-0.5"), 0, 0)
    for name in methods:
        if name not in SLOW_METHODS:
            METHODS[name](problem)()


def _measure(problem: Problem, method: str) -> Row:
    solve = METHODS[method](problem)
    cpu_start, start = time.process_time(), time.perf_counter()
    answer = solve()
    seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
    rotation, translation = errors_deg(answer.cam2_from_cam1, problem.cam2_from_cam1)
    return Row(
        cell=problem.cell.name,
        problem=problem.index,
        method=method,
        rotation_error_deg=rotation,
        translation_error_deg=translation,
        best_error_deg=_best_error(answer, problem),
        accepted=answer.accepted,
        has_warnings=answer.has_warnings,
        status=answer.status,
        normalised_squared_error=normalised_squared_error(answer, problem.cam2_from_cam1),
        seconds=seconds,
        cpu_seconds=cpu_seconds,
    )


def _best_error(answer: Answer, problem: Problem) -> float:
    """Least of the larger errors of the pose and its alternatives; infinite without any."""
    worst = []
    for pose in (answer.cam2_from_cam1, *answer.alternatives):
        rotation, translation = errors_deg(pose, problem.cam2_from_cam1)
        error = max(rotation, translation) if problem.cell.has_direction else rotation
        worst.append(np.inf if np.isnan([rotation, error]).any() else error)
    return float(min(worst))
