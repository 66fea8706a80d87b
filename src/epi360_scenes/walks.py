# SPDX-License-Identifier: BSD-3-Clause
"""Where a person can walk in a scene, and a way between random places there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CELL_M = 0.1
# Furniture at these heights is in the way of the body that carries the camera.
BODY_HEIGHTS_M = (0.4, 0.8, 1.1)
BODY_RADIUS_M = 0.2
# More than the camera bobs and sways, and more than its height changes; cells are coarse.
MARGIN_M = 0.12
HEIGHT_MARGIN_M = 0.25


def plan_walk(
    rng: np.random.Generator,
    distances: Callable[[Floats], Floats],
    bounds: Floats,
    length_m: float,
    height_m: float,
    clearance_m: float,
    *,
    loop: bool = False,
) -> Floats:
    """Way between random places of a scene, at least as long as asked for, in free space.

    A loop goes back to its start as soon as that makes it long enough.
    """
    grid = _Grid(distances, bounds, height_m, clearance_m)
    here = int(rng.choice(grid.connected))
    cells, walked = [here], 0.0
    # A third more than asked for, because smoothing cuts corners.
    while walked < 1.35 * length_m + 1.0:
        goal = grid.far_place(rng, here, 0.4 * length_m if loop else np.inf)
        way = grid.way(here, goal)
        cells += way[1:]
        walked += float(np.linalg.norm(np.diff(grid.centers[way], axis=0), axis=1).sum())
        here = goal
        if loop and walked + grid.distance(here, cells[0]) >= length_m:
            cells += grid.way(here, cells[0])[1:]
            break
    corners: Floats = grid.centers[cells]
    return corners


class _Grid:
    """Cells of a floor plan; those that a person can stand in are connected."""

    def __init__(
        self,
        distances: Callable[[Floats], Floats],
        bounds: Floats,
        height_m: float,
        clearance_m: float,
    ) -> None:
        from scipy.sparse.csgraph import connected_components

        low, high = bounds
        x, z = (np.arange(low[k] + CELL_M / 2, high[k], CELL_M) for k in (0, 2))
        plan = np.array(np.meshgrid(x, z, indexing="ij"))
        self.shape = plan.shape[1:]
        flat = plan.reshape(2, -1)
        floor = high[1]
        self.centers = np.stack([flat[0], np.full(len(flat[0]), floor - height_m), flat[1]], axis=1)
        self.room = _free_room(distances, self.centers, height_m, clearance_m)
        free = self.room >= 0.0
        self.graph = self._graph(free)
        _, labels = connected_components(self.graph, directed=False)
        labels = np.where(free, labels, -1)
        largest = np.argmax(np.bincount(labels[free])) if free.any() else -2
        self.connected = np.flatnonzero(labels == largest)
        if len(self.connected) < 2:
            raise ValueError(
                f"the scene has no place to walk {height_m} m over its floor with a clearance of "
                f"{clearance_m} m; use another height or a smaller clearance"
            )

    def _graph(self, free: NDArray[np.bool_]) -> Any:
        """Sparse matrix of the costs of steps between neighbour cells, larger near furniture."""
        from scipy.sparse import csr_matrix

        index = np.arange(free.size).reshape(self.shape)
        rows, columns = [], []
        for dx, dz in ((1, 0), (0, 1), (1, 1), (1, -1)):
            a = index[: self.shape[0] - dx, max(0, -dz) : self.shape[1] - max(0, dz)]
            b = index[dx:, max(0, dz) : self.shape[1] - max(0, -dz)]
            rows.append(a.ravel())
            columns.append(b.ravel())
        a, b = np.concatenate(rows), np.concatenate(columns)
        keep = free[a] & free[b]
        a, b = a[keep], b[keep]
        steps = np.linalg.norm(self.centers[a] - self.centers[b], axis=1)
        tightness = 1.0 / (0.1 + np.minimum(self.room[a], self.room[b]))
        return csr_matrix((steps * tightness, (a, b)), shape=(free.size, free.size))

    def far_place(self, rng: np.random.Generator, here: int, within_m: float = np.inf) -> int:
        """Pick a random cell that is likely to be far away, but not farther than this."""
        places = rng.choice(self.connected, 4 if within_m == np.inf else 32)
        far = np.linalg.norm(self.centers[places] - self.centers[here], axis=1)
        if far.min() > within_m:
            return int(places[np.argmin(far)])
        return int(places[np.argmax(np.where(far <= within_m, far, -1.0))])

    def distance(self, start: int, goal: int) -> float:
        """Length of the cheapest way."""
        way = self.centers[self.way(start, goal)]
        return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())

    def way(self, start: int, goal: int) -> list[int]:
        """Cells of the cheapest way, both ends included."""
        from scipy.sparse.csgraph import dijkstra

        _, before = dijkstra(self.graph, directed=False, indices=start, return_predecessors=True)
        cells = [goal]
        while cells[-1] != start:
            cells.append(int(before[cells[-1]]))
        return cells[::-1]


def _free_room(
    distances: Callable[[Floats], Floats], centers: Floats, height_m: float, clearance_m: float
) -> Floats:
    """Distance at each place beyond what the camera and its bearer need."""
    needs = [(height_m, clearance_m + MARGIN_M)]
    needs += [(height_m + k * HEIGHT_MARGIN_M, clearance_m + MARGIN_M) for k in (-1, 1)]
    needs += [(height, BODY_RADIUS_M) for height in BODY_HEIGHTS_M if height < height_m - 0.3]
    room = np.full(len(centers), np.inf)
    for height, need in needs:
        left = np.flatnonzero(room >= 0.0)
        points = centers[left] + np.array([0.0, height_m - height, 0.0])
        room[left] = np.minimum(room[left], distances(points) - need)
    return room
