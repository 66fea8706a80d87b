# SPDX-License-Identifier: BSD-3-Clause
"""Evidence made by hand, and matches of the five kinds that a verdict compares."""

from typing import Any

import numpy as np
from noisy_problems import noisy_scene
from numpy.typing import NDArray

from epi360 import _core
from epi360.poses import rotation_from_vector

Matches = tuple[NDArray[np.float64], NDArray[np.float64]]


def made_evidence(**changes: Any) -> Any:
    """Evidence of a sound pose: 60 of 100 matches agree, from everywhere, with much parallax."""
    sound = {
        "num_matches": 100,
        "num_usable": 100,
        "num_effective": 100,
        "support": 60,
        "log10_false_alarms": -50.0,
        "chance": 0.02,
        "parallax": 0.2,
        "scale": 0.002,
        "num_distinct": 60,
        "min_num_inliers": 6,
        "spread": 0.8,
        "spread_of_matches": 0.9,
        "coverage": 0.7,
        "match_coverage": 0.9,
        "noise": 0.002,
    }
    made = _core.internals.Evidence()
    for name, value in (sound | changes).items():
        setattr(made, name, value)
    return made


def turned(seed: int, num_matches: int = 200, noise_deg: float = 0.1) -> Matches:
    rng = np.random.default_rng(seed)
    b1 = rng.normal(size=(num_matches, 3))
    b1 /= np.linalg.norm(b1, axis=1, keepdims=True)
    b2 = b1 @ rotation_from_vector([0.2, 0.7, -0.1]).T
    noise = np.radians(noise_deg)
    return b1 + noise * rng.normal(size=b1.shape), b2 + noise * rng.normal(size=b2.shape)


def unrelated(seed: int, num_matches: int = 200) -> Matches:
    b1, b2 = np.random.default_rng(seed).normal(size=(2, num_matches, 3))
    return b1, b2


def on_a_plane(seed: int) -> Matches:
    scene = noisy_scene(seed, 0.3, 0.2, layout="plane", num_matches=300)
    return scene.bearings1, scene.bearings2


def in_a_room(seed: int) -> Matches:
    scene = noisy_scene(seed, 0.1, 0.4, num_matches=300)
    return scene.bearings1, scene.bearings2


def of_two_motions(seed: int) -> Matches:
    """Half of the matches are from one motion of the camera, half from another."""
    scenes = [noisy_scene(1000 * k + seed, 0.1, num_matches=120) for k in (0, 1)]
    b1, b2 = (np.concatenate([getattr(s, name) for s in scenes]) for name in BEARINGS)
    return b1, b2


BEARINGS = ("bearings1", "bearings2")
