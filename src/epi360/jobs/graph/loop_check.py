# SPDX-License-Identifier: BSD-3-Clause
"""Which poses of pairs contradict each other: a check that two views alone cannot make.

The poses of three pairs of three images must agree: R13 = R23 R12, and t13 = a R23 t12 + b t23
with a, b > 0. Zach, Klopschitz and Pollefeys (CVPR 2010, "Disambiguating visual relations using
loop constraints") find wrong pairs by such loops; here every triangle votes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.jobs.records.match_store import Verdict
from epi360.poses import angles_between

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# A triangle that misses by more is open. Right triangles of a real tour miss by up to 2.5 degrees,
# six times their sigma, if the inliers cover a small part of the sphere.
_SIGMAS = 4.0
_FLOOR_DEG = 1.0
_BLOCK = 1 << 18  # triangles at a time: 100 MB


@dataclass(frozen=True)
class LoopVerdict:
    """What the triangles of a pair say about it.

    ``num_triangles`` are those with two other accepted pairs that are not contradicted themselves,
    ``num_contradicted`` those of them that do not close. If the pair is the worst of those that
    could be to blame, it is ``contradicted``: it is wrong. ``contradicted_by`` names the pairs in
    the triangles that say so.
    """

    num_triangles: int = 0
    num_contradicted: int = 0
    contradicted: bool = False
    contradicted_by: tuple[tuple[str, str], ...] = ()

    @property
    def doubtful(self) -> bool:
        """Most triangles do not close, but another pair in them may be the wrong one."""
        return not self.contradicted and 2 * self.num_contradicted > self.num_triangles


def check_loops(
    pairs: Sequence[tuple[str, str]], verdicts: Sequence[Verdict]
) -> tuple[LoopVerdict, ...]:
    """Look for accepted pairs whose poses other accepted pairs contradict.

    ``pairs`` are the names of both images, each two images at most once. Nothing is said about
    pairs that are not accepted, or that are in no triangle. Neither the order of the pairs matters
    nor that of the images in a pair.

    A triangle closes within four sigma of its poses and one degree. For a pair with c triangles
    that close and o that are open, (o + 1) / (o + c + 2) is the chance that the next one is open,
    by the rule of succession. A pair is contradicted if o > c, no other pair has a greater chance
    in any of its open triangles, and in one of them both others have a smaller one. Triangles with
    it then do not count any more, and the rest is looked at again. So one open triangle by itself
    contradicts nothing, and pairs that are wrong in the same way support each other.
    """
    _check_pairs(pairs, verdicts)
    used = [row for row, verdict in enumerate(verdicts) if _is_usable(verdict)]
    loops = [LoopVerdict()] * len(verdicts)
    if not used:
        return tuple(loops)
    ends, poses = _ordered_poses([pairs[row] for row in used], [verdicts[row] for row in used])
    blocks = [(block, _closes(poses, block)) for block in _triangles(ends)]
    triangles = np.concatenate([block for block, _ in blocks])
    closed = np.concatenate([mask for _, mask in blocks])
    wrong = _contradicted(triangles, closed, len(used))
    num_closed, num_open = _votes(triangles, closed, ~wrong)
    witnesses = _witnesses(triangles[~closed], wrong)
    for position, row in enumerate(used):
        count, contradicted = int(num_open[position]), bool(wrong[position])
        loops[row] = LoopVerdict(
            int(num_closed[position]) + count,
            count,
            contradicted,
            tuple(pairs[used[other]] for other in sorted(witnesses.get(position, ()))),
        )
    return tuple(loops)


@dataclass(frozen=True, eq=False)
class _Poses:
    """Poses from the first to the last image of each pair; their sigmas in degrees."""

    rotations: Array  # (M, 3, 3)
    translations: Array  # (M, 3)
    rotation_sigmas: Array  # (M,)
    translation_sigmas: Array


def _check_pairs(pairs: Sequence[tuple[str, str]], verdicts: Sequence[Verdict]) -> None:
    if len(pairs) != len(verdicts):
        raise ValueError(f"each pair needs a verdict, got {len(pairs)} and {len(verdicts)}")
    distinct = {frozenset(pair) for pair in pairs}
    if len(distinct) < len(pairs) or any(len(pair) < 2 for pair in distinct):
        raise ValueError("each pair must name two images, and no two images may be paired twice")


def _is_usable(verdict: Verdict) -> bool:
    sigmas = (verdict.rotation_sigma_deg, verdict.translation_sigma_deg)
    return verdict.accepted and bool(np.isfinite(sigmas).all())


def _ordered_poses(
    pairs: Sequence[tuple[str, str]], verdicts: Sequence[Verdict]
) -> tuple[Indices, _Poses]:
    """Images of each pair by rank, the smaller first, and the poses in that direction."""
    ranks = {name: rank for rank, name in enumerate(sorted({name for p in pairs for name in p}))}
    ends = np.array([(ranks[name1], ranks[name2]) for name1, name2 in pairs])
    poses = [
        verdict.cam2_from_cam1 if first < last else verdict.cam2_from_cam1.inverse()
        for (first, last), verdict in zip(ends, verdicts, strict=True)
    ]
    return np.sort(ends, axis=1), _Poses(
        np.array([pose.rotation for pose in poses]),
        np.array([pose.translation for pose in poses]),
        np.array([verdict.rotation_sigma_deg for verdict in verdicts]),
        np.array([verdict.translation_sigma_deg for verdict in verdicts]),
    )


def _triangles(ends: Indices) -> Iterator[NDArray[np.int32]]:
    """Pairs 12, 23 and 13 of all triangles of images 1 < 2 < 3, in blocks of shape (T, 3)."""
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    first, last = ends[order].T
    num_images = int(last.max()) + 1
    keys = first * num_images + last
    starts = np.searchsorted(first, np.arange(num_images + 1))
    num_next = (starts[1:] - starts[:-1])[last]  # pairs that start where each pair ends
    cuts = np.flatnonzero(np.diff(np.cumsum(num_next) // _BLOCK)) + 1
    for some in np.split(np.arange(len(ends)), cuts):
        pairs12 = np.repeat(some, num_next[some])
        skipped = np.cumsum(num_next[some]) - num_next[some]
        rank = np.arange(len(pairs12)) - np.repeat(skipped, num_next[some])
        pairs23 = starts[last[pairs12]] + rank
        wanted = first[pairs12] * num_images + last[pairs23]
        pairs13 = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        triangles = np.column_stack([pairs12, pairs23, pairs13])[keys[pairs13] == wanted]
        yield order[triangles].astype(np.int32)


def _closes(poses: _Poses, triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Whether the poses of each triangle agree, shape (T,)."""
    R12, R23, R13 = np.moveaxis(poses.rotations[triangles], 1, 0)
    t12, t23, t13 = np.moveaxis(poses.translations[triangles], 1, 0)
    turned12 = np.einsum("nij,nj->ni", R23, t12)
    rotation_variance = (poses.rotation_sigmas[triangles] ** 2).sum(axis=1)
    translation_variance = (poses.translation_sigmas[triangles] ** 2).sum(axis=1)
    rotation_limit = _FLOOR_DEG + _SIGMAS * np.sqrt(rotation_variance)
    direction_limit = _FLOOR_DEG + _SIGMAS * np.sqrt(rotation_variance + translation_variance)
    is_closed: NDArray[np.bool_] = (_rotation_angles_deg(R13, R23 @ R12) <= rotation_limit) & (
        _direction_gaps_deg(turned12, t23, -t13) <= direction_limit
    )
    return is_closed


def _rotation_angles_deg(a: Array, b: Array) -> Array:
    """Angles between rotations, shape (T,)."""
    difference = np.swapaxes(a, 1, 2) @ b
    twice_sine = np.linalg.norm(
        (difference - np.swapaxes(difference, 1, 2))[:, [2, 0, 1], [1, 2, 0]], axis=1
    )
    twice_cosine = np.trace(difference, axis1=1, axis2=2) - 1.0
    angles: Array = np.degrees(np.arctan2(twice_sine, twice_cosine))
    return angles


def _direction_gaps_deg(u: Array, v: Array, w: Array) -> Array:
    """Least angle to turn one of three directions by, for positive multiples of them to add to 0.

    Which one is free: where two are opposite, as in a walk there and back, the third can be any.
    """
    gaps = [_angles_to_arc(-w, u, v), _angles_to_arc(-u, v, w), _angles_to_arc(-v, w, u)]
    least: Array = np.degrees(np.minimum.reduce(gaps))
    return least


def _angles_to_arc(points: Array, start: Array, end: Array) -> Array:
    """Angle from each point to the shorter great circle arc between two directions, radians."""
    normal = np.cross(start, end)
    is_beside = (_dot(np.cross(normal, start), points) > 0) & (
        _dot(np.cross(end, normal), points) > 0
    )
    across = np.arctan2(
        np.abs(_dot(normal, points)), np.linalg.norm(np.cross(normal, points), axis=1)
    )
    to_ends = np.minimum(angles_between(points, start), angles_between(points, end))
    angles: Array = np.where(is_beside, across, to_ends)
    return angles


def _dot(a: Array, b: Array) -> Array:
    products: Array = np.einsum("ni,ni->n", a, b)
    return products


def _contradicted(
    triangles: NDArray[np.int32], closed: NDArray[np.bool_], num_pairs: int
) -> NDArray[np.bool_]:
    """Pairs that the rule of `check_loops` finds, shape (M,)."""
    wrong = np.zeros(num_pairs, dtype=bool)
    while True:
        counts = ~wrong[triangles].any(axis=1)
        triangles, closed = triangles[counts], closed[counts]
        opened = triangles[~closed]
        num_closed = np.bincount(triangles[closed].ravel(), minlength=num_pairs)
        num_open = np.bincount(opened.ravel(), minlength=num_pairs)
        chance = ((num_open + 1) / (num_open + num_closed + 2))[opened]  # (T, 3)
        is_worst = chance == chance.max(axis=1, keepdims=True, initial=0.0)
        is_alone = is_worst & (is_worst.sum(axis=1, keepdims=True) == 1)
        found = np.zeros(num_pairs, dtype=bool)
        found[opened[is_alone]] = True
        found[opened[~is_worst]] = False
        found &= num_open > num_closed
        if not found.any():
            return wrong
        wrong |= found


def _votes(
    triangles: NDArray[np.int32], closed: NDArray[np.bool_], trusted: NDArray[np.bool_]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Triangles of each pair with two trusted others that close, and that are open."""
    num_pairs = len(trusted)
    num_closed, num_open = np.zeros(num_pairs, dtype=int), np.zeros(num_pairs, dtype=int)
    is_trusted = trusted[triangles]
    for corner in range(3):
        counts = np.delete(is_trusted, corner, axis=1).all(axis=1)
        pairs = triangles[:, corner]
        num_closed += np.bincount(pairs[counts & closed], minlength=num_pairs)
        num_open += np.bincount(pairs[counts & ~closed], minlength=num_pairs)
    return num_closed, num_open


def _witnesses(opened: NDArray[np.int32], wrong: NDArray[np.bool_]) -> dict[int, set[int]]:
    """Trusted pairs in the open triangles of each wrong one."""
    found: dict[int, set[int]] = {}
    for triangle in opened[wrong[opened].sum(axis=1) == 1].tolist():
        (blamed,) = (pair for pair in triangle if wrong[pair])
        found.setdefault(blamed, set()).update(pair for pair in triangle if pair != blamed)
    return found
