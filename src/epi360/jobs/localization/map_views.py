# SPDX-License-Identifier: BSD-3-Clause
"""A model with the features of its images and the points that they show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epi360.cameras import Camera
from epi360.features import Features, match_features
from epi360.interop.reconstruction import Reconstruction
from epi360.jobs.localization.feature_sources import FeatureSource
from epi360.jobs.localization.kept_index import index_key, read_index, write_index
from epi360.jobs.localization.point_errors import point_covariances, world_rays
from epi360.jobs.localization.view_index import ViewIndex
from epi360.odometry.points import triangulate_tracks
from epi360.poses import Pose
from epi360.runs.made_from import fingerprint

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_LARGEST = 1e100  # of a coordinate, whatever its unit: its square is a number
_VIEWS_IN_MEMORY = 64  # of 6 MB each
_IN_MEMORY = "view", "_features"
_TO_SAME_PIXEL = 0.02  # px: key points in single precision
# Share of an image's observations that must be key points of its features, and of the images that
# must have features.
_FEWEST_FOUND = 0.5
_NO_FEATURES = Features(np.zeros((0, 2)), np.zeros((0, 0), np.float32), np.zeros(0))
# For features without points: images that see most of the same points, and how well rays meet.
_NUM_NEIGHBOURS = 5
_MEETING_RAD, _LEAST_PARALLAX_RAD = 0.006, 0.01
NO_POINT = -1


@dataclass(frozen=True, eq=False)
class MapView:
    """An image of a map: its features, and of each the point (N, 3) or NaN, its id or -1."""

    name: str
    camera: Camera
    cam_from_world: Pose
    features: Features
    points: Array
    covariances: Array
    ids: Indices

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """Features with a point."""
        return np.flatnonzero(np.isfinite(self.points[:, 0]))

    @cached_property
    def known(self) -> Features:
        """Those features."""
        return self.features.chosen(self.rows)


class LocalizationMap:
    """A model in which new images get a pose; `load_map` reads one.

    Features of its images are read, or found, when they are needed, and 64 images stay in memory.
    The index over all of them is kept in ``index_file``, if that is given.
    """

    def __init__(
        self,
        model: Reconstruction,
        source: FeatureSource,
        name: str = "the map",
        index_file: Path | None = None,
    ) -> None:
        seen = model.observations
        if seen is None or not len(model.points):
            raise ValueError(f"{name} has no points with observations; triangulate them first")
        places = [image.cam_from_world.translation for image in model.images]
        if max(np.abs(each).max(initial=0.0) for each in (model.points, places)) > _LARGEST:
            raise ValueError(f"{name} must have coordinates of {_LARGEST:g} at most, got more")
        self.model = model
        self.name = name
        self.source = source
        self._index_file = index_file
        order = np.argsort(seen.images, kind="stable")
        starts = np.searchsorted(seen.images[order], np.arange(len(model.images) + 1))
        self._observations = [order[starts[k] : starts[k + 1]] for k in range(len(model.images))]
        self._covariances = point_covariances(model)
        self._remember()

    def _remember(self) -> None:
        self.view = lru_cache(_VIEWS_IN_MEMORY)(self._view)
        self._features = lru_cache(_VIEWS_IN_MEMORY)(self._features_of)

    def __getstate__(self) -> dict[str, Any]:
        """All but the views in memory, which another process finds itself."""
        return {name: value for name, value in vars(self).items() if name not in _IN_MEMORY}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Begin with no views in memory."""
        vars(self).update(state)
        self._remember()

    def camera_of_size(self, width: int, height: int) -> Camera | None:
        """The only camera of the map with this size, or None.

        Parameters
        ----------
        width, height : int
            Size of an image in pixels.
        """
        fitting = self.names_of_size(width, height)
        return self.model.cameras[fitting[0]] if len(fitting) == 1 else None

    def names_of_size(self, width: int, height: int) -> list[str]:
        """Names of the cameras of the map with this size.

        Parameters
        ----------
        width, height : int
            Size of an image in pixels.
        """
        return [
            name
            for name, camera in self.model.cameras.items()
            if (camera.width, camera.height) == (width, height)
        ]

    def similar_views(self, features: Features) -> list[int]:
        """Numbers of the images of the map, those that look most like these features first.

        Parameters
        ----------
        features : Features
            Of a new image, found as those of the map.

        Raises
        ------
        ValueError
            If the features of the map are missing, or not of the same kind.
        """
        if not len(features):
            return []
        index, numbers = self._index
        return [numbers[k] for k in index.most_similar(features.descriptors)]

    def covisible(self, number: int, least: int = 1) -> list[int]:
        """Other images that see points of an image, those with most of them first.

        Parameters
        ----------
        number : int
            Row of the image in the model.
        least : int
            Points that both must see.
        """
        seen = self.model.observations
        assert seen is not None
        counts = self.num_seen(seen.points[self._observations[number]])
        counts[number] = 0
        order = np.argsort(-counts, kind="stable")
        return [int(k) for k in order[: np.count_nonzero(counts >= max(least, 1))]]

    def num_seen(self, points: Indices) -> Indices:
        """How many of some points each image sees; numbers beyond those of the model count not.

        Parameters
        ----------
        points : ndarray, shape (N,)
            Rows of the model's points.
        """
        seen = self.model.observations
        assert seen is not None
        is_one = np.zeros(len(self.model.points), dtype=bool)
        is_one[points[points < len(is_one)]] = True
        counts = np.bincount(seen.images[is_one[seen.points]], minlength=len(self.model.images))
        return counts

    @cached_property
    def centers(self) -> Array:
        """Centre (I, 3) of each camera in the world."""
        poses = [image.cam_from_world for image in self.model.images]
        return np.array([pose.inverse().translation for pose in poses])

    def made_from(self) -> str:
        """Hash of the model and of what its features are made from."""
        seen, model = self.model.observations, self.model
        assert seen is not None
        names = [image.name for image in model.images]
        poses = np.array([image.cam_from_world.matrix() for image in model.images])
        cameras = [self._camera(number) for number in range(len(names))]
        arrays = model.points, seen.points, seen.images, seen.pixels, poses
        return fingerprint((names, cameras, self.source.made_from(names)), *arrays)

    @cached_property
    def _index(self) -> tuple[ViewIndex, list[int]]:
        """Index of the images that have points and features, and their numbers."""
        with_points = [number for number, rows in enumerate(self._observations) if len(rows)]
        if self._index_file is None:
            return self._made_index(with_points)
        names = [self.model.images[number].name for number in with_points]
        cameras = [self._camera(number) for number in with_points]
        key = index_key(with_points, names, cameras, self.source.made_from(names))
        kept = read_index(self._index_file, key, len(self.model.images))
        if kept is None:
            kept = self._made_index(with_points)
            write_index(self._index_file, key, *kept)
        return kept

    def _made_index(self, with_points: list[int]) -> tuple[ViewIndex, list[int]]:
        numbers: list[int] = []

        def descriptors() -> Iterator[NDArray[np.float32]]:
            for number in with_points:
                if len(found := self._features(number).descriptors):
                    numbers.append(number)
                    yield found
            if len(numbers) < _FEWEST_FOUND * len(with_points):
                lost = self.model.images[min(set(with_points) - set(numbers))].name
                others = len(with_points) - len(numbers) - 1
                raise ValueError(
                    f"{self.name} has no features of {lost} and {others} other images; "
                    f"{self.source.remedy}"
                )

        return ViewIndex.of(descriptors()), numbers

    def _features_of(self, number: int) -> Features:
        image = self.model.images[number]
        # An image that was localized in the map may have none: nothing is matched with it.
        return self.source.of_map(image.name, self._camera(number)) or _NO_FEATURES

    def _camera(self, number: int) -> Camera:
        return self.model.cameras[str(self.model.images[number].camera)]

    def _view(self, number: int) -> MapView:
        features = self._features(number)
        if self.source.are_of_the_points or not len(features):
            points, covariances, ids = self._points_of_model(number, features)
        else:
            points, covariances, ids = self._points_of_rays(number, features)
        image = self.model.images[number]
        return MapView(
            image.name,
            self._camera(number),
            image.cam_from_world,
            features,
            points,
            covariances,
            ids,
        )

    def _points_of_model(self, number: int, features: Features) -> tuple[Array, Array, Indices]:
        """Points of the features that stand at the pixel of an observation."""
        seen = self.model.observations
        assert seen is not None
        rows = self._observations[number]
        points, covariances, ids = _no_points(len(features))
        if not len(rows) or not len(features):
            return points, covariances, ids
        apart, nearest = cKDTree(seen.pixels[rows]).query(features.keypoints)
        # All key points at one pixel, which have other directions or sizes, show the same point.
        same = apart < _TO_SAME_PIXEL
        if len(np.unique(nearest[same])) < _FEWEST_FOUND * len(
            np.unique(seen.pixels[rows], axis=0)
        ):
            raise ValueError(
                f"the features of {self.model.images[number].name} are not those that {self.name} "
                f"was made from; {self.source.remedy}"
            )
        ids[same] = seen.points[rows[nearest[same]]]
        points[same], covariances[same] = self.model.points[ids[same]], self._covariances[ids[same]]
        return points, covariances, ids

    def _points_of_rays(self, number: int, features: Features) -> tuple[Array, Array, Indices]:
        """Points where the rays of the features meet those of the images around."""
        poses = [image.cam_from_world for image in self.model.images]
        chosen = [np.arange(len(features))]
        rays = [world_rays(self._camera(number), poses[number], features.keypoints)]
        centers = [np.tile(poses[number].inverse().translation, (len(features), 1))]
        for other in self.covisible(number)[:_NUM_NEIGHBOURS]:
            others = self._features(other)
            matches = match_features(features, others)
            seen = world_rays(self._camera(other), poses[other], others.keypoints[matches[:, 1]])
            center = poses[other].inverse().translation
            fits = _off_plane(rays[0][matches[:, 0]], seen, center - centers[0][0]) < _MEETING_RAD
            chosen.append(matches[fits, 0])
            rays.append(seen[fits])
            centers.append(np.tile(center, (int(fits.sum()), 1)))
        tracks, all_centers = np.concatenate(chosen), np.concatenate(centers)
        found = triangulate_tracks(all_centers, np.concatenate(rays), tracks, len(features))
        good = found.in_front & (found.residual_rad < _MEETING_RAD)
        good &= found.parallax_rad > _LEAST_PARALLAX_RAD
        points, covariances, ids = _no_points(len(features))
        points[good] = found.points[good]
        noise = float(np.median(found.residual_rad[good])) if good.any() else _MEETING_RAD
        covariances[good] = _covariances_of_rays(
            found.points, all_centers, tracks, max(noise, 1e-5)
        )[good]
        ids[good] = len(self.model.points) + number * 10**6 + np.flatnonzero(good)
        return points, covariances, ids


def _no_points(count: int) -> tuple[Array, Array, Indices]:
    return (
        np.full((count, 3), np.nan),
        np.zeros((count, 3, 3)),
        np.full(count, NO_POINT, dtype=np.int64),
    )


def _off_plane(rays1: Array, rays2: Array, baseline: Array) -> Array:
    """Angle of each ray of camera 2 out of the plane of the baseline and the ray of camera 1."""
    normals = np.cross(np.broadcast_to(baseline, rays1.shape), rays1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.abs(np.arcsin(np.clip(np.einsum("ni,ni->n", normals, rays2), -1, 1))))


def _covariances_of_rays(points: Array, centers: Array, tracks: Indices, noise: float) -> Array:
    """Covariance (T, 3, 3) of each track's point by the noise of its rays (radians)."""
    away = points[tracks] - centers
    distances = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    u = away / distances[:, None]
    across = np.eye(3) - u[:, :, None] * u[:, None, :]
    information = np.zeros((len(points), 3, 3))
    known = np.isfinite(away[:, 0])
    np.add.at(information, tracks[known], (across / (distances * noise)[:, None, None] ** 2)[known])
    scale = np.maximum(np.trace(information, axis1=1, axis2=2), 1e-300)[:, None, None]
    return np.asarray(np.linalg.inv(information + 1e-9 * scale * np.eye(3)))
