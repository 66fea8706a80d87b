# SPDX-License-Identifier: BSD-3-Clause
"""Where images were taken, as their GPS or a trajectory says, and which were taken near others."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epi360.features.image_headers import read_image_header
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.frames.frame_source import FRAMES_TABLE, read_frame_times
from epi360.jobs.trajectories import (
    PosedFrames,
    matching_frames,
    posed_frames,
    read_trajectory,
)
from epi360.poses import Pose

Pair = tuple[int, int]
_EARTH_RADIUS_M = 6371008.8  # mean radius (IUGG); within 0.6 % of any distance on the ellipsoid
_MAX_GAP_S = 0.01  # between the times of an image and of its pose, as `epi360 evaluate` has it
_NUMBER, _NANOSECONDS = re.compile(r"\d+(\.\d*)?"), 1e14  # in seconds: in three million years


@dataclass(frozen=True, eq=False)
class Positions:
    """Place (N, 3) of each image, NaN where it is not known, and where that comes from, in words.

    The unit is that of the trajectory, or metres.
    """

    centers: NDArray[np.float64]
    source: str

    @property
    def num_unknown(self) -> int:
        """Images without a place."""
        return int(np.isnan(self.centers[:, 0]).sum())


def positions_of_images(images: ImageSet, trajectory: Path | None) -> Positions:
    """Where images were taken: by their GPS, or by a trajectory or model with their poses.

    The rows of a trajectory without names are found by the times of the images: those of
    ``frames.csv`` beside them, or else the numbers that their names are, in seconds or nanoseconds.

    Raises
    ------
    FileNotFoundError
        If the trajectory does not exist.
    ValueError
        If no image has a place, or the trajectory cannot be read.
    """
    if trajectory is not None:
        return _of_trajectory(images, trajectory)
    places = [read_image_header(image.path).latitude_longitude_deg for image in images.images]
    if not any(places):
        raise ValueError(
            f"none of the {len(places)} images has GPS in its Exif metadata; give their poses with "
            "--positions FILE, or choose other --pairs"
        )
    centers = np.array([_on_sphere(*place) if place else [np.nan] * 3 for place in places])
    return Positions(centers, "GPS")


def near_pairs(
    centers: NDArray[np.float64],
    count: int,
    radius: float | None,
    *,
    without: Collection[Pair] = (),
) -> list[Pair]:
    """Pairs (a, b), a < b, of each image with the ``count`` nearest, not farther than ``radius``.

    Images without a place, whose rows (N, 3) are NaN, get none. Pairs in ``without`` are passed
    over: the next ones take their place.
    """
    known = np.flatnonzero(np.isfinite(centers).all(axis=1))
    if len(known) < 2:
        return []
    passed: list[set[int]] = [{index} for index in range(len(centers))]
    for first, second in without:
        passed[first].add(second)
        passed[second].add(first)
    tree = cKDTree(centers[known])
    chosen = set()
    for index in known.tolist():
        asked = min(count + len(passed[index]), len(known))
        distances, rows = tree.query(
            centers[index], k=np.arange(1, asked + 1), distance_upper_bound=_beyond(radius)
        )
        others = known[rows[np.isfinite(distances)]].tolist()
        fresh = [other for other in others if other not in passed[index]][:count]
        chosen |= {(min(index, other), max(index, other)) for other in fresh}
    return sorted(chosen)


def _beyond(radius: float | None) -> float:
    """Bound that a distance of exactly ``radius`` is still below."""
    return np.inf if radius is None else float(np.nextafter(radius, np.inf))


def _on_sphere(latitude_deg: float, longitude_deg: float) -> list[float]:
    """Place on the earth, in metres. Heights of GPS are too poor to count."""
    latitude, longitude = np.radians((latitude_deg, longitude_deg))
    across = np.cos(latitude)
    direction = (across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude))
    return [_EARTH_RADIUS_M * float(each) for each in direction]


def _of_trajectory(images: ImageSet, path: Path) -> Positions:
    poses = read_trajectory(path)
    names = [image.name for image in images.images]
    indices, rows = (_same_names if poses.has_names else _same_times)(images, names, poses)
    if len(indices) == 0:
        raise ValueError(
            f"none of the {len(poses)} poses of {path} is that of an image of {images.folder}; "
            "names, or times, must be the same"
        )
    centers = np.full((len(names), 3), np.nan)
    centers[indices] = poses.positions[rows]
    return Positions(centers, str(path))


def _same_names(
    _: ImageSet, names: Sequence[str], poses: PosedFrames
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    nowhere = posed_frames(list(names), None, [Pose.nan()] * len(names))
    rows, indices = matching_frames(replace(poses, times_s=None), nowhere, _MAX_GAP_S)
    return indices, rows


def _same_times(
    images: ImageSet, names: Sequence[str], poses: PosedFrames
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    times = _times_of(names, read_frame_times(images.folder))
    if np.isnan(times).all():
        raise ValueError(
            f"the images have no times: put a table {FRAMES_TABLE} with the columns image and "
            f"timestamp_s into {images.folder}, or give a model with their names"
        )
    assert poses.times_s is not None
    middles = (poses.times_s[1:] + poses.times_s[:-1]) / 2
    nearest = np.searchsorted(middles, times)
    indices = np.flatnonzero(np.abs(poses.times_s[nearest] - times) <= _MAX_GAP_S)
    return indices, nearest[indices]


def _times_of(names: Sequence[str], table: Mapping[str, float | None]) -> NDArray[np.float64]:
    """Time of each image in seconds; NaN where neither the table nor the name says it."""
    listed = [table.get(name) for name in names]
    stems = [PurePosixPath(name).stem for name in names]
    numbers = [float(stem) if _NUMBER.fullmatch(stem) else np.nan for stem in stems]
    seconds = [each * 1e-9 if each > _NANOSECONDS else each for each in numbers]
    return np.array(
        [second if time is None else time for time, second in zip(listed, seconds, strict=True)]
    )
