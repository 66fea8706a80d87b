# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of frames with key points tracked between them: the data of Tables 1 to 3.

From a frame on, about 200 Shi-Tomasi corners are followed until the camera is 0.5 m away (paper
section 5.2). Tracks are kept in files named by what they depend on, for all tables and later runs.
"""

import hashlib
import io
import zipfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.epipolar import angular_residuals, essential_from_pose
from epi360.features import track_features
from epi360.poses import Pose
from epi360.runs.whole_files import write_file
from epi360_paper.datasets import ImageSequence

Array = NDArray[np.float64]

# Pairs share most of their images; each image is read once as long as it is among the last ones.
KEPT_IMAGES = 64
TRACKS_VERSION = 1  # raise it when the tracker or the renderer changes: old files are left alone


@dataclass(frozen=True)
class PairRule:
    """Which frames make a pair and how many tracks it has."""

    min_baseline_m: float = 0.5  # distance of the two cameras (paper, section 5.2)
    # Most tracks of a pair: the strongest corners that lived (paper: around 200).
    num_tracks: int = 200
    # Corners to start with: of 300 more than 200 are alive after 0.5 m in a room.
    num_corners: int = 300
    # At this distance between corners a fisheye lens before a bare wall finds 200 as well.
    min_distance_deg: float = 1.5
    # A track is lost if tracking it back misses its start by more. Infinite by default: neither the
    # paper nor the settings in the authors' code name such a test.
    forward_backward_px: float = np.inf
    min_tracks: int = 50  # a pair with fewer is left out
    max_frames: int = 60  # longest way from one frame of a pair to the other
    stride: int = 1  # frames from one reference to the next


@dataclass(frozen=True, eq=False)
class BearingPair:
    """Tracks between two frames and the truth between them."""

    frame1: int  # number in the sequence
    frame2: int
    # (N, 3): unit vectors; row i of both is one track.
    bearings1: Array
    bearings2: Array
    cam2_from_cam1: Pose  # true pose, metric

    def true_residuals_rad(self) -> Array:
        """Angle of each track out of its true epipolar plane, shape (N,)."""
        E = essential_from_pose(self.cam2_from_cam1)
        return np.abs(angular_residuals(E, self.bearings1, self.bearings2))


def pairs_of_frames(
    image: Callable[[int], NDArray[np.uint8]],
    world_from_cam: Sequence[Pose | None],
    camera: Camera,
    rule: PairRule,
    *,
    mask: NDArray[np.bool_] | None = None,
    segments: Iterable[range] | None = None,
    first_frames: range | None = None,
) -> list[BearingPair]:
    """Pairs of a sequence, in the order of their first frames."""
    everything = range(len(world_from_cam))
    first_frames = everything if first_frames is None else first_frames
    kept_image = lru_cache(KEPT_IMAGES)(image)
    pairs = []
    for segment in segments if segments is not None else [everything]:
        for start in segment[:: rule.stride]:
            stop = _far_frame(world_from_cam, start, segment, rule)
            if stop is None or start not in first_frames:
                continue
            tracks = track_features(
                map(kept_image, range(start, stop + 1)),
                camera,
                mask,
                max_features=rule.num_corners,
                min_distance_deg=rule.min_distance_deg,
                forward_backward_px=rule.forward_backward_px,
            )
            pixels = tracks.keypoints[[0, -1]][:, tracks.visible[-1]][:, : rule.num_tracks]
            if pixels.shape[1] >= rule.min_tracks:
                b1, b2 = map(camera.bearings_from_pixels, pixels)
                world_from_cam1, world_from_cam2 = world_from_cam[start], world_from_cam[stop]
                assert world_from_cam1 is not None and world_from_cam2 is not None  # by _far_frame
                truth = world_from_cam2.inverse() @ world_from_cam1
                pairs.append(BearingPair(start, stop, b1, b2, truth))
    return pairs


def sequence_key(sequence: ImageSequence) -> str:
    """Text that changes with the images, poses, camera, mask or grey levels of a sequence."""
    files = [(path.name, path.stat().st_size) for path in sequence.image_paths]
    numbers = [
        b"none" if pose is None else pose.matrix().tobytes() for pose in sequence.world_from_cam
    ]
    digest = hashlib.sha256(b"".join(numbers))
    if sequence.mask is not None:
        digest.update(np.packbits(sequence.mask).tobytes())
    return repr((sequence.name, sequence.camera, sequence.levels, files, digest.hexdigest()))


def cached_pairs(
    folder: Path, key: str, make: Callable[[], list[BearingPair]]
) -> list[BearingPair]:
    """Pairs from a file; if it is missing, they are made and written."""
    name = hashlib.sha256(f"{TRACKS_VERSION} {key}".encode()).hexdigest()[:24]
    path = folder / f"{name}.npz"
    kept = _read_pairs(path)
    if kept is not None:
        return kept
    pairs = make()
    folder.mkdir(parents=True, exist_ok=True)
    _write_pairs(path, pairs)
    return pairs


def _far_frame(
    world_from_cam: Sequence[Pose | None], start: int, segment: range, rule: PairRule
) -> int | None:
    """First frame of a segment that is far enough from one of its frames."""
    first = world_from_cam[start]
    for index in range(start + 1, min(segment.stop, start + rule.max_frames + 1)):
        later = world_from_cam[index]
        if first is None or later is None:
            return None
        if np.linalg.norm(later.translation - first.translation) >= rule.min_baseline_m:
            return index
    return None


def _write_pairs(path: Path, pairs: list[BearingPair]) -> None:
    poses = [pair.cam2_from_cam1.matrix() for pair in pairs]
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        frames=np.array([(pair.frame1, pair.frame2) for pair in pairs], int).reshape(-1, 2),
        counts=np.array([len(pair.bearings1) for pair in pairs], int),
        bearings=np.concatenate(
            [np.empty((0, 6)), *(np.hstack([pair.bearings1, pair.bearings2]) for pair in pairs)]
        ),
        poses=np.array(poses).reshape(-1, 4, 4),
    )
    write_file(path, buffer.getvalue())


def _read_pairs(path: Path) -> list[BearingPair] | None:
    try:
        with np.load(path) as arrays:
            frames, counts, bearings, poses = (
                arrays[name] for name in ("frames", "counts", "bearings", "poses")
            )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    pieces = np.split(bearings, np.cumsum(counts)[:-1])
    return [
        BearingPair(
            int(frame1),
            int(frame2),
            np.ascontiguousarray(piece[:, :3]),
            np.ascontiguousarray(piece[:, 3:]),
            Pose.from_matrix(pose),
        )
        for (frame1, frame2), piece, pose in zip(frames, pieces, poses, strict=False)
    ]
