# SPDX-License-Identifier: BSD-3-Clause
"""Matches and reconstructions in the files of other tools: COLMAP, hloc, OpenSfM, nerfstudio."""

from epi360.interop.match_graph import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.interop.reconstruction import Observations, PosedImage, Reconstruction

__all__ = [
    "MatchGraph",
    "MatchedImage",
    "MatchedPair",
    "Observations",
    "PosedImage",
    "Reconstruction",
    "TwoViewGeometry",
]
