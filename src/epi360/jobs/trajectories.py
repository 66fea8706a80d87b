# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories of files, which of their frames are the same, and how one is laid on another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from epi360.image_folders import natural_order
from epi360.interop.convert import read_reconstruction
from epi360.interop.formats import FORMATS, format_of_file
from epi360.poses import Pose
from epi360.runs.whole_files import PathLike

Floats = NDArray[np.float64]
Alignment = Literal["sim3", "se3", "none"]


@dataclass(frozen=True, eq=False)
class PosedFrames:
    """Poses in the order in which they were taken; ``times_s`` is None if none are known."""

    names: tuple[str, ...]
    times_s: Floats | None  # (N,)
    rotations: Floats  # (N, 3, 3) of world_from_cam
    positions: Floats  # (N, 3)

    def __len__(self) -> int:
        return len(self.names)

    def rows(self, indices: NDArray[np.intp]) -> PosedFrames:
        """Some of the frames."""
        return PosedFrames(
            tuple(self.names[index] for index in indices),
            None if self.times_s is None else self.times_s[indices],
            self.rotations[indices],
            self.positions[indices],
        )

    def path_length(self) -> float:
        """Length of the way from the first position to the last."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())


@dataclass(frozen=True, eq=False)
class Similarity:
    """World of the truth from that of the estimate: ``x -> scale * rotation @ x + translation``."""

    scale: float
    rotation: Floats
    translation: Floats

    def of(self, frames: PosedFrames) -> PosedFrames:
        """Frames in the other world."""
        positions = self.scale * frames.positions @ self.rotation.T + self.translation
        return PosedFrames(
            frames.names, frames.times_s, self.rotation @ frames.rotations, positions
        )


def read_trajectory(
    path: PathLike, times_of: Mapping[str, float | None] | None = None
) -> PosedFrames:
    """Poses of a TUM trajectory, a COLMAP model or another reconstruction, in order.

    ``times_of`` gives names their times, where the file has none. Images without a pose are left
    out.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If it holds no poses, or is damaged.
    """
    kind = format_of_file(path)
    if FORMATS[kind].kind != "reconstruction":
        raise ValueError(
            f"{path} holds matches, expected poses: a TUM trajectory or a COLMAP model"
        )
    images = [
        image
        for image in read_reconstruction(path, kind).images
        if np.isfinite(image.cam_from_world.matrix()).all()
    ]
    if not images:
        raise ValueError(f"{path} holds no pose")
    known = times_of or {}
    times = [
        image.timestamp_s if image.timestamp_s is not None else known.get(image.name)
        for image in images
    ]
    if all(time is not None for time in times):
        order = np.argsort(np.array(times, dtype=np.float64), kind="stable")
        stamps = np.array(times, dtype=np.float64)[order]
    else:
        order = np.array(sorted(range(len(images)), key=lambda k: _name_order(images[k].name)))
        stamps = None
    poses = [images[index].cam_from_world.inverse() for index in order]
    return posed_frames([images[index].name for index in order], stamps, poses)


def _name_order(name: str) -> list[Any]:
    """Sort key of a name: folder by folder, digits as numbers."""
    return [natural_order(Path(part)) for part in name.split("/")]


def posed_frames(
    names: list[str], times_s: Floats | None, world_from_cam: list[Pose]
) -> PosedFrames:
    """Frames of these poses, which are in order."""
    return PosedFrames(
        tuple(names),
        times_s,
        np.array([pose.rotation for pose in world_from_cam]).reshape(-1, 3, 3),
        np.array([pose.translation for pose in world_from_cam]).reshape(-1, 3),
    )


def matching_frames(
    estimate: PosedFrames, truth: PosedFrames, max_gap_s: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows of the estimate and of the truth that are the same frame, in the order of the truth.

    Times are compared where both have them: each frame is the nearest of the other, and not farther
    than ``max_gap_s``. Otherwise names are compared, as they are, then without folders and
    extensions.
    """
    if estimate.times_s is not None and truth.times_s is not None:
        return _matching_times(estimate.times_s, truth.times_s, max_gap_s)
    for key in (str, lambda name: Path(name).stem):
        rows = {key(name): row for row, name in enumerate(estimate.names)}
        pairs = [
            (rows[key(name)], row) for row, name in enumerate(truth.names) if key(name) in rows
        ]
        if pairs:
            break
    table = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _matching_times(
    estimate: Floats, truth: Floats, max_gap_s: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    nearest, back = _nearest(estimate, truth), _nearest(truth, estimate)
    rows = np.arange(len(truth))
    close = np.abs(estimate[nearest] - truth) <= max_gap_s
    keep = close & (back[nearest] == rows)
    return nearest[keep], rows[keep]


def _nearest(sorted_times: Floats, wanted: Floats) -> NDArray[np.intp]:
    """Row of the nearest of some sorted times to each of others."""
    after = np.clip(np.searchsorted(sorted_times, wanted), 1, max(len(sorted_times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(sorted_times) - 1)
    is_before = np.abs(sorted_times[before] - wanted) <= np.abs(sorted_times[after] - wanted)
    return np.where(is_before, before, after)


def align(estimate: Floats, truth: Floats, how: Alignment) -> Similarity:
    """Least-squares transform of positions (N, 3) to others (Umeyama, PAMI 1991).

    Raises
    ------
    ValueError
        If there are fewer than three positions, or the estimate does not move and has no scale.
    """
    if how == "none":
        return Similarity(1.0, np.eye(3), np.zeros(3))
    if len(truth) < 3:
        raise ValueError(f"an alignment needs 3 frames that both have, got {len(truth)}")
    mean_estimate, mean_truth = estimate.mean(axis=0), truth.mean(axis=0)
    from_estimate, from_truth = estimate - mean_estimate, truth - mean_truth
    u, values, vt = np.linalg.svd(from_truth.T @ from_estimate)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = u * signs @ vt
    scale = 1.0
    if how == "sim3":
        spread = float((from_estimate**2).sum())
        if spread <= 1e-24 * max(float((mean_estimate**2).sum()), 1e-300):
            raise ValueError("the estimate stays in one place: it has no scale; use --align se3")
        scale = float(values @ signs) / spread
    return Similarity(scale, rotation, mean_truth - scale * rotation @ mean_estimate)
