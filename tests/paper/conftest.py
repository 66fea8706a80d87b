# SPDX-License-Identifier: BSD-3-Clause
"""Shared fixtures of the experiments' tests."""

import numpy as np
import pytest

from epi360_paper import protocols


@pytest.fixture
def tiny_landmarks(monkeypatch):
    """Landmarks on a sphere of 3 m about the camera, at once: no room is rendered."""
    directions = np.random.default_rng(0).normal(size=(5000, 3))
    cloud = 3.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    monkeypatch.setattr(protocols, "landmark_clouds", lambda density: (cloud,))
