# SPDX-License-Identifier: BSD-3-Clause
"""Whether a picture shows the part of the map in which its points say that it was taken.

In a place that repeats itself, as a corridor with equal doors, the points of one door agree with
those of the next. Where nothing but them says that a frame is in the map (frames are missing before
it, the map was lost, or a loop is closed), what is around them in the pictures is asked as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.estimation.result import LEAST_PROBABILITY
from epi360.features.binary_features import BinaryFeatures
from epi360.features.picture_writing import encode_picture
from epi360.features.warped_patches import Panorama
from epi360.odometry.frame_result import FrameTracks, shared_rows
from epi360.odometry.key_frames import SparseMap
from epi360.odometry.map_parts import PartOfMap
from epi360.odometry.mapping import Noise
from epi360.odometry.relocalization import Relocalization
from epi360.places.corridor import shown_by_itself
from epi360.places.own_evidence import grow_both
from epi360.places.same_place import SURE, can_be_compared, same_place, same_place_in_doubt
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose, angles_of_units

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

# Of a key frame that is asked: points in common, and their median parallax, also in units of their
# noise. Without parallax there is no distance at which anything could be looked for.
_FEWEST_COMMON, _LEAST_PARALLAX_DEG, _LEAST_PARALLAX_SIGMAS = 10, 0.5, 5.0
_JPEG_QUALITY = 90  # 40 to 80 kB a key frame


@dataclass(frozen=True, eq=False)
class SharedView:
    """What a frame shares with a key frame: its pose relative to it, and bearings in both."""

    key_frame: int
    frame_from_key: Pose
    bearings: tuple[Array, Array]
    noise_deg: float

    @property
    def has_parallax(self) -> bool:
        """Whether the frame was clearly taken elsewhere than the key frame."""
        first, second = self.bearings
        turned = first @ self.frame_from_key.rotation.T
        parallax_deg = float(np.degrees(np.median(angles_of_units(turned, second))))
        return parallax_deg > max(_LEAST_PARALLAX_DEG, _LEAST_PARALLAX_SIGMAS * self.noise_deg)

    @classmethod
    def of_relocalization(
        cls,
        found: Relocalization,
        key_from_world: Pose,
        key_features: BinaryFeatures,
        features: BinaryFeatures,
    ) -> SharedView:
        """View of the key frame by which a frame was found again."""
        first, second = found.matches[found.pose.inlier_mask].T
        return cls(
            found.key_frame,
            found.pose.cam_from_world @ key_from_world.inverse(),
            (key_features.bearings[first], features.bearings[second]),
            float(np.degrees(found.pose.noise_rad)),
        )


class Surroundings:
    """Pictures of the key frames of one map, and what they say of later ones."""

    def __init__(self, camera: Camera, mask: NDArray[np.bool_] | None) -> None:
        self._camera, self._mask = camera, mask
        self._is_used = can_be_compared(camera)
        self._pictures: dict[int, bytes] = {}  # compressed

    def add(self, number: int, gray: Picture) -> None:
        """Remember the picture of a key frame."""
        if self._is_used:
            self._pictures[number] = encode_picture(gray, ".jpg", jpeg_quality=_JPEG_QUALITY)

    def has_picture(self, number: int) -> bool:
        """Whether the picture of a key frame is remembered."""
        return number in self._pictures

    def picture(self, number: int) -> Picture | None:
        """Picture of a key frame, if it is remembered."""
        if not self.has_picture(number):
            return None
        content = np.frombuffer(self._pictures[number], np.uint8)
        return np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE), np.uint8)

    def take_in(self, other: Surroundings, own_part: PartOfMap, other_part: PartOfMap) -> None:
        """Take in the pictures of another map that has become a part of this one."""
        own, others = own_part.renumbered(self._pictures), other_part.renumbered(other._pictures)
        self._pictures = dict(sorted((own | others).items()))

    def best_view(
        self, sparse_map: SparseMap, tracks: FrameTracks, pose: Pose, noise: Noise
    ) -> SharedView | None:
        """View of the key frame that has most landmarks in common with a frame, if enough."""
        landmarks = sparse_map.landmarks_of(tracks.ids)
        rays = sparse_map.positions_of(landmarks) @ pose.rotation.T + pose.translation
        rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
        agrees = angles_of_units(rays, tracks.bearings) < noise.outlier_rad  # not if it has none
        landmarks, bearings = landmarks[agrees], tracks.bearings[agrees]
        best, most = None, _FEWEST_COMMON - 1
        for number in self._pictures:
            key_frame = sparse_map.key_frames[number]
            rows1, rows2 = shared_rows(key_frame.ids, landmarks)
            if len(rows1) <= most or key_frame.index >= tracks.index:
                continue
            view = SharedView(
                number,
                pose @ key_frame.cam_from_world.inverse(),
                (key_frame.bearings[rows1], bearings[rows2]),
                float(np.degrees(noise.sigma_rad)),
            )
            if view.has_parallax:
                best, most = view, len(rows1)
        return best

    def deny(self, gray: Picture, view: SharedView | None, *, in_doubt: bool = False) -> bool:
        """Whether a picture seems to show another place than its pose says.

        If nothing is known, it does not. ``in_doubt``, after another frame seemed to show another
        place, or where nothing else says where it is, it must be sure that it does not, though
        another place and a copy are thought as probable as not.
        """
        old = None if view is None else self.picture(view.key_frame)
        if view is None or old is None or not view.has_parallax:
            return in_doubt
        relative = view.frame_from_key
        length = float(np.linalg.norm(relative.translation))
        rows = np.arange(len(view.bearings[0]))
        pair = PosedPair.of(
            (0, 1),
            Pose(relative.rotation, relative.translation / length),
            np.column_stack([rows, rows]),
            view.bearings,
            noise_deg=view.noise_deg,
        )
        panoramas = self._panorama(old), self._panorama(gray)
        views = grow_both(pair, panoramas, num_threads=2)
        own = shown_by_itself(pair, views, panoramas, is_corridor=in_doubt)
        if not own.is_known:
            return in_doubt
        if in_doubt:
            return same_place_in_doubt(own).here < SURE
        return same_place(own).here < LEAST_PROBABILITY

    def _panorama(self, gray: Picture) -> Panorama:
        image = np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2RGB), np.uint8)
        return Panorama.seen_by(self._camera, image, self._mask)
