# SPDX-License-Identifier: BSD-3-Clause
"""What a pose says if the cameras' angles are wrong by some percent.

``python benchmarks/wrong_cameras.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from epi360 import estimate_relative_pose
from epi360.cameras import Camera, Equirectangular, KannalaBrandt
from epi360.estimation.calibration_doubt import with_calibration_doubt
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.result import RelativePoseResult, pose_sigmas_deg
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg

Array = NDArray[np.float64]

NUM_MATCHES, WRONG_SHARE = 400, 0.25
NOISE_RAD, MAX_NOISE_DEG = np.radians(0.06), 0.5
ROOM_M = (3.5, 1.4, 2.8)  # half its sides
PANORAMA = Equirectangular(2048, 1024)
LENS = KannalaBrandt(1200, 1200, 360.0, 360.0, 600.0, 600.0)


@dataclass(frozen=True)
class Kind:
    """A camera, what it sees, and what it makes of the bearings that it sees."""

    camera: Camera
    sees: Callable[[Array], NDArray[np.bool_]]
    measured: Callable[[Array], Array]
    yaw_deg: float
    is_first_right: bool = False  # only what the second view measures is wrong


def main() -> int:
    """Print one row for each kind."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--trials", type=int, default=100, help="of each kind (100)")
    parser.add_argument("--seed", type=int, default=0, help="of problems and sampling (0)")
    options = parser.parse_args()
    print(
        f"{'kind':27} {'moved: ok':>9} {'doubted':>8} {'rotation':>9} {'R, t error':>12} "
        f"{'over sigma':>12} {'with doubt':>12} {'other pose':>12} {'turned: ok':>11} "
        f"{'doubted':>8} {'rotation':>9}"
    )
    for name, kind in KINDS.items():
        print(_row(name, kind, options.trials, options.seed), flush=True)
    return 0


def _row(name: str, kind: Kind, trials: int, seed: int) -> str:
    counts = {"moved": [0, 0, 0], "turned": [0, 0, 0]}  # accepted, doubted, only turned
    errors, stated, told, others = [], [], [], []
    for index in range(trials):
        rng = np.random.Generator(np.random.PCG64([seed, zlib.crc32(name.encode()), index]))
        for how, count in counts.items():
            bearings, pose = _matches(kind, rng, moved=how == "moved")
            estimate = partial(
                estimate_relative_pose,
                options=IMAGE_OPTIONS,
                max_noise_deg=MAX_NOISE_DEG,
                seed=seed,
            )
            result = estimate(*bearings)
            if not result.success:
                continue
            later = with_calibration_doubt(
                result, bearings, (kind.camera, kind.camera), estimate
            ).result
            count[0] += 1
            count[1] += later.success and later.warnings != result.warnings
            count[2] += later.status == "pure_rotation"
            if how == "moved":
                errors.append(_errors(result.cam2_from_cam1, pose))
                stated.append(errors[-1] / pose_sigmas_deg(result))
                told.append(_errors(later.cam2_from_cam1, pose) / pose_sigmas_deg(later))
                if later.warnings != result.warnings:
                    others.append(_errors(_other_pose(result, later), pose))
    error, before, after, other = (
        ", ".join(f"{value:.2f}" for value in np.median(each, axis=0)) if each else "-"
        for each in (errors, stated, told, others)
    )
    moved, turned = counts["moved"], counts["turned"]
    return (
        f"{name:27} {moved[0]:9} {moved[1]:8} {moved[2]:9} {error:>12} {before:>12} {after:>12} "
        f"{other:>12} {turned[0]:11} {turned[1]:8} {turned[2]:9}"
    )


def _other_pose(given: RelativePoseResult, later: RelativePoseResult) -> Pose:
    """The pose with other angles, an alternative or the result itself."""
    new = later.alternatives[len(given.alternatives) :]
    return new[-1] if new else later.cam2_from_cam1


def _errors(found: Pose, pose: Pose) -> Array:
    return np.array([rotation_error_deg(found, pose), translation_error_deg(found, pose)])


def _matches(
    kind: Kind, rng: np.random.Generator, *, moved: bool
) -> tuple[tuple[Array, Array], Pose]:
    """Bearings of a room, as the wrong camera gives them, some of them matched with anything."""
    turn = rotation_from_vector(np.radians([rng.normal(), 0.0, rng.normal()]))
    yaw = np.radians(rng.uniform(-kind.yaw_deg, kind.yaw_deg))
    turn = turn @ rotation_from_vector([0.0, yaw, 0.0])
    around = rng.uniform(0.0, 2.0 * np.pi)
    step = rng.uniform(0.3, 1.5) * np.array([np.cos(around), 0.05 * rng.normal(), np.sin(around)])
    pose = Pose(turn, -turn @ (step if moved else 1e-9 * step))
    room = rng.uniform(-1.0, 1.0, (20 * NUM_MATCHES, 3)) * ROOM_M
    room = room[np.linalg.norm(room, axis=1) > 0.8]
    first, second = _unit(room), _unit(room @ turn.T + pose.translation)
    both = kind.sees(first) & kind.sees(second)
    num_right = round((1.0 - WRONG_SHARE) * NUM_MATCHES)
    first, second = first[both][:num_right], second[both][:num_right]
    measure = [kind.measured, kind.measured]
    if kind.is_first_right:
        measure[0] = np.asarray
    measured = [_noisy(rng, how(b)) for how, b in zip(measure, (first, second), strict=True)]
    for view in range(2):
        anything = _unit(rng.normal(size=(20 * NUM_MATCHES, 3)))
        wrong = measure[view](anything[kind.sees(anything)])[: NUM_MATCHES - num_right]
        measured[view] = np.concatenate([measured[view], wrong])
    return (measured[0], measured[1]), pose


def _lens(scale: float, distortion: float = 0.0, field_deg: float = 190.0) -> Kind:
    """A lens whose angles seem to be larger by a factor, or more so further out."""
    least = np.cos(np.radians(field_deg / 2.0))

    def measured(b: Array) -> Array:
        angle = np.arctan2(np.hypot(b[:, 0], b[:, 1]), b[:, 2]) * scale
        angle *= 1.0 + distortion * angle**2
        around = np.arctan2(b[:, 1], b[:, 0])
        across = np.sin(angle)
        return np.stack([across * np.cos(around), across * np.sin(around), np.cos(angle)], axis=1)

    return Kind(LENS, lambda b: np.asarray(b[:, 2] > least), measured, 40.0)


def _panorama(degrees: float = 360.0, height: float = 1.0, lowest: float = 90.0) -> Kind:
    """A panorama of so many degrees that is taken for a whole one, and stretched upwards.

    Or one that ends ``lowest`` degrees below the horizon.
    """
    middle = np.radians(90.0 - lowest) / 2.0
    height *= 180.0 / (90.0 + lowest)

    def longitudes(b: Array) -> Array:
        return np.asarray(np.arctan2(b[:, 0], b[:, 2]))

    def measured(b: Array) -> Array:
        wider = longitudes(b) * 360.0 / degrees
        down = (np.arcsin(b[:, 1]) + middle) * height
        down = np.clip(down, -np.pi / 2.0, np.pi / 2.0)
        across = np.cos(down)
        return np.stack([across * np.sin(wider), np.sin(down), across * np.cos(wider)], axis=1)

    half = np.radians(degrees / 2.0)
    below = np.sin(np.radians(lowest))

    def sees(b: Array) -> NDArray[np.bool_]:
        return (np.abs(longitudes(b)) < half) & (b[:, 1] <= below)

    return Kind(PANORAMA, sees, measured, 180.0)


def _noisy(rng: np.random.Generator, bearings: Array) -> Array:
    noise = NOISE_RAD * rng.normal(size=bearings.shape)
    return _unit(bearings + noise)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


KINDS = {
    "lens, right": _lens(1.0),
    "lens of 100 deg, right": _lens(1.0, field_deg=100.0),
    **{f"lens, angles {c:+.0%}": _lens(1.0 + c) for c in (0.02, 0.05, -0.05, 0.1, -0.1)},
    "lens, distorted": _lens(1.0, 0.03),
    "lens of 100 deg, +5%": _lens(1.05, field_deg=100.0),
    "panorama, right": _panorama(),
    **{f"{d} deg taken for 360": _panorama(d) for d in (350, 330)},
    **{f"heights {c:+.0%}": _panorama(height=1.0 + c) for c in (-0.05, -0.2)},
    **{f"cut {c} deg from the bottom": _panorama(lowest=90.0 - c) for c in (5, 18, 36)},
    **{
        f"image 2 cut {c} deg": replace(_panorama(lowest=90.0 - c), is_first_right=True)
        for c in (5, 18, 36)
    },
}


if __name__ == "__main__":
    sys.exit(main())
