# SPDX-License-Identifier: BSD-3-Clause
"""Residuals of a pose graph's edges and their derivatives, for all edges at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from epi360.odometry.similarity import Similarity

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

# Rotation vector, translation, logarithm of the scale.
NUM_PARAMETERS = 7


@dataclass(frozen=True)
class Nodes:
    """Similarities node_from_world as arrays."""

    scales: Array
    rotations: Array
    translations: Array

    @classmethod
    def of(cls, similarities: Sequence[Similarity]) -> Nodes:
        """Return the arrays of a sequence."""
        return cls(
            np.array([one.scale for one in similarities]),
            np.array([one.rotation for one in similarities]).reshape(-1, 3, 3),
            np.array([one.translation for one in similarities]).reshape(-1, 3),
        )

    def moved(self, steps: Array) -> Nodes:
        """Each node multiplied from the left by a small similarity, steps (F, 7)."""
        turns = Rotation.from_rotvec(steps[:, :3]).as_matrix()
        growth = np.exp(np.clip(steps[:, 6], -50.0, 50.0))
        rotations = self.rotations.copy()
        moving = steps.any(axis=1)  # fixed nodes keep every bit
        rotations[moving] = _orthonormal((turns @ self.rotations)[moving])
        translations = growth[:, None] * rotated(turns, self.translations) + steps[:, 3:6]
        return Nodes(growth * self.scales, rotations, translations)


@dataclass(frozen=True)
class Edges:
    """Edges of a pose graph as arrays; ``measured`` are the j_from_i."""

    i: Indices
    j: Indices
    measured: Nodes
    information: Array  # (E, 7, 7)


def edge_residuals(nodes: Nodes, edges: Edges) -> Array:
    """Residuals (E, 7): see the notes of `optimize_pose_graph`."""
    if not len(edges.i):  # older versions of SciPy know no empty stack of rotations
        return np.zeros((0, NUM_PARAMETERS))
    predicted, m = _predicted(nodes, edges), edges.measured
    turns = predicted.rotations @ np.swapaxes(m.rotations, 1, 2)
    rotation = Rotation.from_matrix(turns).as_rotvec()
    scale = np.log(predicted.scales / m.scales)
    return np.column_stack([rotation, predicted.translations - m.translations, scale])


def edge_jacobians(nodes: Nodes, edges: Edges) -> tuple[Array, Array]:
    """Derivatives (E, 7, 7) of the residuals by the steps of node i and of node j."""
    predicted = _predicted(nodes, edges)
    rotation = edge_residuals(nodes, edges)[:, :3]
    by_i = np.zeros((len(edges.i), NUM_PARAMETERS, NUM_PARAMETERS))
    by_j = np.zeros_like(by_i)
    by_i[:, :3, :3] = -_inverse_left_jacobian(-rotation) @ edges.measured.rotations
    by_i[:, 3:6, 3:6] = -predicted.scales[:, None, None] * predicted.rotations
    by_i[:, 6, 6] = -1.0
    by_j[:, :3, :3] = _inverse_left_jacobian(rotation)
    by_j[:, 3:6, :3] = -_cross_matrices(predicted.translations)
    by_j[:, 3:6, 3:6] = np.eye(3)
    by_j[:, 3:6, 6] = predicted.translations
    by_j[:, 6, 6] = 1.0
    return by_i, by_j


def _predicted(nodes: Nodes, edges: Edges) -> Nodes:
    """Similarities j_from_i that the nodes say."""
    i, j = edges.i, edges.j
    scales = nodes.scales[j] / nodes.scales[i]
    rotations = nodes.rotations[j] @ np.swapaxes(nodes.rotations[i], 1, 2)
    shifted = scales[:, None] * rotated(rotations, nodes.translations[i])
    return Nodes(scales, rotations, nodes.translations[j] - shifted)


def edge_costs(residuals: Array, edges: Edges) -> Array:
    """Squared residuals (E,) weighted by the information."""
    return np.asarray(np.einsum("ea,eab,eb->e", residuals, edges.information, residuals))


def rotated(rotations: Array, points: Array) -> Array:
    """Each point (N, 3) turned by its rotation (N, 3, 3)."""
    return np.asarray((rotations @ points[:, :, None])[:, :, 0])


def _orthonormal(rotations: Array) -> Array:
    """Rotations again after rounding: one Newton step towards the nearest rotation."""
    gram = np.swapaxes(rotations, 1, 2) @ rotations
    return np.asarray(rotations @ (1.5 * np.eye(3) - 0.5 * gram))


def _cross_matrices(vectors: Array) -> Array:
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), 2, 0)


def _inverse_left_jacobian(vectors: Array) -> Array:
    """Derivative of log(exp(d) exp(v)) by d at zero, for rotation vectors (E, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    half = 0.5 * np.maximum(angle, 1e-4)
    exact = (1.0 - half / np.tan(half)) / (4.0 * half**2)
    factor = np.where(angle > 1e-3, exact, 1.0 / 12.0 + angle**2 / 720.0)
    cross = _cross_matrices(vectors)
    return np.asarray(np.eye(3) - 0.5 * cross + factor[:, None, None] * (cross @ cross))
