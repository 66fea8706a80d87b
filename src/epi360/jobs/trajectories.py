# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories of files, which of their frames are the same, and how one is laid on another."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from epi360.image_folders import natural_order
from epi360.interop.convert import read_reconstruction
from epi360.interop.formats import FORMATS, format_of_file
from epi360.interop.reconstruction import PosedImage
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
    has_names: bool = True  # False for a TUM trajectory, whose names are its times as text

    def __len__(self) -> int:
        return len(self.names)

    def rows(self, indices: NDArray[np.intp]) -> PosedFrames:
        """Some of the frames."""
        return PosedFrames(
            tuple(self.names[index] for index in indices),
            None if self.times_s is None else self.times_s[indices],
            self.rotations[indices],
            self.positions[indices],
            self.has_names,
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

    def apply(self, positions: Floats) -> Floats:
        """Positions (N, 3) in the other world."""
        return np.asarray(self.scale * positions @ self.rotation.T + self.translation)

    def of(self, frames: PosedFrames) -> PosedFrames:
        """Frames in the other world."""
        positions = self.apply(frames.positions)
        return replace(frames, rotations=self.rotation @ frames.rotations, positions=positions)


def read_trajectory(
    path: PathLike, times_of: Mapping[str, float | None] | None = None
) -> PosedFrames:
    """Poses of a TUM trajectory, a COLMAP model or another reconstruction, in order.

    ``times_of`` gives names their times, where the file has none; it gives all images of a folder a
    time or none, and of several cameras that of one: the others are left out then, as are images
    without a pose. Names are compared as those of two trajectories, see `matching_frames`: those in
    transforms.json begin with a folder.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If it holds no poses, is damaged, or has images without a time beside others with one.
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
    times = _times(images, known)
    if known:
        images, times = _of_timed_folders(images, times)
    unknown = [image.name for image, time in zip(images, times, strict=True) if time is None]
    if known and len(unknown) == len(images):
        raise ValueError(
            f"no image of {path} has a time in the table of frames: it has names such as "
            f"{images[0].name}, the table {next(iter(known))}"
        )
    if known and 0 < len(unknown) < len(images):
        raise ValueError(
            f"{len(unknown)} of {len(images)} images of {path} have no time in the table of "
            f"frames, such as {unknown[0]}"
        )
    if not unknown:
        order = np.argsort(np.array(times, dtype=np.float64), kind="stable")
        stamps = np.array(times, dtype=np.float64)[order]
    else:
        order = np.array(sorted(range(len(images)), key=lambda k: _name_order(images[k].name)))
        stamps = None
    poses = [images[index].cam_from_world.inverse() for index in order]
    frames = posed_frames([images[index].name for index in order], stamps, poses)
    return replace(frames, has_names=kind != "tum")


def _times(images: Sequence[PosedImage], known: Mapping[str, float | None]) -> list[float | None]:
    """Times of images: their own, or those of a table by their names; None where there is none."""
    times = [image.timestamp_s for image in images]
    if not known or None not in times:
        return times
    names = list(known)
    rows, table_rows = _matching_names([image.name for image in images], names)
    for row, table_row in zip(rows, table_rows, strict=True):
        if times[row] is None:
            times[row] = known[names[table_row]]
    return times


def _of_timed_folders(
    images: list[PosedImage], times: list[float | None]
) -> tuple[list[PosedImage], list[float | None]]:
    """Images and times without those of folders in which no image has a time, if others do."""
    parents = [PurePosixPath(image.name).parent for image in images]
    timed = {parent for parent, time in zip(parents, times, strict=True) if time is not None}
    kept = [k for k, parent in enumerate(parents) if parent in timed]
    # Folders of a camera hold several images; where each has its own, none is of another camera.
    if not kept or len(set(parents)) == len(images):
        return images, times
    return [images[k] for k in kept], [times[k] for k in kept]


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
    than ``max_gap_s``. Otherwise names are compared, as they are, then without the folder that all
    have in common and the extension, then without any folder.

    Raises
    ------
    ValueError
        If one side has times only and the other names only, a name fits several frames, or two
        frames of one side have the same time, as those of a rig have.
    """
    if estimate.times_s is not None and truth.times_s is not None:
        _check_times_differ(estimate)
        _check_times_differ(truth)
        return _matching_times(estimate.times_s, truth.times_s, max_gap_s)
    if not (estimate.has_names and truth.has_names):
        sides = ("truth", "estimate") if estimate.has_names else ("estimate", "truth")
        raise ValueError(
            f"the {sides[0]} has times and no names, the {sides[1]} names and no times: give the "
            "times of the images, as a table with the columns image and timestamp_s (--frames)"
        )
    return _matching_names(estimate.names, truth.names)


def _matching_names(
    estimate: Sequence[str], truth: Sequence[str]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    row_of: dict[int, int] = {}  # of the truth -> of the estimate
    for keys, true_keys in _keys_of_names(estimate, truth):
        rows = _rows_by_key(estimate, keys, set(row_of.values()))
        for key, true_rows in _rows_by_key(truth, true_keys, set(row_of)).items():
            several = [(estimate, rows.get(key, [])), (truth, true_rows)]
            for names, which in several if key in rows else ():
                if len(which) > 1:
                    raise ValueError(
                        f"{names[which[0]]} and {names[which[1]]} are both the frame {key}: one of "
                        "them must be left out, or the other file must name the folders"
                    )
            if key in rows:
                row_of[true_rows[0]] = rows[key][0]
    table = np.array(sorted(row_of.items()), dtype=np.intp).reshape(-1, 2)
    return table[:, 1], table[:, 0]


Key = Callable[[str], str]


def _keys_of_names(estimate: Sequence[str], truth: Sequence[str]) -> list[tuple[Key, Key]]:
    """What is compared of the names of both, one after the other, until a name has its frame."""
    inner, true_inner = _inner_name(estimate), _inner_name(truth)
    keys: list[tuple[Key, Key]] = [(str, str), (inner, true_inner)]
    # Where both have several folders, a frame of one folder is none of another.
    if not all(any("/" in key(name) for name in names) for names, key in (
        (estimate, inner), (truth, true_inner),
    )):  # fmt: skip
        keys.append((_stem, _stem))
    return keys


def _inner_name(names: Sequence[str]) -> Key:
    """Name without extension and without the folders that all names begin with."""
    folders = [PurePosixPath(name).parent.parts for name in names]
    depth = next(
        (level for level, parts in enumerate(zip(*folders, strict=False)) if len(set(parts)) > 1),
        min(map(len, folders), default=0),
    )
    return lambda name: "/".join((*PurePosixPath(name).parent.parts[depth:], _stem(name)))


def _stem(name: str) -> str:
    return PurePosixPath(name).stem


def _rows_by_key(names: Sequence[str], key: Key, without: set[int]) -> dict[str, list[int]]:
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        if row not in without:
            rows.setdefault(key(name), []).append(row)
    return rows


def _matching_times(
    estimate: Floats, truth: Floats, max_gap_s: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    nearest, back = _nearest(estimate, truth), _nearest(truth, estimate)
    rows = np.arange(len(truth))
    close = np.abs(estimate[nearest] - truth) <= max_gap_s
    keep = close & (back[nearest] == rows)
    return nearest[keep], rows[keep]


def _check_times_differ(frames: PosedFrames) -> None:
    (same,) = np.nonzero(np.diff([] if frames.times_s is None else frames.times_s) == 0.0)
    if len(same):
        first, second = frames.names[same[0]], frames.names[same[0] + 1]
        raise ValueError(
            f"{first} and {second} have the same time; a trajectory is that of one camera: name "
            "the images of one in the table of frames"
        )


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
