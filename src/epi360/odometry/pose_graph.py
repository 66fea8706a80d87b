# SPDX-License-Identifier: BSD-3-Clause
"""Key frames held together by relative similarities: sparse least squares over all of them.

Strasdat, Montiel and Davison, "Scale Drift-Aware Large Scale Monocular SLAM" (RSS 2010): a loop is
closed in Sim(3), because a single camera's scale drifts as its position does.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from epi360.odometry.pose_graph_edges import (
    NUM_PARAMETERS,
    Edges,
    Nodes,
    edge_costs,
    edge_jacobians,
    edge_residuals,
    rotated,
)
from epi360.odometry.similarity import Similarity

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-6, 1e-14, 1e8
_RELATIVE_DECREASE = 1e-10  # of the cost: a step that gains less is the last


@dataclass(frozen=True, eq=False)
class PoseGraphEdge:
    """Measured similarity between two nodes.

    Attributes
    ----------
    i, j : int
        Nodes.
    j_from_i : Similarity
        Takes the frame of node i to that of node j. Between neighbours of an odometry its scale
        is one; that of a loop says how much the scale drifted meanwhile.
    information : ndarray, shape (7, 7), optional
        Inverse covariance of the residual: rotation (rad), translation (units of j), logarithm of
        the scale. Default: the identity.
    """

    i: int
    j: int
    j_from_i: Similarity
    information: Array | None = None


@dataclass(frozen=True, eq=False)
class PoseGraphResult:
    """Nodes after the adjustment.

    Attributes
    ----------
    node_from_world : list of Similarity
    residuals : ndarray, shape (E, 7)
        Residual of each edge: rotation (rad), translation, logarithm of the scale.
    edge_costs : ndarray, shape (E,)
        Residual squared, weighted by the information: chi-squared with 7 degrees of freedom where
        the information is right. An edge far above the others contradicts them.
    num_iterations : int
    converged : bool
    """

    node_from_world: list[Similarity]
    residuals: Array
    edge_costs: Array
    num_iterations: int
    converged: bool

    @property
    def cost(self) -> float:
        """Half the sum of the costs of all edges."""
        return 0.5 * float(self.edge_costs.sum())


def diagonal_information(
    rotation_sigma_rad: float, translation_sigma: float, log_scale_sigma: float
) -> Array:
    """Information (7, 7) of an edge whose errors are independent with these deviations."""
    sigmas = [rotation_sigma_rad] * 3 + [translation_sigma] * 3 + [log_scale_sigma]
    return np.diag(np.array(sigmas) ** -2.0)


def optimize_pose_graph(
    node_from_world: Sequence[Similarity],
    edges: Sequence[PoseGraphEdge],
    *,
    fixed: Collection[int] = (0,),
    max_iterations: int = 50,
) -> PoseGraphResult:
    """Nodes that agree best with the relative similarities between them.

    Parameters
    ----------
    node_from_world : sequence of Similarity
        Start of the search: poses of key frames with scale one.
    edges : sequence of PoseGraphEdge
    fixed : collection of int
        Nodes that stay as they are; at least one, which holds place, heading and scale.
    max_iterations : int

    Returns
    -------
    result : PoseGraphResult
        `Similarity.pose` of a node is the key frame's new pose. A point that key frame i refers to
        moves to ``new[i].inverse() @ old[i]`` of it: see `move_points`.

    Raises
    ------
    ValueError
        If no node is fixed, or a node or the shape of an information is wrong.

    Notes
    -----
    The residual of an edge with prediction p = node_j node_i^-1 and measurement m is
    (log(R_p R_m^T), t_p - t_m, log(s_p / s_m)), all in the frame of j: moving, turning or scaling
    the world changes no residual. Levenberg-Marquardt; a step multiplies each node from the left,
    so that a node turns and grows about its own camera.
    """
    num_nodes = len(node_from_world)
    measured = _checked_edges(edges, num_nodes)
    nodes = Nodes.of(node_from_world)
    if not num_nodes:
        return _result(nodes, measured, 0, True)
    free = _free_nodes(fixed, num_nodes, measured)
    if not np.any(free >= 0):
        return _result(nodes, measured, 0, True)
    system = _NormalEquations(measured, free)
    cost, damping = _cost(nodes, measured), _FIRST_DAMPING
    for iteration in range(max_iterations):
        gradient = system.assemble(nodes)
        while damping <= _LARGEST_DAMPING:
            moved = nodes.moved(system.step(gradient, damping))
            new_cost = _cost(moved, measured)
            if new_cost <= cost:
                break
            damping = 10.0 * max(damping, 1e-8)
        else:
            return _result(nodes, measured, iteration, True)  # no step gains: rounding is reached
        gain, nodes, cost = cost - new_cost, moved, new_cost
        damping = max(0.1 * damping, _LEAST_DAMPING)
        if gain <= _RELATIVE_DECREASE * new_cost or new_cost == 0.0:
            return _result(nodes, measured, iteration + 1, True)
    return _result(nodes, measured, max_iterations, False)


def move_points(
    points: Array, reference: Indices, before: Sequence[Similarity], after: Sequence[Similarity]
) -> Array:
    """Points (P, 3) that keep their place before the key frame (P,) that each refers to.

    ``before`` and ``after`` are the nodes ``cam_from_world`` of the pose graph; points that refer
    to none (a negative index) stay.
    """
    old, new = Nodes.of(before), Nodes.of(after)
    moved = np.array(points, dtype=np.float64)
    rows = np.flatnonzero(reference >= 0)
    k = np.asarray(reference)[rows]
    seen = old.scales[k, None] * rotated(old.rotations[k], moved[rows]) + old.translations[k]
    back = np.swapaxes(new.rotations[k], 1, 2)
    moved[rows] = rotated(back, seen - new.translations[k]) / new.scales[k, None]
    return moved


def _checked_edges(edges: Sequence[PoseGraphEdge], num_nodes: int) -> Edges:
    unit = np.eye(NUM_PARAMETERS)
    information = np.empty((len(edges), NUM_PARAMETERS, NUM_PARAMETERS))
    for row, edge in enumerate(edges):
        if not (0 <= edge.i < num_nodes and 0 <= edge.j < num_nodes) or edge.i == edge.j:
            raise ValueError(
                f"edges[{row}] must join two of {num_nodes} nodes, got {edge.i} and {edge.j}"
            )
        given = unit if edge.information is None else np.asarray(edge.information)
        if given.shape != unit.shape or not np.isfinite(given).all():
            raise ValueError(
                f"edges[{row}].information must be a finite 7x7 matrix, got shape {given.shape}"
            )
        information[row] = given
    return Edges(
        np.array([edge.i for edge in edges], dtype=np.intp),
        np.array([edge.j for edge in edges], dtype=np.intp),
        Nodes.of([edge.j_from_i for edge in edges]),
        information,
    )


def _free_nodes(fixed: Collection[int], num_nodes: int, edges: Edges) -> Indices:
    """Number of each node among the free ones, -1 for one that is fixed or held by no fixed one."""
    held = np.zeros(num_nodes, dtype=bool)
    for node in fixed:
        if not 0 <= node < num_nodes:
            raise ValueError(f"fixed must hold numbers of {num_nodes} nodes, got {node}")
        held[node] = True
    if not held.any():
        raise ValueError("fixed must hold at least one node: place and scale are free otherwise")
    joined = coo_matrix((np.ones(len(edges.i)), (edges.i, edges.j)), (num_nodes, num_nodes))
    _, part = connected_components(joined, directed=False)
    free = ~held & np.isin(part, part[held])
    return np.where(free, np.cumsum(free) - 1, -1)


class _NormalEquations:
    """Sparse normal equations of the free nodes, whose pattern is found once."""

    def __init__(self, edges: Edges, free: Indices) -> None:
        self.edges, self.free = edges, free
        self.num_free = int(free.max()) + 1
        ends = np.stack([free[edges.i], free[edges.j]])
        block = np.arange(NUM_PARAMETERS)
        self._rows, self._columns, self._kept = [], [], []
        for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
            kept = (ends[a] >= 0) & (ends[b] >= 0)
            rows = NUM_PARAMETERS * ends[a, kept, None, None] + block[:, None]
            columns = NUM_PARAMETERS * ends[b, kept, None, None] + block
            rows, columns = np.broadcast_arrays(rows, columns)
            self._rows.append(rows.ravel())
            self._columns.append(columns.ravel())
            self._kept.append(kept)

    def assemble(self, nodes: Nodes) -> Array:
        """Set the matrix up at the nodes and return the gradient of the free ones."""
        by = edge_jacobians(nodes, self.edges)
        weighted = [np.swapaxes(one, 1, 2) @ self.edges.information for one in by]
        pairs = ((0, 0), (0, 1), (1, 0), (1, 1))
        blocks = [
            (weighted[a] @ by[b])[kept].ravel()
            for (a, b), kept in zip(pairs, self._kept, strict=True)
        ]
        size = NUM_PARAMETERS * self.num_free
        where = (np.concatenate(self._rows), np.concatenate(self._columns))
        self._matrix = csc_matrix((np.concatenate(blocks), where), (size, size))
        residuals = edge_residuals(nodes, self.edges)[:, :, None]
        gradient = np.zeros((self.num_free + 1, NUM_PARAMETERS))  # the last row: fixed nodes
        for end, part in zip((self.edges.i, self.edges.j), weighted, strict=True):
            np.add.at(gradient, self.free[end], (part @ residuals)[:, :, 0])
        return gradient[:-1]

    def step(self, gradient: Array, damping: float) -> Array:
        """Damped step (F, 7) of all nodes; the others do not move."""
        matrix = self._matrix.copy()
        matrix.setdiag((1.0 + damping) * matrix.diagonal())
        steps = np.zeros((len(self.free), NUM_PARAMETERS))
        # The pattern is symmetric: minimum degree of A^T + A fills in least.
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        steps[self.free >= 0] = -factors.solve(gradient.ravel()).reshape(-1, NUM_PARAMETERS)
        return steps


def _cost(nodes: Nodes, edges: Edges) -> float:
    return 0.5 * float(edge_costs(edge_residuals(nodes, edges), edges).sum())


def _result(nodes: Nodes, edges: Edges, num_iterations: int, converged: bool) -> PoseGraphResult:
    rows = zip(nodes.scales, nodes.rotations, nodes.translations, strict=True)
    residuals = edge_residuals(nodes, edges)
    return PoseGraphResult(
        [Similarity(float(scale), rotation, shift) for scale, rotation, shift in rows],
        residuals,
        edge_costs(residuals, edges),
        num_iterations,
        converged,
    )
